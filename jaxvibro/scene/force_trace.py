"""Trace a force with JAX and find its operations without a Taylor series."""

from functools import lru_cache

from jax.extend import core

from .force import trace_jaxpr

SERIES_OPS = """add add_any sub mul div neg square integer_pow pow sqrt rsqrt cbrt exp exp2 expm1 log log1p sin cos sinh
cosh tan tanh logistic erf erfc asin acos atan asinh acosh atanh atan2 copy"""  # with rules in `flight.series`
SERIES_OPS_SET = frozenset(SERIES_OPS.split())
INNER_KEYS = ("jaxpr", "call_jaxpr")  # parameters that hold the jaxpr of an inner function
LOOP_OPERATIONS = ("while", "scan", "cond")  # operations with inner functions that do not simply run once
CONST_OPS = """abs sign max min floor ceil round select_n clamp is_finite not and or eq ne lt le gt ge rem stop_gradient
convert_element_type"""  # further operations that are allowed on constants
CONST_OPS_SET = frozenset(CONST_OPS.split())

cached_jaxpr = lru_cache(256)(trace_jaxpr)


@lru_cache(256)
def ops_without_series(function, names, dtype, n_arguments=3):
    """Return the names of the operations of a force without a known Taylor series.

    Parameters
    ----------
    function : callable
        The force.
    names : tuple of str
        Names of its parameters.
    dtype : dtype
        Floating-point type.
    n_arguments : int, optional
        Number of arguments before the parameters.

    Returns
    -------
    tuple of str
        Names, sorted; "... of arrays" if the series is known for scalars only.
    """
    closed_jaxpr = cached_jaxpr(function, names, dtype, n_arguments)
    return tuple(sorted(_scan_operations(closed_jaxpr.jaxpr, [False] * n_arguments + [True] * len(names))[0]))


@lru_cache(256)
def depends_on_time(function, names, dtype):
    """Return True if the time t enters the value of a force."""
    jaxpr = cached_jaxpr(function, names, dtype).jaxpr
    return not all(_scan_operations(jaxpr, [False] + [True] * (len(jaxpr.invars) - 1))[1])


def _scan_operations(jaxpr, is_constant):
    """Return the operations without a series, and which results are constant in time, from the constancy of inputs."""
    constancy = dict(zip(jaxpr.invars, is_constant, strict=True)) | dict.fromkeys(jaxpr.constvars, True)
    missing = set()
    for eqn in jaxpr.eqns:
        input_constancy = [is_literal(variable) or constancy[variable] for variable in eqn.invars]
        inner = find_inner_jaxpr(eqn)
        if inner is not None:
            names, output_constancy = _scan_operations(inner.jaxpr, input_constancy)
            missing |= names
        else:
            output_constancy = [all(input_constancy)] * len(eqn.outvars)
            has_arrays = any(variable.aval.shape for variable in (*eqn.invars, *eqn.outvars))
            if has_arrays or not _has_rule(eqn, all(input_constancy)):
                missing.add(f"{eqn.primitive.name} of arrays" if has_arrays else eqn.primitive.name)
        constancy.update(zip(eqn.outvars, output_constancy, strict=True))
    return missing, [is_literal(variable) or constancy[variable] for variable in jaxpr.outvars]


def _has_rule(eqn, is_constant):
    """Return True if the series of an operation is known."""
    name = eqn.primitive.name
    if name == "convert_element_type":
        return is_constant or _is_identity(eqn)
    return name in SERIES_OPS_SET or (is_constant and name in CONST_OPS_SET)


def _is_identity(eqn):
    """Return True if an operation keeps the type of its input."""
    return eqn.invars[0].aval.dtype == eqn.outvars[0].aval.dtype


def is_literal(variable):
    """Return True for a literal of a jaxpr."""
    return isinstance(variable, core.Literal)


def find_inner_jaxpr(eqn):
    """Return the inner function of an operation that runs it once.

    Parameters
    ----------
    eqn : JaxprEqn
        Operation of a jaxpr.

    Returns
    -------
    ClosedJaxpr or None
        The inner function, None without one.
    """
    if eqn.primitive.name in LOOP_OPERATIONS:
        return None
    for name in INNER_KEYS:
        inner = eqn.params.get(name)
        if inner is not None:
            return inner if isinstance(inner, core.ClosedJaxpr) else core.ClosedJaxpr(inner, ())
    return None

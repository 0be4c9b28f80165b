"""What JAX traces of a force, and which of its operations have a Taylor series."""

from functools import lru_cache

from jax.extend import core

from .force import trace_jaxpr

SERIES_OPS = """add add_any sub mul div neg square integer_pow pow sqrt rsqrt cbrt exp exp2 expm1 log log1p sin cos sinh
cosh tan tanh logistic erf erfc asin acos atan asinh acosh atanh atan2 copy"""  # of which `flight.series` has rules
SERIES_OPS_SET = frozenset(SERIES_OPS.split())
INNER_KEYS = ("jaxpr", "call_jaxpr")  # the operations of one that is a function of its own
LOOP_OPERATIONS = ("while", "scan", "cond")  # functions of their own that are not simply run once
CONST_OPS = """abs sign max min floor ceil round select_n clamp is_finite not and or eq ne lt le gt ge rem stop_gradient
convert_element_type"""  # what may be done to numbers that are the same at all times, besides what has a rule
CONST_OPS_SET = frozenset(CONST_OPS.split())

cached_jaxpr = lru_cache(256)(trace_jaxpr)


@lru_cache(256)
def ops_without_series(function, names, dtype, n_arguments=3):
    """The names of the operations of a force of which no Taylor series is known, as a tuple; "... of arrays" where
    it is known of numbers alone. n_arguments: as of `trace_jaxpr`."""
    closed_jaxpr = cached_jaxpr(function, names, dtype, n_arguments)
    return tuple(sorted(_scan_operations(closed_jaxpr.jaxpr, [False] * n_arguments + [True] * len(names))[0]))


@lru_cache(256)
def depends_on_time(function, names, dtype):
    """Return True if the time t enters the value of a force."""
    jaxpr = cached_jaxpr(function, names, dtype).jaxpr
    return not all(_scan_operations(jaxpr, [False] + [True] * (len(jaxpr.invars) - 1))[1])


def _scan_operations(jaxpr, is_constant):
    """(the names, whether each result is the same at all times), the inputs being so or not."""
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
    name = eqn.primitive.name
    if name == "convert_element_type":
        return is_constant or _is_identity(eqn)
    return name in SERIES_OPS_SET or (is_constant and name in CONST_OPS_SET)


def _is_identity(eqn):
    return eqn.invars[0].aval.dtype == eqn.outvars[0].aval.dtype


def is_literal(variable):
    return isinstance(variable, core.Literal)


def find_inner_jaxpr(eqn):
    """The `ClosedJaxpr` of an operation that is a function of its own, run once, else None."""
    if eqn.primitive.name in LOOP_OPERATIONS:
        return None
    for name in INNER_KEYS:
        inner = eqn.params.get(name)
        if inner is not None:
            return inner if isinstance(inner, core.ClosedJaxpr) else core.ClosedJaxpr(inner, ())
    return None

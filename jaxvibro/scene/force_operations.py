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
def ops_without_series(function, parameter_names, dtype, n_leading_arguments=3):
    """Return the names of the operations of a force without a known Taylor series.

    Parameters
    ----------
    function : callable
        The force.
    parameter_names : tuple of str
        Names of its parameters.
    dtype : dtype
        Floating-point type.
    n_leading_arguments : int, optional
        Number of arguments before the parameters.

    Returns
    -------
    tuple of str
        Names, sorted; "... of arrays" if the series is known for scalars only.
    """
    closed_jaxpr = cached_jaxpr(function, parameter_names, dtype, n_leading_arguments)
    return tuple(
        sorted(_scan_operations(closed_jaxpr.jaxpr, [False] * n_leading_arguments + [True] * len(parameter_names))[0])
    )


@lru_cache(256)
def depends_on_time(function, parameter_names, dtype):
    """Return True if the time t enters the value of a force."""
    jaxpr = cached_jaxpr(function, parameter_names, dtype).jaxpr
    return not all(_scan_operations(jaxpr, [False] + [True] * (len(jaxpr.invars) - 1))[1])


def _scan_operations(jaxpr, is_input_constant):
    """Return (names of operations without a series, True per result that is constant in time).

    is_input_constant: True for each input that is constant in time.
    """
    is_variable_constant = dict(zip(jaxpr.invars, is_input_constant, strict=True)) | dict.fromkeys(
        jaxpr.constvars, True
    )
    ops_lacking_series = set()
    for eqn in jaxpr.eqns:
        are_inputs_constant = [is_literal(variable) or is_variable_constant[variable] for variable in eqn.invars]
        inner_jaxpr = find_inner_jaxpr(eqn)
        if inner_jaxpr is not None:
            inner_ops_lacking_series, are_outputs_constant = _scan_operations(inner_jaxpr.jaxpr, are_inputs_constant)
            ops_lacking_series |= inner_ops_lacking_series
        else:
            are_outputs_constant = [all(are_inputs_constant)] * len(eqn.outvars)
            has_array_operands = any(variable.aval.shape for variable in (*eqn.invars, *eqn.outvars))
            if has_array_operands or not _has_series_rule(eqn, all(are_inputs_constant)):
                ops_lacking_series.add(f"{eqn.primitive.name} of arrays" if has_array_operands else eqn.primitive.name)
        is_variable_constant.update(zip(eqn.outvars, are_outputs_constant, strict=True))
    return ops_lacking_series, [is_literal(variable) or is_variable_constant[variable] for variable in jaxpr.outvars]


def _has_series_rule(eqn, are_inputs_constant):
    """Return True if the Taylor series of an operation is known; more operations are known for constant inputs."""
    operation_name = eqn.primitive.name
    if operation_name == "convert_element_type":
        return are_inputs_constant or keeps_dtype(eqn)
    return operation_name in SERIES_OPS_SET or (are_inputs_constant and operation_name in CONST_OPS_SET)


def keeps_dtype(eqn):
    """Return True if an operation is a type conversion that does not change the type."""
    return eqn.primitive.name == "convert_element_type" and eqn.invars[0].aval.dtype == eqn.outvars[0].aval.dtype


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
        The inner function. None if the operation has none or does not simply run it once.
    """
    if eqn.primitive.name in LOOP_OPERATIONS:
        return None
    for parameter_key in INNER_KEYS:
        inner_jaxpr = eqn.params.get(parameter_key)
        if inner_jaxpr is not None:
            return inner_jaxpr if isinstance(inner_jaxpr, core.ClosedJaxpr) else core.ClosedJaxpr(inner_jaxpr, ())
    return None

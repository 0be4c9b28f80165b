"""Check the contact law of a soft wall; each error names the key, the rule and the value."""

from dataclasses import replace
from functools import lru_cache

import jax
import numpy as np

from . import check
from .force import flat_function, trace_jaxpr
from .force_rules import check_callable
from .push import NAMED_PUSHES, Push, hertz, hunt_crossley

N_ARGUMENTS = 2  # depth and rate
PARAMETER_RULES = {
    "stiffness": (lambda value: value > 0, "must be greater than 0"),
    "dissipation": (lambda value: value >= 0, "must not be negative"),
}
LAW_PARAMETERS = {hertz: ("stiffness",), hunt_crossley: ("stiffness", "dissipation")}


def check_push(side, wall, to_array, dtype, force):
    """Return the law of a wall with checked numbers; ``to_array(key, value)`` converts a number."""
    key, law = f"{side}.law", wall.law
    if not isinstance(law, Push):
        raise check.ArgumentError(key, "must be a Push or None", law)
    if force is None:
        rule = "needs a scene with a force; the spring is jv.Force('polynomial', {'c1': 1.0, 'damping': ...})"
        raise check.ArgumentError(key, rule, law.function)
    function = check_callable(key, law, NAMED_PUSHES, "depth, rate, numbers")
    params = {name: to_array(f"{key}.{name}", value) for name, value in law.numbers.items()}
    _check_params(key, function, params)
    names = tuple(params)
    _check_traceable(key, function, names, np.dtype(dtype))
    if not check.is_traced(*params.values()):
        _check_zero_push(key, function, params, dtype)
    return replace(law, function=function, numbers=params)


def _check_params(key, function, params):
    """Check the parameters of a predefined law."""
    if function not in LAW_PARAMETERS:
        return
    if set(params) != set(LAW_PARAMETERS[function]):
        raise check.ArgumentError(f"{key}.numbers", f"must be {', '.join(LAW_PARAMETERS[function])}", tuple(params))
    for name, value in params.items():
        if not check.is_traced(value):
            holds, rule = PARAMETER_RULES[name]
            check.require(f"{key}.{name}", rule, value, holds(value))


@lru_cache(256)
def _check_traceable(key, function, names, dtype):
    """Check that JAX can trace a law, and that it returns one number."""
    try:
        results = trace_jaxpr(function, names, dtype, N_ARGUMENTS).out_avals
    except Exception as error:
        reason = check.shorten(f"{type(error).__name__}: {error}", 160)
        raise check.ArgumentError(key, f"cannot be traced by JAX ({reason})", function) from None
    if len(results) != 1 or results[0].shape != () or results[0].dtype != dtype:
        outputs_text = ", ".join(f"{output.dtype}{list(output.shape)}" for output in results)
        raise check.ArgumentError(key, f"must return one number of type {dtype} for scalar arguments", outputs_text)


def _check_zero_push(key, function, params, dtype):
    """Check that a law is 0 for a mass that only touches the wall."""
    zero = np.zeros((), dtype)
    with jax.ensure_compile_time_eval():
        push = np.asarray(_compile_law(function, tuple(params))(zero, zero, *params.values()))
    check.require(key, "must be 0 where depth and rate are 0", push, push == 0)


@lru_cache(256)
def _compile_law(function, names):
    """Return the compiled law of positional numbers."""
    return jax.jit(flat_function(function, names, N_ARGUMENTS))

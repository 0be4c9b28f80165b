"""Check the contact law of a soft wall; each error names the key, the rule and the value."""

from dataclasses import replace
from functools import lru_cache

import jax
import numpy as np

from . import check
from .force import with_positional_params
from .force_checks import check_callable, trace_user_function
from .push import PREDEFINED_CONTACT_LAWS, Push, hertz, hunt_crossley

N_ARGUMENTS = 2  # depth and rate
PARAMETER_RULES = {
    "stiffness": (lambda value: value > 0, "must be greater than 0"),
    "dissipation": (lambda value: value >= 0, "must not be negative"),
}
LAW_PARAMETERS = {hertz: ("stiffness",), hunt_crossley: ("stiffness", "dissipation")}

_check_traceable = lru_cache(256)(trace_user_function)


def check_contact_law(side, wall, to_checked_array, dtype, scene_force):
    """Return the contact law of a wall with checked parameters; ``to_checked_array(key, value)`` converts a number."""
    key, contact_law = f"{side}.law", wall.law
    if not isinstance(contact_law, Push):
        raise check.ArgumentError(key, "must be a Push or None", contact_law)
    if scene_force is None:
        rule = "needs a scene with a force; the spring is jv.Force('polynomial', {'c1': 1.0, 'damping': ...})"
        raise check.ArgumentError(key, rule, contact_law.function)
    function = check_callable(key, contact_law, PREDEFINED_CONTACT_LAWS, "depth, rate, numbers")
    params = {name: to_checked_array(f"{key}.{name}", value) for name, value in contact_law.numbers.items()}
    _check_predefined_params(key, function, params)
    _check_traceable(key, function, tuple(params), np.dtype(dtype), N_ARGUMENTS, function)
    if not check.is_traced(*params.values()):
        _check_zero_at_surface(key, function, params, dtype)
    return replace(contact_law, function=function, numbers=params)


def _check_predefined_params(key, function, params):
    """Check the names and the values of the parameters if the contact law is predefined."""
    if function not in LAW_PARAMETERS:
        return
    if set(params) != set(LAW_PARAMETERS[function]):
        raise check.ArgumentError(f"{key}.numbers", f"must be {', '.join(LAW_PARAMETERS[function])}", tuple(params))
    for name, value in params.items():
        if not check.is_traced(value):
            satisfies_rule, rule = PARAMETER_RULES[name]
            check.require(f"{key}.{name}", rule, value, satisfies_rule(value))


def _check_zero_at_surface(key, function, params, dtype):
    """Check that a contact law is 0 at depth 0 and rate 0."""
    zero = np.zeros((), dtype)
    with jax.ensure_compile_time_eval():
        surface_acceleration = np.asarray(
            _compile_positional_law(function, tuple(params))(zero, zero, *params.values())
        )
    check.require(key, "must be 0 where depth and rate are 0", surface_acceleration, surface_acceleration == 0)


@lru_cache(256)
def _compile_positional_law(function, parameter_names):
    """Return the compiled contact law as a function of depth, rate and positional parameters."""
    return jax.jit(with_positional_params(function, parameter_names, N_ARGUMENTS))

"""The rules for the law of a soft wall: each broken one names the key, the rule and the value, like a scene's."""

from dataclasses import replace
from functools import lru_cache

import jax
import numpy as np

from . import check
from .force import of_row, trace
from .force_rules import called
from .push import NAMED_PUSHES, Push, hertz, hunt_crossley

GIVEN = 2  # depth and rate
RULES = {
    "stiffness": (lambda value: value > 0, "must be greater than 0"),
    "dissipation": (lambda value: value >= 0, "must not be negative"),
}
OURS = {hertz: ("stiffness",), hunt_crossley: ("stiffness", "dissipation")}


def check_push(side, wall, number, dtype, force):
    """The law of a wall with its numbers as arrays, once it breaks no rule. number: (key, value) -> the array."""
    key, law = f"{side}.law", wall.law
    if not isinstance(law, Push):
        raise check.ArgumentError(key, "must be a Push or None", law)
    if force is None:
        rule = "needs a force beside it; the spring is jv.Force('polynomial', {'c1': 1.0, 'damping': ...})"
        raise check.ArgumentError(key, rule, law.function)
    function = called(key, law, NAMED_PUSHES, "depth, rate, numbers")
    numbers = {name: number(f"{key}.{name}", value) for name, value in law.numbers.items()}
    _obey(key, function, numbers)
    names = tuple(numbers)
    _traced(key, function, names, np.dtype(dtype))
    if not check.is_traced(*numbers.values()):
        _look(key, function, numbers, dtype)
    return replace(law, function=function, numbers=numbers)


def _obey(key, function, numbers):
    """Refuse numbers that one of our laws does not take, or that break its rules."""
    if function not in OURS:
        return
    if set(numbers) != set(OURS[function]):
        raise check.ArgumentError(f"{key}.numbers", f"must be {', '.join(OURS[function])}", tuple(numbers))
    for name, value in numbers.items():
        if not check.is_traced(value):
            holds, rule = RULES[name]
            check.require(f"{key}.{name}", rule, value, holds(value))


@lru_cache(256)
def _traced(key, function, names, dtype):
    """Refuse a law that JAX cannot trace, or that returns no number."""
    try:
        results = trace(function, names, dtype, GIVEN).out_avals
    except Exception as error:
        reason = check.short(f"{type(error).__name__}: {error}", 160)
        raise check.ArgumentError(key, f"cannot be traced by JAX ({reason})", function) from None
    if len(results) != 1 or results[0].shape != () or results[0].dtype != dtype:
        told = ", ".join(f"{one.dtype}{list(one.shape)}" for one in results)
        raise check.ArgumentError(key, f"must return one number of type {dtype}, of numbers", told)


def _look(key, function, numbers, dtype):
    """Refuse a law that pushes a mass which only touches the wall."""
    zero = np.zeros((), dtype)
    with jax.ensure_compile_time_eval():
        push = np.asarray(_compiled(function, tuple(numbers))(zero, zero, *numbers.values()))
    check.require(key, "must be 0 where depth and rate are 0", push, push == 0)


@lru_cache(256)
def _compiled(function, names):
    return jax.jit(of_row(function, names, GIVEN))

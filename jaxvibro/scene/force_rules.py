"""The rules for a force of the user's own: each broken one names the key, the rule and the value, like a scene's."""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import jax
import numpy as np

from . import check
from .force import LOOSEST, TIGHTEST, Force, of_row, trace
from .named_forces import NAMED

PLACES = 64  # at which a force is looked at
SAME = 1e-9  # of a force's size: as much may it differ a period later
ODD = 1e-12  # of its largest value: so far may a force be from its mirror image
ONES = 4  # scenes of a batch whose forces are looked at


def check_force(force, number):
    """The force with its numbers as arrays, once it breaks no rule that needs no other number of the scene.

    number: (key, value) -> the array.
    """
    if not isinstance(force, Force):
        raise check.ArgumentError("force", "must be a Force or None", force)
    function = force.function
    if isinstance(function, str):
        if function not in NAMED:
            raise check.ArgumentError(
                "force.function", f"must be a function, or one of ours{check.among(function, NAMED)}", function
            )
        function = NAMED[function]
    if not callable(function):
        raise check.ArgumentError("force.function", "must be a function of (t, x, v, numbers)", function)
    if not isinstance(force.numbers, Mapping):
        raise check.ArgumentError("force.numbers", "must be a dict {name: number}", force.numbers)
    for name in force.numbers:
        if not isinstance(name, str) or not name.isidentifier():
            raise check.ArgumentError("force.numbers", "names must be letters, digits and _", name)
    tolerance = force.tolerance
    if not isinstance(tolerance, float) or not TIGHTEST <= tolerance <= LOOSEST:
        raise check.ArgumentError("force.tolerance", f"must be a number from {TIGHTEST} to {LOOSEST}", tolerance)
    numbers = {name: number(f"force.{name}", value) for name, value in force.numbers.items()}
    return replace(force, function=function, numbers=numbers)


def check_force_values(scene):
    """Refuse the force of a scene that is no real number of t, x, v and its numbers, that is not finite where the mass
    may be, or that does not repeat with the drive."""
    force = scene.force
    names, dtype = tuple(force.numbers), np.dtype(scene.dtype)
    depends = _traced(force.function, names, dtype)
    known = (*force.numbers.values(), scene.frequency)
    walls = [wall.position for wall in scene.walls.values()]
    if check.is_traced(*known, *walls):
        return
    count = min(int(np.prod(scene.shape)), ONES)
    numbers = [np.broadcast_to(each, scene.shape).reshape(-1)[:count] for each in (*known, *walls)]
    for k, own in enumerate(np.stack(numbers, 1)):
        place = None if not scene.shape else tuple(int(i) for i in np.unravel_index(k, scene.shape))
        with jax.ensure_compile_time_eval():
            _look(scene, own[: len(names)], float(own[len(names)]), list(own[len(names) + 1 :]), depends, place)


def is_odd(scene):
    """Whether the force of a single scene is its own mirror image: -force(t, x, v) half a period later at -x, -v."""
    rng = np.random.default_rng(1)
    size = max([1.0, *(abs(float(wall.position)) for wall in scene.walls.values())])
    half, dtype = np.pi / float(scene.frequency), scene.dtype
    t = rng.uniform(0.0, 2.0 * half, PLACES)
    x, v = size * rng.uniform(-1.0, 1.0, (2, PLACES))
    call = _compiled(scene.force.function, tuple(scene.force.numbers))
    with jax.ensure_compile_time_eval():
        both = [
            np.asarray(call(*(each.astype(dtype) for each in place), *scene.force.numbers.values()))
            for place in ((t, x, v), (t + half, -x, -v))
        ]
    return bool((abs(both[0] + both[1]) <= ODD * abs(both[0]).max()).all())


def _holds(wall):
    return wall is not None and not wall.soft


def _look(scene, numbers, frequency, walls, by_time, index):
    force, rng = scene.force, np.random.default_rng(0)
    size = max([1.0, *map(abs, walls)])
    low = walls[0] if _holds(scene.left) else min([*walls, 0.0]) - 2.0 * size
    high = walls[-1] if _holds(scene.right) else max([*walls, 0.0]) + 2.0 * size
    period = 2.0 * np.pi / frequency
    t, x = rng.uniform(0.0, period, PLACES), rng.uniform(low, high, PLACES)
    v = rng.uniform(-2.0, 2.0, PLACES) * size * (1.0 + frequency)
    call = _compiled(force.function, tuple(force.numbers))
    first = np.asarray(call(*(each.astype(scene.dtype) for each in (t, x, v)), *numbers))
    wrong = np.flatnonzero(~np.isfinite(first))
    if wrong.size:
        at = {name: float(each[wrong[0]]) for name, each in (("t", t), ("x", x), ("v", v))}
        raise check.ArgumentError("force", f"must be finite where the mass may be: it is {first[wrong[0]]}", at, index)
    if by_time:
        later = np.asarray(call(*(each.astype(scene.dtype) for each in (t + period, x, v)), *numbers))
        apart = abs(later - first)
        off = apart > max(SAME, 64.0 * np.finfo(scene.dtype).eps) * (abs(first) + abs(first).max())
        if off.any():
            worst = int(np.argmax(apart))
            rule = f"must repeat with the drive's period, {period:.6g}: a period later it differs by {apart[worst]:.3g}"
            raise check.ArgumentError("force", rule, {"t": float(t[worst])}, index)


@lru_cache(256)
def _compiled(function, names):
    return jax.jit(jax.vmap(of_row(function, names), (0, 0, 0, *[None] * len(names))))


@lru_cache(256)
def _traced(function, names, dtype):
    """Whether the force depends on t; refused where it cannot be traced, or is another each time it is."""
    try:
        first, second = (trace(function, names, dtype) for _ in range(2))
    except Exception as error:
        reason = check.short(f"{type(error).__name__}: {error}", 160)
        raise check.ArgumentError("force", f"cannot be traced by JAX ({reason})", function) from None
    results = first.out_avals
    if len(results) != 1 or results[0].shape != () or results[0].dtype != dtype:
        told = ", ".join(f"{one.dtype}{list(one.shape)}" for one in results)
        raise check.ArgumentError("force", f"must return one number of type {dtype}, of numbers", told)
    alike = len(first.consts) == len(second.consts)
    alike = alike and all(np.array_equal(a, b) for a, b in zip(first.consts, second.consts, strict=True))
    if not alike or str(first) != str(second):
        raise check.ArgumentError("force", "must be the same each time: it depends on something besides", function)
    time = first.jaxpr.invars[0]
    return any(each is time for eqn in first.jaxpr.eqns for each in eqn.invars) or first.jaxpr.outvars[0] is time

"""The rules for a force of the user's own: each broken one names the key, the rule and the value, like a scene's."""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from importlib import import_module
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np

from . import check
from .force import LOOSEST, TIGHTEST, Force, of_row, trace
from .force_trace import without_rule
from .named_forces import NAMED, knots, named, tabulated, takes

PLACES = 64  # at which a force is looked at
SAME = 1e-9  # of a force's size: as much may it differ a period later
ODD = 1e-12  # of its largest value: so far may a force be from its mirror image
ONES = 4  # scenes of a batch whose forces are looked at
WITHOUT_SERIES = "Dopri8"  # the solver of a force that has an operation without a Taylor series
TIGHTEST_OF_SOLVERS = 1e-14
FASTEST = 1e4  # the rate of a force, over the drive's period, that explicit steps can follow
ADVICE = {  # for what JAX raises
    "TracerBoolConversionError": "no if, and, or, while on t, x, v or its numbers",
    "ConcretizationTypeError": "jax.numpy in place of math, and no float()",
    "TracerArrayConversionError": "jax.numpy in place of numpy",
}


def check_force(force, number, dtype):
    """The force with its numbers as arrays and its solver, once it breaks no rule that needs another number of the
    scene.

    number: (key, value) -> the array; dtype: its type.
    """
    if not isinstance(force, Force):
        raise check.ArgumentError("force", "must be a Force or None: jv.Force(function, {name: number})", force)
    function = called("force", force, NAMED, "t, x, v, numbers")
    wanted = takes(function, force.numbers)
    if wanted is not None:
        given = ", ".join(force.numbers) or "none"
        raise check.ArgumentError("force.numbers", f"those of {named(function)} are {wanted}", given)
    tolerance = force.tolerance
    if not isinstance(tolerance, float) or not TIGHTEST <= tolerance <= LOOSEST:
        raise check.ArgumentError("force.tolerance", f"must be a number from {TIGHTEST} to {LOOSEST}", tolerance)
    numbers = {name: number(f"force.{name}", value) for name, value in force.numbers.items()}
    if function is tabulated:
        _check_table(numbers)
    names, solver = tuple(numbers), force.solver
    _traced(function, names, np.dtype(dtype))
    if solver is None and without_rule(function, names, np.dtype(dtype)):
        solver = WITHOUT_SERIES
    if solver is not None:
        solver = _checked_solver(solver)
        if tolerance < TIGHTEST_OF_SOLVERS:
            raise check.ArgumentError(
                "force.tolerance", f"must be {TIGHTEST_OF_SOLVERS} or more with a solver", tolerance
            )
    return replace(force, function=function, numbers=numbers, solver=solver)


def called(key, given, named, of):
    """The function of a `Force` or a `Push`, once it is one, of ours by name or not, and its numbers have names."""
    function = given.function
    if isinstance(function, str):
        if function not in named:
            rule = f"must be a function, or one of ours{check.among(function, named)}"
            raise check.ArgumentError(f"{key}.function", rule, function)
        function = named[function]
    if not callable(function):
        raise check.ArgumentError(f"{key}.function", f"must be a function of ({of})", function)
    if not isinstance(given.numbers, Mapping):
        raise check.ArgumentError(f"{key}.numbers", "must be a dict {name: number}", given.numbers)
    for name in given.numbers:
        if not isinstance(name, str) or not name.isidentifier():
            raise check.ArgumentError(f"{key}.numbers", "names must be letters, digits and _", name)
    return function


def _check_table(numbers):
    """Refuse the numbers of a `tabulated` force that are no table."""
    count = knots(numbers)
    needed = {f"{letter}{k}" for letter in "xf" for k in range(count)} | {"damping"}
    if count < 3 or needed != set(numbers):
        rule = "must be damping and x0, f0, x1, f1, ..., three places or more, and no others"
        raise check.ArgumentError("force.numbers", rule, ", ".join(numbers))
    places = [numbers[f"x{k}"] for k in range(count)]
    for k, (before, after) in enumerate(pairwise(places)):
        if not check.is_traced(before, after) and not np.all(np.asarray(before) < np.asarray(after)):
            raise check.ArgumentError(f"force.x{k + 1}", f"must be greater than x{k}", after)


def _checked_solver(solver):
    """The solver itself, or that of a name, once it is one of diffrax's that estimate their errors."""
    diffrax = import_module("diffrax")
    kind = getattr(diffrax, solver, None) if isinstance(solver, str) else type(solver)
    if not (isinstance(kind, type) and issubclass(kind, diffrax.AbstractAdaptiveSolver)):
        rule = "must be one of diffrax's solvers that estimate their errors, such as diffrax.Dopri8(), or its name"
        raise check.ArgumentError("force.solver", rule, solver)
    try:
        found = kind() if isinstance(solver, str) else solver
        hash(found)
    except TypeError as error:
        raise check.ArgumentError("force.solver", f"cannot be used: {check.short(error, 80)}", solver) from None
    return found


def solver_name(solver):
    """The name by which diffrax makes this very solver, None where there is none."""
    name = type(solver).__name__
    return name if getattr(import_module("diffrax"), name, None) is type(solver) and solver == type(solver)() else None


def flow_of(force, dtype):
    """Which steps fly under a force, and why, in a sentence."""
    to = f"to {force.tolerance:g}"
    unknown = without_rule(force.function, tuple(force.numbers), np.dtype(dtype))
    if force.solver is None:
        return f"Taylor steps {to}: each operation of the force has a Taylor series"
    why = f"no Taylor series is known of {', '.join(unknown)}" if unknown else "asked for"
    return f"steps of diffrax's {type(force.solver).__name__} {to}: {why}"


def check_force_values(scene):
    """Refuse the force of a scene that is no real number of t, x, v and its numbers, that is not finite where the mass
    may be, or that does not repeat with the drive."""
    force = scene.force
    if force.solver is not None and scene.soft_sides:
        unknown = without_rule(force.function, tuple(force.numbers), np.dtype(scene.dtype))
        why = f", which are not known of {', '.join(unknown)}" if unknown else ""
        raise check.ArgumentError(
            "force.solver", f"beside a soft wall a force flies by Taylor steps{why}", force.solver
        )
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
    if force.solver is None or not isinstance(force.solver, import_module("diffrax").AbstractImplicitSolver):
        rates = _rates(force.function, tuple(force.numbers))(
            *(each.astype(scene.dtype) for each in (t, x, v)), *numbers
        )
        fast = float(np.median(rates))
        if fast * period > FASTEST:
            rule = f'is too stiff for explicit steps, at a rate of {fast:.2g}: solver="Kvaerno5" can'
            raise check.ArgumentError("force", rule, named(force.function), index)
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
def _rates(function, names):
    """How fast a motion turns or decays under a force: the larger of the two rates of what is linear about a state."""
    plain = of_row(function, names)

    def rate(t, x, v, *numbers):
        one, none = jnp.ones_like(x), jnp.zeros_like(x)
        pull, drag = (
            jax.jvp(lambda x, v: plain(t, x, v, *numbers), (x, v), way)[1] for way in ((one, none), (none, one))
        )
        inside = 0.25 * drag * drag + pull
        return jnp.where(inside < 0, jnp.sqrt(abs(pull)), 0.5 * abs(drag) + jnp.sqrt(abs(inside)))

    return jax.jit(jax.vmap(rate, (0, 0, 0, *[None] * len(names))))


@lru_cache(256)
def _traced(function, names, dtype):
    """Whether the force depends on t; refused where it cannot be traced, or is another each time it is."""
    try:
        first, second = (trace(function, names, dtype) for _ in range(2))
        form = jax.eval_shape(of_row(function, names), *[jax.ShapeDtypeStruct((), dtype)] * (3 + len(names)))
    except Exception as error:
        raise check.ArgumentError("force", f"cannot be traced by JAX ({_why(error, names)}", named(function)) from None
    results = first.out_avals
    alone = jax.tree.structure(form) == jax.tree.structure(0.0)
    if not alone or results[0].shape != () or results[0].dtype != dtype:
        told = ", ".join(f"{one.dtype}{list(one.shape)}" for one in results) or "nothing"
        told = told if alone or not results else f"{type(form).__name__} of {told}"
        raise check.ArgumentError("force", f"must return one number of type {dtype}, of numbers", told)
    alike = len(first.consts) == len(second.consts)
    alike = alike and all(np.array_equal(a, b) for a, b in zip(first.consts, second.consts, strict=True))
    if not alike or str(first) != str(second):
        raise check.ArgumentError(
            "force", "must be the same each time: it depends on something besides", named(function)
        )
    time = first.jaxpr.invars[0]
    return any(each is time for eqn in first.jaxpr.eqns for each in eqn.invars) or first.jaxpr.outvars[0] is time


def _why(error, names):
    """The name of what was raised while a force was traced, what it says, and the advice that there is for it."""
    name = type(error).__name__
    if name in ADVICE:
        return f"{name}): {ADVICE[name]}"
    reason = check.short(f"{name}: {error}", 160) + ")"
    if isinstance(error, KeyError):
        return f"{reason}: its numbers are {', '.join(names) or 'none'}"
    return f"{reason}: it is called with (t, x, v, numbers)" if "positional argument" in reason else reason

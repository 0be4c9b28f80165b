"""`trace`: a branch of solutions along one parameter; `switch`: the branches that leave a special point of it."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Real

from . import driver, event_search, held, hopf, leaving
from .arclength import Control
from .arguments import known_numbers, require_settings, require_system
from .branch import Branch, Special
from .driver import End, Task
from .errors import ContinuationError, typed
from .event_search import Event
from .limits import limits_of
from .newton import ADVICE, newton
from .persistent_jit import persistent_jit
from .phases import SystemWatch
from .points import between, start_point
from .problem import EQUILIBRIA, ORBITS, Given, System, linearised, matrix_at, noise_of, problem_of
from .roots import sign_change
from .stretch import backwards, glued

TOLERANCE = 1e-10  # of Newton's method, a length
SMALLEST = 1e-8  # step
ROWS = 64  # of points, whose eigenvalues are asked for in one call
NEAR = 1e-9  # of u and its image: as near are they one
ZERO = 1e-9  # of an eigenvalue's distance from an event: as small is nearly none
Monitors = Mapping[str, Callable[[Any, Any, Any], ArrayLike]]  # of (u, p, args)


class Monitored(SystemWatch):
    """Events where functions of a point, {name: of (u, p, args)}, change their signs, besides the problem's own."""

    def __init__(self, system, names, monitors):
        super().__init__(system, names)
        self.monitors = monitors

    def before(self, task, points):
        return hopf.ahead(self.system, self.names, task, points) if self.system.kind == ORBITS else None

    def events(self, task, points, view, known, end):
        signs = _signs(self.system, self.names, points.z, task.args)
        found = event_search.events(task.problem, points, signs, task.control, task.args, known)
        if held.FOLD in signs:
            found = [one._replace(kind="SN") if one.kind == held.FOLD else one for one in found if one.kind != "SN"]
        for kind in self.monitors:
            values = np.array([self.value(kind, z, task.args) for z in points.z])
            for after in np.flatnonzero(values[:-1] * values[1:] < 0):
                found.append(self.located(kind, task, points, int(after)))
        return found

    def value(self, kind, z, given):
        size = len(z) - len(self.names)
        p = {**given.others, **dict(zip(self.names, z[size:], strict=True))}
        return float(self.monitors[kind](z[:size], p, given.args))

    def located(self, kind, task, points, after):
        def value(length):
            one = between(task, points, after, length)
            if one is None:
                raise ContinuationError("monitors", "must be followed between two points", kind)
            return self.value(kind, one.z, task.args)

        length = sign_change(value, float(points.step[after + 1]))
        one = between(task, points, after, length)
        return Event(kind, after, length, one.z, float(one.residual))


@typed
def trace(
    system: System,
    u: Real[ArrayLike, "..."] | Sequence[float],
    at: Mapping[str, float],
    along: str | Sequence[str],
    bounds: Sequence[float] | Mapping[str, Sequence[float]],
    args: Any = None,
    direction: str = "both",
    first_step: float = 0.05,
    largest_step: float = 0.1,
    tolerance: float | None = None,
    monitors: Monitors | None = None,
    stop: Sequence[str] = (),
    hold: Mapping[Any, float] | None = None,
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> Branch:
    """The branch of solutions of a system through one near u, along one parameter: a `Branch`.

    system: of `equilibria`, `fixed_points` or `shooting.periodic_orbits`; u: (n,), near a solution; at: {name: number},
    the parameters there; along: the name of that which is to change; bounds: (low, high) of it; args: for the system's
    function. direction: "forward" begins towards greater values, "backward" towards smaller, "both" does both.
    first_step, largest_step, tolerance: lengths of (u, parameter). tolerance is that of Newton's method, None for 1e-10
    and for periodic orbits at least 10 times the tolerance of their integrator. monitors: {name: function of (u, p,
    args)}, whose changes of sign are special points; stop: kinds of special points that end the branch.

    hold: {function of (u, p, args), or the name of a monitor: its value all along}; each needs one parameter more:
    along is then a tuple of names, bounds {name: (low, high)}, direction and the start's value are of the last name,
    the start's others are found. A turning point of that one is no fold then: an SN is where dF/du is singular.

    max_points, max_seconds: largest number of points of the branch, and wall-clock time, s, which is checked between
    chunks of steps; None is no limit. A limit that is reached ends the branch there, and its `reasons` say so.
    progress: called with the number of points computed so far.

    Raises ContinuationError for arguments that cannot be, and where Newton's method comes to no solution from u.
    """
    limits = limits_of(max_points, max_seconds, progress, ContinuationError)
    row, at = known_numbers(u, at)
    require_settings(direction, monitors, stop)
    require_system(system, row, at, args)
    system = symmetric(system, row, at, args)
    names = (along,) if isinstance(along, str) else tuple(along)
    kept = held.named(hold, monitors, names)
    box = bounds if isinstance(bounds, Mapping) else dict.fromkeys(names, bounds)
    if set(box) != set(names):
        raise ContinuationError("bounds", f"must be given for {', '.join(names)}", bounds)
    bounds = checked_bounds(at, {name: box[name] for name in names})
    others = {name: value for name, value in at.items() if name not in names}
    given = held.Held(others, args, tuple(kept.values())) if kept else Given(others, args)
    z = np.append(row, [at[name] for name in names])
    problem = held.held_problem(system, tuple(kept), names) if kept else problem_of(system, names)
    z = _solved(problem, z, given)
    checked_bounds(dict(zip(names, z[len(row) :].tolist(), strict=True)), bounds)
    task = task_of(system, z, bounds, given, first_step, largest_step, tolerance, monitors, stop)
    task = task._replace(problem=problem, limits=limits)
    ahead = event_search.tangent(task.problem, z, task.control.scale, given)
    back, on = both_ways(task, z, ahead, direction)
    return branch_of(system, None, bounds, given, back, on)


@typed
def switch(
    special: Special,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    first_step: float = 0.01,
    largest_step: float = 0.1,
    tolerance: float | None = None,
    monitors: Monitors | None = None,
    stop: Sequence[str] = (),
    orbits: System | None = None,
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> tuple[Branch, ...]:
    """The branches that leave a special point besides that on which it was found: a tuple of `Branch`, each from the
    point on. special: of kind BP or SB, the two halves of the branch that crosses there; PD, that of twice as many
    times; HB, that of the periodic orbits, from a first one on that is a first_step large. bounds: {name: (low,
    high)}, or None for those of the point's branch; orbits: at HB the `shooting.periodic_orbits` of the same field; the
    rest as in `trace`; max_points holds for each branch, max_seconds for all of them.

    Raises ContinuationError for points of other kinds, and at HB without orbits.
    """
    if not isinstance(special, Special) or special.kind not in leaving.KINDS or len(special.names) != 1:
        raise ContinuationError("special", f"must be a special point of a branch, {', '.join(leaving.KINDS)}", special)
    if special.kind == "HB" and (not isinstance(orbits, System) or orbits.kind != ORBITS):
        raise ContinuationError("orbits", "must be the `periodic_orbits` of the field that has the Hopf point", orbits)
    limits = limits_of(max_points, max_seconds, progress, ContinuationError)
    bounds = bounds or special.bounds
    require_settings("both", monitors, stop)
    system, z, given, tangents = leaving.ways(special, orbits)
    task = task_of(system, z, bounds, given, first_step, largest_step, tolerance, monitors, stop)
    task = task._replace(starts=(), limits=limits)
    starts = [start_point(z, tangent) for tangent in tangents]
    if special.kind == "HB":
        starts = [hopf.first_orbit(task, one) for one in starts]
    runs = [driver.run(task, one) for one in starts]
    return tuple(branch_of(system, None, bounds, given, None, one) for one in runs)


def both_ways(task, z, ahead, direction="both"):
    """(the `Stretch` backward, that forward) from a solution; None for that which is not asked for, or not needed as
    the other closes."""
    limits = task.limits
    first = task._replace(limits=limits.halved() if direction == "both" else limits)
    on = driver.run(first, start_point(z, ahead)) if direction != "backward" else None
    closed = on is not None and on.end is End.CLOSED
    task = task._replace(limits=limits.after(0 if on is None else len(on.points.z) - 1))
    back = None if direction == "forward" or closed else driver.run(task, start_point(z, -ahead))
    return back, on


def branch_of(system, kind, bounds, given, back, on):
    """The `Branch` of the stretches backward and forward from a start; either may be None."""
    names = tuple(bounds)
    whole = on if back is None else backwards(back) if on is None else glued([backwards(back), on])
    z, size = whole.points.z, whole.points.z.shape[1] - len(names)
    eigenvalues = _eigenvalues(system, names, z, given)
    marks = {one.place: (_name(system, z[one.place, :size], one.kind), one.residual) for one in whole.marks}
    for place in (0, len(z) - 1):
        marks.setdefault(place, ("EP", float(whole.points.residual[place])))
    special = tuple(
        Special(
            marks[k][0],
            z[k, :size],
            {**given.others, **dict(zip(names, z[k, size:].tolist(), strict=True))},
            names,
            eigenvalues[k],
            marks[k][1],
            k,
            system,
            given.args,
            bounds,
            whole.points.tangent[k],
        )
        for k in sorted(marks)
    )
    columns = dict(zip(names, z[:, size:].T, strict=True))
    reasons = tuple("the start" if one is None else _reason(one, names) for one in (back, on))
    return Branch(system, kind, names, z[:, :size], columns, eigenvalues, whole.points.residual, special, reasons)


def _name(system, u, kind):
    """The kind of a special point: a branch that comes to one of symmetric solutions meets it in its SB."""
    alike = kind == "BP" and system.symmetry is not None and not system.within
    return "SB" if alike and np.allclose(system.symmetry(u), u, rtol=0, atol=NEAR) else kind


def symmetric(system, u, at, args):
    """The system, to keep to solutions that are their own images where u is one. Raises ContinuationError."""
    if not isinstance(system, System) or system.symmetry is None:
        return system
    some = u + np.random.default_rng(0).normal(size=len(u))
    twice = np.asarray(system.symmetry(system.symmetry(some)))
    one, two = system.function(system.symmetry(some), at, args), system.symmetry(system.function(some, at, args))
    if not np.allclose(twice, some, rtol=0, atol=1e-9) or not np.allclose(one, two, rtol=1e-9, atol=1e-9):
        raise ContinuationError("symmetry", "must be its own inverse, and keep the function", system.symmetry)
    return system._replace(within=bool(np.allclose(system.symmetry(u), u, rtol=0, atol=NEAR)))


def checked_bounds(at, bounds):
    """{name: (low, high)} as plain numbers: finite, the first smaller, with the value at the start between them."""
    found = {}
    for name, given in bounds.items():
        if name not in at:
            raise ContinuationError("along", f"must be a parameter ({', '.join(at)})", name)
        ends = np.asarray(given, float) if np.shape(given) == (2,) else np.array([np.nan, np.nan])
        if not (np.isfinite(ends).all() and ends[0] < ends[1]):
            raise ContinuationError("bounds", "must be (low, high), two finite numbers, the first smaller", given)
        if not ends[0] <= float(at[name]) <= ends[1]:
            raise ContinuationError("bounds", f"must hold the start's {name}, {float(at[name]):.12g}", given)
        found[name] = (float(ends[0]), float(ends[1]))
    return found


@persistent_jit(static_argnums=0, numpy_first=True)
def _solution(problem, z, given):
    def function(unknowns):
        value, slopes = problem.function(jnp.concatenate([unknowns, z[-1:]]), given)
        return value, slopes[:, :-1]

    return newton(function, z[:-1])


def _solved(problem, z, given):
    """z with all but its last number by Newton's method."""
    found = _solution(problem, z, given)
    if found.status:
        raise ContinuationError("u", f"must be near a solution: {ADVICE[int(found.status)]}", z[:-1])
    return np.append(found.unknowns, z[-1])


def task_of(system, z, bounds, given, first_step, largest_step, tolerance, monitors=None, stop=(), usual=TOLERANCE):
    """The `Task` along the parameters of the bounds from z on; usual: the tolerance in place of None. Raises
    ContinuationError."""
    noise = noise_of(system)
    if tolerance is None:
        tolerance = max(usual, noise)
    elif not tolerance >= 0.999 * noise:
        rule = f"must be at least {noise:g}, 10 times that of `periodic_orbits`, which may be given a smaller one"
        raise ContinuationError("tolerance", rule, tolerance)
    for key, value in (("first_step", first_step), ("largest_step", largest_step), ("tolerance", tolerance)):
        if not (np.isscalar(value) and np.isfinite(value) and value > 0):
            raise ContinuationError(key, "must be greater than 0", value)
    names, box = tuple(bounds), tuple(bounds.values())
    numbers = (min(SMALLEST, first_step), largest_step, tolerance, *box[-1])
    control = Control(np.ones(len(z)), *(np.float64(each) for each in numbers))
    watch = Monitored(system, names, monitors or {})
    first = min(first_step, largest_step)
    return Task(problem_of(system, names), given, control, first, box, watch=watch, stop=tuple(stop), starts=(z,))


def _reason(one, names):
    kind = one.marks[-1].kind if one.marks else ""
    return one.end.value.format(name=names[one.which], value=one.value, kind=kind)


def _signs(system, names, zs, given):
    """{label: at each point a number that changes its sign where the matrix of a test is singular}, by eigenvalues. Two
    of them come to the imaginary axis, or the unit circle, at once where so many more, or fewer, are beyond it."""
    found = _eigenvalues(system, names, zs, given)
    steady = system.kind == EQUILIBRIA
    beyond = np.sum(found.real > 0 if steady else abs(found) > 1, axis=1)
    pair = np.cumprod(np.append(1.0, np.where(abs(np.diff(beyond)) >= 2, -1.0, 1.0)))
    signs = {held.FOLD: _product(found if steady else found - 1.0)} if isinstance(given, held.Held) else {}
    if system.within:
        signs["SB"] = _broken(system, names, zs, given)
    return signs | ({"HB": pair} if steady else {"PD": _product(found + 1.0), "NS": pair})


def _broken(system, names, zs, given):
    """At each point a number whose sign is that of the determinant of SB's matrix."""
    return np.array([np.linalg.slogdet(matrix_at(system, "SB", names, z, given))[0] for z in zs])


def _product(values):
    """The sign of the product of each row, and how near to zero one of it is."""
    return np.prod(values / np.maximum(abs(values), ZERO), axis=1).real


@persistent_jit(static_argnums=(0, 1), numpy_first=True)
def _linearised(system, names, zs, given):
    return jax.vmap(lambda z: linearised(system, names, z, given))(zs)


def _eigenvalues(system, names, z, given):
    """Of the `linearised` at points, (points, count), the largest first."""
    rows = -(-len(z) // ROWS) * ROWS
    padded = np.concatenate([z, np.repeat(z[-1:], rows - len(z), axis=0)])
    found = np.linalg.eigvals(np.asarray(_linearised(system, names, padded, given))[: len(z)]).astype(complex)
    size = found.real if system.kind == EQUILIBRIA else abs(found)
    return np.take_along_axis(found, np.argsort(-size, axis=1, kind="stable"), axis=1)

"""`trace`: a branch of solutions along one parameter; `switch`: the branches that leave a special point of it."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Real

from . import branch_exits, constraint, driver, event_search, hopf
from .arclength import StepControl
from .branch import Branch, Special
from .branch_closure import SystemEventDetector
from .branch_segment import join_segments, reverse_segment
from .driver import ContinuationTask, End
from .errors import ContinuationError, check_types
from .event_search import Event
from .intermediate_points import point_at_length, start_point
from .limits import limits_of
from .newton import ADVICE, newton
from .persistent_jit import persistent_jit
from .problem import EQUILIBRIA, ORBITS, Constants, System, matrix_at, noise_floor, problem_of, stability_matrix
from .roots import find_sign_change
from .validation import require_settings, require_system, validate_start

TOLERANCE = 1e-10  # of Newton's method, a length
MIN_STEP = 1e-8  # step
EIGENVALUE_BATCH = 64  # of points, whose eigenvalues are asked for in one call
SYMMETRY_TOLERANCE = 1e-9  # of u and its image: as near are they one
EIGENVALUE_FLOOR = 1e-9  # of an eigenvalue's distance from an event: as small is nearly none
Monitors = Mapping[str, Callable[[Any, Any, Any], ArrayLike]]  # of (u, p, args)


class BranchEventDetector(SystemEventDetector):
    """Events where functions of a point, {name: of (u, p, args)}, change their signs, besides the problem's own."""

    def __init__(self, system, names, monitors):
        super().__init__(system, names)
        self.monitors = monitors

    def find_early_end(self, task, points):
        return hopf.find_hopf_end(self.system, self.names, task, points) if self.system.kind == ORBITS else None

    def find_events(self, task, points, diagnostics, branch_points, termination):
        signs = _test_signs(self.system, self.names, points.z, task.args)
        events = event_search.locate_events(task.problem, points, signs, task.control, task.args, branch_points)
        if constraint.FOLD in signs:
            events = [
                event._replace(kind="SN") if event.kind == constraint.FOLD else event
                for event in events
                if event.kind != "SN"
            ]
        for kind in self.monitors:
            values = np.array([self.monitor_value(kind, z, task.args) for z in points.z])
            for row_before in np.flatnonzero(values[:-1] * values[1:] < 0):
                events.append(self.locate_monitor_event(kind, task, points, int(row_before)))
        return events

    def monitor_value(self, kind, z, constants):
        n_unknowns = len(z) - len(self.names)
        p = {**constants.fixed_params, **dict(zip(self.names, z[n_unknowns:], strict=True))}
        return float(self.monitors[kind](z[:n_unknowns], p, constants.args))

    def locate_monitor_event(self, kind, task, points, row_before):
        def value_at_length(length):
            point = point_at_length(task, points, row_before, length)
            if point is None:
                raise ContinuationError("monitors", "must be followed between two points", kind)
            return self.monitor_value(kind, point.z, task.args)

        length = find_sign_change(value_at_length, float(points.step[row_before + 1]))
        point = point_at_length(task, points, row_before, length)
        return Event(kind, row_before, length, point.z, float(point.residual))


@check_types
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
    u_start, at = validate_start(u, at)
    require_settings(direction, monitors, stop)
    require_system(system, u_start, at, args)
    system = restrict_to_symmetric(system, u_start, at, args)
    names = (along,) if isinstance(along, str) else tuple(along)
    constraints = constraint.resolve_constraints(hold, monitors, names)
    bounds_by_name = bounds if isinstance(bounds, Mapping) else dict.fromkeys(names, bounds)
    if set(bounds_by_name) != set(names):
        raise ContinuationError("bounds", f"must be given for {', '.join(names)}", bounds)
    bounds = validate_bounds(at, {name: bounds_by_name[name] for name in names})
    p_rest = {name: value for name, value in at.items() if name not in names}
    constants = (
        constraint.HoldConstants(p_rest, args, tuple(constraints.values())) if constraints else Constants(p_rest, args)
    )
    z = np.append(u_start, [at[name] for name in names])
    problem = constraint.make_problem(system, tuple(constraints), names) if constraints else problem_of(system, names)
    z = _correct_start(problem, z, constants)
    validate_bounds(dict(zip(names, z[len(u_start) :].tolist(), strict=True)), bounds)
    task = make_task(system, z, bounds, constants, first_step, largest_step, tolerance, monitors, stop)
    task = task._replace(problem=problem, limits=limits)
    tangent = event_search.unit_tangent(task.problem, z, task.control.scale, constants)
    backward, forward = follow_both_directions(task, z, tangent, direction)
    return assemble_branch(system, None, bounds, constants, backward, forward)


@check_types
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
    if not isinstance(special, Special) or special.kind not in branch_exits.KINDS or len(special.names) != 1:
        raise ContinuationError(
            "special", f"must be a special point of a branch, {', '.join(branch_exits.KINDS)}", special
        )
    if special.kind == "HB" and (not isinstance(orbits, System) or orbits.kind != ORBITS):
        raise ContinuationError("orbits", "must be the `periodic_orbits` of the field that has the Hopf point", orbits)
    limits = limits_of(max_points, max_seconds, progress, ContinuationError)
    bounds = bounds or special.bounds
    require_settings("both", monitors, stop)
    system, z, constants, tangents = branch_exits.emanating_directions(special, orbits)
    task = make_task(system, z, bounds, constants, first_step, largest_step, tolerance, monitors, stop)
    task = task._replace(starts=(), limits=limits)
    starts = [start_point(z, tangent) for tangent in tangents]
    if special.kind == "HB":
        starts = [hopf.first_orbit(task, half) for half in starts]
    segments = [driver.follow_branch(task, half) for half in starts]
    return tuple(assemble_branch(system, None, bounds, constants, None, half) for half in segments)


def follow_both_directions(task, z, tangent, direction="both"):
    """(the `Stretch` backward, that forward) from a solution; None for that which is not asked for, or not needed as
    the other closes."""
    limits = task.limits
    forward_task = task._replace(limits=limits.halved() if direction == "both" else limits)
    forward = driver.follow_branch(forward_task, start_point(z, tangent)) if direction != "backward" else None
    is_closed = forward is not None and forward.end is End.CLOSED
    task = task._replace(limits=limits.after(0 if forward is None else len(forward.points.z) - 1))
    backward = None if direction == "forward" or is_closed else driver.follow_branch(task, start_point(z, -tangent))
    return backward, forward


def assemble_branch(system, kind, bounds, constants, backward, forward):
    """The `Branch` of the stretches backward and forward from a start; either may be None."""
    names = tuple(bounds)
    segment = (
        forward
        if backward is None
        else reverse_segment(backward)
        if forward is None
        else join_segments([reverse_segment(backward), forward])
    )
    z, n_u = segment.points.z, segment.points.z.shape[1] - len(names)
    eigenvalues = _eigenvalues(system, names, z, constants)
    specials = {part.row: (_kind_of(system, z[part.row, :n_u], part.kind), part.residual) for part in segment.specials}
    for row in (0, len(z) - 1):
        specials.setdefault(row, ("EP", float(segment.points.residual[row])))
    special = tuple(
        Special(
            specials[row][0],
            z[row, :n_u],
            {**constants.fixed_params, **dict(zip(names, z[row, n_u:].tolist(), strict=True))},
            names,
            eigenvalues[row],
            specials[row][1],
            row,
            system,
            constants.args,
            bounds,
            segment.points.tangent[row],
        )
        for row in sorted(specials)
    )
    columns = dict(zip(names, z[:, n_u:].T, strict=True))
    reasons = tuple("the start" if part is None else _end_reason(part, names) for part in (backward, forward))
    return Branch(system, kind, names, z[:, :n_u], columns, eigenvalues, segment.points.residual, special, reasons)


def _kind_of(system, u, kind):
    """The kind of a special point: a branch that comes to one of symmetric solutions meets it in its SB."""
    may_break_symmetry = kind == "BP" and system.symmetry is not None and not system.within
    return "SB" if may_break_symmetry and np.allclose(system.symmetry(u), u, rtol=0, atol=SYMMETRY_TOLERANCE) else kind


def restrict_to_symmetric(system, u, params, args):
    """The system, to keep to solutions that are their own images where u is one. Raises ContinuationError."""
    if not isinstance(system, System) or system.symmetry is None:
        return system
    random_u = u + np.random.default_rng(0).normal(size=len(u))
    u_back = np.asarray(system.symmetry(system.symmetry(random_u)))
    f_image, image_f = (
        system.function(system.symmetry(random_u), params, args),
        system.symmetry(system.function(random_u, params, args)),
    )
    if not np.allclose(u_back, random_u, rtol=0, atol=1e-9) or not np.allclose(f_image, image_f, rtol=1e-9, atol=1e-9):
        raise ContinuationError("symmetry", "must be its own inverse, and keep the function", system.symmetry)
    return system._replace(within=bool(np.allclose(system.symmetry(u), u, rtol=0, atol=SYMMETRY_TOLERANCE)))


def validate_bounds(params, bounds):
    """{name: (low, high)} as plain numbers: finite, the first smaller, with the value at the start between them."""
    intervals = {}
    for name, interval in bounds.items():
        if name not in params:
            raise ContinuationError("along", f"must be a parameter ({', '.join(params)})", name)
        ends = np.asarray(interval, float) if np.shape(interval) == (2,) else np.array([np.nan, np.nan])
        if not (np.isfinite(ends).all() and ends[0] < ends[1]):
            raise ContinuationError("bounds", "must be (low, high), two finite numbers, the first smaller", interval)
        if not ends[0] <= float(params[name]) <= ends[1]:
            raise ContinuationError("bounds", f"must hold the start's {name}, {float(params[name]):.12g}", interval)
        intervals[name] = (float(ends[0]), float(ends[1]))
    return intervals


@persistent_jit(static_argnums=0, numpy_first=True)
def _solve_start(problem, z, constants):
    def function(unknowns):
        value, jacobian = problem.function(jnp.concatenate([unknowns, z[-1:]]), constants)
        return value, jacobian[:, :-1]

    return newton(function, z[:-1])


def _correct_start(problem, z, constants):
    """z with all but its last number by Newton's method."""
    solution = _solve_start(problem, z, constants)
    if solution.status:
        raise ContinuationError("u", f"must be near a solution: {ADVICE[int(solution.status)]}", z[:-1])
    return np.append(solution.unknowns, z[-1])


def make_task(system, z, bounds, constants, first_step, max_step, tolerance, monitors=None, stop=(), default=TOLERANCE):
    """The `ContinuationTask` along the parameters of the bounds from z on; default: the tolerance in place of None.
    Raises ContinuationError."""
    noise = noise_floor(system)
    if tolerance is None:
        tolerance = max(default, noise)
    elif not tolerance >= 0.999 * noise:
        rule = f"must be at least {noise:g}, 10 times that of `periodic_orbits`, which may be given a smaller one"
        raise ContinuationError("tolerance", rule, tolerance)
    for key, value in (("first_step", first_step), ("largest_step", max_step), ("tolerance", tolerance)):
        if not (np.isscalar(value) and np.isfinite(value) and value > 0):
            raise ContinuationError(key, "must be greater than 0", value)
    names, intervals = tuple(bounds), tuple(bounds.values())
    control_values = (min(MIN_STEP, first_step), max_step, tolerance, *intervals[-1])
    control = StepControl(np.ones(len(z)), *(np.float64(control_value) for control_value in control_values))
    detector = BranchEventDetector(system, names, monitors or {})
    step = min(first_step, max_step)
    return ContinuationTask(
        problem_of(system, names), constants, control, step, intervals, detector=detector, stop=tuple(stop), starts=(z,)
    )


def _end_reason(segment, names):
    kind = segment.specials[-1].kind if segment.specials else ""
    return segment.end.value.format(name=names[segment.end_param_index], value=segment.end_value, kind=kind)


def _test_signs(system, names, zs, constants):
    """{label: at each point a number that changes its sign where the matrix of a test is singular}, by eigenvalues. Two
    of them come to the imaginary axis, or the unit circle, at once where so many more, or fewer, are beyond it."""
    eigenvalues = _eigenvalues(system, names, zs, constants)
    is_steady = system.kind == EQUILIBRIA
    n_unstable = np.sum(eigenvalues.real > 0 if is_steady else abs(eigenvalues) > 1, axis=1)
    pair_sign = np.cumprod(np.append(1.0, np.where(abs(np.diff(n_unstable)) >= 2, -1.0, 1.0)))
    signs = (
        {constraint.FOLD: _signed_product(eigenvalues if is_steady else eigenvalues - 1.0)}
        if isinstance(constants, constraint.HoldConstants)
        else {}
    )
    if system.within:
        signs["SB"] = _symmetry_breaking_signs(system, names, zs, constants)
    return signs | ({"HB": pair_sign} if is_steady else {"PD": _signed_product(eigenvalues + 1.0), "NS": pair_sign})


def _symmetry_breaking_signs(system, names, zs, constants):
    """At each point a number whose sign is that of the determinant of SB's matrix."""
    return np.array([np.linalg.slogdet(matrix_at(system, "SB", names, z, constants))[0] for z in zs])


def _signed_product(values):
    """The sign of the product of each row, and how near to zero one of it is."""
    return np.prod(values / np.maximum(abs(values), EIGENVALUE_FLOOR), axis=1).real


@persistent_jit(static_argnums=(0, 1), numpy_first=True)
def _matrices(system, names, zs, constants):
    return jax.vmap(lambda z: stability_matrix(system, names, z, constants))(zs)


def _eigenvalues(system, names, z, constants):
    """Of the `stability_matrix` at points, (points, count), the largest first."""
    n_rows = -(-len(z) // EIGENVALUE_BATCH) * EIGENVALUE_BATCH
    padded = np.concatenate([z, np.repeat(z[-1:], n_rows - len(z), axis=0)])
    eigenvalues = np.linalg.eigvals(np.asarray(_matrices(system, names, padded, constants))[: len(z)]).astype(complex)
    sort_key = eigenvalues.real if system.kind == EQUILIBRIA else abs(eigenvalues)
    return np.take_along_axis(eigenvalues, np.argsort(-sort_key, axis=1, kind="stable"), axis=1)

"""Continue solutions in one parameter (`trace`) and along the branches that emanate from special points (`switch`)."""

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

TOLERANCE = 1e-10  # tolerance of Newton's method, a length
MIN_STEP = 1e-8  # smallest step length
EIGENVALUE_BATCH = 64  # number of points whose eigenvalues one call computes
SYMMETRY_TOLERANCE = 1e-9  # largest difference between a symmetric u and its image
EIGENVALUE_FLOOR = 1e-9  # smallest distance of an eigenvalue from criticality that counts as nonzero
Monitors = Mapping[str, Callable[[Any, Any, Any], ArrayLike]]  # functions of (u, p, args)


class BranchEventDetector(SystemEventDetector):
    """Detector of special points of a branch: the test functions of the problem and user-defined monitors."""

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
        """Evaluate a monitor at a point."""
        n_unknowns = len(z) - len(self.names)
        p = {**constants.fixed_params, **dict(zip(self.names, z[n_unknowns:], strict=True))}
        return float(self.monitors[kind](z[:n_unknowns], p, constants.args))

    def locate_monitor_event(self, kind, task, points, row_before):
        """Locate the zero of a monitor between two points."""

        def value_at_length(length):
            point = point_at_length(task, points, row_before, length)
            if point is None:
                raise ContinuationError(
                    "monitors", "must be evaluated between two points, where Newton's method does not converge", kind
                )
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
    """Continue a solution in one parameter.

    Follows the branch of solutions through a solution near `u` by pseudo-arclength continuation and locates its special
    points.

    Parameters
    ----------
    system : System
        Equations, made by `equilibria`, `fixed_points` or `continuation.shooting.periodic_orbits`.
    u : array_like
        Approximate solution at `at`. Array of shape (n,).
    at : mapping of str to float
        Values of all parameters at the start.
    along : str or sequence of str
        Continuation parameter. With `hold`, one more parameter for each held function.
    bounds : sequence of float or mapping of str to sequence of float
        Lower and upper bound of the continuation parameter; with several parameters, the bounds of each by name. They
        must contain the values at the start.
    args : Any, optional
        Pytree of numbers and arrays passed to the function of the system.
    direction : {"both", "forward", "backward"}, optional
        Direction of the first step: towards larger values (forward), smaller values (backward), or one branch in each
        direction (both). With several parameters it refers to the last one.
    first_step : float, optional
        Length of the first step, measured in (u, parameter).
    largest_step : float, optional
        Largest step length, measured in (u, parameter).
    tolerance : float, optional
        Tolerance of Newton's method, measured in (u, parameter). None stands for 1e-10, and for periodic orbits for at
        least 10 times the tolerance of their integrator.
    monitors : mapping of str to callable, optional
        Functions of (u, p, args) whose sign changes are located as special points of the given names.
    stop : sequence of str, optional
        Kinds of special point at which the continuation ends.
    hold : mapping, optional
        Functions of (u, p, args), or names of monitors, and the values at which they are held along the branch.
    max_points : int, optional
        Largest number of points of the branch. None stands for no limit.
    max_seconds : float, optional
        Largest wall-clock time, in s, checked between chunks of steps. None stands for no limit.
    progress : callable, optional
        Function called with the number of computed points.

    Returns
    -------
    Branch
        The branch with its special points. Its `reasons` state why it ends, a limit that is reached included.

    Raises
    ------
    ContinuationError
        If an argument is invalid or Newton's method does not converge from `u`.

    See Also
    --------
    switch : Continue the branches that emanate from a special point.
    curve : Continue a special point in two parameters.

    Notes
    -----
    With `hold`, the start keeps the value in `at` of the last parameter of `along`; Newton's method adjusts the others.
    A turning point of the last parameter is then no fold: an SN is a point at which dF/du is singular.

    Examples
    --------
    >>> system = co.equilibria(lambda u, p, args: p["a"] - 0.5 - u * u)
    >>> branch = co.trace(system, [1.0], {"a": 1.5}, "a", bounds=(0.0, 2.0))
    >>> [(special.kind, round(special.p["a"], 6)) for special in branch.special]
    [('EP', 2.0), ('SN', 0.5), ('EP', 2.0)]
    >>> branch.reason["last"]
    'a reached its bound 2'
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
        raise ContinuationError("bounds", f"must contain the interval of each parameter: {', '.join(names)}", bounds)
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
    """Continue the branches that emanate from a special point.

    Parameters
    ----------
    special : Special
        Special point of kind BP, SB, PD or HB on a branch with one continuation parameter.
    bounds : mapping of str to tuple of float, optional
        Bounds of the continuation parameter. None stands for those of the branch of the point.
    first_step : float, optional
        Length of the first step, measured in (u, parameter). At HB it sets the amplitude of the first periodic orbit.
    largest_step : float, optional
        Largest step length, measured in (u, parameter).
    tolerance : float, optional
        Tolerance of Newton's method, as in `trace`.
    monitors : mapping of str to callable, optional
        Functions of (u, p, args) whose sign changes are located as special points.
    stop : sequence of str, optional
        Kinds of special point at which the continuation ends.
    orbits : System, optional
        System of periodic orbits of the same field, made by `continuation.shooting.periodic_orbits`. Required at HB.
    max_points : int, optional
        Largest number of points of each branch. None stands for no limit.
    max_seconds : float, optional
        Largest wall-clock time for all branches together, in s. None stands for no limit.
    progress : callable, optional
        Function called with the number of computed points.

    Returns
    -------
    tuple of Branch
        Branches that begin at the point, without the branch on which it lies: both halves of the crossing branch at BP
        and SB, the branch of doubled period at PD, the branch of periodic orbits at HB.

    Raises
    ------
    ContinuationError
        If the point is of another kind, or `orbits` is missing at HB.

    See Also
    --------
    trace : Continue a solution in one parameter.

    Examples
    --------
    >>> system = co.equilibria(lambda u, p, args: (p["a"] - 0.5) * u - u**3)
    >>> branch = co.trace(system, [0.0], {"a": 0.0}, "a", bounds=(-1.0, 1.0))
    >>> halves = co.switch(*branch.points("BP"))
    >>> [half.reason["last"] for half in halves]
    ['a reached its bound 1', 'a reached its bound 1']
    """
    if not isinstance(special, Special) or special.kind not in branch_exits.KINDS or len(special.names) != 1:
        raise ContinuationError(
            "special",
            f"must be a special point of kind {', '.join(branch_exits.KINDS)} on a branch in one parameter",
            special,
        )
    if special.kind == "HB" and (not isinstance(orbits, System) or orbits.kind != ORBITS):
        raise ContinuationError(
            "orbits", "must be the `periodic_orbits` system of the field with the Hopf point", orbits
        )
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
    """Continue from a solution in the requested directions.

    Returns (`BranchSegment` backward, `BranchSegment` forward). An entry is None if its direction is not requested, or
    if the forward branch closes, so that the backward one is not needed.
    """
    limits = task.limits
    forward_task = task._replace(limits=limits.halved() if direction == "both" else limits)
    forward = driver.follow_branch(forward_task, start_point(z, tangent)) if direction != "backward" else None
    is_closed = forward is not None and forward.end is End.CLOSED
    task = task._replace(limits=limits.after(0 if forward is None else len(forward.points.z) - 1))
    backward = None if direction == "forward" or is_closed else driver.follow_branch(task, start_point(z, -tangent))
    return backward, forward


def assemble_branch(system, kind, bounds, constants, backward, forward):
    """Make the `Branch` of the segments backward and forward from a start; either may be None."""
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
    """Return SB for a branch point of a branch of asymmetric solutions at a symmetric solution, else the kind."""
    may_break_symmetry = kind == "BP" and system.symmetry is not None and not system.within
    return "SB" if may_break_symmetry and np.allclose(system.symmetry(u), u, rtol=0, atol=SYMMETRY_TOLERANCE) else kind


def restrict_to_symmetric(system, u, params, args):
    """Restrict a system to symmetric solutions if u is symmetric; raise ContinuationError for an invalid symmetry."""
    if not isinstance(system, System) or system.symmetry is None:
        return system
    random_u = u + np.random.default_rng(0).normal(size=len(u))
    u_back = np.asarray(system.symmetry(system.symmetry(random_u)))
    f_image, image_f = (
        system.function(system.symmetry(random_u), params, args),
        system.symmetry(system.function(random_u, params, args)),
    )
    if not np.allclose(u_back, random_u, rtol=0, atol=1e-9) or not np.allclose(f_image, image_f, rtol=1e-9, atol=1e-9):
        raise ContinuationError(
            "symmetry", "must satisfy S(S(u)) = u and function(S(u)) = S(function(u))", system.symmetry
        )
    return system._replace(within=bool(np.allclose(system.symmetry(u), u, rtol=0, atol=SYMMETRY_TOLERANCE)))


def validate_bounds(params, bounds):
    """Return the bounds {name: (low, high)} as floats; raise ContinuationError if they are invalid.

    Bounds must be finite with low < high and contain the value at the start.
    """
    intervals = {}
    for name, interval in bounds.items():
        if name not in params:
            raise ContinuationError("along", f"must be one of the parameters {', '.join(params)}", name)
        ends = np.asarray(interval, float) if np.shape(interval) == (2,) else np.array([np.nan, np.nan])
        if not (np.isfinite(ends).all() and ends[0] < ends[1]):
            raise ContinuationError("bounds", "must be (low, high), two finite numbers with low < high", interval)
        if not ends[0] <= float(params[name]) <= ends[1]:
            raise ContinuationError(
                "bounds", f"must contain the value of {name} at the start, {float(params[name]):.12g}", interval
            )
        intervals[name] = (float(ends[0]), float(ends[1]))
    return intervals


@persistent_jit(static_argnums=0, numpy_first=True)
def _solve_start(problem, z, constants):
    def function(unknowns):
        value, jacobian = problem.function(jnp.concatenate([unknowns, z[-1:]]), constants)
        return value, jacobian[:, :-1]

    return newton(function, z[:-1])


def _correct_start(problem, z, constants):
    """Correct all entries of z except the last by Newton's method."""
    solution = _solve_start(problem, z, constants)
    if solution.status:
        raise ContinuationError("u", f"must be near a solution: {ADVICE[int(solution.status)]}", z[:-1])
    return np.append(solution.unknowns, z[-1])


def make_task(system, z, bounds, constants, first_step, max_step, tolerance, monitors=None, stop=(), default=TOLERANCE):
    """Make the `ContinuationTask` from z in the parameters of `bounds`; raise ContinuationError for invalid settings.

    The tolerance `default` replaces a tolerance of None.
    """
    noise = noise_floor(system)
    if tolerance is None:
        tolerance = max(default, noise)
    elif not tolerance >= 0.999 * noise:
        rule = f"must be at least {noise:g}, 10 times the tolerance of `periodic_orbits`, which may be reduced"
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
    """Format the termination reason of a `BranchSegment`."""
    kind = segment.specials[-1].kind if segment.specials else ""
    return segment.end.value.format(name=names[segment.end_param_index], value=segment.end_value, kind=kind)


def _test_signs(system, names, zs, constants):
    """Return {label: values of a test function at the points}, computed from eigenvalues.

    The values change sign where the matrix of the test is singular. For HB and NS the sign changes where the number of
    unstable eigenvalues changes by two or more, because a pair crosses the imaginary axis, or the unit circle.
    """
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
    """Return the sign of the determinant of the SB matrix at each point."""
    return np.array([np.linalg.slogdet(matrix_at(system, "SB", names, z, constants))[0] for z in zs])


def _signed_product(values):
    """Return the sign of the product of each row, scaled down where a factor is close to zero."""
    return np.prod(values / np.maximum(abs(values), EIGENVALUE_FLOOR), axis=1).real


@persistent_jit(static_argnums=(0, 1), numpy_first=True)
def _matrices(system, names, zs, constants):
    return jax.vmap(lambda z: stability_matrix(system, names, z, constants))(zs)


def _eigenvalues(system, names, z, constants):
    """Compute the eigenvalues of the `stability_matrix` at the points, (points, count), in descending order."""
    n_rows = -(-len(z) // EIGENVALUE_BATCH) * EIGENVALUE_BATCH
    padded = np.concatenate([z, np.repeat(z[-1:], n_rows - len(z), axis=0)])
    eigenvalues = np.linalg.eigvals(np.asarray(_matrices(system, names, padded, constants))[: len(z)]).astype(complex)
    sort_key = eigenvalues.real if system.kind == EQUILIBRIA else abs(eigenvalues)
    return np.take_along_axis(eigenvalues, np.argsort(-sort_key, axis=1, kind="stable"), axis=1)

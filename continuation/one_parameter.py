"""Continue solutions in one parameter (`trace`) and along the branches that emanate from special points (`switch`)."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Real

from . import constraint, continuation_loop, emanating_branches, event_search
from .arclength import make_control, make_start_point
from .branch import Branch, Special
from .branch_closure import SystemEventDetector
from .branch_segment import join_segments, make_limits, reverse_segment
from .continuation_loop import ContinuationTask, follow_both_directions
from .errors import ContinuationError, check_types
from .event_search import locate_sign_changes
from .hostcall import persistent_jit
from .newton import ADVICE, newton
from .problem import (
    EQUILIBRIA,
    ORBITS,
    System,
    SystemConstants,
    make_problem,
    matrix_of_kind,
    newton_step_floor,
    split_unknowns,
    stability_matrix,
)
from .validation import (
    SYMMETRY_TOLERANCE,
    require_settings,
    require_system,
    restrict_to_symmetric,
    validate_bounds,
    validate_start,
)

TOLERANCE = 1e-10  # tolerance of Newton's method, a length
EIGENVALUE_BATCH = 64  # number of points whose eigenvalues one call computes
EIGENVALUE_FLOOR = 1e-9  # smallest distance of an eigenvalue from criticality that counts as nonzero
Monitors = Mapping[str, Callable[[Any, Any, Any], ArrayLike]]  # functions of (u, p, args)


class BranchEventDetector(SystemEventDetector):
    """Event detector that locates sign changes of the test functions of a problem and of user-defined monitors."""

    def __init__(self, system, param_names, monitors):
        super().__init__(system, param_names)
        self.monitors = monitors

    def find_early_end(self, task, points):
        return (
            emanating_branches.find_hopf_end(self.system, self.names, task, points)
            if self.system.kind == ORBITS
            else None
        )

    def find_events(self, task, points, diagnostics, known_branch_points, termination):
        test_signs = _test_signs(self.system, self.names, points.z, task.args)
        events = event_search.locate_events(
            task.problem, points, test_signs, task.control, task.args, known_branch_points
        )
        if constraint.FOLD in test_signs:
            events = [
                event._replace(kind="SN") if event.kind == constraint.FOLD else event
                for event in events
                if event.kind != "SN"
            ]
        for monitor_name in self.monitors:
            value_at = partial(self.monitor_value, monitor_name, task.args)
            monitor_values = np.array([value_at(z) for z in points.z])
            events += locate_sign_changes(task, points, monitor_name, monitor_values, value_at, self.monitor_error)
        return events

    def monitor_value(self, monitor_name, constants, z):
        """Evaluate a monitor at a point."""
        return float(self.monitors[monitor_name](*split_unknowns(self.names, z, constants), constants.args))

    def monitor_error(self, monitor_name, row_before):
        """Return the error for a monitor that cannot be evaluated after a point."""
        rule = "must be evaluated between two points, where Newton's method does not converge"
        return ContinuationError("monitors", rule, monitor_name)


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
        Direction of the first step: towards larger values (forward), smaller values (backward), or both. With several
        parameters the values are those of the last parameter.
    first_step : float, optional
        Length of the first step, measured in (u, parameter).
    largest_step : float, optional
        Largest step length, measured in (u, parameter).
    tolerance : float, optional
        Tolerance of Newton's method, measured in (u, parameter). None stands for 1e-10, or for 10 times the tolerance
        of the integrator of periodic orbits if this is larger.
    monitors : mapping of str to callable, optional
        Functions of (u, p, args) whose sign changes are located as special points of the given names.
    stop : sequence of str, optional
        Kinds of special point, or names of monitors, at which the continuation ends.
    hold : mapping, optional
        Values at which functions are held along the branch. Keys are functions of (u, p, args) or names of monitors.
    max_points : int, optional
        Largest number of points of the branch. None stands for no limit.
    max_seconds : float, optional
        Largest wall-clock time, in s, checked between chunks of steps. None stands for no limit.
    progress : callable, optional
        Function called with the number of computed points.

    Returns
    -------
    Branch
        The branch with its special points. `Branch.reasons` contains the termination reasons, such as a limit.

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
    With `hold`, the start keeps the value in `at` of the last parameter of `along`; Newton's method adjusts u and the
    other parameters. An SN is then a point at which dF/du is singular. A turning point of the last parameter is in
    general not such a point.

    Examples
    --------
    >>> system = co.equilibria(lambda u, p, args: p["a"] - 0.5 - u * u)
    >>> branch = co.trace(system, [1.0], {"a": 1.5}, "a", bounds=(0.0, 2.0))
    >>> [(special.kind, round(special.p["a"], 6)) for special in branch.special]
    [('EP', 2.0), ('SN', 0.5), ('EP', 2.0)]
    >>> branch.reason["last"]
    'a reached its bound 2'
    """
    limits = make_limits(max_points, max_seconds, progress, ContinuationError)
    start_u, at = validate_start(u, at)
    require_settings(direction, monitors, stop)
    require_system(system, start_u, at, args)
    system = restrict_to_symmetric(system, start_u, at, args)
    param_names = (along,) if isinstance(along, str) else tuple(along)
    constraints = constraint.resolve_constraints(hold, monitors, param_names)
    bounds_by_name = bounds if isinstance(bounds, Mapping) else dict.fromkeys(param_names, bounds)
    bounds = validate_bounds(at, param_names, bounds_by_name)
    fixed_params = {name: value for name, value in at.items() if name not in param_names}
    constants = SystemConstants(fixed_params, args, tuple(constraints.values()))
    start_z = np.append(start_u, [at[name] for name in param_names])
    problem = (
        constraint.make_constrained_problem(system, tuple(constraints), param_names)
        if constraints
        else make_problem(system, param_names)
    )
    start_z = _correct_start(problem, start_z, constants)
    validate_bounds(dict(zip(param_names, start_z[len(start_u) :].tolist(), strict=True)), param_names, bounds)
    task = make_task(system, start_z, bounds, constants, first_step, largest_step, tolerance, monitors, stop)
    task = task._replace(problem=problem, limits=limits)
    tangent = event_search.unit_tangent(task.problem, start_z, task.control.scale, constants)
    backward_segment, forward_segment = follow_both_directions(task, start_z, tangent, direction)
    return assemble_branch(system, None, bounds, constants, backward_segment, forward_segment)


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
        Kinds of special point, or names of monitors, at which the continuation ends.
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
        Branches that start at the special point, without the branch of the special point: both halves of the crossing
        branch at BP and SB, the branch of doubled period at PD, the branch of periodic orbits at HB.

    Raises
    ------
    ContinuationError
        If an argument is invalid, if the point is of another kind or on a branch in several parameters, if `orbits` is
        missing at HB, or if `first_step` does not lead to a periodic orbit at HB.
    ValueError
        If no other branch crosses the branch at BP or SB.

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
    if not isinstance(special, Special) or special.kind not in emanating_branches.KINDS or len(special.names) != 1:
        raise ContinuationError(
            "special",
            f"must be a special point of kind {', '.join(emanating_branches.KINDS)} on a branch in one parameter",
            special,
        )
    if special.kind == "HB" and (not isinstance(orbits, System) or orbits.kind != ORBITS):
        raise ContinuationError(
            "orbits", "must be the `periodic_orbits` system of the field with the Hopf point", orbits
        )
    limits = make_limits(max_points, max_seconds, progress, ContinuationError)
    bounds = validate_bounds(special.p, special.names, special.bounds if bounds is None else bounds)
    require_settings("both", monitors, stop)
    system, start_z, constants, tangents = emanating_branches.emanating_directions(special, orbits)
    task = make_task(system, start_z, bounds, constants, first_step, largest_step, tolerance, monitors, stop)
    task = task._replace(starts=(), limits=limits)
    start_points = [make_start_point(start_z, tangent) for tangent in tangents]
    if special.kind == "HB":
        start_points = [emanating_branches.first_orbit(task, branch_half) for branch_half in start_points]
    segments = [continuation_loop.follow_branch(task, branch_half) for branch_half in start_points]
    return tuple(assemble_branch(system, None, bounds, constants, None, branch_half) for branch_half in segments)


def assemble_branch(system, kind, bounds, constants, backward_segment, forward_segment):
    """Make the `Branch` of the segments backward and forward from a start; either segment may be None."""
    param_names = tuple(bounds)
    full_segment = (
        forward_segment
        if backward_segment is None
        else reverse_segment(backward_segment)
        if forward_segment is None
        else join_segments([reverse_segment(backward_segment), forward_segment])
    )
    zs, n_unknowns = full_segment.points.z, full_segment.points.z.shape[1] - len(param_names)
    eigenvalues = _sorted_eigenvalues(system, param_names, zs, constants)
    kind_and_residual_by_row = {
        segment_special.row: (
            _kind_with_symmetry(system, zs[segment_special.row, :n_unknowns], segment_special.kind),
            segment_special.residual,
        )
        for segment_special in full_segment.specials
    }
    for row in (0, len(zs) - 1):
        kind_and_residual_by_row.setdefault(row, ("EP", float(full_segment.points.residual[row])))
    special_points = tuple(
        Special(
            kind_and_residual_by_row[row][0],
            zs[row, :n_unknowns],
            {**constants.fixed_params, **dict(zip(param_names, zs[row, n_unknowns:].tolist(), strict=True))},
            param_names,
            eigenvalues[row],
            kind_and_residual_by_row[row][1],
            row,
            system,
            constants.args,
            bounds,
            full_segment.points.tangent[row],
        )
        for row in sorted(kind_and_residual_by_row)
    )
    parameter_columns = dict(zip(param_names, zs[:, n_unknowns:].T, strict=True))
    reasons = tuple(
        "the start" if segment is None else _format_end_reason(segment, param_names)
        for segment in (backward_segment, forward_segment)
    )
    return Branch(
        system,
        kind,
        param_names,
        zs[:, :n_unknowns],
        parameter_columns,
        eigenvalues,
        full_segment.points.residual,
        special_points,
        reasons,
    )


def _kind_with_symmetry(system, u, kind):
    """Return SB for a branch point at a symmetric solution of an unrestricted system, else the kind."""
    may_break_symmetry = kind == "BP" and system.symmetry is not None and not system.within
    return "SB" if may_break_symmetry and np.allclose(system.symmetry(u), u, rtol=0, atol=SYMMETRY_TOLERANCE) else kind


@persistent_jit(static_argnums=0, numpy_first=True)
def _correct_unknowns(problem, z, constants):
    def residual_and_jacobian(unknowns):
        residual, jacobian = problem.function(jnp.concatenate([unknowns, z[-1:]]), constants)
        return residual, jacobian[:, :-1]

    return newton(residual_and_jacobian, z[:-1])


def _correct_start(problem, z, constants):
    """Correct all entries of z except the last by Newton's method."""
    solution = _correct_unknowns(problem, z, constants)
    if solution.status:
        raise ContinuationError("u", f"must be near a solution: {ADVICE[int(solution.status)]}", z[:-1])
    return np.append(solution.unknowns, z[-1])


def make_task(
    system,
    start_z,
    bounds,
    constants,
    first_step,
    max_step,
    tolerance,
    monitors=None,
    stop_kinds=(),
    default_tolerance=TOLERANCE,
):
    """Make the `ContinuationTask` from z in the parameters of `bounds`; raise ContinuationError for invalid settings.

    `default_tolerance` is the tolerance that replaces None.
    """
    min_tolerance = newton_step_floor(system)
    if tolerance is None:
        tolerance = max(default_tolerance, min_tolerance)
    elif not tolerance >= 0.999 * min_tolerance:
        error_rule = (
            f"must be at least {min_tolerance:g}, 10 times the tolerance of `periodic_orbits`, which may be reduced"
        )
        raise ContinuationError("tolerance", error_rule, tolerance)
    for key, value in (("first_step", first_step), ("largest_step", max_step), ("tolerance", tolerance)):
        if not (np.isscalar(value) and np.isfinite(value) and value > 0):
            raise ContinuationError(key, "must be greater than 0", value)
    param_names, intervals = tuple(bounds), tuple(bounds.values())
    control = make_control(np.ones(len(start_z)), first_step, max_step, tolerance, intervals[-1])
    detector = BranchEventDetector(system, param_names, monitors or {})
    first_step_length = min(first_step, max_step)
    return ContinuationTask(
        make_problem(system, param_names),
        constants,
        control,
        first_step_length,
        intervals,
        detector=detector,
        stop=tuple(stop_kinds),
        starts=(start_z,),
    )


def _format_end_reason(segment, param_names):
    """Format the termination reason of a `BranchSegment`."""
    last_special_kind = segment.specials[-1].kind if segment.specials else ""
    return segment.end.value.format(
        name=param_names[segment.end_param_index], value=segment.end_value, kind=last_special_kind
    )


def _test_signs(system, param_names, zs, constants):
    """Return {label: values of a test function at the points}, computed from eigenvalues except for SB.

    For the fold, PD and SB the values change sign where the matrix of the test function is singular. For HB and NS they
    change sign where the number of unstable eigenvalues changes by two or more, as when a pair of eigenvalues crosses
    the imaginary axis or the unit circle.
    """
    eigenvalues = _sorted_eigenvalues(system, param_names, zs, constants)
    is_equilibrium = system.kind == EQUILIBRIA
    n_unstable = np.sum(eigenvalues.real > 0 if is_equilibrium else abs(eigenvalues) > 1, axis=1)
    pair_crossing_signs = np.cumprod(np.append(1.0, np.where(abs(np.diff(n_unstable)) >= 2, -1.0, 1.0)))
    signs_by_kind = (
        {constraint.FOLD: _smooth_product_signs(eigenvalues if is_equilibrium else eigenvalues - 1.0)}
        if constants.values
        else {}
    )
    if system.within:
        matrices = [matrix_of_kind(system, "SB", param_names, z, constants) for z in zs]
        signs_by_kind["SB"] = np.linalg.slogdet(matrices)[0]
    return signs_by_kind | (
        {"HB": pair_crossing_signs}
        if is_equilibrium
        else {"PD": _smooth_product_signs(eigenvalues + 1.0), "NS": pair_crossing_signs}
    )


def _smooth_product_signs(factors):
    """Return the sign of the product of each row; the result has a modulus below 1 where a factor is nearly zero."""
    return np.prod(factors / np.maximum(abs(factors), EIGENVALUE_FLOOR), axis=1).real


@persistent_jit(static_argnums=(0, 1), numpy_first=True)
def _stability_matrices(system, param_names, zs, constants):
    return jax.vmap(lambda z: stability_matrix(system, param_names, z, constants))(zs)


def _sorted_eigenvalues(system, param_names, zs, constants):
    """Compute the eigenvalues of the `stability_matrix` at points, shape (points, count).

    Eigenvalues of equilibria are in descending order of their real parts, multipliers in that of their moduli.
    """
    n_padded_rows = -(-len(zs) // EIGENVALUE_BATCH) * EIGENVALUE_BATCH
    padded_zs = np.concatenate([zs, np.repeat(zs[-1:], n_padded_rows - len(zs), axis=0)])
    eigenvalues = np.linalg.eigvals(
        np.asarray(_stability_matrices(system, param_names, padded_zs, constants))[: len(zs)]
    ).astype(complex)
    sort_key = eigenvalues.real if system.kind == EQUILIBRIA else abs(eigenvalues)
    return np.take_along_axis(eigenvalues, np.argsort(-sort_key, axis=1, kind="stable"), axis=1)

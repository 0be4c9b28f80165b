"""Follow the branches that emanate from a special point, and extend a branch beyond its ends."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from continuation import augmented_systems
from continuation import branch_point_tangents as crossing
from continuation.computation_limits import UNLIMITED, Limits, make_limits
from continuation.event_search import unit_tangent
from continuation.intermediate_points import make_start_point

from ..problem.branches_from_grazing import make_padded_sequence
from ..problem.end import RESUMABLE_ENDS, End, EndReason
from ..problem.grazing_contact import arclength_weights
from ..problem.orbit_curve import dataset_row, parse_orbit_point
from ..problem.orbit_equations import continuation_problem
from ..problem.orbit_point import set_up_equations
from ..problem.soft_wall_grazing import find_all_exits
from ..scene import check
from ..scene.scene_parameters import check_parameter_bounds, parameter_domain
from ..scene.typical_scales import typical_length
from .assemble import START_REASON, assemble_branch, merge_branches
from .branch import Branch, Special
from .follow import Monitors, check_follow_settings, make_branch_settings
from .through_grazings import continue_through_grazings

FIRST_STEP = 0.01  # first step of a branch that leaves a special point
SWITCHING_KINDS = ("SB", "BP", "PD", "GR")


@check.host_only("use strobe or monodromy")
def switch(
    special: Special,
    bounds: tuple[float, float] | None = None,
    first_step: float = FIRST_STEP,
    largest_step: float = 0.1,
    tolerance: float = 1e-10,
    monitors: Monitors = (),
    stop: str | Sequence[str] = (),
    limits: Limits = UNLIMITED,
) -> tuple[Branch, ...]:
    """Follow the branches that emanate from a special point of a branch.

    `jaxvibro.switch` documents the arguments.

    Parameters
    ----------
    special : Special
        Special point of kind SB, BP, PD or GR.
    bounds : tuple of float, optional
        Bounds of the parameter. None means the bounds of the point.
    first_step : float, optional
        First step along each branch.
    largest_step : float, optional
        Largest step.
    tolerance : float, optional
        Tolerance of Newton's method.
    monitors : dict of str to callable, optional
        User-defined test functions, as in `follow`.
    stop : str or sequence of str, optional
        Kinds of special point at which a branch ends.
    limits : Limits, optional
        Limits of points and time.

    Returns
    -------
    tuple of Branch
        The branches.

    Raises
    ------
    ArgumentError
        If the point is of another kind, or an argument is invalid.
    """
    if not isinstance(special, Special):
        raise check.ArgumentError("special", "must be a special point of a branch", special)
    if special.kind not in SWITCHING_KINDS:
        raise check.ArgumentError(
            "special",
            f"must be of kind {', '.join(SWITCHING_KINDS)}, because no branch emanates from other kinds",
            special.kind,
        )
    bounds = check_parameter_bounds(special.scene, special.name, special.bounds if bounds is None else bounds)
    settings = check_follow_settings(first_step, largest_step, tolerance, monitors, stop) | {"limits": limits}
    return tuple(follow_away_from_point(special, start, bounds, **settings) for start in branch_starts(special))


def branch_starts(special):
    """Return `OrbitEquations` and `Point` at the start of each branch that emanates from a special point.

    The kind of the point must be one of `SWITCHING_KINDS`. Raises ValueError if the equations show that no branches
    cross.
    """
    start_function = {"PD": _doubling_starts, "GR": _grazing_starts}.get(special.kind, _crossing_starts)
    return start_function(special, *set_up_equations(special.scene, special.name, special.spot))


def follow_away_from_point(special, start, bounds, **settings):
    """Follow a branch that emanates from a special point in one direction, from one of its `branch_starts`."""
    (problem, point), scene = start, special.scene
    branch_settings = make_branch_settings(
        scene, special.name, bounds, typical_length(scene), (problem, point.z), **settings
    )
    start_reason = End.LEFT.reason(special.value, special.kind)
    return assemble_branch(
        scene,
        special.name,
        bounds,
        settings,
        None,
        continue_through_grazings(problem, point, branch_settings),
        start_reason,
    )


@check.host_only("use strobe or monodromy")
def extend(
    branch: Branch,
    bounds: tuple[float, float],
    *,
    max_points: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> Branch:
    """Continue a branch beyond its ends within wider bounds.

    An end is continued if the parameter had reached its bound, or if a limit of points or time had been reached.

    Parameters
    ----------
    branch : Branch
        Branch to continue.
    bounds : tuple of float
        Wider bounds. They must contain the bounds of the branch.
    max_points : int, optional
        Largest number of added points. None is no limit.
    max_seconds : float, optional
        Largest wall-clock time in s. None is no limit.
    progress : callable, optional
        Called with the number of points computed.

    Returns
    -------
    Branch
        The branch with the new bounds.

    Raises
    ------
    ArgumentError
        If the new bounds do not contain the old ones.

    See Also
    --------
    follow : Continue a periodic orbit in one parameter.

    Examples
    --------
    >>> wider = jv.extend(branch, bounds=(0.0, 6.2))
    >>> wider.bounds, len(wider) >= len(branch)
    ((0.0, 6.2), True)
    """
    if not isinstance(branch, Branch):
        raise check.ArgumentError("branch", "must be a Branch", branch)
    limits = make_limits(max_points, max_seconds, progress, check.ArgumentError)
    wide_bounds = check_parameter_bounds(branch.scene, branch.name, bounds)
    if not (wide_bounds[0] <= branch.bounds[0] and branch.bounds[1] <= wide_bounds[1]):
        raise check.ArgumentError("bounds", f"must contain the branch's own, {branch.bounds}", bounds)
    for end_index in (0, -1):
        value = branch.values[end_index]
        if branch.ends[end_index] not in RESUMABLE_ENDS and (
            branch.ends[end_index] is not End.BOUND or value in wide_bounds
        ):
            continue
        if value in parameter_domain(branch.scene, branch.name):
            branch = _branch_with_end(branch, end_index, End.DOMAIN.reason(value))
            continue
        if limits.is_reached(1):
            reason = (End.MAX_SECONDS if limits.expired else End.MAX_POINTS).reason(value)
            branch = _branch_with_end(branch, end_index, reason)
            continue
        extension = _extend_from_end(branch, end_index, wide_bounds, limits)
        limits = limits.after_points(len(extension) - 1)
        is_closed = extension.ends[end_index] is End.CLOSED
        if len(extension) > 1:
            branch = merge_branches(branch, extension) if end_index else merge_branches(extension, branch)
        branch = _branch_with_end(branch, end_index, EndReason(extension.ends[end_index], extension.reasons[end_index]))
        if is_closed:  # it reached the other end
            return _branch_with_bounds(_branch_with_end(branch, -1 - end_index, START_REASON), wide_bounds)
    return _branch_with_bounds(branch, wide_bounds)


def _branch_with_end(branch, end_index, reason):
    """Replace the `EndReason` of one end (0 or -1) of a branch."""
    ends, reasons = list(branch.ends), list(branch.reasons)
    ends[end_index], reasons[end_index] = reason
    return replace(branch, ends=tuple(ends), reasons=tuple(reasons))


def _branch_with_bounds(branch, bounds):
    """Replace the bounds of a branch and of its special points."""
    return replace(branch, bounds=bounds, special=tuple(replace(special, bounds=bounds) for special in branch.special))


def _extend_from_end(branch, end_index, bounds, limits):
    """Follow a branch beyond its end 0 or -1.

    Beyond end -1 the extension starts at the last point; beyond end 0 it finishes at the first point. The extension is
    closed if it reaches the other end.
    """
    row, sign = dataset_row(branch.data, end_index), 1.0 if end_index else -1.0
    orbit_row = parse_orbit_point(row, branch.name)
    scene = branch.scene.replace(**{branch.name: orbit_row.value})
    problem, z = set_up_equations(scene, branch.name, orbit_row)
    closing_orbit = set_up_equations(
        scene, branch.name, parse_orbit_point(dataset_row(branch.data, -1 - end_index), branch.name)
    )
    n_impacts, n_rows = len(orbit_row.times), len(problem.sequence.sides)
    stored_tangent = np.zeros(len(z))
    is_impact = row["side"] != 0
    if n_rows:
        stored_tangent[:n_impacts], stored_tangent[n_rows : n_rows + n_impacts] = (
            row["time_slope"][is_impact],
            row["speed_slope"][is_impact],
        )
    stored_tangent[-1] = row["value_slope"]
    start = make_start_point(
        z,
        unit_tangent(
            continuation_problem(problem),
            z,
            arclength_weights(problem, typical_length(scene)),
            problem,
            sign * stored_tangent,
        ),
    )
    branch_settings = make_branch_settings(
        scene, branch.name, bounds, typical_length(scene), closing_orbit, **branch.settings, limits=limits
    )
    extension = continue_through_grazings(problem, start, branch_settings)
    backward, forward = (extension, None) if sign < 0 else (None, extension)
    return replace(assemble_branch(scene, branch.name, bounds, branch.settings, backward, forward), scene=branch.scene)


def _crossing_starts(special, problem, z):
    """Return the starts of both directions of the branch that crosses the branch of the point."""
    weights, n_rows = arclength_weights(problem, typical_length(special.scene)), len(problem.sequence.sides)
    n_impacts, branch_tangent = len(special.spot.times), np.zeros(len(z))
    branch_tangent[:n_impacts], branch_tangent[n_rows : n_rows + n_impacts] = (
        special.slopes[:n_impacts],
        special.slopes[n_impacts:-1],
    )
    branch_tangent[-1] = special.slopes[-1]
    tangent_pair = crossing.branch_tangents(continuation_problem(problem), z, weights, problem)
    if special.kind == "SB":  # the halves of one branch are mirror images at equal parameter values
        tangent_pair[np.argmin(abs(tangent_pair[:, -1])), -1] = 0.0
    crossing_tangent = crossing.less_aligned_tangent(tangent_pair, branch_tangent, weights)
    sign_entry_index = np.flatnonzero(abs(crossing_tangent) > 0.5 * abs(crossing_tangent).max())[
        0
    ]  # a null vector has no sign of its own
    return [
        (problem, make_start_point(z, sign * np.sign(crossing_tangent[sign_entry_index]) * crossing_tangent))
        for sign in (1.0, -1.0)
    ]


def _doubling_starts(special, problem, z):
    """Return the start of the branch of twice the period, in the direction in which its two halves differ."""
    orbit_problem, n_rows, n_impacts = (
        continuation_problem(problem),
        len(problem.sequence.sides),
        len(special.spot.times),
    )
    null_vector = augmented_systems.null_vector(
        augmented_systems.matrix_and_derivative(orbit_problem, orbit_problem.test_functions[0], z, problem)[0]
    )
    orbit_row, orbit_duration = special.spot, special.spot.periods * 2.0 * np.pi / float(special.scene.frequency)
    doubled_times = np.concatenate([orbit_row.times, orbit_row.times + orbit_duration])
    doubled_problem = problem._replace(sequence=problem.sequence._replace(periods=np.asarray(2.0 * orbit_row.periods)))
    if not n_impacts:  # z = (x, v, parameter)
        tangent = np.append(null_vector, 0.0)
        return [
            (
                doubled_problem,
                make_start_point(
                    z,
                    tangent
                    / np.linalg.norm(arclength_weights(doubled_problem, typical_length(special.scene)) * tangent),
                ),
            )
        ]
    doubled_impacts = zip(doubled_times, np.tile(orbit_row.speeds, 2), np.tile(orbit_row.sides, 2), strict=True)
    doubled_problem = doubled_problem._replace(sequence=make_padded_sequence(doubled_problem, list(doubled_impacts)))
    n_doubled_rows = len(doubled_problem.sequence.sides)
    tangent = np.zeros(2 * n_doubled_rows + 1)
    for half_index in (0, 1):
        half_null_vector = null_vector[half_index * n_rows : half_index * n_rows + n_impacts]
        tangent[half_index * n_doubled_rows : half_index * n_doubled_rows + 2 * n_impacts] = np.concatenate(
            [half_null_vector, -half_null_vector]
        )
    tangent /= np.linalg.norm(arclength_weights(doubled_problem, typical_length(special.scene)) * tangent)
    doubled_z = np.concatenate([doubled_problem.sequence.times, doubled_problem.sequence.speeds, z[-1:]])
    return [(doubled_problem, make_start_point(doubled_z, tangent))]


def _grazing_starts(special, problem, z):
    """Return the starts of the branches from a grazing, except those along which the branch of the point continues."""
    _, grazing_exits, _ = find_all_exits(problem, z, typical_length(special.scene))
    if len(grazing_exits) != len(special.aside):
        raise check.ArgumentError(
            "special", "must be a grazing that this version reproduces; follow its branch again", special
        )
    return [
        (grazing_exit.problem, grazing_exit.point)
        for grazing_exit, is_unfollowed in zip(grazing_exits, special.aside, strict=True)
        if is_unfollowed
    ]

"""Follow the branches that emanate from a special point, and extend a branch beyond its ends."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from continuation import augmented_systems
from continuation import branch_switching as crossing
from continuation.event_search import unit_tangent
from continuation.intermediate_points import start_point
from continuation.limits import UNLIMITED, Limits, limits_of

from ..problem.end import RESUMABLE_ENDS, End, Reason
from ..problem.equations import continuation_problem
from ..problem.grazing import padded_sequence
from ..problem.grazing_contact import arclength_weights
from ..problem.orbit_point import set_up_problem
from ..problem.orbit_rows import dataset_row, parse_orbit_row
from ..problem.soft_grazing import find_all_exits
from ..scene import check
from ..scene.parameters import check_bounds, parameter_domain
from ..scene.typical_scales import scene_length
from .assemble import START_REASON, assemble_branch, merge_branches
from .branch import Branch, Special
from .follow import Monitors, check_settings, make_branch_settings
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
        Bounds of the parameter. None takes those of the point.
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
    bounds = check_bounds(special.scene, special.name, special.bounds if bounds is None else bounds)
    settings = check_settings(first_step, largest_step, tolerance, monitors, stop) | {"limits": limits}
    return tuple(follow_from_start(special, start, bounds, **settings) for start in branch_starts(special))


def branch_starts(special):
    """Return `OrbitEquations` and `Point` at the start of each branch that emanates from a special point.

    The kind of the point must be one of `SWITCHING_KINDS`. Raises ValueError if the equations show that no branches
    cross.
    """
    start_function = {"PD": _doubling_starts, "GR": _grazing_starts}.get(special.kind, _crossing_starts)
    return start_function(special, *set_up_problem(special.scene, special.name, special.spot))


def follow_from_start(special, start, bounds, **settings):
    """Follow the branch that leaves a special point from one of its `branch_starts`."""
    (problem, point), scene = start, special.scene
    branch_settings = make_branch_settings(
        scene, special.name, bounds, scene_length(scene), (problem, point.z), **settings
    )
    start = End.LEFT.reason(special.value, special.kind)
    return assemble_branch(
        scene, special.name, bounds, settings, None, continue_through_grazings(problem, point, branch_settings), start
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
    limits = limits_of(max_points, max_seconds, progress, check.ArgumentError)
    wide_bounds = check_bounds(branch.scene, branch.name, bounds)
    if not (wide_bounds[0] <= branch.bounds[0] and branch.bounds[1] <= wide_bounds[1]):
        raise check.ArgumentError("bounds", f"must contain the branch's own, {branch.bounds}", bounds)
    for end_index in (0, -1):
        value = branch.values[end_index]
        if branch.ends[end_index] not in RESUMABLE_ENDS and (
            branch.ends[end_index] is not End.BOUND or value in wide_bounds
        ):
            continue
        if value in parameter_domain(branch.scene, branch.name):
            branch = _with_end(branch, end_index, End.DOMAIN.reason(value))
            continue
        if limits.reached(1):
            reason = (End.MAX_SECONDS if limits.expired else End.MAX_POINTS).reason(value)
            branch = _with_end(branch, end_index, reason)
            continue
        extension = _extend_from_end(branch, end_index, wide_bounds, limits)
        limits = limits.after(len(extension) - 1)
        is_closed = extension.ends[end_index] is End.CLOSED
        if len(extension) > 1:
            branch = merge_branches(branch, extension) if end_index else merge_branches(extension, branch)
        branch = _with_end(branch, end_index, Reason(extension.ends[end_index], extension.reasons[end_index]))
        if is_closed:  # it reached the other end
            return _with_bounds(_with_end(branch, -1 - end_index, START_REASON), wide_bounds)
    return _with_bounds(branch, wide_bounds)


def _with_end(branch, end_index, reason):
    """Replace the `Reason` of one end (0 or -1) of a branch."""
    ends, reasons = list(branch.ends), list(branch.reasons)
    ends[end_index], reasons[end_index] = reason
    return replace(branch, ends=tuple(ends), reasons=tuple(reasons))


def _with_bounds(branch, bounds):
    """Replace the bounds of a branch and of its special points."""
    return replace(branch, bounds=bounds, special=tuple(replace(special, bounds=bounds) for special in branch.special))


def _extend_from_end(branch, end_index, bounds, limits):
    """Follow a branch beyond its end 0 or -1.

    The extension starts at the last point, or finishes at the first point. It closes where it reaches the other end.
    """
    row, sign = dataset_row(branch.data, end_index), 1.0 if end_index else -1.0
    orbit_row = parse_orbit_row(row, branch.name)
    scene = branch.scene.replace(**{branch.name: orbit_row.value})
    problem, z = set_up_problem(scene, branch.name, orbit_row)
    other_end = set_up_problem(
        scene, branch.name, parse_orbit_row(dataset_row(branch.data, -1 - end_index), branch.name)
    )
    n_impacts, n_rows = len(orbit_row.times), len(problem.sequence.sides)
    direction = np.zeros(len(z))
    is_impact = row["side"] != 0
    if n_rows:
        direction[:n_impacts], direction[n_rows : n_rows + n_impacts] = (
            row["time_slope"][is_impact],
            row["speed_slope"][is_impact],
        )
    direction[-1] = row["value_slope"]
    start = start_point(
        z,
        unit_tangent(
            continuation_problem(problem), z, arclength_weights(problem, scene_length(scene)), problem, sign * direction
        ),
    )
    branch_settings = make_branch_settings(
        scene, branch.name, bounds, scene_length(scene), other_end, **branch.settings, limits=limits
    )
    extension = continue_through_grazings(problem, start, branch_settings)
    backward, forward = (extension, None) if sign < 0 else (None, extension)
    return replace(assemble_branch(scene, branch.name, bounds, branch.settings, backward, forward), scene=branch.scene)


def _crossing_starts(special, problem, z):
    """Start both directions of the branch that crosses the branch of the point."""
    weights, n_rows = arclength_weights(problem, scene_length(special.scene)), len(problem.sequence.sides)
    n_impacts, branch_tangent = len(special.spot.times), np.zeros(len(z))
    branch_tangent[:n_impacts], branch_tangent[n_rows : n_rows + n_impacts] = (
        special.slopes[:n_impacts],
        special.slopes[n_impacts:-1],
    )
    branch_tangent[-1] = special.slopes[-1]
    directions = crossing.branch_tangents(continuation_problem(problem), z, weights, problem)
    if special.kind == "SB":  # the halves of one branch are mirror images at equal parameter values
        directions[np.argmin(abs(directions[:, -1])), -1] = 0.0
    crossing_tangent = crossing.farther_tangent(directions, branch_tangent, weights)
    leading_index = np.flatnonzero(abs(crossing_tangent) > 0.5 * abs(crossing_tangent).max())[
        0
    ]  # a null vector has no sign of its own
    return [
        (problem, start_point(z, sign * np.sign(crossing_tangent[leading_index]) * crossing_tangent))
        for sign in (1.0, -1.0)
    ]


def _doubling_starts(special, problem, z):
    """Start the branch of twice the period, in the direction in which its two halves become different."""
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
                start_point(
                    z,
                    tangent / np.linalg.norm(arclength_weights(doubled_problem, scene_length(special.scene)) * tangent),
                ),
            )
        ]
    doubled_impacts = zip(doubled_times, np.tile(orbit_row.speeds, 2), np.tile(orbit_row.sides, 2), strict=True)
    doubled_problem = doubled_problem._replace(sequence=padded_sequence(doubled_problem, list(doubled_impacts)))
    n_doubled_rows = len(doubled_problem.sequence.sides)
    tangent = np.zeros(2 * n_doubled_rows + 1)
    for half in (0, 1):
        half_vector = null_vector[half * n_rows : half * n_rows + n_impacts]
        tangent[half * n_doubled_rows : half * n_doubled_rows + 2 * n_impacts] = np.concatenate(
            [half_vector, -half_vector]
        )
    tangent /= np.linalg.norm(arclength_weights(doubled_problem, scene_length(special.scene)) * tangent)
    start_z = np.concatenate([doubled_problem.sequence.times, doubled_problem.sequence.speeds, z[-1:]])
    return [(doubled_problem, start_point(start_z, tangent))]


def _grazing_starts(special, problem, z):
    """Start each branch that emanates from a grazing, except those on which the point was located."""
    _, grazing_exits, _ = find_all_exits(problem, z, scene_length(special.scene))
    if len(grazing_exits) != len(special.aside):
        raise check.ArgumentError(
            "special", "must be a grazing that this version reproduces; follow its branch again", special
        )
    return [
        (grazing_exit.problem, grazing_exit.point)
        for grazing_exit, is_new in zip(grazing_exits, special.aside, strict=True)
        if is_new
    ]

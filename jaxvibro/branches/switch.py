"""Follow the branches that emanate from a special point, and extend a branch beyond its ends."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from continuation import augmented_systems
from continuation import augmented_systems as crossing
from continuation.arclength import make_start_point
from continuation.branch_segment import make_limits

from ..problem.curve_ends import RESUMABLE_ENDS, End, EndReason
from ..problem.soft_wall_grazing import find_all_exits
from ..scene import check
from ..scene.scene_parameters import check_parameter_bounds, parameter_domain
from .assemble import START_REASON, assemble_branch, merge_branches
from .branch import Branch
from .follow import make_branch_task
from .itinerary_segment import continue_through_grazings

FIRST_STEP = 0.01  # first step of a branch that leaves a special point
SWITCHING_KINDS = ("SB", "BP", "PD", "GR")


def branch_starts(special):
    """Return `OrbitProblem` and `Point` at the start of each branch that emanates from a special point.

    The kind of the point must be one of `SWITCHING_KINDS`. Raises ValueError if the equations show that no branches
    cross.
    """
    start_function = {"PD": _doubling_starts, "GR": _grazing_starts}.get(special.kind, _crossing_starts)
    return start_function(special, special.spot.problem, special.spot.z)


def follow_away_from_point(special, start, bounds, **settings):
    """Follow a branch that emanates from a special point in one direction, from one of its `branch_starts`."""
    (problem, point), scene = start, special.scene
    task = make_branch_task(scene, special.name, bounds, problem, (problem, point.z), **settings)
    start_reason = End.LEFT.reason(special.value, special.kind)
    return assemble_branch(
        scene,
        special.name,
        bounds,
        settings,
        None,
        continue_through_grazings(task, point),
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
    sign = 1.0 if end_index else -1.0
    scene, end_point = branch.located(end_index)
    _, other_end_point = branch.located(-1 - end_index)
    problem, z = end_point.problem, end_point.z
    task = make_branch_task(
        scene,
        branch.name,
        bounds,
        problem,
        (other_end_point.problem, other_end_point.z),
        **branch.settings,
        limits=limits,
    )
    extension = continue_through_grazings(task, make_start_point(z, problem.tangent(z, sign * end_point.tangent)))
    backward, forward = (extension, None) if sign < 0 else (None, extension)
    return replace(assemble_branch(scene, branch.name, bounds, branch.settings, backward, forward), scene=branch.scene)


def _crossing_starts(special, problem, z):
    """Return the starts of both directions of the branch that crosses the branch of the point."""
    weights = problem.weights()
    tangent_pair = crossing.branch_tangents(problem.equations, z, weights, problem)
    if special.kind == "SB":  # the halves of one branch are mirror images at equal parameter values
        tangent_pair[np.argmin(abs(tangent_pair[:, -1])), -1] = 0.0
    crossing_tangent = crossing.less_aligned_tangent(tangent_pair, special.spot.tangent, weights)
    sign_entry_index = np.flatnonzero(abs(crossing_tangent) > 0.5 * abs(crossing_tangent).max())[
        0
    ]  # a null vector has no sign of its own
    return [
        (problem, make_start_point(z, sign * np.sign(crossing_tangent[sign_entry_index]) * crossing_tangent))
        for sign in (1.0, -1.0)
    ]


def _doubling_starts(special, problem, z):
    """Return the start of the branch of twice the period, in the direction in which its two halves differ."""
    equations, n_rows, n_impacts = problem.equations, problem.n_rows, problem.n_used_rows
    null_vector = augmented_systems.null_vector(
        augmented_systems.matrix_and_derivative(equations, equations.test_functions[0], z, problem)[0]
    )
    doubled_problem, doubled_z = problem.repeat(z, 2)
    tangent = np.zeros(len(doubled_z)) if n_impacts else np.append(null_vector, 0.0)
    n_doubled_rows = doubled_problem.n_rows
    for half_index in (0, 1):
        half_null_vector = null_vector[half_index * n_rows : half_index * n_rows + n_impacts]
        tangent[half_index * n_doubled_rows : half_index * n_doubled_rows + 2 * n_impacts] = np.concatenate(
            [half_null_vector, -half_null_vector]
        )
    tangent /= np.linalg.norm(doubled_problem.weights() * tangent)
    return [(doubled_problem, make_start_point(doubled_z, tangent))]


def _grazing_starts(special, problem, z):
    """Return the starts of the branches from a grazing, except those along which the branch of the point continues."""
    grazing_exits = find_all_exits(problem, z).exits
    if len(grazing_exits) != len(special.aside):
        raise check.ArgumentError(
            "special", "must be a grazing that this version reproduces; follow its branch again", special
        )
    return [
        (grazing_exit.problem, grazing_exit.point)
        for grazing_exit, is_unfollowed in zip(grazing_exits, special.aside, strict=True)
        if is_unfollowed
    ]

"""Follow a branch and, recursively, the branches that emanate from its special points, and mirror images.

Compute the mirror image of a branch of a symmetric scene. The symmetry maps (x, v, phase) to (-x, -v, phase + pi). The
impacts of the mirror image are on the other walls, half a drive period later, with the same speeds (paper, section 1).
"""

from dataclasses import replace

import numpy as np

from continuation.branch_segment import UNLIMITED, make_limits

from ..orbits.orbit import is_same_orbit
from ..problem.curve_ends import RESUMABLE_ENDS, End
from ..problem.orbit_curve import dataset_row, unknowns_of_rows
from ..problem.orbit_equations import diagnose
from ..problem.orbit_point import comparison_points, is_repeated, label_of_point
from ..problem.orbit_problem import make_orbit_problem
from ..scene.check import ArgumentError
from ..scene.scene_properties import stays_symmetric
from .branch import make_special, multipliers_of_row, point_of_row
from .follow import follow
from .switch import FIRST_STEP, branch_starts, follow_away_from_point


def mirror_branch(branch):
    """Return the branch of the mirror images of a branch's orbits.

    The scene and the parameter of the branch must satisfy `stays_symmetric`.
    """
    template = make_orbit_problem(branch.scene, branch.name, periods=1)
    data = _mirrored_data(branch, template)
    rows = [special.place for special in branch.special] + [segment.first for segment in branch.segments]
    points = {row: point_of_row(template, branch.name, dataset_row(data, row)) for row in rows}
    return replace(
        branch,
        data=data,
        segments=tuple(_mirrored_segment(branch, points[segment.first], segment) for segment in branch.segments),
        special=tuple(_mirrored_special(branch, data, points[special.place], special) for special in branch.special),
    )


def _mirrored_data(branch, template):
    """Move the impacts to the other walls half a drive period later, and recompute x and v at phase 0."""
    data, name = branch.data, branch.name
    frequencies = branch.values if name == "frequency" else float(branch.scene.frequency)
    half_period = np.broadcast_to(np.pi / frequencies, branch.values.shape)
    mirrored_times = half_period[:, None] + data["time"]
    time_slopes = data["time_slope"]
    if name == "frequency":
        time_slopes = time_slopes - (half_period / branch.values * data["value_slope"].values)[:, None]
    mirrored_data = data.assign(time=mirrored_times, side=-data["side"], time_slope=time_slopes)
    x, v = data["x"].values.copy(), data["v"].values.copy()
    for segment in branch.segments:
        rows = slice(segment.first, segment.last + 1)
        problem = point_of_row(template, name, dataset_row(mirrored_data, segment.first)).problem
        if problem.n_rows:
            diagnostics = diagnose(problem, unknowns_of_rows(mirrored_data.isel(point=rows), name, problem))
            x[rows], v[rows] = diagnostics.x, diagnostics.v
    return mirrored_data.assign(x=data["x"].copy(data=x), v=data["v"].copy(data=v))


def _mirrored_special(branch, data, orbit_point, special):
    neighbours = [
        neighbour.mirror().with_section_state() if neighbour.problem.n_rows else neighbour
        for neighbour in special.joins
    ]
    return make_special(
        branch.scene,
        branch.name,
        branch.bounds,
        special.place,
        orbit_point,
        multipliers_of_row(dataset_row(data, special.place)),
        special.kind,
        special.residual,
        neighbours,
        special.aside,
    )


def _mirrored_segment(branch, orbit_point, segment):
    itinerary = orbit_point.itinerary
    return replace(segment, label=label_of_point(branch.scene, orbit_point, itinerary), itinerary=itinerary)


MAX_BRANCHES = 64
VALUE_TOLERANCE, IMPACT_TOLERANCE = (
    1e-8,
    1e-6,
)  # largest differences of the parameter and of the impacts of identical special points
IDENTIFYING_KINDS = ("SN", "PD", "SB", "BP")  # kinds that lie on one branch only, or at which a branch ends
OFFSET = 1e-3  # arclength along the tangent at which repeated orbits are recognised
BRANCHING_KINDS = ("SB", "BP", "PD")  # kinds from which branches emanate; a branch continues through a GR by itself


def follow_tree(orbit, name, bounds, max_period=1, progress=None, largest_step=0.1, max_seconds=None):
    """Follow a branch and, recursively, the branches that emanate from its special points.

    Parameters
    ----------
    orbit : Orbit
        Starting orbit.
    name : str
        Continuation parameter.
    bounds : tuple of float
        Lower and upper bound.
    max_period : int, optional
        Largest number of drive periods of the orbits that are followed from period doublings. With 1, no branch is
        followed from a period doubling.
    progress : callable, optional
        Called with the number of branches.
    largest_step : float, optional
        Largest continuation step.
    max_seconds : float, optional
        Largest wall-clock time in s. If the limit is reached while the first branch is followed, this branch ends
        early. Later the branches of the current special point are omitted. None is no limit.

    Returns
    -------
    tuple of Branch
        Branches of the tree, which stops growing after the special point at which their number reaches 64. The first
        branch contains `orbit`.

    Raises
    ------
    ArgumentError
        If an argument is invalid, as in `follow`.
    OrbitError
        If the start is not an orbit, as in `follow`.

    Notes
    -----
    The branches of each SB, BP and PD are followed once, in the order in which the points are found. A branch that was
    followed from its other end is omitted. In a symmetric scene each branch precedes its mirror image in the result,
    unless the branch contains the mirror images of its orbits.
    """
    limits = make_limits(None, max_seconds, None, ArgumentError)
    step_settings = {"largest_step": largest_step, "tolerance": 1e-10, "monitors": {}, "stop": (), "limits": limits}
    tree = BranchTree(
        bounds, max_period, MAX_BRANCHES, step_settings, [], [], stays_symmetric(orbit.scene, name), progress
    )
    tree.add(follow(orbit, name, bounds, largest_step=largest_step, max_seconds=max_seconds))
    tree.follow_special_points()
    return tuple(tree.branches)


class BranchTree:
    """Set of branches that grows by the branches that emanate from its special points.

    Parameters
    ----------
    bounds : tuple of float
        Bounds of the parameter.
    max_period : int
        Largest number of drive periods at period doublings.
    max_branches : int
        Number of branches at which the tree stops growing, after all branches of a special point.
    step_settings : dict
        Settings of the continuation.
    branches : list of Branch
        Known branches.
    processed_indices : list of tuple of int
        Indices (branch, special point) of the points whose branches have been followed.
    symmetric : bool
        True if the mirror image of each orbit is an orbit of the same scene.
    progress : callable or None
        Called with the number of branches.
    """

    def __init__(
        self, bounds, max_period, max_branches, step_settings, branches, processed_indices, symmetric, progress
    ):
        self.bounds, self.max_period, self.max_branches, self.step_settings = (
            bounds,
            max_period,
            max_branches,
            step_settings,
        )
        self.branches, self.processed_indices, self.symmetric, self.progress = (
            branches,
            processed_indices,
            symmetric,
            progress,
        )

    @property
    def has_reached_limit(self):
        """True if the largest number of branches, or the time limit, is reached."""
        return len(self.branches) >= self.max_branches or self.step_settings.get("limits", UNLIMITED).expired

    def contains(self, branch):
        """Test whether a branch shares a special point of an identifying kind with a known branch."""
        known_special_points = [special for known_branch in self.branches for special in known_branch.special]
        return any(
            is_same_point(special, known_point)
            for special in branch.special
            if special.kind in IDENTIFYING_KINDS
            for known_point in known_special_points
        )

    def follow_special_points(self):
        """Follow the branches of every special point that has not been processed, in turn."""
        followed_points = [
            entry
            for branch_index, point_index in self.processed_indices
            for entry in self._with_mirror_image(self.branches[branch_index].special[point_index])
        ]
        branch_index = 0
        while branch_index < len(self.branches) and not self.has_reached_limit:
            for point_index, special in enumerate(self.branches[branch_index].special):
                if (
                    (branch_index, point_index) in self.processed_indices
                    or self.has_reached_limit
                    or not _needs_following(special, self.max_period)
                ):
                    continue
                if not any(is_same_point(special, followed_point) for followed_point in followed_points):
                    followed_points += self._with_mirror_image(special)
                    n_branches_before = len(self.branches)
                    self._follow_from_point(branch_index, special)
                    if any(End.MAX_SECONDS in entry.ends for entry in self.branches[n_branches_before:]):
                        del self.branches[n_branches_before:]  # the next run follows all of them
                        return
                self.processed_indices.append((branch_index, point_index))
            branch_index += 1

    def _with_mirror_image(self, special):
        """Return a special point, and in a symmetric scene its mirror image."""
        return [special, _mirrored_point(special)] if self.symmetric else [special]

    def _follow_from_point(self, branch_index, special):
        """Follow the branches of one special point."""
        if _is_on_other_branch(special, branch_index, self.branches, self.symmetric):
            return
        for start in _prime_period_starts(special):
            branch = follow_away_from_point(
                special, start, self.bounds, **{"first_step": FIRST_STEP} | self.step_settings
            )
            if len(branch) > 1 and not self._retraces_known_branch(branch):
                self.add(branch)
            if self.symmetric and special.kind == "SB" and not _is_own_mirror_image(branch):
                break  # the other half is the mirror image; branches of symmetric orbits need both halves

    def _retraces_known_branch(self, branch):
        """Test whether a branch, or its mirror image, retraces an earlier branch.

        Mirror images count only for earlier branches that contain their own mirror images.
        """
        if any(_is_retraced(branch, known_branch) for known_branch in self.branches):
            return True
        self_mirrored_branches = (
            [known_branch for known_branch in self.branches if _is_own_mirror_image(known_branch)]
            if self.symmetric
            else []
        )
        return bool(self_mirrored_branches) and any(
            _is_retraced(mirror_branch(branch), known_branch) for known_branch in self_mirrored_branches
        )

    def add(self, branch):
        """Add a branch, and in a symmetric scene its mirror image."""
        self.branches.append(branch)
        if self.symmetric and not _is_own_mirror_image(branch):
            self.branches.append(mirror_branch(branch))
        if self.progress is not None:
            self.progress(len(self.branches))


def _needs_following(special, max_period):
    """Test whether the branches of a special point should be followed."""
    if special.kind not in BRANCHING_KINDS or special.place == 0:
        return False
    if special.kind == "PD":
        return 2 * special.spot.periods <= max_period
    return not is_repeated(special.spot.problem, special.spot.z)


def _prime_period_starts(special):
    """Return the starts of the branches at a special point, except those of repeated shorter orbits."""
    try:
        all_starts = branch_starts(special)
    except ValueError:  # no branches cross there
        return []
    return [start for start in all_starts if not is_repeated(start[0], start[1].z + OFFSET * start[1].tangent)]


def _is_on_other_branch(special, own_branch_index, branches, symmetric):
    """Test whether another branch passes through a point, so that the crossing branch is known.

    The mirror image of the point's own branch does not count, because it passes through each SB of that branch.
    """
    n_repetitions = 2 if special.kind == "PD" else 1
    for branch_index, branch in enumerate(branches):
        crossing_or_end_points = (
            other_special for other_special in branch.special if other_special.kind in ("SB", "BP", "EP")
        )
        if branch_index == own_branch_index or not any(
            has_same_orbit(special, other_special, n_repetitions) for other_special in crossing_or_end_points
        ):
            continue
        if not (symmetric and _is_mirror_image(branch, branches[own_branch_index])):
            return True
    return False


def _is_retraced(branch, earlier_branch):
    """Test whether a branch ends in the same orbit as an earlier branch, and thus retraces the earlier branch."""
    last_point, earlier_last_point = branch.special[-1], earlier_branch.special[-1]
    return branch.segments[-1].label == earlier_branch.segments[-1].label and has_same_orbit(
        last_point, earlier_last_point
    )


def originals_of_mirrors(branches):
    """Find the branches that are mirror images of earlier ones.

    Parameters
    ----------
    branches : sequence of Branch
        Branches along one parameter.

    Returns
    -------
    dict of int to int
        Index of the earlier branch, by the index of its mirror image.
    """
    original_of: dict[int, int] = {}
    for branch_index, branch in enumerate(branches):
        if not stays_symmetric(branch.scene, branch.name):
            continue
        for earlier_index in range(branch_index):
            if earlier_index not in original_of and _is_mirror_image(branch, branches[earlier_index]):
                original_of[branch_index] = earlier_index
                break
    return original_of


def _is_mirror_image(first_branch, second_branch):
    """Test whether a branch consists of the mirror images of another, by comparing their special points."""
    first_points, second_points = _identifying_points(first_branch), _identifying_points(second_branch)
    if not first_points or len(first_points) != len(second_points):
        return False
    return all(
        any(is_same_point(_mirrored_point(special), candidate) for candidate in second_points)
        for special in first_points
    )


def _is_own_mirror_image(branch):
    """Test whether a branch contains the mirror images of its orbits.

    The branch contains them if it passes through an SB and its ends are final, or if the mirror images of all its
    special points lie on the branch.
    """
    has_symmetry_breaking = any(special.kind == "SB" for special in branch.special) and not any(
        end in RESUMABLE_ENDS for end in branch.ends
    )
    return has_symmetry_breaking or _is_mirror_image(branch, branch)


def _identifying_points(branch):
    """Return the special points that identify a branch: all of them, except the EPs of a closed branch."""
    if End.CLOSED not in branch.ends:
        return branch.special
    return tuple(special for special in branch.special if special.kind != "EP")


def _mirrored_point(special):
    """Return the mirror image of a special point, with the fields that `is_same_point` compares."""
    return replace(special, spot=special.spot.mirror())


def is_same_point(first_point, second_point):
    """Test whether two special points are identical."""
    return first_point.kind == second_point.kind and has_same_orbit(first_point, second_point)


def has_same_orbit(first_point, second_point, n_repetitions=1):
    """Test whether the orbit of a special point, traversed `n_repetitions` times, equals the orbit of another point."""
    if n_repetitions * first_point.spot.periods != second_point.spot.periods or not np.isclose(
        first_point.value, second_point.value, VALUE_TOLERANCE, VALUE_TOLERANCE
    ):
        return False
    speed_scale = max(special.spot.speeds.max(initial=0.0) for special in (first_point, second_point))
    impact_sets = (
        comparison_points(special.spot.problem, special.spot.z, speed_scale) for special in (first_point, second_point)
    )
    return is_same_orbit(*impact_sets, IMPACT_TOLERANCE)

"""A branch and those that leave it, and those that leave these: `BranchTree`, `follow_tree`."""

from dataclasses import replace

import numpy as np

from continuation.limits import UNLIMITED, limits_of

from ..orbits.orbit_comparison import is_same_orbit
from ..problem.end import RESUMABLE_ENDS, End
from ..problem.orbit_point import impact_points, set_up_problem
from ..problem.same_orbit import is_repeated
from ..scene.check import ArgumentError
from ..scene.symmetry import stays_symmetric
from .branch import frequency_at
from .follow import follow
from .mirror_image import mirror_branch
from .switch import FIRST_STEP, branch_starts, follow_from_start

MAX_BRANCHES = 64  # branches
VALUE_TOLERANCE, IMPACT_TOLERANCE = (
    1e-8,
    1e-6,
)  # two special points as near in the parameter and in their impacts are one
IDENTIFYING_KINDS = ("SN", "PD", "SB", "BP")  # points that are on one branch alone, or where one ends
OFFSET = 1e-3  # along its tangent a branch is told from one of repeated orbits
BRANCHING_KINDS = ("SB", "BP", "PD")  # points that other branches leave; at a GR a branch goes on by itself


def follow_tree(orbit, name, bounds, max_period=1, progress=None, largest_step=0.1, max_seconds=None):
    """The branch through an orbit, and those that leave its special points and theirs: a tuple of `Branch`.

    orbit, name, bounds, largest_step: as in `follow`. max_period: drive periods of the longest orbits that are switched
    to at a period doubling; 1: none are. progress: called with the number of branches so far.

    Each SB, BP and PD is left once, in the order in which they are found, the first branch being that of the orbit; a
    branch that has been walked from its other end is left out. In a symmetric scene a branch is followed by its mirror
    image, unless it is its own. There are at most 64. max_seconds: wall-clock time, s; None is no limit. Then a branch
    may end where the time was over, and those that would leave it later are not followed.

    Raises ArgumentError and OrbitError as `follow` does.
    """
    limits = limits_of(None, max_seconds, None, ArgumentError)
    step_settings = {"largest_step": largest_step, "tolerance": 1e-10, "monitors": {}, "stop": (), "limits": limits}
    tree = BranchTree(
        bounds, max_period, MAX_BRANCHES, step_settings, [], [], stays_symmetric(orbit.scene, name), progress
    )
    tree.add(follow(orbit, name, bounds, largest_step=largest_step, max_seconds=max_seconds))
    tree.follow_special_points()
    return tuple(tree.branches)


class BranchTree:
    """branches: the branches so far; processed_points: (branch, special point) of those that have been left, by their
    places; symmetric: whether the mirror image of an orbit is one."""

    def __init__(
        self, bounds, max_period, max_branches, step_settings, branches, processed_points, symmetric, progress
    ):
        self.bounds, self.max_period, self.max_branches, self.step_settings = (
            bounds,
            max_period,
            max_branches,
            step_settings,
        )
        self.branches, self.processed_points, self.symmetric, self.progress = (
            branches,
            processed_points,
            symmetric,
            progress,
        )

    @property
    def is_exhausted(self):
        """Return True if there is no room for another branch, or no time."""
        return len(self.branches) >= self.max_branches or self.step_settings.get("limits", UNLIMITED).expired

    def contains(self, branch):
        """Whether a branch is one of those found: it has a special point that is theirs."""
        known_points = [special for known_branch in self.branches for special in known_branch.special]
        return any(
            is_same_point(special, known_point)
            for special in branch.special
            if special.kind in IDENTIFYING_KINDS
            for known_point in known_points
        )

    def follow_special_points(self):
        """Leaves every special point of the branches that has not been left, in turn."""
        followed_points = [
            entry
            for branch_index, point_index in self.processed_points
            for entry in self._with_mirror_image(self.branches[branch_index].special[point_index])
        ]
        branch_index = 0
        while branch_index < len(self.branches) and not self.is_exhausted:
            for point_index, special in enumerate(self.branches[branch_index].special):
                if (
                    (branch_index, point_index) in self.processed_points
                    or self.is_exhausted
                    or not _needs_following(special, self.max_period)
                ):
                    continue
                if not any(is_same_point(special, followed_point) for followed_point in followed_points):
                    followed_points += self._with_mirror_image(special)
                    n_before = len(self.branches)
                    self._follow_from(branch_index, special)
                    if any(End.MAX_SECONDS in entry.ends for entry in self.branches[n_before:]):
                        del self.branches[n_before:]  # the next run follows all of them
                        return
                self.processed_points.append((branch_index, point_index))
            branch_index += 1

    def _with_mirror_image(self, special):
        """A special point, and in a symmetric scene its mirror image."""
        return [special, _mirrored_point(special)] if self.symmetric else [special]

    def _follow_from(self, branch_index, special):
        if _is_on_other_branch(special, branch_index, self.branches, self.symmetric):
            return
        for start in _new_starts(special):
            branch = follow_from_start(special, start, self.bounds, **{"first_step": FIRST_STEP} | self.step_settings)
            if len(branch) > 1 and not self._is_known(branch):
                self.add(branch)
            if self.symmetric and special.kind == "SB" and not _is_own_mirror(branch):
                break  # the other half is the mirror image; those of symmetric orbits are two

    def _is_known(self, branch):
        """Return True if a branch, or its mirror image, retraces one found earlier.

        Mirror images count only for earlier branches that contain their own mirror images.
        """
        if any(_is_retraced(branch, known_branch) for known_branch in self.branches):
            return True
        symmetric_branches = (
            [known_branch for known_branch in self.branches if _is_own_mirror(known_branch)] if self.symmetric else []
        )
        return bool(symmetric_branches) and any(
            _is_retraced(mirror_branch(branch), known_branch) for known_branch in symmetric_branches
        )

    def add(self, branch):
        """One branch more, and in a symmetric scene its mirror image."""
        self.branches.append(branch)
        if self.symmetric and not _is_own_mirror(branch):
            self.branches.append(mirror_branch(branch))
        if self.progress is not None:
            self.progress(len(self.branches))


def _needs_following(special, max_period):
    """Whether branches are to be followed from a special point."""
    if special.kind not in BRANCHING_KINDS or special.place == 0:
        return False
    if special.kind == "PD":
        return 2 * special.spot.periods <= max_period
    return not is_repeated(*set_up_problem(special.scene, special.name, special.spot))


def _new_starts(special):
    """The starts of a point's branches, but for orbits that are shorter ones, repeated."""
    try:
        all_starts = branch_starts(special)
    except ValueError:  # the equations say that no branches cross there
        return []
    return [start for start in all_starts if not is_repeated(start[0], start[1].z + OFFSET * start[1].tangent)]


def _is_on_other_branch(special, source_index, branches, symmetric):
    """Return True if another branch passes through a point, so that the crossing branch is already known.

    The mirror image of the point's own branch does not count, because it passes through each SB of that branch.
    """
    n_times = 2 if special.kind == "PD" else 1
    for branch_index, branch in enumerate(branches):
        crossing_points = (
            other_special for other_special in branch.special if other_special.kind in ("SB", "BP", "EP")
        )
        if branch_index == source_index or not any(
            has_same_orbit(special, other_special, n_times) for other_special in crossing_points
        ):
            continue
        if not (symmetric and _is_mirror(branch, branches[source_index])):
            return True
    return False


def _is_retraced(branch, earlier_branch):
    """Whether a branch ends in the very orbit in which an earlier one does, with as many impacts: it is that one, or
    that one the other way round."""
    last_point, earlier_last_point = branch.special[-1], earlier_branch.special[-1]
    return branch.segments[-1].label == earlier_branch.segments[-1].label and has_same_orbit(
        last_point, earlier_last_point
    )


def mirror_images(branches):
    """{place: the place of an earlier branch whose mirror image it is} of branches along one parameter."""
    original_of: dict[int, int] = {}
    for branch_index, branch in enumerate(branches):
        if not stays_symmetric(branch.scene, branch.name):
            continue
        for earlier_index in range(branch_index):
            if earlier_index not in original_of and _is_mirror(branch, branches[earlier_index]):
                original_of[branch_index] = earlier_index
                break
    return original_of


def _is_mirror(first_branch, second_branch):
    """Return True if the mirror images of a branch's special points are those of another."""
    first_points, second_points = _identifying_points(first_branch), _identifying_points(second_branch)
    if not first_points or len(first_points) != len(second_points):
        return False
    return all(
        any(is_same_point(_mirrored_point(special), candidate) for candidate in second_points)
        for special in first_points
    )


def _is_own_mirror(branch):
    """Return True if a branch contains the mirror images of its orbits.

    It does if it passes through an SB, or if the mirror images of all its special points lie on it.
    """
    has_symmetry_breaking = any(special.kind == "SB" for special in branch.special) and not any(
        end in RESUMABLE_ENDS for end in branch.ends
    )
    return has_symmetry_breaking or _is_mirror(branch, branch)


def _identifying_points(branch):
    """The special points that tell a branch from others: all but the EPs of a closed one, which lie where it was
    started."""
    if End.CLOSED not in branch.ends:
        return branch.special
    return tuple(special for special in branch.special if special.kind != "EP")


def _mirrored_point(special):
    """A special point with the impacts on the other walls, half a period later: enough to tell its mirror image."""
    orbit_row = special.spot
    half_period = np.pi / frequency_at(special.scene, special.name, special.value)
    return replace(special, spot=orbit_row._replace(times=orbit_row.times + half_period, sides=-orbit_row.sides))


def is_same_point(first_point, second_point):
    """Whether two special points are one."""
    return first_point.kind == second_point.kind and has_same_orbit(first_point, second_point)


def has_same_orbit(first_point, second_point, n_times=1):
    """Whether the orbit of a special point, this many times round, is that of another."""
    if n_times * first_point.spot.periods != second_point.spot.periods or not np.isclose(
        first_point.value, second_point.value, VALUE_TOLERANCE, VALUE_TOLERANCE
    ):
        return False
    speed_scale = max(special.spot.speeds.max(initial=0.0) for special in (first_point, second_point))
    impact_sets = (
        impact_points(special.spot, frequency_at(special.scene, special.name, special.value), speed_scale)
        for special in (first_point, second_point)
    )
    return is_same_orbit(*impact_sets, IMPACT_TOLERANCE)

"""A branch and those that leave it, and those that leave these: `Tree`, `followed`."""

from dataclasses import replace

import numpy as np

from continuation.limits import UNLIMITED, limits_of

from ..orbits.orbit_comparison import is_same_orbit
from ..problem.end import LIMITS, End
from ..problem.orbit_on_branch import impacts, place_orbit
from ..problem.same_orbit import is_repeated
from ..scene.check import ArgumentError
from ..scene.symmetry import stays_symmetric
from .branch import frequency_at
from .follow import follow
from .mirror import mirrored
from .switch import FIRST, branch_from, starts

MOST = 64  # branches
VALUE, NEAR = 1e-8, 1e-6  # two special points as near in the parameter and in their impacts are one
OWN = ("SN", "PD", "SB", "BP")  # points that are on one branch alone, or where one ends
ASIDE = 1e-3  # along its tangent a branch is told from one of repeated orbits
LEFT = ("SB", "BP", "PD")  # points that other branches leave; at a GR a branch goes on by itself


def followed(orbit, name, bounds, max_period=1, progress=None, largest_step=0.1, max_seconds=None):
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
    steps = {"largest_step": largest_step, "tolerance": 1e-10, "monitors": {}, "stop": (), "limits": limits}
    tree = Tree(bounds, max_period, MOST, steps, [], [], stays_symmetric(orbit.scene, name), progress)
    tree.add(follow(orbit, name, bounds, largest_step=largest_step, max_seconds=max_seconds))
    tree.grow()
    return tuple(tree.found)


class Tree:
    """found: the branches so far; done: (branch, special point) of those that have been left, by their places;
    symmetric: whether the mirror image of an orbit is one."""

    def __init__(self, bounds, max_period, most, steps, found, done, symmetric, progress):
        self.bounds, self.max_period, self.most, self.steps = bounds, max_period, most, steps
        self.found, self.done, self.symmetric, self.progress = found, done, symmetric, progress

    @property
    def is_spent(self):
        """Return True if there is no room for another branch, or no time."""
        return len(self.found) >= self.most or self.steps.get("limits", UNLIMITED).expired

    def has(self, branch):
        """Whether a branch is one of those found: it has a special point that is theirs."""
        theirs = [one for other in self.found for one in other.special]
        return any(is_same(one, two) for one in branch.special if one.kind in OWN for two in theirs)

    def grow(self):
        """Leaves every special point of the branches that has not been left, in turn."""
        met = [one for k, j in self.done for one in self._images(self.found[k].special[j])]
        k = 0
        while k < len(self.found) and not self.is_spent:
            for j, point in enumerate(self.found[k].special):
                if (k, j) in self.done or self.is_spent or not _is_left(point, self.max_period):
                    continue
                if not any(is_same(point, other) for other in met):
                    met += self._images(point)
                    first = len(self.found)
                    self._leave(k, point)
                    if any(End.MAX_SECONDS in one.ends for one in self.found[first:]):
                        del self.found[first:]  # the next run follows all of them
                        return
                self.done.append((k, j))
            k += 1

    def _images(self, point):
        """A special point, and in a symmetric scene its mirror image."""
        return [point, _reflected(point)] if self.symmetric else [point]

    def _leave(self, k, point):
        if _is_reached(point, k, self.found, self.symmetric):
            return
        for start in _starts(point):
            branch = branch_from(point, start, self.bounds, **{"first_step": FIRST} | self.steps)
            if len(branch) > 1 and not self._is_known(branch):
                self.add(branch)
            if self.symmetric and point.kind == "SB" and not _is_own_mirror(branch):
                break  # the other half is the mirror image; those of symmetric orbits are two

    def _is_known(self, branch):
        """Return True if a branch, or its mirror image, retraces one found earlier.

        Mirror images count only for earlier branches that contain their own mirror images.
        """
        if any(_is_retraced(branch, other) for other in self.found):
            return True
        own = [other for other in self.found if _is_own_mirror(other)] if self.symmetric else []
        return bool(own) and any(_is_retraced(mirrored(branch), other) for other in own)

    def add(self, branch):
        """One branch more, and in a symmetric scene its mirror image."""
        self.found.append(branch)
        if self.symmetric and not _is_own_mirror(branch):
            self.found.append(mirrored(branch))
        if self.progress is not None:
            self.progress(len(self.found))


def _is_left(point, max_period):
    """Whether branches are to be followed from a special point."""
    if point.kind not in LEFT or point.place == 0:
        return False
    if point.kind == "PD":
        return 2 * point.spot.periods <= max_period
    return not is_repeated(*place_orbit(point.scene, point.name, point.spot))


def _starts(point):
    """The starts of a point's branches, but for orbits that are shorter ones, repeated."""
    try:
        found = starts(point)
    except ValueError:  # the equations say that no branches cross there
        return []
    return [one for one in found if not is_repeated(one[0], one[1].z + ASIDE * one[1].tangent)]


def _is_reached(point, source, found, symmetric):
    """Return True if another branch passes through a point, so that the crossing branch is already known.

    The mirror image of the point's own branch does not count, because it passes through each SB of that branch.
    """
    times = 2 if point.kind == "PD" else 1
    for k, branch in enumerate(found):
        through = (one for one in branch.special if one.kind in ("SB", "BP", "EP"))
        if k == source or not any(is_orbit(point, one, times) for one in through):
            continue
        if not (symmetric and _is_mirror(branch, found[source])):
            return True
    return False


def _is_retraced(branch, earlier):
    """Whether a branch ends in the very orbit in which an earlier one does, with as many impacts: it is that one, or
    that one the other way round."""
    one, other = branch.special[-1], earlier.special[-1]
    return branch.segments[-1].label == earlier.segments[-1].label and is_orbit(one, other)


def mirror_images(branches):
    """{place: the place of an earlier branch whose mirror image it is} of branches along one parameter."""
    found: dict[int, int] = {}
    for k, one in enumerate(branches):
        if not stays_symmetric(one.scene, one.name):
            continue
        for j in range(k):
            if j not in found and _is_mirror(one, branches[j]):
                found[k] = j
                break
    return found


def _is_mirror(one, other):
    """Return True if the mirror images of a branch's special points are those of another."""
    ours, theirs = _marks(one), _marks(other)
    if not ours or len(ours) != len(theirs):
        return False
    return all(any(is_same(_reflected(each), two) for two in theirs) for each in ours)


def _is_own_mirror(branch):
    """Return True if a branch contains the mirror images of its orbits.

    It does if it passes through an SB, or if the mirror images of all its special points lie on it.
    """
    through = any(one.kind == "SB" for one in branch.special) and not any(end in LIMITS for end in branch.ends)
    return through or _is_mirror(branch, branch)


def _marks(branch):
    """The special points that tell a branch from others: all but the EPs of a closed one, which lie where it was
    started."""
    if End.CLOSED not in branch.ends:
        return branch.special
    return tuple(one for one in branch.special if one.kind != "EP")


def _reflected(point):
    """A special point with the impacts on the other walls, half a period later: enough to tell its mirror image."""
    spot = point.spot
    half = np.pi / frequency_at(point.scene, point.name, point.value)
    return replace(point, spot=spot._replace(times=spot.times + half, sides=-spot.sides))


def is_same(one, other):
    """Whether two special points are one."""
    return one.kind == other.kind and is_orbit(one, other)


def is_orbit(one, other, times=1):
    """Whether the orbit of a special point, this many times round, is that of another."""
    if times * one.spot.periods != other.spot.periods or not np.isclose(one.value, other.value, VALUE, VALUE):
        return False
    pace = max(each.spot.speeds.max(initial=0.0) for each in (one, other))
    points = (impacts(each.spot, frequency_at(each.scene, each.name, each.value), pace) for each in (one, other))
    return is_same_orbit(*points, NEAR)

"""A branch and those that leave it, and those that leave these: `Tree`, `followed`."""

import numpy as np

from .branch import row_of
from .follow import follow, placed
from .image import is_repeated
from .switch import FIRST, KINDS, left, starts

MOST = 64  # branches
VALUE, SPEED = 1e-8, 1e-6  # two special points as near in the parameter and in the impacts' speeds are one
OWN = ("SN", "PD", "SB", "BP")  # points that are on one branch alone, or where one ends
ASIDE = 1e-3  # along its tangent a branch is told from one of repeated orbits
ALIKE = 0.9  # the cosine between two directions that are one


def followed(orbit, name, bounds, max_period=1, progress=None, largest_step=0.1):
    """The branch through an orbit, and those that leave its special points and theirs: a tuple of `Branch`.

    orbit, name, bounds, largest_step: as in `follow`. max_period: drive periods of the longest orbits that are switched
    to at a period doubling; 1: none are. progress: called with the number of branches so far.

    Each special point is left once, in the order in which they are found, the first branch being that of the orbit; a
    branch that has been walked from its other end is left out. There are at most 64.

    Raises SceneError and OrbitError as `follow` does.
    """
    steps = {"largest_step": largest_step, "tolerance": 1e-10, "monitors": {}, "stop": ()}
    tree = Tree(bounds, max_period, MOST, steps, [], [], progress)
    tree.add(follow(orbit, name, bounds, largest_step=largest_step))
    tree.grow()
    return tuple(tree.found)


class Tree:
    """found: the branches so far; done: (branch, special point) of those that have been left, by their places."""

    def __init__(self, bounds, max_period, most, steps, found, done, progress):
        self.bounds, self.max_period, self.most, self.steps = bounds, max_period, most, steps
        self.found, self.done, self.progress = found, done, progress

    @property
    def is_spent(self):
        """Whether there is no room for another branch."""
        return len(self.found) >= self.most

    def has(self, branch):
        """Whether a branch is one of those found: it has a special point that is theirs."""
        theirs = [one for other in self.found for one in other.special]
        return any(is_same(one, two) for one in branch.special if one.kind in OWN for two in theirs)

    def grow(self):
        """Leaves every special point of the branches that has not been left, in turn."""
        met = [self.found[k].special[j] for k, j in self.done]
        k = 0
        while k < len(self.found) and not self.is_spent:
            for j, point in enumerate(self.found[k].special):
                if (k, j) in self.done or self.is_spent or not _is_left(point, self.max_period):
                    continue
                if not any(is_same(point, other) for other in met if point.kind != "GR"):
                    met.append(point)
                    self._leave(k, point)
                self.done.append((k, j))
            k += 1

    def _leave(self, k, point):
        if _is_reached(point, k, self.found):
            return
        for start in _starts(point):
            if point.kind == "GR" and _is_taken(start, point, self.found):
                continue
            branch = left(point, start, self.bounds, **{"first_step": FIRST} | self.steps)
            if len(branch) > 1 and not any(_is_retraced(branch, other) for other in self.found):
                self.add(branch)

    def add(self, branch):
        """One branch more."""
        self.found.append(branch)
        if self.progress is not None:
            self.progress(len(self.found))


def _is_left(point, max_period):
    """Whether branches are to be followed from a special point."""
    if point.kind not in KINDS or (point.place == 0 and point.kind != "GR"):
        return False
    if point.kind == "PD":
        return 2 * point.spot.periods <= max_period
    along, z = placed(point.scene, point.name, point.spot)
    return point.kind == "GR" or not is_repeated(along, z)


def _starts(point):
    """The starts of a point's branches, but for orbits that are shorter ones, repeated."""
    try:
        found = starts(point)
    except ValueError:  # the equations say that no branches cross there
        return []
    return [one for one in found if not is_repeated(one[0], one[1].z + ASIDE * one[1].tangent)]


def _is_reached(point, source, found):
    """Whether another branch than its own has come through a point: what crosses there has been walked."""
    times = 2 if point.kind == "PD" else 1
    return point.kind != "GR" and any(
        other.kind in ("SB", "BP", "EP") and is_orbit(point, other, times)
        for k, branch in enumerate(found)
        if k != source
        for other in branch.special
    )


def _is_retraced(branch, earlier):
    """Whether a branch ends in the very orbit in which an earlier one does, with as many impacts: it is that one, or
    that one the other way round."""
    one, other = branch.special[-1], earlier.special[-1]
    return branch.segments[-1].label == earlier.segments[-1].label and is_orbit(one, other)


def _is_taken(start, point, found):
    """Whether one of the branches comes to a grazing, or leaves it, by a start: its orbits a little on are on it."""
    along, begun = start
    count = len(begun.z) // 2 if len(along.cycle.sides) else 0
    hits = np.flatnonzero(along.cycle.sides != 0)
    sides = along.cycle.sides[hits]
    slopes = begun.tangent[count + hits] if count else begun.tangent[:0]
    way = np.sign(begun.tangent[-1])
    for branch in found:
        for other in branch.special:
            if other.kind != "GR" or not is_orbit(point, other):
                continue
            for step in (-1, 1):
                place = other.place + step
                if 0 <= place < len(branch) and _is_along(branch, place, other.place, sides, slopes, way):
                    return True
    return False


def _is_along(branch, place, grazing, sides, slopes, way):
    """Whether a point beside a grazing has the impacts, and lies in the direction, of a start there."""
    row, near = row_of(branch.data, place), row_of(branch.data, grazing)
    hit = row["side"] != 0
    if branch.data["segment"].values[place] != branch.data["segment"].values[grazing]:
        return _has(row["side"][hit], sides) and np.sign(row[branch.name] - near[branch.name]) == way
    if not _has(row["side"][hit], sides):
        return False
    change, value = (row["speed"] - near["speed"])[hit], row[branch.name] - near[branch.name]
    if not len(slopes):
        return np.sign(value) == way
    size = np.linalg.norm(slopes) * np.linalg.norm(change)
    turns = [
        np.roll(change, k) @ slopes for k in range(len(change)) if np.array_equal(np.roll(row["side"][hit], k), sides)
    ]
    return bool(turns) and max(turns) > ALIKE * size and np.sign(value) == way


def _has(sides, others):
    return len(sides) == len(others) and np.sum(sides) == np.sum(others)


def is_same(one, other):
    """Whether two special points are one."""
    return one.kind == other.kind and is_orbit(one, other)


def is_orbit(one, other, times=1):
    """Whether the orbit of a special point, this many times round, is that of another, counted from any impact.

    Compared are the speeds at each wall; an impact of a grazing, without speed, may be there or not.
    """
    if times * one.spot.periods != other.spot.periods or not np.isclose(one.value, other.value, VALUE, VALUE):
        return False
    for side in (-1, 1):
        here, there = (each.spot.speeds[each.spot.sides == side] for each in (one, other))
        size = SPEED * max(here.max(initial=0.0), there.max(initial=0.0))
        here, there = np.repeat(np.sort(here[here > size]), times), np.sort(there[there > size])
        if len(here) != len(there) or not np.allclose(here, there, SPEED, size):
            return False
    return True

"""`explore`: the periodic orbits of a scene along a parameter, unattended: followed both ways and from point to point.

What many starts at values all over the parameter's range settle on is looked at in turn. What lies on no branch so far
is followed, and so is all that leaves the special points met; then the next is looked at.
"""

import numpy as np

from continuation.arclength import Control
from continuation.follow import pinned

from . import check
from .along import problem
from .branch import row_of, spot_of
from .diagram import Diagram, is_orbit, is_same
from .domain import bounds_of, domain
from .find import find_orbit
from .follow import follow, placed, settled
from .graze import scales
from .image import is_repeated
from .orbit import OrbitError
from .probe import probes
from .switch import KINDS, left, starts

MOST = 400  # branches, where no budget is given
NEAR = 0.15  # of a branch's largest x and v: a state so near to its points is looked at more closely
ON = 1e-5  # of the largest speed: an orbit as near is on the branch
ASIDE = 1e-3  # along its tangent a branch is told from one of repeated orbits
FIRST = 0.01  # step of a branch that leaves a point
OWN = ("SN", "PD", "SB", "BP")  # points that are on one branch alone, or where one ends
PERIODS = 32  # the longest orbits
DONE = "all that was found has been followed"
SPENT = "the budget of {} branches is spent"


def explore(scene, name, bounds, max_period=8, seed=0, budget=None, resume=None, largest_step=0.1, progress=None):
    """The periodic orbits of a scene along a parameter: a `Diagram`.

    scene: a single one; name, bounds: as in `follow`; the scene's own value of the parameter does not matter.
    max_period: drive periods of the longest orbits that are looked for and that a period doubling is followed to;
    seed: of the random starts. budget: the most branches; None is 400. resume: a `Diagram` that stopped at its budget,
    of the same scene, parameter and settings, to go on from. progress: called with the number of branches so far.

    Every attractor that one of 256 starts settles on is on a branch. What lies on no branch that leaves these, as an
    isolated unstable orbit, is not found. The same arguments give the same diagram.

    Raises SceneError for arguments that cannot be.
    """
    check.is_single(scene)
    max_period, seed = check.whole("max_period", max_period, 1), check.whole("seed", seed, 0)
    if max_period > PERIODS:
        raise check.SceneError("max_period", f"must be at most {PERIODS}", max_period)
    most = MOST if budget is None else check.whole("budget", budget, 1)
    check.is_known(name, scene.names, name)
    scene = scene.replace(**{name: _inside(scene, name, bounds)})
    bounds = bounds_of(scene, name, bounds)
    steps = settled(FIRST, largest_step, 1e-10, (), ())
    settings = {"max_period": max_period, "seed": seed, "largest_step": largest_step}
    found, done = _resumed(resume, scene, name, bounds, settings)
    growing = _Growing(bounds, max_period, most, steps, found, done, progress)
    growing.grow()
    for probe in probes(scene, name, bounds, max_period, seed):
        if growing.is_spent:
            break
        if not any(_is_on(probe, branch) for branch in growing.found):
            growing.begin(probe, name)
    told = SPENT.format(most) if growing.is_spent else DONE
    return Diagram(name, bounds, scene, tuple(growing.found), tuple(growing.done), not growing.is_spent, told, settings)


def _inside(scene, name, bounds):
    """A value within the bounds and the parameter's domain."""
    value = float(scene.parameter(name))
    if np.shape(bounds) != (2,) or not np.isfinite(bounds).all() or not bounds[0] < bounds[1]:
        return value  # `bounds_of` tells
    low, high = np.clip(domain(scene, name), *bounds)
    return value if low <= value <= high else 0.5 * (low + high)


def _resumed(resume, scene, name, bounds, settings):
    if resume is None:
        return [], []
    if not isinstance(resume, Diagram):
        raise check.SceneError("resume", "must be a Diagram", resume)
    same = resume.name == name and resume.bounds == bounds and resume.settings == settings
    others = [key for key in scene.names if key != name]
    if not same or any(float(scene.parameter(key)) != float(resume.scene.parameter(key)) for key in others):
        raise check.SceneError("resume", "must be of the same scene, parameter, bounds and settings", resume)
    return list(resume.branches), list(resume.left)


class _Growing:
    """Branches found so far, and the special points that have been left."""

    def __init__(self, bounds, max_period, most, steps, found, done, progress):
        self.bounds, self.max_period, self.most, self.steps = bounds, max_period, most, steps
        self.found, self.done, self.progress = found, done, progress

    @property
    def is_spent(self):
        """Whether there is no room for another branch."""
        return len(self.found) >= self.most

    def begin(self, probe, name):
        """Follows the orbit that a probe settled on, and all that leaves it."""
        try:
            orbit = find_orbit(probe.scene, probe.state, periods=probe.periods, settle=0)
            branch = follow(orbit, name, self.bounds, **self.steps)
        except OrbitError:  # it rests on a wall, or had not settled
            return
        if not any(is_same(one, two) for one in branch.special if one.kind in OWN for two in self._points()):
            self._add(branch)
            self.grow()

    def _points(self):
        return [one for branch in self.found for one in branch.special]

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
                if not self.is_spent:
                    self.done.append((k, j))
            k += 1

    def _leave(self, k, point):
        if _is_reached(point, k, self.found):
            return
        for start in _starts(point):
            if self.is_spent:
                return
            if point.kind == "GR" and _is_taken(start, point, self.found):
                continue
            branch = left(point, start, self.bounds, **self.steps)
            if len(branch) > 1:
                self._add(branch)

    def _add(self, branch):
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
    return bool(turns) and max(turns) > 0.9 * size and np.sign(value) == way


def _has(sides, others):
    return len(sides) == len(others) and np.sum(sides) == np.sum(others)


def _is_on(probe, branch):
    """Whether what a probe settled on is an orbit of a branch."""
    if branch.data.sizes["period"] != probe.periods:
        return False
    values = branch.values
    for place in np.flatnonzero((values[:-1] - probe.value) * (values[1:] - probe.value) <= 0):
        if _is_near(probe, branch, place) and _is_there(probe, branch, place):
            return True
    return False


def _is_near(probe, branch, place):
    """Whether a probe's states are near those of one of two points of a branch, by the branch's own measure."""
    points = np.stack([branch.data[key].values for key in "xv"], axis=2)
    size = NEAR * abs(points).max()
    turns = [np.roll(row, k, axis=0) for row in points[place : place + 2] for k in range(probe.periods)]
    return any(abs(turn - probe.points).max() < size for turn in turns)


def _is_there(probe, branch, place):
    """Whether Newton's method leads from a branch's point to the very orbit."""
    for k in (place, place + 1):
        spot = spot_of(row_of(branch.data, k), branch.name)
        along, z = placed(branch.scene.replace(**{branch.name: spot.value}), branch.name, spot)
        numbers = (np.float64(each) for each in (0.0, 1.0, 1.0, -np.inf, np.inf))
        found = pinned(problem(along), z, -1, probe.value, Control(scales(along, 1.0), *numbers), along)
        if found.met and _is_orbit(probe, along, found.z):
            return True
    return False


def _is_orbit(probe, along, z):
    rows, size = len(along.cycle.sides), ON * max(1.0, abs(probe.points).max())
    if not rows:
        return not len(probe.speeds) and abs(z[:2] - probe.points[0]).max() < size
    for side in (-1, 1):
        here, there = z[rows : 2 * rows][along.cycle.sides == side], probe.speeds[probe.sides == side]
        if len(here) != len(there) or abs(np.sort(here) - np.sort(there)).max(initial=0.0) > size:
            return False
    return True

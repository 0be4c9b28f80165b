"""A branch and those that leave it, and those that leave these: `followed`."""

import numpy as np

from .domain import scene_length
from .follow import follow
from .switch import KINDS, switch

MOST = 64  # branches
VALUE, SPEED = 1e-8, 1e-6  # two special points as near in the parameter and in the impacts' speeds are one


def followed(orbit, name, bounds, max_period=1, progress=None, **settings):
    """The branch through an orbit, and those that leave its special points and theirs: a tuple of `Branch`.

    orbit, name, bounds: as in `follow`. max_period: drive periods of the longest orbits that are switched to at a
    period doubling; 1: none are. progress: called with the number of branches so far. settings: largest_step and the
    others that `follow` and `switch` share.

    Each special point is left once, in the order in which they are found, the first branch being that of the orbit; a
    branch that has been walked from its other end is left out. There are at most 64.

    Raises SceneError and OrbitError as `follow` does.
    """
    found, met = [follow(orbit, name, bounds, **settings)], []
    for branch in found:  # which grows
        for point in _leaving(branch, max_period):
            if any(_is_same(point, other) for other in met) or _is_reached(point, branch, found):
                continue
            met.append(point)
            for one in _switched(point, bounds, settings):
                if len(found) < MOST and not any(_is_retraced(one, other) for other in found):
                    found.append(one)
            if progress is not None:
                progress(len(found))
    return tuple(found)


def _leaving(branch, max_period):
    """The special points of a branch that others leave, but for its own start."""
    (start, *_) = branch.special
    for one in branch.special:
        doubled = one.kind != "PD" or 2 * one.spot.periods <= max_period
        if one.kind in KINDS and doubled and not _is_orbit(one, start):
            yield one


def _switched(point, bounds, settings):
    """The branches that leave a point and have a length; none where the equations say that none cross there."""
    try:
        return [one for one in switch(point, bounds, **settings) if len(one) > 1]
    except ValueError:
        return []


def _is_same(one, other):
    """Whether two special points are one."""
    return one.kind == other.kind and _is_orbit(one, other)


def _is_reached(point, source, found):
    """Whether another branch than its own has come through a point: what crosses there has been walked."""
    times = 2 if point.kind == "PD" else 1
    return point.kind != "GR" and any(
        other.kind in ("SB", "BP") and _is_orbit(point, other, times)
        for branch in found
        if branch is not source
        for other in branch.special
    )


def _is_retraced(branch, earlier):
    """Whether a branch ends in the very orbit in which an earlier one does, with as many impacts: it is that one, or
    that one the other way round."""
    one, other = branch.special[-1], earlier.special[-1]
    return branch.segments[-1].label == earlier.segments[-1].label and _is_orbit(one, other)


def _is_orbit(one, other, times=1):
    """Whether the orbit of a special point, this many times round, is that of another.

    Compared are the speeds at each wall; an impact of a grazing, without speed, may be there or not.
    """
    if times * one.spot.periods != other.spot.periods or not np.isclose(one.value, other.value, VALUE, VALUE):
        return False
    slow = SPEED * scene_length(one.scene)
    for side in (-1, 1):
        here, there = (np.sort(each.spot.speeds[each.spot.sides == side]) for each in (one, other))
        here, there = np.repeat(here[here > slow], times), there[there > slow]
        if len(here) != len(there) or not np.allclose(here, there, SPEED, slow):
            return False
    return True

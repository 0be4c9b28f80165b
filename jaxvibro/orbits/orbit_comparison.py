"""Orbits seen at the walls: each impact is a point (wall, phase, speed). Whether two are one is told there.

An impact tells the whole motion that follows. So orbits are the same where their impacts are, from whichever impact or
period they are counted and however often they are gone through. The mirror image of an orbit exchanges the walls and
comes half a drive period later, with the same speeds.
"""

import numpy as np

APART = 10.0  # between the two walls' points: more than any two of one wall
QUERIES = 200  # impacts of one set that are looked for in another


def meetings(frequency, time, side, speed, length):
    """The impacts as points (side APART, cos phase, sin phase, speed / length), shape (impacts, 4), in order.

    time, side, speed: of the impacts in periods that start at phase `time` 0, as in `Impacts`, slots last.
    length: of the scene, per t a speed that is large.
    """
    hit = side != 0
    phase = frequency * time[hit]
    return np.stack([side[hit] * APART, np.cos(phase), np.sin(phase), speed[hit] / length], -1)


def mirrored(points):
    """The points of the mirror image: the other wall, half a drive period later."""
    return points * np.array([-1.0, -1.0, -1.0, 1.0])


def is_same_orbit(points, others, near=None):
    """Whether two periodic orbits of a scene are one, or one several times the other: each impact is near one of the
    other's, but for those without speed, which may be there or not. Without impacts there is one orbit.

    near: of two points; None is eps^(1/4), for orbits that starts have settled on.
    """
    near = np.finfo(points.dtype).eps ** 0.25 if near is None else near
    points, others = (_weighed(each[each[:, -1] > near]) for each in (points, others))
    if not len(points) or not len(others):
        return len(points) == len(others)
    apart = abs(points[:, None] - others).max(axis=-1)
    return bool(max(apart.min(axis=0).max(), apart.min(axis=1).max()) <= near)


def times_round(points, periods, near):
    """How many times an orbit of so many drive periods, its impacts in order of travel, goes through a shorter one;
    impacts without speed do not count. Without others it is the response to the drive, which has the drive's period."""
    points = _weighed(points[points[:, -1] > near])
    count = len(points)
    if not count:
        return periods
    parts = (k for k in range(periods, 0, -1) if periods % k == 0 and count % k == 0)
    return next((k for k in parts if abs(np.roll(points, count // k, axis=0) - points).max() <= near), 1)


def _weighed(points):
    """The points with phases that count by the speed where that is small: as much worse is the time of it known."""
    return np.concatenate([points[:, :1], points[:, 1:3] * np.minimum(points[:, 3:], 1.0), points[:, 3:]], axis=1)


def is_same_set(points, others):
    """Whether two long samples, in order of time, fill the same set.

    They do where the median distance from one to the other is at most three times that between the halves of a
    sample; one direction is enough, for an orbit that still roams part of a set.
    """
    return bool(_median(points, others) <= 3.0 * _spread(others) or _median(others, points) <= 3.0 * _spread(points))


def _spread(points):
    half = len(points) // 2
    return _median(points[half:], points[:half])


def _median(points, others):
    """The median distance from points, a sample of them, to the others; infinite where there are none."""
    found = _nearest(points[:: max(1, len(points) // QUERIES)], others)
    return np.median(found) if len(found) else np.inf


def _nearest(points, others):
    """The distance of each point to the nearest of the others, good to the root of the rounding."""
    if not len(others):
        return np.full(len(points), np.inf)
    square = np.einsum("ik,jk->ij", -2.0 * points, others)  # ten times as fast here as a threaded matrix product
    square += (others**2).sum(-1)
    return np.sqrt(np.maximum(square.min(axis=1) + (points**2).sum(-1), 0.0))

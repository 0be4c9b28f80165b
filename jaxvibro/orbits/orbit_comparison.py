"""Orbits seen at the walls: each impact is a point (wall, phase, speed). Whether two are one is told there.

An impact tells the whole motion that follows. So orbits are the same where their impacts are, from whichever impact or
period they are counted and however often they are gone through. The mirror image of an orbit exchanges the walls and
comes half a drive period later, with the same speeds.
"""

import numpy as np

WALL_OFFSET = 10.0  # between the two walls' points: more than any two of one wall
MAX_QUERIES = 200  # impacts of one set that are looked for in another


def impacts_as_points(frequency, time, side, speed, speed_scale):
    """The impacts as points (side APART, cos phase, sin phase, speed / length), shape (impacts, 4), in order.

    time, side, speed: of the impacts in periods that start at phase `time` 0, as in `Impacts`, slots last.
    speed_scale: of the scene, per t a speed that is large.
    """
    is_impact = side != 0
    phase = frequency * time[is_impact]
    return np.stack([side[is_impact] * WALL_OFFSET, np.cos(phase), np.sin(phase), speed[is_impact] / speed_scale], -1)


def mirror_points(points):
    """The points of the mirror image: the other wall, half a drive period later."""
    return points * np.array([-1.0, -1.0, -1.0, 1.0])


def is_same_orbit(points, other_points, tolerance=None):
    """Whether two periodic orbits of a scene are one, or one several times the other: each impact is near one of the
    other's, but for those without speed, which may be there or not. Without impacts there is one orbit.

    tolerance: of two points; None is eps^(1/4), for orbits that starts have settled on.
    """
    tolerance = np.finfo(points.dtype).eps ** 0.25 if tolerance is None else tolerance
    points, other_points = (
        _weight_phases(point_set[point_set[:, -1] > tolerance]) for point_set in (points, other_points)
    )
    if not len(points) or not len(other_points):
        return len(points) == len(other_points)
    distances = abs(points[:, None] - other_points).max(axis=-1)
    return bool(max(distances.min(axis=0).max(), distances.min(axis=1).max()) <= tolerance)


def repetition_count(points, periods, tolerance):
    """How many times an orbit of so many drive periods, its impacts in order of travel, goes through a shorter one;
    impacts without speed do not count. Without others it is the response to the drive, which has the drive's period."""
    points = _weight_phases(points[points[:, -1] > tolerance])
    n_impacts = len(points)
    if not n_impacts:
        return periods
    common_divisors = (
        divisor for divisor in range(periods, 0, -1) if periods % divisor == 0 and n_impacts % divisor == 0
    )
    return next(
        (
            divisor
            for divisor in common_divisors
            if abs(np.roll(points, n_impacts // divisor, axis=0) - points).max() <= tolerance
        ),
        1,
    )


def _weight_phases(points):
    """The points with phases that count by the speed where that is small: as much worse is the time of it known."""
    return np.concatenate([points[:, :1], points[:, 1:3] * np.minimum(points[:, 3:], 1.0), points[:, 3:]], axis=1)


def is_same_set(points, other_points):
    """Whether two long samples, in order of time, fill the same set.

    They do where the median distance from one to the other is at most three times that between the halves of a
    sample; one direction is enough, for an orbit that still roams part of a set.
    """
    return bool(
        _median_distance(points, other_points) <= 3.0 * _distance_of_halves(other_points)
        or _median_distance(other_points, points) <= 3.0 * _distance_of_halves(points)
    )


def _distance_of_halves(points):
    half_count = len(points) // 2
    return _median_distance(points[half_count:], points[:half_count])


def _median_distance(points, other_points):
    """The median distance from points, a sample of them, to the others; infinite where there are none."""
    distances = _nearest_distances(points[:: max(1, len(points) // MAX_QUERIES)], other_points)
    return np.median(distances) if len(distances) else np.inf


def _nearest_distances(points, other_points):
    """The distance of each point to the nearest of the others, good to the root of the rounding."""
    if not len(other_points):
        return np.full(len(points), np.inf)
    squared_distances = np.einsum(
        "ik,jk->ij", -2.0 * points, other_points
    )  # ten times as fast here as a threaded matrix product
    squared_distances += (other_points**2).sum(-1)
    return np.sqrt(np.maximum(squared_distances.min(axis=1) + (points**2).sum(-1), 0.0))

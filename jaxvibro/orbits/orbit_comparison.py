"""Compare orbits by their impacts, as points (wall, phase, speed).

An impact determines all motion that follows. Therefore two orbits are the same if their impacts are the same, whichever
impact or period comes first and however often the orbit is traversed. The impacts of the mirror image are on the other
walls, half a drive period later, with the same speeds.
"""

import numpy as np

WALL_OFFSET = 10.0  # separates the points of the walls by more than the distance of any two on one wall
MAX_QUERIES = 200  # impacts of one set that are compared with another


def impacts_as_points(frequency, time, side, speed, speed_scale):
    """Convert impacts to points.

    Parameters
    ----------
    frequency : float
        Frequency of the drive.
    time, side, speed : numpy.ndarray
        Impacts in arrays of one shape, with side 0 in empty slots. `time` is the time since phase 0, up to
        multiples of the drive period.
    speed_scale : float
        Large speed of the scene, in lengths per t.

    Returns
    -------
    numpy.ndarray
        Points (side * WALL_OFFSET, cos phase, sin phase, speed / speed_scale) in order, of shape (impacts, 4).
    """
    is_impact = side != 0
    phase = frequency * time[is_impact]
    return np.stack([side[is_impact] * WALL_OFFSET, np.cos(phase), np.sin(phase), speed[is_impact] / speed_scale], -1)


def mirror_points(points):
    """Compute the points of the mirror image: impacts on the other walls, half a drive period later.

    Parameters
    ----------
    points : numpy.ndarray
        Points of shape (impacts, 4).

    Returns
    -------
    numpy.ndarray
        Points of the mirror image.
    """
    return points * np.array([-1.0, -1.0, -1.0, 1.0])


def is_same_orbit(points, other_points, tolerance=None):
    """Test whether two periodic orbits of a scene are the same, possibly traversed several times.

    Each impact must be near an impact of the other orbit. Impacts whose scaled speed is at most the tolerance are
    ignored. Orbits without further impacts are the same.

    Parameters
    ----------
    points, other_points : numpy.ndarray
        Impacts of the orbits as points.
    tolerance : float, optional
        Largest distance of two points. By default it is eps^(1/4), for orbits on which states have settled.

    Returns
    -------
    bool
        True if they are the same.
    """
    tolerance = np.finfo(points.dtype).eps ** 0.25 if tolerance is None else tolerance
    points, other_points = (
        _weight_phases_by_speed(impact_points[impact_points[:, -1] > tolerance])
        for impact_points in (points, other_points)
    )
    if not len(points) or not len(other_points):
        return len(points) == len(other_points)
    pair_distances = abs(points[:, None] - other_points).max(axis=-1)
    return bool(max(pair_distances.min(axis=0).max(), pair_distances.min(axis=1).max()) <= tolerance)


def repetition_count(points, periods, tolerance):
    """Count how many times an orbit traverses a shorter one.

    Parameters
    ----------
    points : numpy.ndarray
        Impacts as points, in order of time. Impacts whose scaled speed is at most `tolerance` are ignored.
    periods : int
        Number of drive periods.
    tolerance : float
        Largest distance of two equal points.

    Returns
    -------
    int
        Number of repetitions. Without impacts the motion is the response to the drive, which repeats every period.
    """
    points = _weight_phases_by_speed(points[points[:, -1] > tolerance])
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


def _weight_phases_by_speed(points):
    """Weight the phases by the speed where it is small: the times of slow impacts are less accurate."""
    return np.concatenate([points[:, :1], points[:, 1:3] * np.minimum(points[:, 3:], 1.0), points[:, 3:]], axis=1)


def samples_fill_same_set(points, other_points):
    """Test whether two long samples of impacts, in order of time, fill the same set.

    The median distance from the points of one sample to the other sample must be at most three times the median
    distance between the halves of the other sample. One direction is sufficient, because an orbit may still explore
    part of a set.

    Parameters
    ----------
    points, other_points : numpy.ndarray
        Samples as points, of shape (impacts, 4).

    Returns
    -------
    bool
        True if they fill the same set.
    """
    return bool(
        _median_distance(points, other_points) <= 3.0 * _sample_half_distance(other_points)
        or _median_distance(other_points, points) <= 3.0 * _sample_half_distance(points)
    )


def _sample_half_distance(points):
    n_half = len(points) // 2
    return _median_distance(points[n_half:], points[:n_half])


def _median_distance(points, other_points):
    """Return the median distance from a subset of the points to the other points; inf without points."""
    distances = _nearest_distances(points[:: max(1, len(points) // MAX_QUERIES)], other_points)
    return np.median(distances) if len(distances) else np.inf


def _nearest_distances(points, other_points):
    """Return the distance of each point to the nearest other point, accurate to the square root of rounding."""
    if not len(other_points):
        return np.full(len(points), np.inf)
    squared_distances = np.einsum(
        "ik,jk->ij", -2.0 * points, other_points
    )  # ten times as fast as a threaded matrix product for these shapes
    squared_distances += (other_points**2).sum(-1)
    return np.sqrt(np.maximum(squared_distances.min(axis=1) + (points**2).sum(-1), 0.0))

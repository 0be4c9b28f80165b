"""Lines through points, bent between them."""

from itertools import pairwise

import numpy as np
import scipy

MAX_POINTS = 200  # points of a line: with more it is smooth as it is
SUBDIVISIONS = 8  # points put between two
CORNER_ANGLE = 0.6  # radians: where a line turns by more from one chord to the next it has a corner


def smooth_line(x, y):
    """(across, up) of a line through points that breaks where one is nan, with more points between: each coordinate is
    a cubic spline of the way along the line, from corner to corner. A point that is there twice is taken once."""
    if len(y) > MAX_POINTS:
        return x, y
    x, y = np.stack([x, y])[:, np.append(True, (np.diff(x) != 0) | (np.diff(y) != 0))]
    extent = np.array(
        [
            [np.ptp(coordinate[np.isfinite(coordinate)]) if np.isfinite(coordinate).any() else 0.0]
            for coordinate in (x, y)
        ]
    )
    if not extent.all():
        return x, y
    points = np.stack([x, y])
    chords = np.diff(points / extent, axis=1)
    with np.errstate(invalid="ignore"):
        turn_angles = abs(np.diff(np.unwrap(np.arctan2(chords[1], chords[0]))))
        is_corner = np.concatenate([[True], ~(turn_angles < CORNER_ANGLE), [True]])  # nan is one
    corner_rows = np.flatnonzero(is_corner)
    parts = [
        _spline_points(points[:, start : stop + 1], chords[:, start:stop]) for start, stop in pairwise(corner_rows)
    ]
    return np.concatenate([*parts, points[:, -1:]], axis=1)


def _spline_points(points, chords):
    """The points of a line without corners, (2, points), with more between, up to the last."""
    chord_lengths = np.hypot(*chords)
    if len(chord_lengths) < 2:
        return points[:, :-1]
    fractions, arclength = np.arange(SUBDIVISIONS) / SUBDIVISIONS, np.append(0.0, np.cumsum(chord_lengths))
    return scipy.interpolate.CubicSpline(arclength, points, axis=1)(
        (arclength[:-1, None] + fractions * chord_lengths[:, None]).ravel()
    )

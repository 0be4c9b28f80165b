"""Interpolate lines through points smoothly."""

from itertools import pairwise

import numpy as np
import scipy

MAX_POINTS = 200  # a line with more points needs no interpolation
SUBDIVISIONS = 8  # subdivisions of the interval between two points
CORNER_ANGLE = 0.6  # radians: a larger angle between two chords is a corner


def smooth_line(x, y):
    """Return (x, y) of a line through points, with further points on cubic splines between its corners.

    The splines are functions of the arclength. The line breaks at nan. Repeated points are used once.
    """
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
        is_corner = np.concatenate([[True], ~(turn_angles < CORNER_ANGLE), [True]])  # nan counts as a corner
    corner_rows = np.flatnonzero(is_corner)
    parts = [
        _spline_points(points[:, start : stop + 1], chords[:, start:stop]) for start, stop in pairwise(corner_rows)
    ]
    return np.concatenate([*parts, points[:, -1:]], axis=1)


def _spline_points(points, chords):
    """Return the points of a line without corners and points between them, up to the last, of shape (2, points)."""
    chord_lengths = np.hypot(*chords)
    if len(chord_lengths) < 2:
        return points[:, :-1]
    fractions, arclength = np.arange(SUBDIVISIONS) / SUBDIVISIONS, np.append(0.0, np.cumsum(chord_lengths))
    return scipy.interpolate.CubicSpline(arclength, points, axis=1)(
        (arclength[:-1, None] + fractions * chord_lengths[:, None]).ravel()
    )

"""Interpolate lines through points by splines between corners."""

from itertools import pairwise

import numpy as np
import scipy

MAX_POINTS = 200  # a line with more points needs no interpolation
SUBDIVISIONS = 8  # subdivisions of the interval between two points
CORNER_ANGLE = 0.6  # radians: a larger angle between two chords is a corner


def smooth_line(x, y):
    """Return (x, y) of a line through points, with further points on cubic splines between its corners.

    The splines are functions of the arclength. The line breaks at nan. Consecutive equal points are used once. A line
    with more than `MAX_POINTS` points is returned unchanged.
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
    unscaled_points = np.stack([x, y])
    scaled_chords = np.diff(unscaled_points / extent, axis=1)
    with np.errstate(invalid="ignore"):
        chord_turn_angles = abs(np.diff(np.unwrap(np.arctan2(scaled_chords[1], scaled_chords[0]))))
        is_corner = np.concatenate([[True], ~(chord_turn_angles < CORNER_ANGLE), [True]])  # nan counts as a corner
    corner_rows = np.flatnonzero(is_corner)
    spline_parts = [
        _spline_points(unscaled_points[:, first_row : last_row + 1], scaled_chords[:, first_row:last_row])
        for first_row, last_row in pairwise(corner_rows)
    ]
    return np.concatenate([*spline_parts, unscaled_points[:, -1:]], axis=1)


def _spline_points(points, scaled_chords):
    """Return the points of a line that has no corners, with interpolated points between them; shape (2, points).

    The last point of the line is omitted.
    """
    scaled_chord_lengths = np.hypot(*scaled_chords)
    if len(scaled_chord_lengths) < 2:
        return points[:, :-1]
    chord_fractions, arclength = np.arange(SUBDIVISIONS) / SUBDIVISIONS, np.append(0.0, np.cumsum(scaled_chord_lengths))
    return scipy.interpolate.CubicSpline(arclength, points, axis=1)(
        (arclength[:-1, None] + chord_fractions * scaled_chord_lengths[:, None]).ravel()
    )

"""Lines through points, bent between them."""

from itertools import pairwise

import numpy as np
import scipy

FEW = 200  # points of a line: with more it is smooth as it is
BETWEEN = 8  # points put between two
CORNER = 0.6  # radians: where a line turns by more from one chord to the next it has a corner


def smooth(across, up):
    """(across, up) of a line through points that breaks where one is nan, with more points between: each coordinate is
    a cubic spline of the way along the line, from corner to corner. A point that is there twice is taken once."""
    if len(up) > FEW:
        return across, up
    across, up = np.stack([across, up])[:, np.append(True, (np.diff(across) != 0) | (np.diff(up) != 0))]
    size = np.array([[np.ptp(each[np.isfinite(each)]) if np.isfinite(each).any() else 0.0] for each in (across, up)])
    if not size.all():
        return across, up
    line = np.stack([across, up])
    chords = np.diff(line / size, axis=1)
    with np.errstate(invalid="ignore"):
        turned = abs(np.diff(np.unwrap(np.arctan2(chords[1], chords[0]))))
        corner = np.concatenate([[True], ~(turned < CORNER), [True]])  # nan is one
    ends = np.flatnonzero(corner)
    parts = [_bent(line[:, first : last + 1], chords[:, first:last]) for first, last in pairwise(ends)]
    return np.concatenate([*parts, line[:, -1:]], axis=1)


def _bent(line, chords):
    """The points of a line without corners, (2, points), with more between, up to the last."""
    steps = np.hypot(*chords)
    if len(steps) < 2:
        return line[:, :-1]
    share, way = np.arange(BETWEEN) / BETWEEN, np.append(0.0, np.cumsum(steps))
    return scipy.interpolate.CubicSpline(way, line, axis=1)((way[:-1, None] + share * steps[:, None]).ravel())

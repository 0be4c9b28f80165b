"""Where a clearance or a speed may have dipped below zero between two points of a branch that are both good."""

import numpy as np

from continuation.points import between
from continuation.rows import put

from .diagnostics import diagnose
from .touches import admissible

DIP = 0.5  # of a value at the least of three points: a parabola's least below that is looked at
CUTS = 8  # parts of an interval that is looked at for a least value
ZOOMS = 6  # times that the parts are made smaller around it


def with_dips(task, points, look):
    """(the points, with one more where a clearance or speed may have dipped below zero between them; their
    `Diagnostics`).

    task: the `driver.Task` of the branch or locus, its args the equations.
    """
    along = task.args
    values = _values(along, points.z, look)
    with np.errstate(invalid="ignore"):
        free = values > along.slack
        low = (values[1:-1] < values[:-2]) & (values[1:-1] <= values[2:]) & free[1:-1] & free[2:]
        bend = values[:-2] - 2.0 * values[1:-1] + values[2:]
        least = values[1:-1] - (values[2:] - values[:-2]) ** 2 / (8.0 * np.where(bend > 0, bend, np.inf))
        low &= np.isfinite(values[:-2]) & np.isfinite(values[2:]) & (least < DIP * values[1:-1])
    offset = 0
    for middle in np.unique(np.nonzero(low)[0]) + 1:
        for after in (middle - 1, middle):
            columns = np.flatnonzero(low[middle - 1])
            found = _dip(task, points, int(after + offset), columns)
            if found is not None:
                points = put(points, after + offset + 1, found)
                offset += 1
    return points, diagnose(along, points.z) if offset else look


def _dip(task, points, after, columns):
    """A `Point` between two that keeps to its walls no more, None where there is none."""
    along, low, high = task.args, 0.0, float(points.step[after + 1])
    for _ in range(ZOOMS):
        lengths = np.linspace(low, high, CUTS + 1)[1:-1]
        some = [between(task, points, after, length) for length in lengths]
        if any(one is None for one in some):
            return None
        zs = np.stack([one.z for one in some])
        look = diagnose(along, zs)
        bad = ~admissible(along, zs, look)
        if bad.any():
            return some[int(np.argmax(bad))]
        values = _values(along, zs, look)
        best = int(np.argmin(values[:, columns].min(axis=1)))
        width = (high - low) / CUTS
        low, high = lengths[best] - width, lengths[best] + width
    return None


def _values(along, zs, look):
    """Clearances, then speeds: (points, values)."""
    speeds = zs[:, len(along.cycle.sides) + along.hits]
    return np.concatenate([look.clear.reshape(len(zs), -1), speeds], axis=1)

"""Neimark-Sacker points, where a complex pair of multipliers leaves the unit circle: only a force of the user's own
feeds a motion so that there are any."""

import numpy as np

from continuation.rows import at

from ..problem.diagnostics import diagnose
from .user_monitors import crossings


def neimark_sacker(task, points, look):
    """The `Event`s of a row of points at which the determinant of the monodromy matrix passes 1 and the multipliers are
    complex; where they are real it is a neutral saddle, which is none."""
    if task.args.scene.force is None or not (np.diff(np.sign(look.determinant - 1.0)) != 0).any():
        return []
    found = crossings(task, points, look, "NS", _beyond)
    return [one for one in found if abs(at(diagnose(task.args, one.z[None]), 0).trace) < 2.0]


def _beyond(point):
    """By how much the determinant at a `MonitoredPoint` is larger than 1."""
    with np.errstate(invalid="ignore"):  # infinite at an impact without speed
        return float(np.prod(point.multipliers).real) - 1.0

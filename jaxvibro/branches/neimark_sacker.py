"""Where the product of the multipliers passes 1: Neimark-Sacker points and neutral saddles, which only a scene may have
whose areas grow somewhere."""

import jax
import numpy as np

from continuation.rows import at

from ..orbits.orbit import areas_kept
from ..problem.diagnostics import diagnose
from ..scene.dissipation import never_grow
from .user_monitors import crossings


def neimark_sacker(task, points, look):
    """The `Event`s of a row of points at which the determinant of the monodromy matrix passes 1: NS where the
    multipliers are complex there, NSA where they are real, a neutral saddle. None where areas are proved never to grow,
    and where the determinant is 1 all along."""
    off = look.determinant - 1.0
    if task.args.scene.force is None or not (np.diff(np.sign(off)) != 0).any():
        return []
    if areas_kept(look.trace, look.determinant) or never_grow(*_ends(task.args, points)):
        return []
    return [one._replace(kind=_kind(task.args, one)) for one in crossings(task, points, look, "NS", _beyond)]


def _ends(along, points):
    """The scene at the least and at the largest value of the parameter."""
    values = points.z[:, -1]

    def scene(value):
        return jax.tree.map(lambda leaf, mark: np.where(mark == 1, value, leaf), along.scene, along.which)

    return scene(values.min()), scene(values.max())


def _kind(along, event):
    return "NS" if abs(at(diagnose(along, event.z[None]), 0).trace) < 2.0 else "NSA"


def _beyond(point):
    """By how much the determinant at a `MonitoredPoint` is larger than 1."""
    with np.errstate(invalid="ignore"):  # infinite at an impact without speed
        return float(np.prod(point.multipliers).real) - 1.0

"""Where the product of the multipliers passes 1: Neimark-Sacker points and neutral saddles, which only a scene may have
whose areas grow somewhere."""

import jax
import numpy as np

from continuation.point_rows import row_at

from ..orbits.orbit import is_area_preserving
from ..problem.diagnostics import diagnose
from ..scene.dissipation import areas_never_grow
from .user_monitors import locate_crossings


def locate_neimark_sacker(task, points, diagnostics):
    """The `Event`s of a row of points at which the determinant of the monodromy matrix passes 1: NS where the
    multipliers are complex there, NSA where they are real, a neutral saddle. None where areas are proved never to grow,
    and where the determinant is 1 all along."""
    excess = diagnostics.determinant - 1.0
    if task.args.scene.force is None or not (np.diff(np.sign(excess)) != 0).any():
        return []
    if is_area_preserving(diagnostics.trace, diagnostics.determinant) or areas_never_grow(
        *_scenes_at_extremes(task.args, points)
    ):
        return []
    return [
        event._replace(kind=_event_kind(task.args, event))
        for event in locate_crossings(task, points, diagnostics, "NS", _determinant_excess)
    ]


def _scenes_at_extremes(problem, points):
    """The scene at the least and at the largest value of the parameter."""
    values = points.z[:, -1]

    def scene_at_value(value):
        return jax.tree.map(
            lambda leaf, parameter_mark: np.where(parameter_mark == 1, value, leaf),
            problem.scene,
            problem.parameter_marks,
        )

    return scene_at_value(values.min()), scene_at_value(values.max())


def _event_kind(problem, event):
    return "NS" if abs(row_at(diagnose(problem, event.z[None]), 0).trace) < 2.0 else "NSA"


def _determinant_excess(point):
    """By how much the determinant at a `MonitoredPoint` is larger than 1."""
    with np.errstate(invalid="ignore"):  # infinite at an impact without speed
        return float(np.prod(point.multipliers).real) - 1.0

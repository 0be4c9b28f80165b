"""Locate Neimark-Sacker points and neutral saddles, where the product of the multipliers passes 1.

Such points exist only in scenes in which areas in the phase space grow somewhere.
"""

import jax
import numpy as np

from continuation.point_rows import row_at

from ..contact.kinds import flow_of_scene
from ..orbits.orbit import has_unit_determinants
from ..problem.orbit_diagnostics import diagnose
from ..scene.area_growth_proof import areas_never_grow
from .user_monitors import locate_crossings


def locate_neimark_sacker(task, points, diagnostics):
    """Locate the `Event` of each point at which the determinant of the monodromy matrix passes 1.

    The kind is NS if the multipliers are complex there, and NSA (neutral saddle) if they are real. There are no events
    if the flow contracts areas, if areas are proved never to grow, or if the determinant is 1 everywhere.
    """
    determinant_excess = diagnostics.determinant - 1.0
    if not flow_of_scene(task.args.scene).areas_may_grow() or not (np.diff(np.sign(determinant_excess)) != 0).any():
        return []
    if has_unit_determinants(diagnostics.trace, diagnostics.determinant) or areas_never_grow(
        *_scenes_at_extremes(task.args, points)
    ):
        return []
    return [
        event._replace(kind=_event_kind(task.args, event))
        for event in locate_crossings(task, points, diagnostics, "NS", _determinant_excess)
    ]


def _scenes_at_extremes(problem, points):
    """Return the scenes at the least and at the largest value of the parameter."""
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
    """Return the determinant at a `MonitoredPoint` minus 1."""
    with np.errstate(invalid="ignore"):  # multipliers are infinite at an impact with zero speed
        return float(np.prod(point.multipliers).real) - 1.0

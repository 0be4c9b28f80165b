"""Detect missed grazings: clearances or speeds that are negative only between two points of a continuation."""

import numpy as np

from continuation.intermediate_points import point_at_length
from continuation.point_rows import insert_row

from .grazing_contact import are_admissible
from .orbit_diagnostics import diagnose

DIP_RATIO = 0.5  # relative to the least of three values; intervals where a parabola falls below this are searched
N_PARTS = 8  # parts of an interval that is searched for a minimum
MAX_REFINEMENTS = 6  # refinements of the parts around the minimum


def insert_missed_grazings(task, points, diagnostics):
    """Insert an inadmissible point where a clearance or a speed becomes negative between two points.

    Returns (points, `Diagnostics` of the points). `task` is the `ContinuationTask` of a branch or a locus; its ``args``
    are the equations.
    """
    problem = task.args
    margins = _clearances_and_speeds(problem, points.z, diagnostics)
    with np.errstate(invalid="ignore"):
        is_positive = margins > problem.slack
        may_become_negative = (
            (margins[1:-1] < margins[:-2]) & (margins[1:-1] <= margins[2:]) & is_positive[1:-1] & is_positive[2:]
        )
        curvature = margins[:-2] - 2.0 * margins[1:-1] + margins[2:]
        predicted_minimum = margins[1:-1] - (margins[2:] - margins[:-2]) ** 2 / (
            8.0 * np.where(curvature > 0, curvature, np.inf)
        )
        may_become_negative &= (
            np.isfinite(margins[:-2]) & np.isfinite(margins[2:]) & (predicted_minimum < DIP_RATIO * margins[1:-1])
        )
    n_inserted = 0
    for middle_point_index in np.unique(np.nonzero(may_become_negative)[0]) + 1:
        for previous_point_index in (middle_point_index - 1, middle_point_index):
            suspect_margin_columns = np.flatnonzero(may_become_negative[middle_point_index - 1])
            inadmissible_point = _find_inadmissible_point(
                task, points, int(previous_point_index + n_inserted), suspect_margin_columns
            )
            if inadmissible_point is not None:
                points = insert_row(points, previous_point_index + n_inserted + 1, inadmissible_point)
                n_inserted += 1
    return points, diagnose(problem, points.z) if n_inserted else diagnostics


def _find_inadmissible_point(task, points, previous_point_index, margin_columns):
    """Return an inadmissible `Point` between two points, or None if no such point is detected."""
    problem, lower_arclength, upper_arclength = task.args, 0.0, float(points.step[previous_point_index + 1])
    for _ in range(MAX_REFINEMENTS):
        sample_arclengths = np.linspace(lower_arclength, upper_arclength, N_PARTS + 1)[1:-1]
        sample_points = [
            point_at_length(task, points, previous_point_index, sample_arclength)
            for sample_arclength in sample_arclengths
        ]
        if any(point is None for point in sample_points):
            return None
        zs = np.stack([point.z for point in sample_points])
        diagnostics = diagnose(problem, zs)
        is_inadmissible = ~are_admissible(problem, zs, diagnostics)
        if is_inadmissible.any():
            return sample_points[int(np.argmax(is_inadmissible))]
        margins = _clearances_and_speeds(problem, zs, diagnostics)
        lowest_sample_index = int(np.argmin(margins[:, margin_columns].min(axis=1)))
        sample_spacing = (upper_arclength - lower_arclength) / N_PARTS
        lower_arclength, upper_arclength = (
            sample_arclengths[lowest_sample_index] - sample_spacing,
            sample_arclengths[lowest_sample_index] + sample_spacing,
        )
    return None


def _clearances_and_speeds(problem, zs, diagnostics):
    """Return the clearances and the impact speeds of each point, array of shape (points, clearances + impacts)."""
    speeds = zs[:, len(problem.sequence.sides) + problem.impact_rows]
    return np.concatenate([diagnostics.clearance.reshape(len(zs), -1), speeds], axis=1)

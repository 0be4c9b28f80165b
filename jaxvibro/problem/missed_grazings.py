"""Detect grazings that continuation steps over: clearances or speeds that are negative only between two points."""

import numpy as np

from continuation.intermediate_points import point_at_length
from continuation.point_rows import insert_row

from .diagnostics import diagnose
from .grazing_contact import admissible

DIP_RATIO = 0.5  # relative to the least of three values; intervals where a parabola falls below this are searched
N_PARTS = 8  # parts of an interval that is searched for a minimum
MAX_REFINEMENTS = 6  # refinements of the parts around the minimum


def insert_missed_grazings(task, points, diagnostics):
    """Insert an inadmissible point where a clearance or a speed becomes negative between two points.

    Returns the points and their `Diagnostics`. `task` is the `ContinuationTask` of a branch or a locus, whose ``args``
    are the equations.
    """
    problem = task.args
    margins = _margins(problem, points.z, diagnostics)
    with np.errstate(invalid="ignore"):
        is_positive = margins > problem.slack
        may_dip = (margins[1:-1] < margins[:-2]) & (margins[1:-1] <= margins[2:]) & is_positive[1:-1] & is_positive[2:]
        curvature = margins[:-2] - 2.0 * margins[1:-1] + margins[2:]
        predicted_minimum = margins[1:-1] - (margins[2:] - margins[:-2]) ** 2 / (
            8.0 * np.where(curvature > 0, curvature, np.inf)
        )
        may_dip &= (
            np.isfinite(margins[:-2]) & np.isfinite(margins[2:]) & (predicted_minimum < DIP_RATIO * margins[1:-1])
        )
    n_inserted = 0
    for middle_row in np.unique(np.nonzero(may_dip)[0]) + 1:
        for row_before in (middle_row - 1, middle_row):
            suspect_columns = np.flatnonzero(may_dip[middle_row - 1])
            grazing_point = _find_violation(task, points, int(row_before + n_inserted), suspect_columns)
            if grazing_point is not None:
                points = insert_row(points, row_before + n_inserted + 1, grazing_point)
                n_inserted += 1
    return points, diagnose(problem, points.z) if n_inserted else diagnostics


def _find_violation(task, points, row_before, columns):
    """Return an inadmissible `Point` between two points, None if there is none."""
    problem, lower, upper = task.args, 0.0, float(points.step[row_before + 1])
    for _ in range(MAX_REFINEMENTS):
        lengths = np.linspace(lower, upper, N_PARTS + 1)[1:-1]
        sample_points = [point_at_length(task, points, row_before, length) for length in lengths]
        if any(point is None for point in sample_points):
            return None
        zs = np.stack([point.z for point in sample_points])
        diagnostics = diagnose(problem, zs)
        is_inadmissible = ~admissible(problem, zs, diagnostics)
        if is_inadmissible.any():
            return sample_points[int(np.argmax(is_inadmissible))]
        margins = _margins(problem, zs, diagnostics)
        lowest_sample = int(np.argmin(margins[:, columns].min(axis=1)))
        cell_length = (upper - lower) / N_PARTS
        lower, upper = lengths[lowest_sample] - cell_length, lengths[lowest_sample] + cell_length
    return None


def _margins(problem, zs, diagnostics):
    """Return clearances, then speeds, array of shape (points, values)."""
    speeds = zs[:, len(problem.sequence.sides) + problem.impact_rows]
    return np.concatenate([diagnostics.clearance.reshape(len(zs), -1), speeds], axis=1)

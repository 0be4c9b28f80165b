"""Check orbits along a branch or a locus against the walls and locate their first grazing."""

import numpy as np

from continuation import event_search
from continuation.augmented_systems import PointSolution
from continuation.driver import EventDetector
from continuation.intermediate_points import point_at_length, point_from_z
from continuation.point_rows import head, insert_row, row_at

from . import soft_grazing, sticking_limits
from .diagnostics import diagnose
from .grazing_contact import GRAZING_TOLERANCE, admissible, locate_grazing, sticking_margins, zero_slow_speeds
from .missed_grazings import insert_missed_grazings

MAX_BISECTIONS = 60  # of an interval that contains a grazing


class OrbitEventDetector(EventDetector):
    """Event detector for orbits that stay between their walls and have impacts with positive speed.

    Parameters
    ----------
    equations : OrbitEquations
        Equations of the orbits, or those of a locus.
    length_scale : float
        Length of the scene.
    """

    def __init__(self, equations, length_scale):
        self.equations, self.length_scale = equations, length_scale

    def refine_points(self, task, points, diagnostics):
        return insert_missed_grazings(task, points, diagnostics)

    def diagnose(self, zs):
        return diagnose(self.equations, zs)

    def is_admissible(self, zs, diagnostics):
        return admissible(self.equations, zs, diagnostics)


def truncate_at_grazing(task, points, diagnostics, first_bad, length_scale):
    """Truncate points at the grazing before the first inadmissible point.

    Parameters
    ----------
    task : continuation.driver.ContinuationTask
        Task, whose ``args`` are the equations.
    points : continuation.arclength.Point
        Points along the curve.
    diagnostics : Diagnostics
        Their diagnostics.
    first_bad : int
        Index of the first inadmissible point.
    length_scale : float
        Length of the scene.

    Returns
    -------
    points : continuation.arclength.Point
        Admissible points, and the grazing if it is located.
    residual : float or None
        Largest residual at the grazing; None if it is not located, or the time is over.
    """
    good_point, step_length = row_at(points, first_bad - 1), float(points.step[first_bad])
    bad_point, bad_diagnostics, lower, upper = (
        row_at(points, first_bad),
        row_at(diagnostics, first_bad),
        0.0,
        step_length,
    )
    for _ in range(MAX_BISECTIONS):
        grazing = _locate_first_grazing(task, good_point, bad_point, bad_diagnostics, lower, upper, length_scale)
        if grazing is not None or task.limits.expired:
            break
        middle_point = point_at_length(task, points, first_bad - 1, 0.5 * (lower + upper))
        if middle_point is None:
            break
        middle_diagnostics = diagnose(task.args, middle_point.z[None])
        if admissible(task.args, middle_point.z, middle_diagnostics)[0]:
            lower = 0.5 * (lower + upper)
        else:
            upper, bad_point, bad_diagnostics = 0.5 * (lower + upper), middle_point, row_at(middle_diagnostics, 0)
    truncated = head(points, first_bad)
    if grazing is None:
        return truncated, None
    z, residual = grazing
    return insert_row(truncated, first_bad, point_from_z(task, points, first_bad - 1, z)), residual


def _locate_first_grazing(task, good_point, bad_point, bad_diagnostics, lower, upper, length_scale):
    """Return (z, residual) of the first grazing between two arclengths from a good point.

    None if it is not located, or if another grazing precedes it.
    """
    problem = task.args
    n_rows, impact_rows = len(problem.sequence.sides), problem.impact_rows
    middle_z = 0.5 * (good_point.z + bad_point.z)
    squared_scale, candidates = task.control.scale**2, []
    for row in impact_rows:
        if bad_point.z[n_rows + row] <= 0:
            candidates.append(_locate_zero_speed(task, middle_z, int(row), length_scale))
    if not candidates or not (bad_point.z[n_rows + impact_rows] <= 0).any():
        for row, wall in zip(*np.nonzero(bad_diagnostics.clearance < 0), strict=True):
            candidates.append(
                locate_grazing(problem, bad_point.z, row, wall, float(bad_diagnostics.turning_time[row, wall]))
            )
        candidates += _locate_sticking_ends(problem, middle_z, bad_diagnostics)
    nearest = None
    for candidate in candidates:
        if candidate.z is None:
            continue
        candidate_length = float(np.sum(squared_scale * good_point.tangent * (candidate.z - good_point.z)))
        is_between = lower - 1e-9 - 0.02 * (upper - lower) <= candidate_length <= upper + 1e-9 + 0.02 * (upper - lower)
        if is_between and (nearest is None or candidate_length < nearest[0]):
            nearest = candidate_length, candidate
    if nearest is None:
        return None
    z = zero_slow_speeds(problem, nearest[1].z, length_scale)
    diagnostics, min_clearance = diagnose(problem, z[None]), -GRAZING_TOLERANCE * length_scale
    has_earlier_grazing = (
        diagnostics.clearance.min(initial=0.0) < min_clearance
        or z[n_rows : 2 * n_rows].min(initial=0.0) < min_clearance
    )
    return None if has_earlier_grazing else (z, nearest[1].residual)


def _locate_sticking_ends(problem, z, bad_diagnostics):
    """Locate the points near z where sticking phases that no longer exist begin to exist."""
    measure_pairs = zip(
        (sticking_limits.excess_speeds, sticking_limits.min_contact_forces),
        sticking_margins(problem, bad_diagnostics),
        strict=True,
    )
    return [
        sticking_limits.locate_sticking_limit(problem, z, int(row), measure)
        for measure, values in measure_pairs
        for row in np.flatnonzero(values <= 0)
    ]


def _locate_zero_speed(task, z, row, length_scale):
    """Locate the point near z where an impact loses its speed."""
    problem = task.args
    n_rows = len(problem.sequence.sides)
    if len(z) > 2 * n_rows + 1 and soft_grazing.is_smooth_wall(
        problem.scene, problem.sequence.sides[row]
    ):  # singular, for a locus
        return soft_grazing.locate_soft_grazing(problem, z, [row], length_scale)
    point = event_search.solve_with_fixed_entry(task.problem, z, n_rows + row, 0.0, task.control, problem)
    return PointSolution(point.z if point.converged else None, float(point.residual))

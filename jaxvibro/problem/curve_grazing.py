"""Check orbits along a branch or a locus for admissibility and locate the first grazing."""

import numpy as np

from continuation import event_search
from continuation.augmented_systems import RootAndResidual
from continuation.branch_segment import SpecialIndex
from continuation.continuation_loop import EventDetector, Termination
from continuation.intermediate_points import point_at_length, point_from_z
from continuation.point_rows import first_rows, insert_row, row_at

from . import soft_wall_grazing, sticking_limits
from .end import End
from .grazing_contact import (
    GRAZING_TOLERANCE,
    are_admissible,
    locate_grazing,
    set_slow_speeds_to_zero,
)
from .missed_grazings import insert_missed_grazings
from .orbit_diagnostics import diagnose

MAX_BISECTIONS = 60  # of an interval that contains a grazing


class OrbitEventDetector(EventDetector):
    """Event detector for orbits that must stay between the walls and have impacts with positive speed.

    Parameters
    ----------
    problem : OrbitProblem
        Problem of the orbits.
    """

    def __init__(self, problem):
        self.problem = problem

    def refine_points(self, task, points, diagnostics):
        return insert_missed_grazings(task, points, diagnostics)

    def diagnose(self, zs):
        return diagnose(self.problem, zs)

    def is_admissible(self, zs, diagnostics):
        return are_admissible(self.problem, zs, diagnostics)

    def find_boundary_end(self, task, points, diagnostics, first_bad):
        """End the curve at the grazing before the first inadmissible point."""
        points, residual = truncate_at_grazing(task, points, diagnostics, first_bad)
        if residual is None:
            return None
        return Termination(points, SpecialIndex(0, self.end_kind(points.z[-1]), residual), End.GRAZE)

    def end_kind(self, z):
        """Return the kind of special point at which the orbits become inadmissible."""
        return "GR"


def truncate_at_grazing(task, points, diagnostics, first_inadmissible):
    """Truncate points at the grazing before the first inadmissible point.

    Parameters
    ----------
    task : continuation.continuation_loop.ContinuationTask
        Task whose ``args`` are the equations.
    points : continuation.arclength.Point
        Points along the curve.
    diagnostics : Diagnostics
        Diagnostics of the points.
    first_inadmissible : int
        Index of the first inadmissible point.

    Returns
    -------
    points : continuation.arclength.Point
        Admissible points, and the grazing if it is located.
    residual : float or None
        Largest residual at the grazing; None if the grazing is not located or the time limit is reached.
    """
    admissible_point, step_length = row_at(points, first_inadmissible - 1), float(points.step[first_inadmissible])
    inadmissible_point, inadmissible_diagnostics, lower_arclength, upper_arclength = (
        row_at(points, first_inadmissible),
        row_at(diagnostics, first_inadmissible),
        0.0,
        step_length,
    )
    for _ in range(MAX_BISECTIONS):
        located_grazing = _locate_first_grazing(
            task,
            admissible_point,
            inadmissible_point,
            inadmissible_diagnostics,
            lower_arclength,
            upper_arclength,
        )
        if located_grazing is not None or task.limits.expired:
            break
        middle_point = point_at_length(task, points, first_inadmissible - 1, 0.5 * (lower_arclength + upper_arclength))
        if middle_point is None:
            break
        middle_diagnostics = diagnose(task.args, middle_point.z[None])
        if are_admissible(task.args, middle_point.z, middle_diagnostics)[0]:
            lower_arclength = 0.5 * (lower_arclength + upper_arclength)
        else:
            upper_arclength, inadmissible_point, inadmissible_diagnostics = (
                0.5 * (lower_arclength + upper_arclength),
                middle_point,
                row_at(middle_diagnostics, 0),
            )
    truncated_points = first_rows(points, first_inadmissible)
    if located_grazing is None:
        return truncated_points, None
    grazing_z, residual = located_grazing
    return insert_row(
        truncated_points, first_inadmissible, point_from_z(task, points, first_inadmissible - 1, grazing_z)
    ), residual


def _locate_first_grazing(
    task, admissible_point, inadmissible_point, inadmissible_diagnostics, lower_arclength, upper_arclength
):
    """Return (z, residual) of the first grazing between two arclengths from an admissible point.

    The result is None if no grazing is located, or if another grazing precedes the located grazing.
    """
    problem = task.args
    n_rows, impact_row_indices = len(problem.sequence.sides), problem.impact_rows
    middle_z = 0.5 * (admissible_point.z + inadmissible_point.z)
    squared_weights, candidate_solutions = task.control.scale**2, []
    for row in impact_row_indices:
        if inadmissible_point.z[n_rows + row] <= 0:
            candidate_solutions.append(_locate_zero_speed(task, middle_z, int(row)))
    if not candidate_solutions or not (inadmissible_point.z[n_rows + impact_row_indices] <= 0).any():
        for row, wall_index in zip(*np.nonzero(inadmissible_diagnostics.clearance < 0), strict=True):
            candidate_solutions.append(
                locate_grazing(
                    problem,
                    inadmissible_point.z,
                    row,
                    wall_index,
                    float(inadmissible_diagnostics.turning_time[row, wall_index]),
                )
            )
        candidate_solutions += _locate_sticking_ends(problem, middle_z, inadmissible_diagnostics)
    nearest_candidate = None
    for candidate in candidate_solutions:
        if candidate.z is None:
            continue
        candidate_arclength = float(
            np.sum(squared_weights * admissible_point.tangent * (candidate.z - admissible_point.z))
        )
        is_between = (
            lower_arclength - 1e-9 - 0.02 * (upper_arclength - lower_arclength)
            <= candidate_arclength
            <= upper_arclength + 1e-9 + 0.02 * (upper_arclength - lower_arclength)
        )
        if is_between and (nearest_candidate is None or candidate_arclength < nearest_candidate[0]):
            nearest_candidate = candidate_arclength, candidate
    if nearest_candidate is None:
        return None
    grazing_z = set_slow_speeds_to_zero(problem, nearest_candidate[1].z)
    diagnostics, min_allowed_clearance = diagnose(problem, grazing_z[None]), -GRAZING_TOLERANCE * problem.length_scale
    has_earlier_grazing = (
        diagnostics.clearance.min(initial=0.0) < min_allowed_clearance
        or grazing_z[n_rows : 2 * n_rows].min(initial=0.0) < min_allowed_clearance
    )
    return None if has_earlier_grazing else (grazing_z, nearest_candidate[1].residual)


def _locate_sticking_ends(problem, z, inadmissible_diagnostics):
    """Locate the points near z at which sticking phases that are missing at the inadmissible point cease to exist."""
    functions_with_margins = zip(
        (sticking_limits.excess_speeds, sticking_limits.min_contact_forces),
        problem.condition.sticking_margins(inadmissible_diagnostics),
        strict=True,
    )
    return [
        sticking_limits.locate_sticking_limit(problem, z, int(row), row_values_of)
        for row_values_of, row_margins in functions_with_margins
        for row in np.flatnonzero(row_margins <= 0)
    ]


def _locate_zero_speed(task, z, impact_row):
    """Locate the point near z at which the speed of an impact is zero."""
    problem = task.args
    n_rows = len(problem.sequence.sides)
    if len(z) > 2 * n_rows + 1 and soft_wall_grazing.is_smooth_soft_wall(
        problem.scene, problem.sequence.sides[impact_row]
    ):  # singular, for a locus
        return soft_wall_grazing.locate_soft_grazing(problem, z, [impact_row])
    point = event_search.solve_with_fixed_entry(task.problem, z, n_rows + impact_row, 0.0, task.control, problem)
    return RootAndResidual(point.z if point.converged else None, float(point.residual))

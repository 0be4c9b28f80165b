"""Locate the degenerate grazing (DG) that ends a locus of grazings: the contact has zero speed and zero acceleration.

Beyond a DG the contact force is positive as soon as the mass reaches the wall. The mass then sticks at once, without a
grazing. Towards a DG, the acceleration at the contact vanishes, and with it the speeds and durations of the bounces
between the contact and the sticking phase. The equations with these bounces are singular at the DG. The equations
without these bounces are regular: the contact is then the last row before the release.
"""

import numpy as np

from continuation.branch_segment import SpecialIndex

from ..problem.end import End
from ..problem.grazing_contact import approach_acceleration
from ..problem.orbit_equations import are_releases, mark_impact_rows, sides_with_release_codes
from .locus_equations import GrazingCondition

MAX_HOP_SPEED = 1e-3  # in lengths of the scene per unit time: slower hops may be vanishing
END_TOLERANCE = 1e-4  # relative to 1 + |parameter|: largest distance of the point from the end


def locate_degenerate_end(segment):
    """Return the segment along a `LocusDirection` with its last point moved to the DG, or None if it ends at no DG."""
    problem = segment.args
    is_grazing = isinstance(problem.condition, GrazingCondition)
    if segment.end is not End.STEP or not is_grazing or problem.sequence.releases is None:
        return None
    z, grazing_row = np.array(segment.points.z[-1]), int(np.argmax(problem.condition.row_mask))
    vanishing_bounce_rows = _vanishing_bounce_rows(problem, z, grazing_row)
    if not vanishing_bounce_rows:
        return None
    n_rows, n_impacts = problem.n_rows, problem.n_used_rows
    remaining_rows = [row for row in range(n_impacts) if row not in vanishing_bounce_rows]
    reduced_problem, start_z = problem.with_rows(z, remaining_rows)
    reduced_grazing_row = remaining_rows.index(grazing_row)
    solution = reduced_problem.locate_zero(
        start_z, lambda z: approach_acceleration(reduced_problem, z, reduced_grazing_row)
    )
    if solution.z is None or (abs(solution.z[-2:] - z[-2:]) > END_TOLERANCE * (1.0 + abs(z[-2:]))).any():
        return None
    n_reduced_rows = len(reduced_problem.sequence.sides)
    z[remaining_rows], z[[n_rows + row for row in remaining_rows]], z[-2:] = (
        solution.z[: len(remaining_rows)],
        solution.z[n_reduced_rows : n_reduced_rows + len(remaining_rows)],
        solution.z[-2:],
    )
    z[vanishing_bounce_rows], z[[n_rows + row for row in vanishing_bounce_rows]] = solution.z[reduced_grazing_row], 0.0
    last_point_index = len(segment.points.z) - 1
    points = segment.points._replace(z=segment.points.z.copy(), residual=segment.points.residual.copy())
    points.z[last_point_index], points.residual[last_point_index] = z, solution.residual
    special_records = (
        *(special_record for special_record in segment.specials if special_record.row < last_point_index),
        SpecialIndex(last_point_index, "DG", solution.residual),
    )
    return segment._replace(points=points, specials=special_records, end=End.GRAZE)


def _vanishing_bounce_rows(problem, z, grazing_row):
    """Return the rows of the bounces between a contact and the next release, or no rows if a bounce is not slow."""
    n_rows, n_impacts = len(problem.sequence.sides), int(np.sum(problem.sequence.sides != 0))
    sides, is_impact, bounce_rows = (
        sides_with_release_codes(problem.sequence)[:n_impacts],
        mark_impact_rows(problem.sequence),
        [],
    )
    for row_offset in range(1, n_impacts):
        row = (grazing_row + row_offset) % n_impacts
        if are_releases(sides[row]):
            return bounce_rows if np.sign(sides[row]) == sides[grazing_row] else []
        if (
            not is_impact[row]
            or sides[row] != sides[grazing_row]
            or z[n_rows + row] > MAX_HOP_SPEED * problem.length_scale
        ):
            return []
        bounce_rows.append(row)
    return []

"""Locate the degenerate grazing (DG) that ends a locus of grazings: the contact has neither speed nor acceleration.

Beyond it the contact force is positive as soon as the mass reaches the wall, and the mass sticks at once, without a
grazing. Towards the point, the hops between the contact and the sticking phase lose their speed and duration with the
acceleration of the contact. The equations with these hops are singular at the point. The equations without them are
regular: the contact is then the last row before the release.
"""

import numpy as np

from continuation.branch_segment import SpecialIndex

from ..problem.end import End
from ..problem.equations import are_impacts, are_releases, side_codes
from ..problem.grazing import padded_sequence, replace_sequence
from ..problem.grazing_contact import approach_acceleration, locate_zero
from .extended_system import GrazingEquations

MAX_HOP_SPEED = 1e-3  # in lengths of the scene per unit time: slower hops may be vanishing
END_TOLERANCE = 1e-4  # relative to 1 + |parameter|: largest distance of the point from the end


def locate_degenerate_end(direction, segment):
    """Return the segment along a `LocusDirection` with its end moved to the DG that it approaches, or None."""
    problem = direction.problem
    if segment.end is not End.STEP or not isinstance(problem, GrazingEquations) or problem.sequence.releases is None:
        return None
    z, grazing_row = np.array(segment.points.z[-1]), int(np.argmax(problem.row_mask))
    vanishing_rows = _vanishing_hop_rows(problem, z, grazing_row, direction.settings.scene_length)
    if not vanishing_rows:
        return None
    n_rows, n_impacts = len(problem.sequence.sides), int(np.sum(problem.sequence.sides != 0))
    remaining_rows = [k for k in range(n_impacts) if k not in vanishing_rows]
    remaining_impacts = zip(
        z[remaining_rows],
        z[n_rows + np.array(remaining_rows)],
        side_codes(problem.sequence)[remaining_rows],
        strict=True,
    )
    reduced_problem = replace_sequence(problem, padded_sequence(problem, list(remaining_impacts)), remaining_rows)
    grazing_index = remaining_rows.index(grazing_row)
    start_z = np.concatenate([reduced_problem.sequence.times, reduced_problem.sequence.speeds, z[2 * n_rows :]])
    solution = locate_zero(reduced_problem, start_z, lambda z: approach_acceleration(reduced_problem, z, grazing_index))
    if solution.z is None or (abs(solution.z[-2:] - z[-2:]) > END_TOLERANCE * (1.0 + abs(z[-2:]))).any():
        return None
    n_reduced_rows = len(reduced_problem.sequence.sides)
    z[remaining_rows], z[[n_rows + k for k in remaining_rows]], z[-2:] = (
        solution.z[: len(remaining_rows)],
        solution.z[n_reduced_rows : n_reduced_rows + len(remaining_rows)],
        solution.z[-2:],
    )
    z[vanishing_rows], z[[n_rows + k for k in vanishing_rows]] = solution.z[grazing_index], 0.0
    last_index = len(segment.points.z) - 1
    points = segment.points._replace(z=segment.points.z.copy(), residual=segment.points.residual.copy())
    points.z[last_index], points.residual[last_index] = z, solution.residual
    special_indices = (
        *(special_index for special_index in segment.specials if special_index.row < last_index),
        SpecialIndex(last_index, "DG", solution.residual),
    )
    return segment._replace(points=points, specials=special_indices, end=End.GRAZE)


def _vanishing_hop_rows(problem, z, grazing_row, scene_length):
    """Return the rows of the hops between a contact and the next release if all are slow, else no row."""
    n_rows, n_impacts = len(problem.sequence.sides), int(np.sum(problem.sequence.sides != 0))
    sides, is_impact, hop_rows = side_codes(problem.sequence)[:n_impacts], are_impacts(problem.sequence), []
    for row_offset in range(1, n_impacts):
        k = (grazing_row + row_offset) % n_impacts
        if are_releases(sides[k]):
            return hop_rows if np.sign(sides[k]) == sides[grazing_row] else []
        if not is_impact[k] or sides[k] != sides[grazing_row] or z[n_rows + k] > MAX_HOP_SPEED * scene_length:
            return []
        hop_rows.append(k)
    return []

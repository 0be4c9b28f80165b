"""Where a locus of grazings ends in a degenerate one (DG): the touch has neither speed nor acceleration.

Beyond, the wall presses as the mass comes to it, which rests at once: nothing grazes any more. Towards the point the
hops behind the touch, by which the mass comes to rest, lose their speed and time with its acceleration, so that the
equations with them are singular there. Those without are not: the touch is the last row before the release.
"""

import numpy as np

from continuation.branch_segment import SpecialIndex

from ..problem.end import End
from ..problem.equations import are_impacts, are_releases, side_codes
from ..problem.grazing import padded_sequence, replace_sequence
from ..problem.grazing_contact import approach_acceleration, locate_zero
from .extended_system import GrazingEquations

MAX_HOP_SPEED = 1e-3  # of the scene's length per t: hops that are as slow may be about to vanish
END_TOLERANCE = 1e-4  # of 1 + abs of the parameters: so far from its end is the point


def locate_degenerate_end(direction, segment):
    """The `Stretch` along a `LocusWay` with its end put to the DG that it comes to, None where it comes to none."""
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
    """The rows of the hops between a touch and the release that follows, where all are slow; none elsewhere."""
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

"""Continue loci through grazing switchovers, at which an orbit has several grazing contacts.

Each grazing contact defines a locus, along which this contact is an impact with zero speed. The locus is admissible on
the side of the switchover on which the other contacts open. If the orbit keeps all contacts along a locus, as P100
between walls at equal distances does, this locus is continued in both directions. Otherwise each locus is admissible on
one side only. The boundary then has a corner with one-sided derivatives.
"""

import jax.numpy as jnp
import numpy as np

from ..problem.end import RESUMABLE_ENDS, End
from ..problem.orbit_equations import scene_at as at
from ..problem.orbit_point import point_of_solution
from ..problem.orbit_problem import make_orbit_problem
from ..scene import check
from ..scene.scene import replace_unchecked
from .bounce_row_reselection import reselect_bounce_rows
from .degenerate_grazing import locate_degenerate_end
from .locus_equations import GrazingCondition
from .locus_start import LocusStart, forward_locus_directions
from .locus_tracking import track_locus

MAX_PARTS = 64  # largest number of parts of a locus
SAME_GRAZING_TOLERANCE = 1e-6  # in periods: contacts closer than this coincide


def opposite_directions(locus_start, names, bounds, *step_settings):
    """Return the two opposite `LocusDirection` records of a locus at its `LocusStart`.

    Raises ArgumentError if an argument is invalid, or if the contacts of a grazing do not define two directions.
    """
    directions = forward_locus_directions(locus_start, names, bounds, *step_settings)
    if len(directions) == 1:
        return directions[0], directions[0].reverse()
    admissible_by_contact = _admissible_by_contact(directions)
    for both_ways in admissible_by_contact:
        if len(both_ways) == 2:
            return tuple(both_ways)
    one_sided_directions = sorted(
        (both_ways[0] for both_ways in admissible_by_contact if both_ways),
        key=lambda direction: direction.start.tangent[-1],
    )
    if len(one_sided_directions) < 2:
        rule = "must be a grazing whose simultaneous contacts can be continued separately"
        raise check.ArgumentError("special", rule, len(directions))
    return one_sided_directions[-1], one_sided_directions[0]


def track_across_walls(locus_start, locus_direction, step_settings, segment=None):
    """Track a locus along a `LocusDirection` and through grazing switchovers.

    `segment` is the first segment, if it is already known. `step_settings` are the last arguments of
    `opposite_directions`. Returns a list of (`LocusDirection`, segment)."""
    locus_parts, limits = [], None if locus_direction is None else locus_direction.task.limits
    while locus_direction is not None and len(locus_parts) < MAX_PARTS:
        locus_direction = locus_direction.with_limits(limits)
        segment = segment or track_locus(locus_direction)
        limits = limits.after_points(len(segment.points.z) - 1)
        if segment.end in RESUMABLE_ENDS or limits.is_reached(1):
            locus_parts.append((locus_direction, segment))
            break
        degenerate_segment = locate_degenerate_end(segment)
        segment_and_direction = (
            (degenerate_segment, None)
            if degenerate_segment
            else reselect_bounce_rows(locus_start, locus_direction, segment, step_settings)
        )
        final_segment, next_direction = segment_and_direction or (
            segment,
            _direction_beyond_touch(locus_start, locus_direction, segment, step_settings),
        )
        locus_parts.append((locus_direction, final_segment))
        locus_direction, segment = next_direction, None
    return locus_parts


def _admissible_by_contact(directions):
    """Return one list per direction, with the admissible directions among this direction and its reverse."""
    return [
        [candidate for candidate in (locus_direction, locus_direction.reverse()) if candidate.is_admissible]
        for locus_direction in directions
    ]


def _direction_beyond_touch(locus_start, locus_direction, segment, step_settings):
    """Return the `LocusDirection` of a GR of a motion without impacts, along the other wall beyond a GG.

    Returns None if the segment does not end at such a GG, or if no admissible direction along the other wall exists.
    """
    problem, names = locus_direction.problem, locus_direction.names
    if (
        segment.end is not End.GRAZE
        or not isinstance(problem.condition, GrazingCondition)
        or len(problem.impact_rows)
        or float(problem.sequence.closure_sign) < 0
    ):
        return None
    z = segment.points.z[-1]
    names_and_values = zip(names, z[-2:], strict=True)
    scene = replace_unchecked(
        locus_start.scene, {name: jnp.asarray(value, locus_start.scene.dtype) for name, value in names_and_values}
    )
    template = make_orbit_problem(scene, names[0], periods=int(problem.sequence.periods))
    free_problem, free_z = template.with_impacts(np.array([0.0, 0.0, z[-2]]), [])
    point = point_of_solution(free_problem, free_z, free_z[:2], segment.points.residual[-1])
    admissible_by_contact = _admissible_by_contact(
        forward_locus_directions(
            LocusStart("GR", names[0], scene, point), names, locus_direction.bounds, *step_settings
        )
    )
    candidates = (both_ways[0] for both_ways in admissible_by_contact if len(both_ways) == 1)
    return next(
        (
            candidate
            for candidate in candidates
            if not _is_same_grazing(candidate.problem, candidate.start.z, problem, z)
        ),
        None,
    )


def _is_same_grazing(problem, z, other_problem, other_z):
    """Check whether two motions without impacts have the same grazing contact."""
    period_shift = (z[0] - other_z[0]) * float(at(problem, z).frequency) / (2.0 * np.pi * int(problem.sequence.periods))
    return (
        problem.sequence.sides[0] == other_problem.sequence.sides[0]
        and abs(period_shift - np.round(period_shift)) < SAME_GRAZING_TOLERANCE
    )

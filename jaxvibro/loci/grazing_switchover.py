"""Continue a locus of grazings where its grazing contact, its itinerary or its bounces change.

Locate the degenerate grazing (DG) that ends a locus of grazings: the contact has zero speed and zero acceleration.
Beyond a DG the contact force is positive as soon as the mass reaches the wall. The mass then sticks at once, without a
grazing. Towards a DG, the acceleration at the contact vanishes, and with it the speeds and durations of the bounces
between the contact and the sticking phase. The equations with these bounces are singular at the DG. The equations
without these bounces are regular: the contact is then the last row before the release.

Continue a locus of sticking orbits with other bounces as rows of the equations. Before a sticking phase, the rows of
the equations are the bounces up to the first bounce after which all flights are short (`chatter_and_release`). Along a
locus the flight after this bounce may become too long. It may also become so short that the speed of the bounce and the
time until sticking both approach zero. In both cases the equations have spurious solutions nearby. Other bounces must
then become rows.

Each grazing contact defines a locus, along which this contact is an impact with zero speed. The locus is admissible on
the side of the switchover on which the other contacts open. If the orbit keeps all contacts along a locus, as P100
between walls at equal distances does, this locus is continued in both directions. Otherwise each locus is admissible on
one side only. The boundary then has a corner with one-sided derivatives.
"""

import jax.numpy as jnp
import numpy as np

from continuation.branch_segment import SpecialIndex, first_rows

from ..orbits import chatter_and_release
from ..problem.curve_ends import RESUMABLE_ENDS, End
from ..problem.grazing_contact import approach_acceleration
from ..problem.orbit_equations import are_releases, mark_impact_rows, scene_at, sides_with_release_codes
from ..problem.orbit_equations import scene_at as at
from ..problem.orbit_point import make_orbit_point, point_of_solution
from ..problem.orbit_problem import make_orbit_problem
from ..scene import check
from ..scene.scene import replace_unchecked
from .locus_equations import GrazingCondition
from .locus_start import forward_locus_directions, track_locus, whole_orbit_impacts

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


# `ChatterOutcome.hop_margin` of a hop that is nearly too long, and of one that is nearly too short
NEARLY_TOO_LONG, NEARLY_TOO_SHORT = 0.05, 0.95
STICKING_SLACK = 1e-9  # tolerance of the speed and of the contact force at the limit of a sticking phase


def reselect_bounce_rows(locus_direction, segment, step_settings):
    """Truncate a segment where its rows become unsuitable, and set up the continuation with other rows.

    `segment` was tracked along the `LocusDirection` `locus_direction`.
    `step_settings` are the last arguments of `forward_locus_directions`. Returns the truncated segment and the next
    `LocusDirection`. Returns None if the rows are suitable at the end of the segment, if the segment ends for another
    reason, or if the selection of other rows does not change their number.
    """
    problem = locus_direction.problem
    last_point_index = len(segment.points.z) - (2 if segment.end is End.GRAZE else 1)
    if problem.sequence.releases is None or segment.end not in (End.GRAZE, End.STEP) or last_point_index < 1:
        return None
    hop_margins = segment.diagnostics.hop_margin[last_point_index][
        np.isfinite(segment.diagnostics.hop_margin[last_point_index])
    ]
    if not ((hop_margins > NEARLY_TOO_SHORT) if segment.end is End.GRAZE else (hop_margins < NEARLY_TOO_LONG)).any():
        return None
    scene, orbit_point = _orbit_with_other_rows(problem, segment.points.z[last_point_index], locus_direction.names[0])
    if orbit_point.problem.n_used_rows == len(whole_orbit_impacts(problem, segment.points.z[:1])[2]):
        return None
    truncated_segment = segment._replace(
        points=first_rows(segment.points, last_point_index + 1),
        diagnostics=first_rows(segment.diagnostics, last_point_index + 1),
        specials=tuple(special_record for special_record in segment.specials if special_record.row < last_point_index),
    )
    next_direction = min(
        forward_locus_directions(
            locus_direction.kind, scene, orbit_point, locus_direction.names, locus_direction.bounds, *step_settings
        ),
        key=lambda candidate: abs(
            _limit_row_time(candidate.problem, candidate.start.z)
            - _limit_row_time(problem, segment.points.z[last_point_index])
        ),
    )
    tangent_product = np.sum(next_direction.start.tangent[-2:] * segment.points.tangent[last_point_index][-2:])
    return truncated_segment, next_direction if tangent_product > 0 else next_direction.reverse()


def _limit_row_time(problem, z):
    """Return the time of the row whose sticking phase is at its limit."""
    return z[np.argmax(problem.condition.row_mask)]


def _orbit_with_other_rows(problem, z, name):
    """Return the scene and the orbit at z with other bounces as rows."""
    scene = scene_at(problem, z)
    times, speeds, sides, periods = whole_orbit_impacts(problem, z[None])
    times, speeds = times[0], speeds[0]
    release_rows = np.flatnonzero(are_releases(sides))
    sticking_spans = [
        (np.sign(sides[release_row]), times[release_row - 1], times[release_row]) for release_row in release_rows
    ]
    impact_rows = np.setdiff1d(np.arange(len(sides)), release_rows)
    row_arrays = chatter_and_release.sticking_orbit_rows(
        scene, 0.0, times[impact_rows], speeds[impact_rows], sides[impact_rows], sticking_spans, periods, STICKING_SLACK
    )
    template, impacts = make_orbit_problem(scene, name, periods=periods), list(zip(*row_arrays, strict=True))
    return scene, make_orbit_point(template, float(scene.parameter(name)), impacts, periods)


MAX_PARTS = 64  # largest number of parts of a locus
SAME_GRAZING_TOLERANCE = 1e-6  # in periods: contacts closer than this coincide


def opposite_directions(kind, scene, orbit_point, names, bounds, *step_settings):
    """Return the two opposite `LocusDirection` records of a locus at an `OrbitPoint`.

    The arguments are those of `forward_locus_directions`. Raises ArgumentError if an argument is invalid, or if the
    contacts of a grazing do not define two directions.
    """
    directions = forward_locus_directions(kind, scene, orbit_point, names, bounds, *step_settings)
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


def track_across_walls(locus_direction, step_settings):
    """Track a locus along a `LocusDirection` and through grazing switchovers.

    `step_settings` are the last arguments of `opposite_directions`. Returns a list of (`LocusDirection`, segment)."""
    locus_parts, limits = [], None if locus_direction is None else locus_direction.task.limits
    while locus_direction is not None and len(locus_parts) < MAX_PARTS:
        locus_direction = locus_direction.with_limits(limits)
        segment = track_locus(locus_direction)
        limits = limits.after_points(len(segment.points.z) - 1)
        if segment.end in RESUMABLE_ENDS or limits.is_reached(1):
            locus_parts.append((locus_direction, segment))
            break
        degenerate_segment = locate_degenerate_end(segment)
        segment_and_direction = (
            (degenerate_segment, None)
            if degenerate_segment
            else reselect_bounce_rows(locus_direction, segment, step_settings)
        )
        final_segment, next_direction = segment_and_direction or (
            segment,
            _direction_beyond_touch(locus_direction, segment, step_settings),
        )
        locus_parts.append((locus_direction, final_segment))
        locus_direction = next_direction
    return locus_parts


def _admissible_by_contact(directions):
    """Return one list per direction, with the admissible directions among this direction and its reverse."""
    return [
        [candidate for candidate in (locus_direction, locus_direction.reverse()) if candidate.is_admissible]
        for locus_direction in directions
    ]


def _direction_beyond_touch(locus_direction, segment, step_settings):
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
    scene = locus_direction.scene
    scene = replace_unchecked(scene, {name: jnp.asarray(value, scene.dtype) for name, value in names_and_values})
    template = make_orbit_problem(scene, names[0], periods=int(problem.sequence.periods))
    free_problem, free_z = template.with_impacts(np.array([0.0, 0.0, z[-2]]), [])
    point = point_of_solution(free_problem, free_z, free_z[:2], segment.points.residual[-1])
    admissible_by_contact = _admissible_by_contact(
        forward_locus_directions("GR", scene, point, names, locus_direction.bounds, *step_settings)
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

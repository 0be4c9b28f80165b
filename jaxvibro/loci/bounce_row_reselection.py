"""Continue a locus of sticking orbits with other bounces as rows of the equations.

Before a sticking phase, the rows of the equations are the bounces up to the first bounce after which all flights are
short (`chatter_and_release`). Along a locus the flight after this bounce may become too long. It may also become so
short that the speed of the bounce and the time until sticking both approach zero. In both cases the equations have
spurious solutions nearby. Other bounces must then become rows.
"""

import numpy as np

from continuation.point_rows import first_rows

from ..orbits import chatter_and_release
from ..problem.end import End
from ..problem.orbit_equations import are_releases, scene_at
from ..problem.orbit_point import make_orbit_point
from ..problem.orbit_problem import make_orbit_problem
from .locus_start import LocusStart, forward_locus_directions, whole_orbit_impacts

# `ChatterOutcome.hop_margin` of a hop that is nearly too long, and of one that is nearly too short
NEARLY_TOO_LONG, NEARLY_TOO_SHORT = 0.05, 0.95
STICKING_SLACK = 1e-9  # tolerance of the speed and of the contact force at the limit of a sticking phase


def reselect_bounce_rows(locus_start, locus_direction, segment, step_settings):
    """Truncate a segment where its rows become unsuitable, and set up the continuation with other rows.

    `locus_start` is the `LocusStart` of the locus. `segment` was tracked along the `LocusDirection` `locus_direction`.
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
    new_start = _start_with_other_rows(
        problem, segment.points.z[last_point_index], locus_start, locus_direction.names[0]
    )
    if new_start.point.problem.n_used_rows == len(whole_orbit_impacts(problem, segment.points.z[:1])[2]):
        return None
    truncated_segment = segment._replace(
        points=first_rows(segment.points, last_point_index + 1),
        diagnostics=first_rows(segment.diagnostics, last_point_index + 1),
        specials=tuple(special_record for special_record in segment.specials if special_record.row < last_point_index),
    )
    next_direction = min(
        forward_locus_directions(new_start, locus_direction.names, locus_direction.bounds, *step_settings),
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


def _start_with_other_rows(problem, z, locus_start, name):
    """Return the `LocusStart` of the orbit at z with other bounces as rows."""
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
    point = make_orbit_point(template, float(scene.parameter(name)), impacts, periods)
    return LocusStart(locus_start.kind, name, scene, point)

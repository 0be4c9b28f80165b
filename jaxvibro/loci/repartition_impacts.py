"""Continue a locus of sticking orbits with another partition of the hops before a release.

The rows of the equations are the hops up to the first from which all hops are short (`chatter_and_release`). Along a
locus this hop may become too long, or so short that its speed vanishes with the remaining time. Near these points the
equations have spurious solutions.
"""

import numpy as np

from continuation.point_rows import head

from ..orbits import chatter_and_release
from ..problem.end import End
from ..problem.equations import are_releases, scene_at
from ..problem.orbit_point import OrbitPoint
from .locus_start import LocusStart, locus_directions, reverse_direction, whole_orbit_impacts

# `ChatterOutcome.hop_margin` of a hop that is nearly too long, and of one that is nearly too short
NEARLY_TOO_LONG, NEARLY_TOO_SHORT = 0.05, 0.95
STICKING_SLACK = 1e-9  # tolerance of the speed and of the contact force at the limit of a sticking phase


def repartition_impacts(start, direction, segment, step_settings):
    """Split a segment at the point up to which its rows are suitable, and set up the continuation with other rows.

    `start` is the `LocusStart`, `direction` a `LocusDirection` with the `segment` that was tracked along it, and
    `step_settings` the arguments of `locus_directions`. Returns the truncated segment and the next `LocusDirection`, or
    None if the rows are suitable up to the end.
    """
    problem = direction.problem
    last_index = len(segment.points.z) - (2 if segment.end is End.GRAZE else 1)
    if problem.sequence.releases is None or segment.end not in (End.GRAZE, End.STEP) or last_index < 1:
        return None
    hop_margins = segment.diagnostics.hop_margin[last_index][np.isfinite(segment.diagnostics.hop_margin[last_index])]
    if not ((hop_margins > NEARLY_TOO_SHORT) if segment.end is End.GRAZE else (hop_margins < NEARLY_TOO_LONG)).any():
        return None
    new_start = _repartitioned_start(problem, segment.points.z[last_index], start, direction.settings.names[0])
    if len(new_start.orbit_row.times) == len(whole_orbit_impacts(problem, segment.points.z[:1])[2]):
        return None
    truncated_segment = segment._replace(
        points=head(segment.points, last_index + 1),
        diagnostics=head(segment.diagnostics, last_index + 1),
        specials=tuple(special_index for special_index in segment.specials if special_index.row < last_index),
    )
    next_direction = min(
        locus_directions(new_start, direction.settings.names, direction.settings.bounds, *step_settings),
        key=lambda candidate: abs(
            _row_time(candidate.problem, candidate.start.z) - _row_time(problem, segment.points.z[last_index])
        ),
    )
    tangent_product = np.sum(next_direction.start.tangent[-2:] * segment.points.tangent[last_index][-2:])
    return truncated_segment, next_direction if tangent_product > 0 else reverse_direction(next_direction)


def _row_time(problem, z):
    """Return the time of the row at the limit of its sticking phase."""
    return z[np.argmax(problem.row_mask)]


def _repartitioned_start(problem, z, start, name):
    """Return the `LocusStart` of the orbit at z with other hops as rows."""
    scene = scene_at(problem, z)
    times, speeds, sides, periods = whole_orbit_impacts(problem, z[None])
    times, speeds = times[0], speeds[0]
    release_rows = np.flatnonzero(are_releases(sides))
    sticking_spans = [(np.sign(sides[k]), times[k - 1], times[k]) for k in release_rows]
    impact_rows = np.setdiff1d(np.arange(len(sides)), release_rows)
    row_columns = chatter_and_release.sticking_orbit_rows(
        scene, 0.0, times[impact_rows], speeds[impact_rows], sides[impact_rows], sticking_spans, periods, STICKING_SLACK
    )
    orbit_row = OrbitPoint(float(scene.parameter(name)), *row_columns, periods, np.nan, np.nan, 0.0)
    return LocusStart(start.kind, name, scene, orbit_row)

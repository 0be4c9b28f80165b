"""On along a locus of orbits that rest where other hops before a release are the better rows of the equations.

Rows are the hops up to one from which on all are short (`chatter_and_release`). Along a locus that one's hop comes to
be too long, or so short that its speed goes to zero with the time that is left: next to there the equations have false
solutions."""

import numpy as np

from continuation.point_rows import head

from ..orbits import chatter_and_release
from ..problem.end import End
from ..problem.equations import are_releases, scene_at
from ..problem.orbit_point import OrbitPoint
from .locus_start import LocusStart, locus_directions, reverse_direction, whole_orbit_impacts

NEARLY_TOO_LONG, NEARLY_TOO_SHORT = (
    0.05,
    0.95,
)  # `releases.Tails.plain` of a hop that is about to be too long, of one that is too short
STICKING_SLACK = 1e-9  # of its speed, and of the press: so nearly a rest is one


def repartition_impacts(start, direction, segment, step_settings):
    """(the `Stretch` up to where its rows were good, the `track.LocusWay` on from there with others); None where they
    are good to its end. start: the `LocusStart`; direction, segment: a `LocusWay` and what was tracked along it;
    step_settings: as of `first_point.ways`."""
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
    """The time of the row that the locus is of."""
    return z[np.argmax(problem.row_mask)]


def _repartitioned_start(problem, z, start, name):
    """The `LocusStart` of the orbit at z with other hops as rows."""
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

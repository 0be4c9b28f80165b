"""On along a locus of orbits that rest where other hops before a release are the better rows of the equations.

Rows are the hops up to one from which on all are short (`releases`). Along a locus that one's hop comes to be too long,
or so short that its speed goes to zero with the time that is left: next to there the equations have false solutions.
"""

import numpy as np

from continuation.rows import upto

from ..orbits import releases
from ..problem.end import End
from ..problem.equations import are_releases, there
from ..problem.orbit_on_branch import OrbitPoint
from .first_point import LocusStart, backward, impacts_of, ways

LONG, SHORT = 0.05, 0.95  # `releases.Tails.plain` of a hop that is about to be too long, of one that is too short
SLACK = 1e-9  # of its speed, and of the press: so nearly a rest is one


def cut_anew(start, way, one, steps):
    """(the `Stretch` up to where its rows were good, the `track.LocusWay` on from there with others); None where they
    are good to its end. start: the `LocusStart`; way, one: a `LocusWay` and what was tracked along it; steps: as of
    `first_point.ways`."""
    curve = way.curve
    last = len(one.points.z) - (2 if one.end is End.GRAZE else 1)
    if curve.cycle.releases is None or one.end not in (End.GRAZE, End.STEP) or last < 1:
        return None
    plain = one.view.plain[last][np.isfinite(one.view.plain[last])]
    if not ((plain > SHORT) if one.end is End.GRAZE else (plain < LONG)).any():
        return None
    again = _recut(curve, one.points.z[last], start, way.asked.names[0])
    if len(again.spot.times) == len(impacts_of(curve, one.points.z[:1])[2]):
        return None
    kept = one._replace(
        points=upto(one.points, last + 1),
        view=upto(one.view, last + 1),
        marks=tuple(mark for mark in one.marks if mark.place < last),
    )
    new = min(
        ways(again, way.asked.names, way.asked.bounds, *steps),
        key=lambda each: abs(_place(each.curve, each.start.z) - _place(curve, one.points.z[last])),
    )
    ahead = np.sum(new.start.tangent[-2:] * one.points.tangent[last][-2:])
    return kept, new if ahead > 0 else backward(new)


def _place(curve, z):
    """The time of the row that the locus is of."""
    return z[np.argmax(curve.pick)]


def _recut(curve, z, start, name):
    """The `LocusStart` of the orbit at z with other hops as rows."""
    scene = there(curve, z)
    times, speeds, sides, periods = impacts_of(curve, z[None])
    times, speeds = times[0], speeds[0]
    free = np.flatnonzero(are_releases(sides))
    spans = [(np.sign(sides[k]), times[k - 1], times[k]) for k in free]
    hits = np.setdiff1d(np.arange(len(sides)), free)
    rows = releases.rows_of(scene, 0.0, times[hits], speeds[hits], sides[hits], spans, periods, SLACK)
    spot = OrbitPoint(float(scene.parameter(name)), *rows, periods, np.nan, np.nan, 0.0)
    return LocusStart(start.kind, name, scene, spot)

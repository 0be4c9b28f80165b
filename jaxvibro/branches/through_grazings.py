"""From piece to piece along a branch: at each grazing it is decided what goes on."""

import warnings
from typing import NamedTuple

import numpy as np

from continuation.slow_progress import SlowProgress
from continuation.stretch import Mark, Stretch

from ..orbits.orbit_comparison import is_same_orbit
from ..problem.end import End, Reason
from ..problem.equations import codes
from ..problem.same_orbit import impacts, is_repeated
from ..problem.touches import scales
from .segment import GrazingPoint, follow_itinerary
from .through_rests import SLOW, completed, cut_anew, is_chatter

MOST = 200  # pieces of a branch
CROWD, CROWDED = 16, 1e-5  # grazings in a row, and 1 + abs of the parameter: as many within as little are slow progress
SLOWER = 1e-2  # of the scene's length per t: where nothing goes on, as slow an impact tells of a chatter
SAME, NEAR = 1e-7, 1e-6  # two grazings with values and impacts as near are one


class OneWay(NamedTuple):
    """The pieces of a branch in one direction, and why it ends."""

    pieces: list[Stretch]
    reason: Reason


def go_on(along, start, asked):
    """The `OneWay` from a `Point`, whose tangent leads away."""
    pieces, met, rest = [], [], ()
    while True:
        scale = scales(along, asked.length)
        one = follow_itinerary(along, start, asked._replace(control=asked.control._replace(scale=scale)))
        one = one._replace(marks=(*rest, *one.marks))
        way, rest = None, ()
        asked = asked._replace(limits=asked.limits.after(len(one.points.z)))
        if one.end is End.GRAZE and asked.limits.reached(1):
            one = one._replace(end=End.MAX_SECONDS if asked.limits.expired else End.MAX_POINTS)
        if one.end is End.GRAZE:
            one, way = _onwards(along, one, scale)
            here = one.points.z[-1, -1], impacts(along, one.points.z[-1], asked.length)
            if any(_is_met(here, each) for each in met):
                one, way = one._replace(end=End.CLOSED), None
            elif is_repeated(along, one.points.z[-1]):
                one, way = one._replace(end=End.HALVED), None
            elif one.marks[-1].kind == "GR" and _is_slow(along, one, asked.length, SLOW if way else SLOWER):
                z, sign = one.points.z[-1], np.sign(one.points.tangent[-1, -1])
                found = completed(along, z, sign, asked.length, asked.limits)
                if found is None and asked.limits.expired:
                    one, way = one._replace(end=End.MAX_SECONDS), None
                else:
                    one, way, rest = _into_rest(one, found, way is not None)
            met.append(here)
        if one.end is End.STEP:
            way = cut_anew(along, one.points.z[-1], np.sign(one.points.tangent[-1, -1]), asked.length)
        if len(pieces) == MOST - 1 and way is not None:
            one, way = one._replace(end=End.POINTS), None
        pieces.append(one)
        _warn_if_slow(pieces)
        if way is None:
            return OneWay(pieces, _reason(one))
        along, start = way.along, way.point


def _warn_if_slow(pieces):
    """Warn where many grazings in a row lie at nearly one value of the parameter."""
    values = np.array([one.points.z[-1, -1] for one in pieces[-CROWD:]])
    if len(pieces) % CROWD == 0 and np.ptp(values) < CROWDED * (1.0 + abs(values[-1])):
        warnings.warn(
            f"slow progress: {CROWD} grazings lie within {np.ptp(values):.1e} of the parameter value {values[-1]:.12g},"
            " as towards a complete chatter; set max_points or max_seconds, or narrow the bounds",
            SlowProgress,
            stacklevel=2,
        )


def _onwards(along, one, scale):
    """(the piece, its last mark telling which exits are left aside; the `GrazingExit` by which the branch goes on).

    It goes on with the touches' impacts exchanged, those it had for those it had not, else as many of them as can be;
    the exit is None where there is none.
    """
    mark, met = one.marks[-1], one.marks[-1].more
    here = tuple(touch.own for touch in met.touches)
    arrived, rows = one.points.tangent[-1], codes(along.cycle)

    def is_back(way):
        same = way.included == here and np.array_equal(codes(way.along.cycle), rows)
        return same and np.sum(scale * scale * way.point.tangent * arrived) < 0

    def exchanged(way):
        forward = way.included == here
        return forward, sum(a != b for a, b in zip(way.included, here, strict=True))

    chosen = max((way for way in met.exits if not is_back(way)), key=exchanged, default=None)
    aside = tuple(not (way is chosen or is_back(way)) for way in met.exits)
    marks = (*one.marks[:-1], mark._replace(more=met._replace(aside=aside)))
    end = one.end if chosen or met.sure else End.STEP
    return one._replace(marks=marks, end=End.UNSETTLED if not chosen and mark.kind != "GR" else end), chosen


def _into_rest(one, found, chatters):
    """(the piece, the `GrazingExit` by which the branch goes on, the marks at its start) where it comes near a CH;
    found: what `completed` gives."""
    if found is None:
        return one._replace(end=End.CHATTER if chatters else one.end), None, ()
    way, residual = found
    return one, way, (Mark(0, "CH", residual, GrazingPoint((), (way,), True, (False,))),)


def _is_slow(along, one, length, slow):
    """Whether at the grazing at the end of a piece an impact besides its touches is slower than that."""
    return is_chatter(along, one.points.z[-1], length, one.marks[-1].more.touches, slow)


def _is_met(here, other):
    """Whether two grazings, (value, impacts) each, are one."""
    return abs(here[0] - other[0]) < SAME and is_same_orbit(here[1], other[1], NEAR)


def _reason(one):
    kind = one.marks[-1].kind if one.marks else ""
    return one.end.reason(one.points.z[-1, -1], kind)

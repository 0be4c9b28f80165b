"""From piece to piece along a branch: at each grazing it is decided what goes on."""

from typing import NamedTuple

import numpy as np

from continuation.stretch import Stretch

from ..orbits.orbit_comparison import is_same_orbit
from ..problem.end import End, Reason
from ..problem.same_orbit import impacts, is_repeated
from ..problem.touches import scales
from .segment import follow_itinerary

MOST = 200  # pieces of a branch
SAME, NEAR = 1e-7, 1e-6  # two grazings with values and impacts as near are one
SLOW = 1e-4  # of the scene's length per t: below, the flights between impacts are lost in rounding


class OneWay(NamedTuple):
    """The pieces of a branch in one direction, and why it ends."""

    pieces: list[Stretch]
    reason: Reason


def go_on(along, start, asked):
    """The `OneWay` from a `Point`, whose tangent leads away."""
    pieces, met = [], []
    while True:
        scale = scales(along, asked.length)
        one = follow_itinerary(along, start, asked._replace(control=asked.control._replace(scale=scale)))
        way = None
        if one.end is End.GRAZE:
            one, way = _onwards(one, scale)
            here = one.points.z[-1, -1], impacts(along, one.points.z[-1], asked.length)
            if any(_is_met(here, each) for each in met):
                one, way = one._replace(end=End.CLOSED), None
            elif is_repeated(along, one.points.z[-1]):
                one, way = one._replace(end=End.HALVED), None
            elif _is_chatter(along, one.points.z[-1], asked.length, one.marks[-1].more.touches):
                one, way = one._replace(end=End.CHATTER), None
            met.append(here)
        if len(pieces) == MOST - 1 and way is not None:
            one, way = one._replace(end=End.POINTS), None
        pieces.append(one)
        if way is None:
            return OneWay(pieces, _reason(one))
        along, start = way.along, way.point


def _onwards(one, scale):
    """(the piece, its last mark telling which exits are left aside; the `GrazingExit` by which the branch goes on).

    It goes on with the touches' impacts exchanged, those it had for those it had not, else as many of them as can be;
    the exit is None where there is none.
    """
    mark, met = one.marks[-1], one.marks[-1].more
    here = tuple(touch.own for touch in met.touches)
    arrived = one.points.tangent[-1]

    def is_back(way):
        same = way.included == here and way.point.tangent.shape == arrived.shape
        return same and np.sum(scale * scale * way.point.tangent * arrived) < 0

    def exchanged(way):
        forward = way.included == here
        return forward, sum(a != b for a, b in zip(way.included, here, strict=True))

    chosen = max((way for way in met.exits if not is_back(way)), key=exchanged, default=None)
    aside = tuple(not (way is chosen or is_back(way)) for way in met.exits)
    marks = (*one.marks[:-1], mark._replace(more=met._replace(aside=aside)))
    return one._replace(marks=marks, end=one.end if chosen or met.sure else End.STEP), chosen


def _is_chatter(along, z, length, touches):
    """Whether at a grazing with these `Touch`es yet another impact is very slow."""
    known = [touch.row for touch in touches if touch.own]
    speeds = z[len(along.cycle.sides) :][np.setdiff1d(along.hits, known)]
    return bool(((speeds > 0) & (speeds < SLOW * length)).any())


def _is_met(here, other):
    """Whether two grazings, (value, impacts) each, are one."""
    return abs(here[0] - other[0]) < SAME and is_same_orbit(here[1], other[1], NEAR)


def _reason(one):
    kind = one.marks[-1].kind if one.marks else ""
    return one.end.reason(one.points.z[-1, -1], kind)

"""A locus in one direction: steps along it up to where its bounds, its walls or its start end it."""

from typing import NamedTuple

import numpy as np

from continuation import follow
from continuation.arclength import ON, Control, Place, Point

from .along import problem
from .codim import events
from .curve import Grazing
from .dips import with_dips
from .graze import admissible
from .look import Look, looked
from .piece import (
    BOUND,
    CLOSED,
    DOMAIN,
    ENDS,
    GRAZE,
    MOST,
    POINTS,
    STEP,
    Mark,
    cut_at,
    inserted,
    listed,
    to_touch,
    to_value,
)
from .rows import joined

REASONS = {
    BOUND: "{name} reached its bound {value:.12g}",
    DOMAIN: "the domain of {name} ends at {value:.12g}",
    CLOSED: "it closes: the locus came back to its start",
    STEP: "the step became too small: Newton's method does not converge there",
    GRAZE: "an impact loses its speed there, or a flight touches a wall",
    POINTS: "it has too many points",
}


class Bounded(NamedTuple):
    """What a locus is asked for. control: of steps, with the second parameter's bounds; first: the first step; names;
    box: (low, high) of each parameter; domain: the same by their meaning; length: the scene's."""

    control: Control
    first: float
    names: tuple[str, str]
    box: tuple
    domain: tuple
    length: float


class Tracked(NamedTuple):
    """points, look: a row a point; marks: the special ones; reason: why it ends; why: the same, one of `piece`'s."""

    points: Point
    look: Look
    marks: tuple[Mark, ...]
    reason: str
    why: int


def tracked(curve, start, asked):
    """The `Tracked` from a `Point`, whose tangent leads away."""
    place = Place(start.z, start.tangent, np.float64(asked.first), np.int32(ON))
    parts, marks, count = [], [], 0
    for points, status in follow.stretches(problem(curve), place, asked.control, curve):
        points, look, met, end = _part(curve, points, status, asked, start.z)
        marks += [one._replace(place=one.place + count) for one in met]
        parts.append((points, look))
        count += len(points.z) - 1
        if end is not None or count > MOST:
            break
    points, look = (joined(list(each)) for each in zip(*parts, strict=True))
    why, name, value = end or (POINTS, "", 0.0)
    return Tracked(points, look, tuple(marks), REASONS.get(why, REASONS[STEP]).format(name=name, value=value), why)


def _part(curve, points, status, asked, begun):
    """(points, `Look`, `Mark`s, (why, name, value) or None) of a chunk of steps, cut at its end."""
    points, end = _within(curve, points, status, asked)
    points, look = with_dips(curve, points, looked(curve, points.z), asked.control)
    good = admissible(curve, points.z, look)
    good[0] = True
    last = []
    if not good.all():
        points, residual = to_touch(curve, points, look, int(np.argmin(good)), asked)
        end = STEP if residual is None else GRAZE, "", 0.0
        last = [] if residual is None else [Mark(0, "GG" if isinstance(curve, Grazing) else "GR", residual)]
    loop = follow.passes_mark(problem(curve), points, [begun], asked.control, curve)
    if loop is not None:
        points, last, end = cut_at(curve, points, *loop, asked.control), [], (CLOSED, "", 0.0)
    points, marks = inserted(curve, points, listed(events(curve, points, asked.control)), asked.control)
    marks += [one._replace(place=len(points.z) - 1) for one in last]
    return points, looked(curve, points.z), marks, end


def _within(curve, points, status, asked):
    """(the points up to the first bound, (why, name, value) or None)."""
    end = None if status == ON else (ENDS[status], "", 0.0)
    for k in (-2, -1):
        low, high = asked.box[k]
        outside = (points.z[:, k] < low) | (points.z[:, k] > high)
        outside[0] = False
        if outside.any():
            last = int(np.argmax(outside))
            value = low if points.z[last, k] < low else high
            points, there = to_value(curve, points, last, k, value, asked)
            why = (DOMAIN if value in asked.domain[k] else BOUND) if there else STEP
            end = why, asked.names[k], value
    return points, end

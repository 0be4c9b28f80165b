"""A locus in one direction: steps along it up to where its bounds, its walls or its start end it."""

from typing import NamedTuple

import numpy as np

from continuation import follow, locate
from continuation.arclength import ON, Control, Place, Point

from ..branches.segment import ENDS, MOST, Mark, cut_at, inserted, listed, to_touch, to_value
from ..problem.diagnostics import Look, looked
from ..problem.end import End
from ..problem.equations import problem
from ..problem.missed_touches import with_dips
from ..problem.points import joined
from ..problem.touches import admissible
from .codim2 import events
from .extended_system import Grazing, Singular

REASONS = {
    End.BOUND: "{name} reached its bound {value:.12g}",
    End.DOMAIN: "the domain of {name} ends at {value:.12g}",
    End.CLOSED: "it closes: the locus came back to its start",
    End.STEP: "the step became too small: Newton's method does not converge there",
    End.GRAZE: "an impact loses its speed there, or a flight touches a wall",
    End.POINTS: "it has too many points",
}


class Bounded(NamedTuple):
    """What a locus is asked for. control: of steps, with the second parameter's bounds; first: the first step; names;
    bounds: (low, high) of each parameter by name; box: the same within their domains; domain: the ends of these that
    no bound is; length: the scene's."""

    control: Control
    first: float
    names: tuple[str, str]
    bounds: dict
    box: tuple
    domain: tuple
    length: float


class Way(NamedTuple):
    """A locus in one direction, to be tracked. curve: its equations; start: a `Point` whose tangent leads away."""

    curve: Grazing | Singular
    start: Point
    asked: Bounded


class Tracked(NamedTuple):
    """points, look: a row a point; marks: the special ones; reason: why it ends; why: the same, an `End`."""

    points: Point
    look: Look
    marks: tuple[Mark, ...]
    reason: str
    why: End


class _Part(NamedTuple):
    """A chunk of steps, cut at its end. end: (why, name, value), None where it goes on."""

    points: Point
    look: Look
    marks: list[Mark]
    end: tuple | None


def tracked(curve, start, asked):
    """The `Tracked` from a `Point`, whose tangent leads away."""
    parts = []
    for points, status in follow.stretches(problem(curve), _place(start, asked), asked.control, curve):
        parts.append(_part(curve, points, status, asked, start.z))
        if _is_over(parts):
            break
    return _joined(parts)


def together(ways):
    """The `Tracked` of each of some `Way`s, those of one kind and size as the lanes of one compiled call."""
    groups, found = {}, {}
    for place, way in enumerate(ways):
        groups.setdefault((problem(way.curve), len(way.start.z)), []).append(place)
    for (task, _), places in groups.items():
        found |= zip(places, _side_by_side(task, [ways[place] for place in places]), strict=True)
    return [found[place] for place in range(len(ways))]


def _side_by_side(task, ways):
    parts = [[] for _ in ways]

    def goes_on(lane, points, status):
        curve, start, asked = ways[lane]
        parts[lane].append(_part(curve, points, status, asked, start.z))
        return not _is_over(parts[lane])

    places = [_place(one.start, one.asked) for one in ways]
    follow.together(task, places, [one.asked.control for one in ways], [one.curve for one in ways], goes_on)
    return [_joined(each) for each in parts]


def _place(start, asked):
    return Place(start.z, start.tangent, np.float64(asked.first), np.int32(ON))


def _is_over(parts):
    return parts[-1].end is not None or sum(len(one.points.z) - 1 for one in parts) > MOST


def _joined(parts):
    """The `Tracked` of chunks of steps."""
    marks, count = [], 0
    for one in parts:
        marks += [each._replace(place=each.place + count) for each in one.marks]
        count += len(one.points.z) - 1
    points, look = joined([one.points for one in parts]), joined([one.look for one in parts])
    why, name, value = parts[-1].end or (End.POINTS, "", 0.0)
    return Tracked(points, look, tuple(marks), REASONS.get(why, REASONS[End.STEP]).format(name=name, value=value), why)


def _part(curve, points, status, asked, begun):
    """The `_Part` of a chunk of steps."""
    points, end = _within(curve, points, status, asked)
    points = points._replace(residual=_left(curve, points, asked.control.tolerance))
    points, look = with_dips(curve, points, looked(curve, points.z), asked.control)
    seen = points
    good = admissible(curve, points.z, look)
    good[0] = True
    last = []
    if not good.all():
        points, residual = to_touch(curve, points, look, int(np.argmin(good)), asked)
        end = End.STEP if residual is None else End.GRAZE, "", 0.0
        last = [] if residual is None else [Mark(0, "GG" if isinstance(curve, Grazing) else "GR", residual)]
    loop = follow.passes_mark(problem(curve), points, [begun], asked.control, curve)
    if loop is not None:
        points, last, end = cut_at(curve, points, *loop, asked.control), [], (End.CLOSED, "", 0.0)
    look, seen = look if points is seen else looked(curve, points.z), points
    points, marks = inserted(curve, points, listed(events(curve, points, look, asked.control)), asked.control)
    marks += [one._replace(place=len(points.z) - 1) for one in last]
    return _Part(points, look if points is seen else looked(curve, points.z), marks, end)


def _left(curve, points, tolerance):
    """The residual of each point: the error before Newton's last step, but where that is large the one after it."""
    left = points.residual.copy()
    for k in np.flatnonzero(left > tolerance * (1.0 + abs(points.z[:, -2:]).max(axis=1))):
        left[k] = abs(np.asarray(locate.evaluated(problem(curve), points.z[k], curve)[0])).max()
    return left


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
            why = (End.DOMAIN if value in asked.domain[k] else End.BOUND) if there else End.STEP
            end = why, asked.names[k], value
    return points, end

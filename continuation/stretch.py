"""A stretch of a branch, with its special points and why it ends; turned, and put to another."""

from enum import Enum
from typing import Any, NamedTuple

from .arclength import Point
from .rows import joined, turned


class Mark(NamedTuple):
    """A special point among those of a branch: its place there, kind, the largest error left in its equations; more:
    what a `driver.Watch` knows of it."""

    place: int
    kind: str
    residual: float
    more: Any = None


class Stretch(NamedTuple):
    """args: of the equations its points solve; points, view: a row a point, and what a `driver.Watch` knows of each;
    marks: the special ones, in order; end: why it ends, None where it goes on; which: the place in the box of the
    parameter that ended it, value: where."""

    args: Any
    points: Point
    view: Any
    marks: tuple[Mark, ...]
    end: Enum | None
    which: int
    value: float


def backwards(one):
    """The `Stretch` from its end to its start."""
    last = len(one.points.z) - 1
    marks = tuple(each._replace(place=last - each.place) for each in reversed(one.marks))
    points = turned(one.points)
    return one._replace(points=points._replace(tangent=-points.tangent), view=turned(one.view), marks=marks)


def glued(parts):
    """`Stretch`es of the same equations as one, each beginning where that before it ends."""
    marks, first = [], 0
    for one in parts:
        marks += [each._replace(place=each.place + first) for each in one.marks]
        first += len(one.points.z) - 1
    points, view = joined([one.points for one in parts]), joined([one.view for one in parts])
    return parts[-1]._replace(points=points, view=view, marks=tuple(marks))

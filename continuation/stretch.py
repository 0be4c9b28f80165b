"""A stretch of a branch, with its special points and why it ends; turned, and put to another."""

from enum import Enum
from typing import Any, NamedTuple

from .arclength import Point
from .points import joined, turned


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


def glued(one, other):
    """Two `Stretch`es of the same equations as one, the second beginning where the first ends."""
    last = len(one.points.z) - 1
    marks = (*one.marks, *(each._replace(place=each.place + last) for each in other.marks))
    points, view = joined([one.points, other.points]), joined([one.view, other.view])
    return other._replace(points=points, view=view, marks=marks)

"""A stretch of a branch, with its special points and why it ends; turned, and put to another."""

from enum import Enum
from typing import Any, NamedTuple

from .arclength import Point
from .point_rows import join_rows, reverse_rows


class SpecialIndex(NamedTuple):
    """A special point among those of a branch: its place there, kind, the largest error left in its equations; more:
    what a `driver.Watch` knows of it."""

    row: int
    kind: str
    residual: float
    details: Any = None


class BranchSegment(NamedTuple):
    """args: of the equations its points solve; points, diagnostics: a row a point, and what a `driver.Watch` knows of
    each; specials: the special ones, in order; end: why it ends, None where it goes on; end_param_index: the place in
    the box of the parameter that ended it, end_value: where."""

    args: Any
    points: Point
    diagnostics: Any
    specials: tuple[SpecialIndex, ...]
    end: Enum | None
    end_param_index: int
    end_value: float


def reverse_segment(segment):
    """The `BranchSegment` from its end to its start."""
    last_row = len(segment.points.z) - 1
    specials = tuple(special._replace(row=last_row - special.row) for special in reversed(segment.specials))
    points = reverse_rows(segment.points)
    return segment._replace(
        points=points._replace(tangent=-points.tangent),
        diagnostics=reverse_rows(segment.diagnostics),
        specials=specials,
    )


def join_segments(segments):
    """`BranchSegment`es of the same equations as one, each beginning where that before it ends."""
    specials, first_row = [], 0
    for segment in segments:
        specials += [special._replace(row=special.row + first_row) for special in segment.specials]
        first_row += len(segment.points.z) - 1
    points, diagnostics = (
        join_rows([segment.points for segment in segments]),
        join_rows([segment.diagnostics for segment in segments]),
    )
    return segments[-1]._replace(points=points, diagnostics=diagnostics, specials=tuple(specials))

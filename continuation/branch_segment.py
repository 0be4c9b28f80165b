"""Define a segment of a branch with its special points and termination reason; reverse and join segments."""

from enum import Enum
from typing import Any, NamedTuple

from .arclength import Point
from .point_rows import join_rows, reverse_rows


class SpecialIndex(NamedTuple):
    """Index of a special point in a segment.

    Attributes
    ----------
    row : int
        Row of the point.
    kind : str
        Kind of special point.
    residual : float
        Largest residual of its equations.
    details : Any
        Further result of the `driver.EventDetector`.
    """

    row: int
    kind: str
    residual: float
    details: Any = None


class BranchSegment(NamedTuple):
    """Segment of a branch.

    Attributes
    ----------
    args : Any
        Further argument of the equations of its points.
    points : Point
        Points, one row each.
    diagnostics : Any
        Diagnostics of the `driver.EventDetector`, one row per point.
    specials : tuple of SpecialIndex
        Special points in order.
    end : Enum or None
        Termination reason; None if the branch continues.
    end_param_index : int
        Index in the bounds of the parameter that ends the branch.
    end_value : float
        Value of this parameter at the end.
    """

    args: Any
    points: Point
    diagnostics: Any
    specials: tuple[SpecialIndex, ...]
    end: Enum | None
    end_param_index: int
    end_value: float


def reverse_segment(segment):
    """Reverse a `BranchSegment`."""
    last_row = len(segment.points.z) - 1
    specials = tuple(special._replace(row=last_row - special.row) for special in reversed(segment.specials))
    points = reverse_rows(segment.points)
    return segment._replace(
        points=points._replace(tangent=-points.tangent),
        diagnostics=reverse_rows(segment.diagnostics),
        specials=specials,
    )


def join_segments(segments):
    """Join `BranchSegment` objects of the same equations, each of which begins at the end of the previous one."""
    specials, first_row = [], 0
    for segment in segments:
        specials += [special._replace(row=special.row + first_row) for special in segment.specials]
        first_row += len(segment.points.z) - 1
    points, diagnostics = (
        join_rows([segment.points for segment in segments]),
        join_rows([segment.diagnostics for segment in segments]),
    )
    return segments[-1]._replace(points=points, diagnostics=diagnostics, specials=tuple(specials))

"""Define, reverse and join segments of branches, with their special points and termination reasons."""

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
        Largest residual of the equations of the point.
    detector_details : Any
        Additional result of the `continuation_loop.EventDetector` for this point.
    """

    row: int
    kind: str
    residual: float
    detector_details: Any = None


class BranchSegment(NamedTuple):
    """Segment of a branch.

    Attributes
    ----------
    args : Any
        Further argument of the equations.
    points : Point
        Points, one row each.
    diagnostics : Any
        Diagnostics of the `continuation_loop.EventDetector`, one row per point.
    specials : tuple of SpecialIndex
        Special points in order.
    end : Enum or None
        Termination reason; None if the branch continues.
    end_param_index : int
        Index in z of the parameter that the termination reason reports; -1 for the last parameter.
    end_value : float
        Value of this parameter at the end of the segment.
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
    """Join `BranchSegment` objects of the same equations, each of which starts at the end of the previous segment."""
    specials, row_offset = [], 0
    for segment in segments:
        specials += [special._replace(row=special.row + row_offset) for special in segment.specials]
        row_offset += len(segment.points.z) - 1
    points, diagnostics = (
        join_rows([segment.points for segment in segments]),
        join_rows([segment.diagnostics for segment in segments]),
    )
    return segments[-1]._replace(points=points, diagnostics=diagnostics, specials=tuple(specials))

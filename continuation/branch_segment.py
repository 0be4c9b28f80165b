"""Segments of branches: rows of points, limits of their computation, and warnings of slow progress.

Limit a computation by a largest number of points and a wall-clock time. A public function makes a `Limits` object and
passes it to the functions that it calls. Loops check the limits between chunks of steps. The clock is a field, so that
tests can replace it.
"""

import time
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, NamedTuple, TypeVar

import numpy as np

from .arclength import Point


def map_fields(function, *rows):
    """Apply a function to the fields of rows.

    Parameters
    ----------
    function : callable
        Function of arrays, one from each argument in `rows`.
    *rows : NamedTuple or None
        Rows of one class, with one array per field.

    Returns
    -------
    NamedTuple or None
        The results in the class of the rows; None if the rows are None.

    Notes
    -----
    `jax.tree.map` takes about ten times as long.
    """
    return None if rows[0] is None else type(rows[0])._make(map(function, *rows))


def row_at(points, index):
    """Return the row at an index."""
    return map_fields(lambda leaf: leaf[index], points)


def first_rows(points, n_rows):
    """Return the first `n_rows` rows."""
    return map_fields(lambda leaf: leaf[:n_rows], points)


def insert_row(points, index, row):
    """Insert a row at an index and shorten the step of the next row by that of the inserted row."""
    extended_points = map_fields(
        lambda leaf, entry: np.concatenate([leaf[:index], np.asarray(entry)[None], leaf[index:]]), points, row
    )
    if index + 1 < len(extended_points.z):
        extended_points.step[index + 1] -= row.step
    return extended_points


def join_rows(row_blocks):
    """Join blocks of rows, each of which starts with the last row of the previous block."""
    return map_fields(lambda *leaves: np.concatenate([leaves[0], *(leaf[1:] for leaf in leaves[1:])]), *row_blocks)


def reverse_rows(points):
    """Reverse the order of the rows."""
    return map_fields(lambda leaf: leaf[::-1], points)


clock = time.monotonic
EXPIRED_REASON = "max_seconds reached"
ResultType = TypeVar("ResultType", covariant=True)


@dataclass(frozen=True)
class Limits:
    """Limits of a computation.

    Parameters
    ----------
    points : int, optional
        Largest number of points. None stands for no limit.
    deadline : float, optional
        Reading of the clock, in s, at which the computation stops. None stands for no limit.
    read_clock : callable, optional
        Clock, in s.
    progress_callback : callable, optional
        Function called with the number of computed points.
    done : int, optional
        Number of points that are already computed.
    """

    points: int | None = None
    deadline: float | None = None
    read_clock: Callable[[], float] = clock
    progress_callback: Callable[[int], object] | None = None
    done: int = 0

    @property
    def expired(self) -> bool:
        """True once the wall-clock time is used up."""
        return self.deadline is not None and self.read_clock() >= self.deadline

    @property
    def seconds_remaining(self) -> float | None:
        """Remaining time in s, positive; None if there is no limit."""
        return None if self.deadline is None else max(self.deadline - self.read_clock(), 1e-9)

    @property
    def points_remaining(self) -> int | None:
        """Number of points that may still be computed; None if there is no limit."""
        return None if self.points is None else max(self.points - self.done, 0)

    def is_reached(self, n_new_points: int) -> bool:
        """Return True if `n_new_points` further points reach the limit of points or the time is used up."""
        return self.expired or (self.points_remaining is not None and n_new_points >= self.points_remaining)

    def after_points(self, n_new_points: int) -> "Limits":
        """Return the limits with `n_new_points` further points counted as computed."""
        return replace(self, done=self.done + n_new_points)

    def half_points(self) -> "Limits":
        """Return the limits for the first of two directions: half of the points, rounded up, but at least 2."""
        return self if self.points is None else replace(self, points=max((self.points + 1) // 2, 2))

    def report(self, n_new_points: int) -> None:
        """Report `n_new_points` further points to `progress_callback`."""
        if self.progress_callback is not None:
            self.progress_callback(self.done + n_new_points)


UNLIMITED = Limits()


class Results(tuple[ResultType, ...]):
    """Tuple of results.

    Attributes
    ----------
    stopped : str
        Reason why the computation is incomplete, else an empty string.
    """

    stopped: str

    def __new__(cls, results: Iterable[ResultType] = (), stopped: str = "") -> "Results[ResultType]":
        instance = super().__new__(cls, tuple(results))
        instance.stopped = stopped
        return instance


def partial_result_reason(n_done: int, n_total: int, unit: str) -> str:
    """Format the reason why a result is partial.

    Parameters
    ----------
    n_done : int
        Number of completed units.
    n_total : int
        Number of all units.
    unit : str
        Noun in the plural.

    Returns
    -------
    str
        The reason.
    """
    return f"{EXPIRED_REASON}: {n_done} of {n_total} {unit} done"


def make_limits(
    max_points: int | None,
    max_seconds: float | None,
    progress: Callable[[int], object] | None = None,
    error_class: type[ValueError] = ValueError,
) -> Limits:
    """Make the `Limits` of a computation that starts now.

    Parameters
    ----------
    max_points : int or None
        Largest number of points. None stands for no limit.
    max_seconds : float or None
        Largest wall-clock time, in s. None stands for no limit.
    progress : callable, optional
        Function called with the number of computed points.
    error_class : type, optional
        Class of the error for invalid arguments, called with key, rule and value.

    Returns
    -------
    Limits
        The limits.

    Raises
    ------
    ValueError
        If an argument is invalid. The error is an instance of `error_class`.
    """
    if max_points is not None:
        is_whole_number = isinstance(max_points, int | np.integer) and not isinstance(max_points, bool)
        if not is_whole_number or max_points < 2:
            raise error_class("max_points", "must be a whole number of at least 2, or None for no limit", max_points)
    if max_seconds is not None:
        is_real_number = isinstance(max_seconds, int | float | np.integer | np.floating) and not isinstance(
            max_seconds, bool
        )
        if not is_real_number or not 0 < max_seconds < np.inf:
            raise error_class("max_seconds", "must be a positive number of seconds, or None for no limit", max_seconds)
    if progress is not None and not callable(progress):
        raise error_class("progress", "must be a function of the number of computed points, or None", progress)
    deadline = None if max_seconds is None else clock() + float(max_seconds)
    return Limits(None if max_points is None else int(max_points), deadline, clock, progress)


# Number of consecutive points within a width, relative to 1 + abs(parameter), that count as slow progress.
SLOW_POINTS, NARROW_WIDTH = 100, 1e-7


class SlowProgressWarning(UserWarning):
    """Warning for a continuation that takes many steps at nearly one value of its parameter."""


def has_slow_progress(segment):
    """Return True if many points of a `BranchSegment` lie at nearly one value of the parameter."""
    parameter_values = segment.points.z[:, -1]
    return len(parameter_values) > SLOW_POINTS and float(np.ptp(parameter_values)) < NARROW_WIDTH * (
        1.0 + abs(parameter_values[-1])
    )


def warn_if_slow(control, segment):
    """Warn if many consecutive points lie at nearly one value of the parameter."""
    if has_slow_progress(segment):
        parameter_values, steps = segment.points.z[:, -1], segment.points.step
        parameter_range, n_steps = float(np.ptp(parameter_values)), len(parameter_values) - 1
        smallest_step, largest_step = float(steps[1:].min()), float(steps[1:].max())
        warnings.warn(
            f"slow progress: {n_steps} points lie within {parameter_range:.1e} of the parameter value"
            f" {parameter_values[-1]:.12g},"
            " with steps"
            f" of {smallest_step:.1e} to {largest_step:.1e} (the smallest allowed is"
            f" {float(control.min_step):.1e}); the curve bends"
            " sharply or is nearly singular there; set max_points or max_seconds, or narrow the bounds",
            SlowProgressWarning,
            stacklevel=2,
        )


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

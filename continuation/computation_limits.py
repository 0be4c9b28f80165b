"""Limit a computation by a largest number of points and a wall-clock time.

A public function makes a `Limits` object and passes it to the functions that it calls. Loops check the limits between
chunks of steps. The clock is a field, so that tests can replace it.
"""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

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

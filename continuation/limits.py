"""Limits of a computation: a largest number of points and a wall-clock time.

A public function makes one `Limits` and passes it down; loops check it between chunks. The clock is a field, so that
tests can replace it.
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
    now : callable, optional
        Clock, in s.
    progress : callable, optional
        Function called with the number of computed points.
    done : int, optional
        Number of points computed before.
    """

    points: int | None = None
    deadline: float | None = None
    now: Callable[[], float] = clock
    progress: Callable[[int], object] | None = None
    done: int = 0

    @property
    def expired(self) -> bool:
        """True once the wall-clock time is used up."""
        return self.deadline is not None and self.now() >= self.deadline

    @property
    def remaining(self) -> float | None:
        """Remaining time in s, positive; None without a limit."""
        return None if self.deadline is None else max(self.deadline - self.now(), 1e-9)

    @property
    def room(self) -> int | None:
        """Number of points that may still be computed; None without a limit."""
        return None if self.points is None else max(self.points - self.done, 0)

    def reached(self, count: int) -> bool:
        """Return True if `count` points reach the limit of points, or the time is used up."""
        return self.expired or (self.room is not None and count >= self.room)

    def after(self, count: int) -> "Limits":
        """Return the limits after `count` further points."""
        return replace(self, done=self.done + count)

    def halved(self) -> "Limits":
        """Return the limits of the first of two directions: half of the points, rounded up."""
        return self if self.points is None else replace(self, points=max((self.points + 1) // 2, 2))

    def report(self, count: int) -> None:
        """Report `count` further points to `progress`."""
        if self.progress is not None:
            self.progress(self.done + count)


UNLIMITED = Limits()


class Results(tuple[ResultType, ...]):
    """Tuple of results.

    Attributes
    ----------
    stopped : str
        Reason why the computation ended before it was complete, else an empty string.
    """

    stopped: str

    def __new__(cls, results: Iterable[ResultType] = (), stopped: str = "") -> "Results[ResultType]":
        instance = super().__new__(cls, tuple(results))
        instance.stopped = stopped
        return instance


def partial_reason(n_done: int, n_total: int, unit: str) -> str:
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


def limits_of(
    max_points: int | None,
    max_seconds: float | None,
    progress: Callable[[int], object] | None = None,
    error_class: type[ValueError] = ValueError,
) -> Limits:
    """Make the `Limits` that begin now.

    Parameters
    ----------
    max_points : int or None
        Largest number of points. None stands for no limit.
    max_seconds : float or None
        Largest wall-clock time, in s. None stands for no limit.
    progress : callable, optional
        Function called with the number of computed points.
    error_class : type, optional
        Error raised for invalid arguments, called with key, rule and value.

    Returns
    -------
    Limits
        The limits.

    Raises
    ------
    ValueError
        If an argument is invalid; `error_class`, a subclass, is raised.
    """
    if max_points is not None:
        is_integer = isinstance(max_points, int | np.integer) and not isinstance(max_points, bool)
        if not is_integer or max_points < 2:
            raise error_class("max_points", "must be a whole number of at least 2, or None for no limit", max_points)
    if max_seconds is not None:
        is_number = isinstance(max_seconds, int | float | np.integer | np.floating) and not isinstance(
            max_seconds, bool
        )
        if not is_number or not 0 < max_seconds < np.inf:
            raise error_class("max_seconds", "must be a positive number of seconds, or None for no limit", max_seconds)
    if progress is not None and not callable(progress):
        raise error_class("progress", "must be a function of the number of computed points, or None", progress)
    deadline = None if max_seconds is None else clock() + float(max_seconds)
    return Limits(None if max_points is None else int(max_points), deadline, clock, progress)

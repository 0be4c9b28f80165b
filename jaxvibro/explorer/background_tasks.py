"""Long work: a thread for each piece of it, which tells how far it is and can be stopped."""

import ctypes
import itertools
import threading
import time
from collections.abc import Callable
from typing import Any

import jax

from ..scene.check import ArgumentError
from ..stores.filling import Progress

PROGRESS_INTERVAL = 0.1  # s between two tellings
MAX_TASKS = 4  # at a time

ProgressCallback = Callable[[Any], object]
Schedule = Callable[[Callable[[], None]], object]


def progress_text(progress: Any) -> str:
    """How far work is, as a text."""
    if isinstance(progress, Progress):
        return f"{progress.done} of {progress.total}"
    return "" if progress is None else str(progress)


class TaskStopped(SystemExit):
    """Work was stopped by the user. No Exception, so that nothing on the way takes it for an error of its own; a thread
    that ends by it tells nobody."""


class BackgroundTask(threading.Thread):
    """Work in a thread of its own, begun at once.

    run: is given what tells how far it is; done: called with (value, None), or (None, error), at the end, from this
    thread; not after `stop`. tell: called with how far it is, at most ten times a second. double: whether numbers are
    of double precision.
    """

    def __init__(
        self,
        job: Callable[[ProgressCallback], Any],
        on_end: Callable[[Any, Exception | None], None],
        report: ProgressCallback,
        double_precision: bool,
    ) -> None:
        super().__init__(daemon=True)
        self._job, self._on_end, self._report, self._double_precision = job, on_end, report, double_precision
        self._lock, self._stop_requested, self._is_running, self._last_report_time = threading.Lock(), False, True, 0.0
        self.start()

    def run(self) -> None:
        """What the thread does."""
        value, error = None, None
        try:
            with jax.enable_x64(self._double_precision):
                value = self._job(self._report_progress)
        except Exception as exception:
            error = exception
        except TaskStopped:
            pass
        with self._lock:
            self._is_running = False
            was_stopped = self._stop_requested
        if not was_stopped:
            self._on_end(value, error)

    def stop(self) -> None:
        """Ends the work: at its next telling, or between two steps of Python, whichever comes first."""
        with self._lock:
            self._stop_requested = True
            if self._is_running and self.ident is not None:
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self.ident), ctypes.py_object(TaskStopped))

    def _report_progress(self, progress):
        if self._stop_requested:
            raise TaskStopped
        if time.monotonic() - self._last_report_time > PROGRESS_INTERVAL:
            self._last_report_time = time.monotonic()
            self._report(progress)


class BackgroundTasks:
    """What one page has under way.

    tell: called with (number, how far), from any thread; later: called with what the page's own thread is to do.
    """

    def __init__(
        self,
        report: Callable[[int, Any], object],
        schedule: Schedule,
        double_precision: bool,
    ) -> None:
        self._report, self._schedule, self._double_precision = report, schedule, double_precision
        self._task_numbers, self._tasks = itertools.count(1), dict[int, tuple[str, BackgroundTask]]()

    @property
    def labels(self) -> dict[int, str]:
        """{number: what it is} of all that is under way."""
        return {number: label for number, (label, _) in self._tasks.items()}

    def start(
        self,
        label: str,
        job: Callable[[ProgressCallback, Schedule], Any],
        on_end: Callable[[Any, Exception | None], None],
    ) -> None:
        """Begins work. job: is given what tells how far it is, and a `later` that does nothing once this is stopped;
        on_end: called by the page's thread with (value, error), unless it was stopped. Raises ArgumentError where there
        is too much already."""
        if len(self._tasks) >= MAX_TASKS:
            raise ArgumentError("work", f"must be at most {MAX_TASKS} things at a time: stop what is under way", label)
        number = next(self._task_numbers)

        def schedule(callback):
            self._schedule(lambda: callback() if number in self._tasks else None)

        def finish(value, error):
            del self._tasks[number]
            on_end(value, error)

        task = BackgroundTask(
            lambda report: job(report, schedule),
            lambda value, error: schedule(lambda: finish(value, error)),
            lambda progress: self._report(number, progress),
            self._double_precision,
        )
        self._tasks[number] = label, task

    def stop(self) -> None:
        """Ends all that is under way."""
        for _, task in self._tasks.values():
            task.stop()
        self._tasks.clear()

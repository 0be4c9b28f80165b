"""Run long tasks in threads that report progress and can be stopped."""

import ctypes
import itertools
import threading
import time
from collections.abc import Callable
from typing import Any

import jax

from ..scene.check import ArgumentError
from ..stores.study import Progress

PROGRESS_INTERVAL = 0.1  # s between two reports
MAX_TASKS = 4  # simultaneous tasks

ProgressCallback = Callable[[Any], object]
Schedule = Callable[[Callable[[], None]], object]


def progress_text(progress: Any) -> str:
    """Return the progress of a task as text."""
    if isinstance(progress, Progress):
        return f"{progress.done} of {progress.total}"
    return "" if progress is None else str(progress)


class TaskStopped(SystemExit):
    """Signal that the user stopped a task.

    The class does not derive from Exception, so that handlers of errors do not catch it. A thread that ends with a
    SystemExit prints nothing.
    """


class BackgroundTask(threading.Thread):
    """Task in its own thread, which starts at once.

    Parameters
    ----------
    task_function : callable
        Function to run. Its argument is a function that reports progress.
    on_end : callable
        Function of ``(value, None)`` or ``(None, error)``, called from this thread at the end unless the task was
        stopped.
    report_progress : callable
        Function that receives progress at most ten times per second.
    double_precision : bool
        Use double precision in the thread.
    """

    def __init__(
        self,
        task_function: Callable[[ProgressCallback], Any],
        on_end: Callable[[Any, Exception | None], None],
        report_progress: ProgressCallback,
        double_precision: bool,
    ) -> None:
        super().__init__(daemon=True)
        self._job, self._on_end, self._report, self._double_precision = (
            task_function,
            on_end,
            report_progress,
            double_precision,
        )
        self._lock, self._stop_requested, self._is_running, self._last_report_time = threading.Lock(), False, True, 0.0
        self.start()

    def run(self) -> None:
        """Run the task."""
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
        """Stop the task at its next report or between two Python instructions, whichever comes first."""
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
    """Running tasks of one page.

    Parameters
    ----------
    report_progress : callable
        Function of (task number, progress), called from any thread.
    run_in_page_thread : callable
        Function that runs a callback in the thread of the page.
    double_precision : bool
        Use double precision in the threads.
    """

    def __init__(
        self,
        report_progress: Callable[[int, Any], object],
        run_in_page_thread: Schedule,
        double_precision: bool,
    ) -> None:
        self._report, self._schedule, self._double_precision = report_progress, run_in_page_thread, double_precision
        self._task_numbers, self._tasks = itertools.count(1), dict[int, tuple[str, BackgroundTask]]()

    @property
    def labels(self) -> dict[int, str]:
        """Labels of the running tasks, {number: label}."""
        return {task_number: label for task_number, (label, _) in self._tasks.items()}

    def start(
        self,
        label: str,
        task_function: Callable[[ProgressCallback, Schedule], Any],
        on_end: Callable[[Any, Exception | None], None],
    ) -> None:
        """Start a task.

        `task_function` has two arguments: a function that reports progress, and a function that runs a callback in the
        thread of the page unless the task was stopped. `on_end` is called in the thread of the page with (value, error)
        unless the task was stopped. Raises ArgumentError if `MAX_TASKS` tasks are running."""
        if len(self._tasks) >= MAX_TASKS:
            raise ArgumentError(
                "work", f"must be at most {MAX_TASKS} simultaneous tasks. Stop the running ones first", label
            )
        task_number = next(self._task_numbers)

        def schedule_if_running(callback):
            self._schedule(lambda: callback() if task_number in self._tasks else None)

        def finish_task(value, error):
            del self._tasks[task_number]
            on_end(value, error)

        task = BackgroundTask(
            lambda report: task_function(report, schedule_if_running),
            lambda value, error: schedule_if_running(lambda: finish_task(value, error)),
            lambda progress: self._report(task_number, progress),
            self._double_precision,
        )
        self._tasks[task_number] = label, task

    def stop(self) -> None:
        """Stop all running tasks."""
        for _, task in self._tasks.values():
            task.stop()
        self._tasks.clear()

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

EVERY = 0.1  # s between two tellings
MOST = 4  # at a time

Tell = Callable[[Any], object]
Later = Callable[[Callable[[], None]], object]


def text_of_far(far: Any) -> str:
    """How far work is, as a text."""
    if isinstance(far, Progress):
        return f"{far.done} of {far.total}"
    return "" if far is None else str(far)


class Stopped(SystemExit):
    """Work was stopped by the user. No Exception, so that nothing on the way takes it for an error of its own; a thread
    that ends by it tells nobody."""


class Work(threading.Thread):
    """Work in a thread of its own, begun at once.

    run: is given what tells how far it is; done: called with (value, None), or (None, error), at the end, from this
    thread; not after `stop`. tell: called with how far it is, at most ten times a second. double: whether numbers are
    of double precision.
    """

    def __init__(
        self,
        run: Callable[[Tell], Any],
        done: Callable[[Any, Exception | None], None],
        tell: Tell,
        double: bool,
    ) -> None:
        super().__init__(daemon=True)
        self._run, self._done, self._tell, self._double = run, done, tell, double
        self._lock, self._stopping, self._open, self._told = threading.Lock(), False, True, 0.0
        self.start()

    def run(self) -> None:
        """What the thread does."""
        value, error = None, None
        try:
            with jax.enable_x64(self._double):
                value = self._run(self._progress)
        except Exception as found:
            error = found
        except Stopped:
            pass
        with self._lock:
            self._open = False
            stopped = self._stopping
        if not stopped:
            self._done(value, error)

    def stop(self) -> None:
        """Ends the work: at its next telling, or between two steps of Python, whichever comes first."""
        with self._lock:
            self._stopping = True
            if self._open and self.ident is not None:
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self.ident), ctypes.py_object(Stopped))

    def _progress(self, far):
        if self._stopping:
            raise Stopped
        if time.monotonic() - self._told > EVERY:
            self._told = time.monotonic()
            self._tell(far)


class Works:
    """What one page has under way.

    tell: called with (number, how far), from any thread; later: called with what the page's own thread is to do.
    """

    def __init__(
        self,
        tell: Callable[[int, Any], object],
        later: Later,
        double: bool,
    ) -> None:
        self._tell, self._later, self._double = tell, later, double
        self._numbers, self._known = itertools.count(1), dict[int, tuple[str, Work]]()

    @property
    def labels(self) -> dict[int, str]:
        """{number: what it is} of all that is under way."""
        return {number: label for number, (label, _) in self._known.items()}

    def begin(
        self, label: str, run: Callable[[Tell, Later], Any], ended: Callable[[Any, Exception | None], None]
    ) -> None:
        """Begins work. run: is given what tells how far it is, and a `later` that does nothing once this is stopped;
        ended: called by the page's thread with (value, error), unless it was stopped. Raises ArgumentError where there
        is too much already."""
        if len(self._known) >= MOST:
            raise ArgumentError("work", f"must be at most {MOST} things at a time: stop what is under way", label)
        number = next(self._numbers)

        def later(does):
            self._later(lambda: does() if number in self._known else None)

        def over(value, error):
            del self._known[number]
            ended(value, error)

        work = Work(
            lambda tell: run(tell, later),
            lambda value, error: later(lambda: over(value, error)),
            lambda far: self._tell(number, far),
            self._double,
        )
        self._known[number] = label, work

    def stop(self) -> None:
        """Ends all that is under way."""
        for _, work in self._known.values():
            work.stop()
        self._known.clear()

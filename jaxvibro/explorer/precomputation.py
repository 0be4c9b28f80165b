"""Compute the first results of a page in advance, in a thread that lives as long as the server."""

import threading
from collections.abc import Callable
from contextlib import suppress

import jax
import numpy as np
import scipy

from continuation.hostcall import CompilationQueue

from ..maps.simulate import simulate
from ..maps.strobe import strobe
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError
from ..scene.check import ArgumentError
from ..scene.scene import Scene
from ..scene.state import State
from .page_calls import SETTLE_PERIODS
from .panels import SAMPLES_PER_PERIOD

SCIPY_MODULES = "interpolate", "spatial", "linalg", "special", "sparse"  # SciPy imports each on first use
DRAWING_TIME = 1.0  # s, until the first results are drawn
POLL_INTERVAL = 0.25  # s between two checks for work


class PrecomputationThread(threading.Thread):
    """Thread that computes the first results while the browser starts, then compiles functions while no page is used.

    The functions to compile are those that NumPy evaluates until they are compiled.

    Parameters
    ----------
    scene : Scene
        Scene of the first page.
    is_idle : callable
        Function that returns True if no page has sent a message recently.

    Attributes
    ----------
    ready : threading.Event
        Event that is set once the first results are computed or have failed.
    """

    def __init__(self, scene: Scene, is_idle: Callable[[], bool]) -> None:
        super().__init__(daemon=True)
        self._scene, self._is_idle, self._stop_event = scene, is_idle, threading.Event()
        self.ready = threading.Event()
        self.start()

    def run(self) -> None:
        """Run the thread."""
        with CompilationQueue() as compilation_queue:
            self._compute_first_results()
            while not self._stop_event.wait(POLL_INTERVAL):
                if self._is_idle():
                    compilation_queue.compile_next()

    def _compute_first_results(self):
        with jax.enable_x64(bool(self._scene.dtype == np.float64)):
            try:
                orbit = find_orbit(self._scene, State(0.0, 0.0))
                simulate(self._scene, orbit.state, orbit.periods, SAMPLES_PER_PERIOD)
            except (ArgumentError, OrbitError, ArithmeticError):
                pass  # the page reports the error
            finally:
                self.ready.set()
            self._stop_event.wait(DRAWING_TIME)
            with suppress(ArgumentError):
                strobe(self._scene, State(0.0, 0.0), SETTLE_PERIODS, 0)
        for module_name in SCIPY_MODULES:
            getattr(scipy, module_name)

    def stop(self) -> None:
        """End the thread after the current compilation."""
        self._stop_event.set()
        self.join(10.0)

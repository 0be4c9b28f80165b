"""What a page will ask, done before it asks: a thread that lasts as long as the server does."""

import threading
from collections.abc import Callable
from contextlib import suppress

import jax
import numpy as np
import scipy

from continuation.persistent_jit import compile_evaluated

from ..maps.simulate import simulate
from ..maps.strobe import strobe
from ..orbits.find import find_orbit
from ..orbits.orbit import OrbitError
from ..scene.check import ArgumentError
from ..scene.scene import Scene
from ..scene.state import State
from .lines import SETTLE
from .panels import SAMPLES

PARTS = ("interpolate", "spatial", "linalg", "special", "sparse")  # of SciPy, which loads each when it is first used
SOON = 1.0  # s after the first answers: they have been drawn by then
PAUSE = 0.25  # s from one look for work to the next


class Ahead(threading.Thread):
    """Asks what a page asks first, while the browser is on its way; then compiles what NumPy evaluates, while nobody
    waits. is_quiet: whether nobody does. ready: set once the first answers are there. end: ends it."""

    def __init__(self, scene: Scene, is_quiet: Callable[[], bool]) -> None:
        super().__init__(daemon=True)
        self._scene, self._is_quiet, self._over = scene, is_quiet, threading.Event()
        self.ready = threading.Event()
        self.start()

    def run(self) -> None:
        """What the thread does."""
        with jax.enable_x64(bool(self._scene.dtype == np.float64)):
            try:
                one = find_orbit(self._scene, State(0.0, 0.0))
                simulate(self._scene, one.state, one.periods, SAMPLES)
            except (ArgumentError, OrbitError, ArithmeticError):
                pass  # the page will say so
            finally:
                self.ready.set()
            self._over.wait(SOON)
            with suppress(ArgumentError):
                strobe(self._scene, State(0.0, 0.0), SETTLE, 0)
        for part in PARTS:
            getattr(scipy, part)
        while not self._over.wait(PAUSE):
            if self._is_quiet():
                next(compile_evaluated(), None)

    def end(self) -> None:
        """Ends it, after the function that is being compiled."""
        self._over.set()
        self.join(10.0)

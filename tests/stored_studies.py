"""Studies for the tests of stores: `python -m tests.stored_studies KIND NUMBER FOLDER ENGINE` computes a random one.

ENGINE is local, dask, or the address of a scheduler.
"""

import hashlib
import os
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import jax
import numpy as np
import xarray as xr

import jaxvibro as jv
from jaxvibro.stores.study import Column, Grid, complete_study


@dataclass(frozen=True)
class Counted:
    """Study in which cells have the number of their row.

    rows: of four cells; nap: seconds a chunk takes; log: a file for the numbers of chunks; fails: a chunk that raises
    an error; offset: of the numbers; block: cells of a chunk along rows and columns.
    """

    rows: int
    nap: float = 0.0
    log: str = ""
    fails: int = -1
    offset: float = 0.5
    block: tuple[int, int] = (1, 4)

    @property
    def grid(self):
        return Grid({"row": self.rows, "column": 4}, self.block)

    @property
    def columns(self):
        return {
            "label": Column(np.dtype(np.int32), -1, {"long_name": "row"}),
            "number": Column(np.dtype(np.float64), np.nan, {"units": "1"}, {"pair": 2}),
        }

    @property
    def identity(self):
        return {"scene": f"offset = {self.offset}\nrest = 0", "rows": str(self.rows)}

    @property
    def frame(self):
        return xr.Dataset(
            {"known": ("place", np.arange(3.0))},
            {"row": self.offset + np.arange(self.rows), "column": np.arange(4.0)},
            {"told": "something", "scales": [1.0, 2.0]},
        )

    def compute(self, number, frame):
        assert frame["known"].values[2] == 2.0
        if number == self.fails:
            raise ArithmeticError(f"chunk {number}")
        time.sleep(self.nap)
        if self.log:
            handle = os.open(self.log, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
            os.write(handle, f"{number}\n".encode())
            os.close(handle)
        rows, columns = self.grid.chunk_slices(number)
        label = np.arange(rows.start, rows.stop, dtype=np.int32)[:, None] + 0 * np.arange(columns.start, columns.stop)
        return {"label": label, "number": np.stack([self.offset + label, -1.0 * label], -1)}, number % 2


def counts(log):
    """Return how often each chunk was computed: {number: times}."""
    return Counter(map(int, Path(log).read_text().split())) if Path(log).exists() else Counter()


def bits(path):
    """Return a digest of each file of a folder."""
    files = sorted(file for file in Path(path).rglob("*") if file.is_file())
    return {str(file.relative_to(path)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def keep(study, path, workers=None):
    """Compute a study in a store of a folder."""
    return complete_study(study, jv.Store(path, jv.LocalEngine(workers)), None)


@dataclass(frozen=True)
class StudyKind:
    """A kind of study.

    make: from random numbers to a function of a store, a callback and limits that computes the study; blank: a variable
    and its value in cells that are not done.
    """

    name: str
    make: Callable
    blank: tuple[str, int] = ("label", -1)

    def draw(self, number):
        """Return the function of a draw."""
        return self.make(np.random.default_rng([21, number]))


def counted(rng):
    study = Counted(int(rng.integers(2, 12)), 0.01, block=(int(rng.integers(1, 3)), int(rng.integers(1, 5))))
    return lambda store=None, progress=None: complete_study(study, store, progress)


def _scene(damping=0.05):
    return jv.make_scene(4.65, 2.1, damping, 0.7, (jv.Wall(-1.0), jv.Wall(1.0)))


def study_of(function, *given, **chosen):
    """Return a function of a store, a callback and limits that computes a study."""

    def compute(store=None, progress=None, **limits):
        return function(*given, **chosen, store=store, progress=progress, **limits)

    return compute


def map_of_parameters(rng):
    grid = {"frequency": np.linspace(1.6, 3.0, 3), "amplitude": np.linspace(4.0, 6.0, 2)}
    chosen = {"chunk": int(rng.integers(1, 4)), "settle": 64, "patience": 600}
    return study_of(jv.map_parameters, _scene(rng.uniform(0.04, 0.06)), grid, **chosen)


def basins(rng):
    scene, phase, size = _scene(rng.uniform(0.04, 0.06)), rng.uniform(0.0, 6.0), int(rng.integers(20, 60))
    axes, attractors = (np.linspace(-1.0, 1.0, 9), np.linspace(-4.0, 4.0, 10)), jv.find_attractors(scene, 24)
    study = study_of(jv.basins, scene, *axes, phase, attractors, 600)

    def compute(store=None, progress=None, **limits):
        with mock.patch("jaxvibro.attractors.basins.STARTS_PER_CHUNK", size if store else 1000):
            return study(store, progress, **limits)

    return compute


def spectrum(rng):
    values, state = np.linspace(2.0, 2.0 + rng.uniform(0.1, 4.0), 66), jv.State(0.0, rng.uniform(-1.0, 1.0))
    return study_of(jv.spectrum, _scene(), "amplitude", values, state, settle=5, error=1.0, most=1)


def sweep(rng):
    state = jv.State(rng.uniform(-0.5, 0.5, (2, 33)), 0.0)
    return study_of(jv.sweep, _scene(rng.uniform(0.04, 0.06)), "amplitude", np.linspace(2, 4, 5), state, 20, 5)


KINDS = {
    kind.name: kind
    for kind in (
        StudyKind("counted", counted),
        StudyKind("map", map_of_parameters),
        StudyKind("basins", basins, ("label", -3)),
        StudyKind("spectrum", spectrum, ("status", -1)),
        StudyKind("sweep", sweep, ("status", -1)),
    )
}


def main(name, number, folder, engine):
    """Compute a draw of a kind in a store."""
    jax.config.update("jax_enable_x64", True)
    if engine == "local":
        chosen = jv.LocalEngine(1)
    else:
        chosen = jv.DaskEngine(workers=1) if engine == "dask" else jv.DaskEngine(engine)
    KINDS[name].draw(int(number))(jv.Store(folder, chosen))


if __name__ == "__main__":
    main(*sys.argv[1:])

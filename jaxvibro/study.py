"""What a scene file asks for, computed: a swept diagram, attractors, or the motion from rest where it asks nothing."""

from dataclasses import dataclass

import jax
import numpy as np
import xarray as xr
from tqdm import tqdm

from .attractors import find_attractors
from .place import fit
from .scene import Scene
from .state import State
from .sweep import sweep
from .tables import SceneFile

SETTLE, KEEP = 300, 100  # drive periods from rest, where no study says how many


@dataclass(frozen=True)
class Found:
    """What came out. file: what was asked; scene: its scene, and `there`, the scene that the attractors are of.

    swept: the Dataset of `sweep` with a dimension `leg`, of one value and a leg "rest" where no study was asked for;
    attractors: as `find_attractors` gives them. Either is None where the file does not ask for it.
    """

    file: SceneFile
    scene: Scene
    there: Scene
    swept: xr.Dataset | None
    attractors: tuple | None

    @property
    def mark(self):
        """The swept parameter's value at which the attractors belong into the diagram, None where they do not."""
        asked, sweeping = self.file.attractors, self.file.sweep
        if asked is None or sweeping is None or not set(asked.at) <= {sweeping.parameter}:
            return None
        return float(self.there.parameter(sweeping.parameter))


def study(file, progress=False):
    """Does what a `SceneFile` asks: `Found`. progress: show bars on stderr."""
    scene = file.scene.make()
    there, swept, attractors = scene, None, None
    if file.sweep is not None:
        swept = _legs(scene, file.sweep, progress)
    if file.attractors is not None:
        there = scene.replace(**file.attractors.at)
        attractors = _attractors(there, file.attractors, progress)
    if file.sweep is None and file.attractors is None:
        swept = _rest(scene)
    return Found(file, scene, there, swept, attractors)


def _legs(scene, table, progress):
    """The legs of a sweep as lanes of one: they are run side by side."""
    values = np.stack([table.values(leg) for leg in table.legs], axis=-1)
    start = State(*(np.array([getattr(leg.start, key) for leg in table.legs]) for key in ("x", "v")))
    with tqdm(desc="sweep", total=len(values), unit=" values", mininterval=0.5, disable=not progress) as bar:
        swept = sweep(
            scene, table.parameter, values, start, table.settle, table.keep, progress=lambda n: bar.update(n - bar.n)
        )
    return _named(swept, [leg.name for leg in table.legs])


def _attractors(scene, table, progress):
    with tqdm(desc="attractors", total=table.starts, unit=" starts", disable=not progress) as bar:
        found = find_attractors(scene, table.starts, table.seed)
        bar.update(table.starts)
    return found


def _rest(scene):
    """The motion from rest at 0, or at the wall in the way of that, as a sweep of one value."""
    start = jax.tree.map(lambda leaf: np.reshape(leaf, 1), fit(scene, State(0.0, 0.0)))
    found = sweep(scene, "amplitude", np.reshape(scene.amplitude, (1, 1)), start, SETTLE, KEEP)
    return _named(found, ["rest"])


def _named(swept, legs):
    return swept.rename(lane="leg").assign_coords(leg=legs)

"""What a scene file asks for, computed: a swept diagram, attractors, periodic orbits; else the motion from rest."""

from dataclasses import dataclass, replace

import jax
import numpy as np
import xarray as xr
from tqdm import tqdm

from .attractors import find_attractors
from .orbits import find_orbits
from .place import fit
from .scene import Scene
from .state import State
from .sweep import sweep
from .tables import SceneFile

SETTLE, KEEP = 300, 100  # drive periods from rest, where no study says how many
SAME = 1e-6  # of a state: an orbit as near to an attractor's is that attractor


@dataclass(frozen=True)
class Found:
    """What came out. file: what was asked; scene: its scene.

    swept: the Dataset of `sweep` with a dimension `leg`, of one value and a leg "rest" where no study was asked for;
    attractors, orbits: as `find_attractors` and `find_orbits` give them. Each is None where the file does not ask for
    it.
    """

    file: SceneFile
    scene: Scene
    swept: xr.Dataset | None
    attractors: tuple | None
    orbits: tuple | None

    def there(self, asked):
        """The scene that a table with values `at` is about; for None the file's own."""
        return self.scene if asked is None else self.scene.replace(**asked.at)

    def mark(self, asked):
        """The swept parameter's value at which what a table with values `at` gave belongs into the diagram, None where
        it does not."""
        sweeping = self.file.sweep
        if asked is None or sweeping is None or not set(asked.at) <= {sweeping.parameter}:
            return None
        return float(self.there(asked).parameter(sweeping.parameter))

    @property
    def others(self):
        """The orbits that are not among the attractors, mirror images being places in this tuple."""
        asked, orbits = self.file, self.orbits or ()
        if asked.attractors is None or asked.orbits is None or asked.attractors.at != asked.orbits.at:
            return orbits
        kept = [k for k, one in enumerate(orbits) if not any(_is_on(one, other) for other in self.attractors)]
        places = {old: new for new, old in enumerate(kept)}
        return tuple(replace(orbits[k], mirror_of=places.get(orbits[k].mirror_of)) for k in kept)


def study(file, progress=False):
    """Does what a `SceneFile` asks: `Found`. progress: show bars on stderr."""
    scene = file.scene.make()
    swept, attractors, orbits = None, None, None
    if file.sweep is not None:
        swept = _legs(scene, file.sweep, progress)
    if file.attractors is not None:
        attractors = _attractors(scene.replace(**file.attractors.at), file.attractors, progress)
    if file.orbits is not None:
        orbits = _orbits(scene.replace(**file.orbits.at), file.orbits, progress)
    if swept is None and attractors is None and orbits is None:
        swept = _rest(scene)
    return Found(file, scene, swept, attractors, orbits)


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


def _orbits(scene, table, progress):
    with tqdm(desc="orbits", total=table.starts, unit=" starts", disable=not progress) as bar:
        found = find_orbits(scene, table.max_period, table.starts, table.seed)
        bar.update(table.starts)
    return found


def _is_on(orbit, attractor):
    """Whether an orbit's state is a point of a periodic attractor."""
    if orbit.state.phase or not attractor.periods:
        return False
    point = np.array([orbit.state.x, orbit.state.v])
    return bool(abs(attractor.points - point).max(axis=1).min() <= SAME * (1.0 + abs(point).max()))


def _rest(scene):
    """The motion from rest at 0, or at the wall in the way of that, as a sweep of one value."""
    start = jax.tree.map(lambda leaf: np.reshape(leaf, 1), fit(scene, State(0.0, 0.0)))
    found = sweep(scene, "amplitude", np.reshape(scene.amplitude, (1, 1)), start, SETTLE, KEEP)
    return _named(found, ["rest"])


def _named(swept, legs):
    return swept.rename(lane="leg").assign_coords(leg=legs)

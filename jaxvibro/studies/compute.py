"""What a scene file asks for, computed: a swept diagram, attractors, orbits, branches and loci; else the motion from
rest."""

from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property

import jax
import numpy as np
import xarray as xr
from tqdm import tqdm

from ..attractors.find import Attractor, find_attractors
from ..attractors.sweep import sweep
from ..branches.branch import Branch, Special
from ..branches.branch_tree import followed
from ..branches.diagram import Diagram
from ..branches.explore import explore
from ..design.fit import fit as fitted
from ..design.fitted import Fit
from ..design.margin import Margin, margin
from ..design.records import ImpactRecord, SampleRecord
from ..flight.wall_positions import fit
from ..loci.loci import count, loci
from ..loci.locus import Locus
from ..orbits.find import find_orbit
from ..orbits.from_starts import find_orbits
from ..orbits.orbit import Orbit, OrbitError
from ..scene.check import ArgumentError, SceneError
from ..scene.scene import Scene, changed
from ..scene.state import State
from ..surveys.map import map_parameters
from .schema import AttractorsTable, BranchTable, ExploreTable, MarginTable, OrbitsTable, SceneFile
from .sweep_periods import Stretch, stretches

Asked = AttractorsTable | OrbitsTable | BranchTable | ExploreTable | MarginTable | None  # a table with values `at`

SETTLE, KEEP = 300, 100  # drive periods from rest, where no study says how many
SAME = 1e-6  # of a state: an orbit as near to an attractor's is that attractor


@dataclass(frozen=True)
class Found:
    """What came out. file: what was asked; scene: its scene.

    swept: the Dataset of `sweep` with a dimension `leg`, of one value and a leg "rest" where no study was asked for;
    attractors, orbits: as `find_attractors` and `find_orbits` give them; branches: as `followed` does, or those of the
    `Diagram` of `explore`, which is in diagram; loci, refused: as `loci.loci` gives them; margin, fit: as `margin` and
    `fit` do; record: what was fitted; map: as `map_parameters` gives it. Each is None where the file does not ask for
    it.
    """

    file: SceneFile
    scene: Scene
    swept: xr.Dataset | None
    attractors: tuple[Attractor, ...] | None
    orbits: tuple[Orbit, ...] | None
    branches: tuple[Branch, ...] | None = None
    diagram: Diagram | None = None
    loci: tuple[Locus, ...] | None = None
    refused: tuple[tuple[Special, str], ...] | None = None
    margin: Margin | None = None
    fit: Fit | None = None
    record: ImpactRecord | SampleRecord | None = None
    map: xr.Dataset | None = None

    @cached_property
    def stretches(self) -> list[Stretch]:
        """The `Stretch`es of the swept diagram, none where there is no sweep."""
        if self.swept is None:
            return []
        return stretches(self.swept, self.scene, SETTLE if self.file.sweep is None else self.file.sweep.settle)

    @property
    def across(self) -> str | None:
        """The parameter of the diagram: that which is swept, or else followed; None where there is no diagram."""
        asked = self.file.sweep or self.file.followed
        return None if asked is None else asked.parameter

    @property
    def base(self) -> Scene:
        """The scene of the diagram, but for its parameter."""
        return self.scene if self.file.sweep is not None else self.there(self.file.followed)

    def there(self, asked: Asked) -> Scene:
        """The scene that a table with values `at` is about; for None the file's own."""
        return self.scene if asked is None else self.scene.replace(**asked.at)

    def mark(self, asked: Asked) -> float | None:
        """The value of the diagram's parameter at which what a table with values `at` gave belongs into it, None where
        it does not."""
        if asked is None or self.across is None or not self._is_inside(asked):
            return None
        return float(self.there(asked).parameter(self.across))

    @property
    def drawn(self) -> tuple[Branch, ...]:
        """The branches that belong into the diagram: none where another parameter is swept, or in another scene."""
        asked, found = self.file.followed, self.branches or ()
        return found if asked and asked.parameter == self.across and self._is_inside(asked) else ()

    def _is_inside(self, asked):
        """Whether the scene that a table is about is that of the diagram, but for its parameter."""
        here = self.base
        there = changed(self.there(asked), {self.across: here.parameter(self.across)})
        return all(float(here.parameter(key)) == float(there.parameter(key)) for key in here.names)

    @property
    def others(self) -> tuple[Orbit, ...]:
        """The orbits that are not among the attractors, mirror images being places in this tuple."""
        asked, orbits = self.file, self.orbits or ()
        if asked.attractors is None or asked.orbits is None or asked.attractors.at != asked.orbits.at:
            return orbits
        kept = [k for k, one in enumerate(orbits) if not any(_is_on(one, other) for other in self.attractors or ())]
        places: dict[int | None, int] = {old: new for new, old in enumerate(kept)}
        return tuple(replace(orbits[k], mirror_of=places.get(orbits[k].mirror_of)) for k in kept)


def study(file, record=None, progress=False, store=None):
    """Does what a `SceneFile` asks: `Found`. record: the one that it names; progress: show bars on stderr; store: where
    a [map] is kept.

    Raises SceneError where the start of a branch settles on no orbit that can be followed, and where a record holds
    less than is asked of it.
    """
    scene = file.scene.make()
    swept, attractors, orbits, branches, diagram, curves = None, None, None, None, None, (None, None)
    fit = None if file.fit is None else _fit(scene, file.fit, record)  # first, as what is asked may not be in a record
    if file.branch is not None:  # and this, as its start may turn out to be none
        branches = _branches(scene.replace(**file.branch.at), file.branch, progress)
    if file.explore is not None:
        diagram = _explored(scene.replace(**file.explore.at), file.explore, progress)
        branches = diagram.branches
    if file.locus is not None:
        curves = _loci(branches, file.locus, progress)
    if file.sweep is not None:
        swept = _legs(scene, file.sweep, progress)
    if file.attractors is not None:
        attractors = _attractors(scene.replace(**file.attractors.at), file.attractors, progress)
    if file.orbits is not None:
        orbits = _orbits(scene.replace(**file.orbits.at), file.orbits, progress)
    near = None if file.margin is None else _margin(scene.replace(**file.margin.at), file.margin)
    mapped = None if file.map is None else _map(scene.replace(**file.map.at), file.map, progress, store)
    if swept is attractors is orbits is branches is near is fit is mapped is None:
        swept = _rest(scene)
    return Found(file, scene, swept, attractors, orbits, branches, diagram, *curves, near, fit, record, mapped)


def _legs(scene, table, progress):
    """The legs of a sweep as lanes of one: they are run side by side."""
    values = np.stack([table.values(leg) for leg in table.legs], axis=-1)
    start = State(*(np.array([getattr(leg.start, key) for leg in table.legs]) for key in ("x", "v")))
    with tqdm(desc="sweep", total=len(values), unit=" values", mininterval=0.5, disable=not progress) as bar:
        settings = {"progress": lambda n: bar.update(n - bar.n), "max_seconds": table.max_seconds}
        swept = sweep(scene, table.parameter, values, start, table.settle, table.keep, **settings)
    if "stopped" in swept.attrs:  # the values that are done
        swept = swept.isel(step=(swept["status"] >= 0).all("lane").values)
    return _named(swept, [leg.name for leg in table.legs])


def _attractors(scene, table, progress):
    with tqdm(desc="attractors", total=table.starts, unit=" starts", disable=not progress) as bar:
        found = find_attractors(scene, table.starts, table.seed, max_seconds=table.max_seconds)
        bar.update(table.starts)
    return found


def _orbits(scene, table, progress):
    with tqdm(desc="orbits", total=table.starts, unit=" starts", disable=not progress) as bar:
        found = find_orbits(scene, table.max_period, table.starts, table.seed)
        bar.update(table.starts)
    return found


def _branches(scene, table, progress):
    with tqdm(desc="branches", unit=" branches", disable=not progress) as bar:
        try:
            orbit = find_orbit(scene, State(table.start.x, table.start.v), settle=table.settle)
            found = followed(
                orbit,
                table.parameter,
                table.bounds,
                table.max_period,
                lambda n: bar.update(n - bar.n),
                largest_step=table.largest_step,
                max_seconds=table.max_seconds,
            )
        except OrbitError as error:
            rule = f"must settle on an orbit that can be followed ({error})"
            raise SceneError("branch.start", rule, {"x": table.start.x, "v": table.start.v}) from None
        bar.update(len(found) - bar.n)
    return found


def _explored(scene, table, progress):
    settings = {"max_period": table.max_period, "seed": table.seed, "budget": table.budget}
    settings["max_seconds"] = table.max_seconds
    with tqdm(desc="explore", unit=" branches", disable=not progress) as bar:
        try:
            return explore(
                scene, table.parameter, table.bounds, **settings, progress=lambda number: bar.update(number - bar.n)
            )
        except ArgumentError as error:
            raise SceneError(f"explore.{error.key}", error.rule, error.value, error.index) from None


def _loci(branches, table, progress):
    total = count(branches, table.bounds, table.kinds)
    with tqdm(desc="loci", total=total, unit=" points", disable=not progress) as bar:
        return loci(
            branches,
            table.parameters,
            table.bounds,
            table.kinds,
            table.largest_step,
            lambda number: bar.update(number - bar.n),
            table.max_seconds,
        )


def _is_on(orbit, attractor):
    """Whether an orbit's state is a point of a periodic attractor."""
    if orbit.state.phase or not attractor.periods:
        return False
    point = np.array([orbit.state.x, orbit.state.v])
    return bool(abs(attractor.points - point).max(axis=1).min() <= SAME * (1.0 + abs(point).max()))


def _margin(scene, table):
    try:
        orbit = find_orbit(scene, State(table.start.x, table.start.v), settle=table.settle)
        settings = table.kinds, table.directions, table.seed
        return margin(orbit, table.free, table.bounds, *settings, max_seconds=table.max_seconds)
    except OrbitError as error:
        rule = f"must settle on an orbit that can be followed ({error})"
        raise SceneError("margin.start", rule, {"x": table.start.x, "v": table.start.v}) from None


def _fit(scene, table, record):
    try:
        return fitted(scene, record, table.free, table.bounds)
    except ArgumentError as error:
        raise SceneError(f"fit.{error.key}", error.rule, error.value, error.index) from None


def _map(scene, table, progress, store):
    with _cells_bar(not progress) as report:
        return map_parameters(scene, **table.arguments, store=store, progress=report, max_seconds=table.max_seconds)


@contextmanager
def _cells_bar(silent):
    """What is to be called with each `Progress`: a bar on stderr, with rate, time left and what is undecided."""
    with tqdm(desc="map", unit=" cells", unit_scale=True, mininterval=0.5, disable=silent) as bar:

        def report(progress):
            if bar.total is None:
                bar.reset(progress.total)
                bar.initial = bar.n = progress.done
            bar.set_postfix(undecided=progress.undecided, refresh=False)
            bar.update(progress.done - bar.n)

        yield report


def _rest(scene):
    """The motion from rest at 0, or at the wall in the way of that, as a sweep of one value."""
    start = jax.tree.map(lambda leaf: np.reshape(leaf, 1), fit(scene, State(0.0, 0.0)))
    found = sweep(scene, "amplitude", np.reshape(scene.amplitude, (1, 1)), start, SETTLE, KEEP)
    return _named(found, ["rest"])


def _named(swept, legs):
    return swept.rename(lane="leg").assign_coords(leg=legs)

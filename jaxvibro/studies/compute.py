"""Run the analyses of a scene file: sweep, attractors, orbits, branches, loci, map; else the motion from rest."""

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
from ..branches.branch_tree import follow_tree
from ..branches.diagram import Diagram
from ..branches.explore import explore
from ..design.fit import fit as fitted
from ..design.fitted import Fit
from ..design.margin import Margin, margin
from ..design.records import ImpactRecord, SampleRecord
from ..flight.wall_positions import clamp_to_walls
from ..loci.loci import count_points, follow_loci
from ..loci.locus import Locus
from ..orbits.find import find_orbit
from ..orbits.find_orbits import find_orbits
from ..orbits.orbit import Orbit, OrbitError
from ..scene.check import ArgumentError, SceneError
from ..scene.scene import Scene, replace_unchecked
from ..scene.state import State
from ..surveys.map import map_parameters
from .schema import AttractorsTable, BranchTable, ExploreTable, MarginTable, OrbitsTable, SceneFile
from .sweep_periods import Stretch, find_stretches

# Tables with values `at`.
TableWithValues = AttractorsTable | OrbitsTable | BranchTable | ExploreTable | MarginTable | None

DEFAULT_SETTLE, DEFAULT_KEEP = 300, 100  # drive periods from rest, without a sweep
STATE_TOLERANCE = 1e-6  # relative distance within which the states of an orbit and an attractor are equal


@dataclass(frozen=True)
class StudyResults:
    """Results of the analyses of a scene file; each is None if the file does not request it.

    swept is the Dataset of `sweep` with a dimension `leg`; without analyses it has one value and a leg "rest". branches
    are those of `follow_tree`, or those of the `Diagram` of `explore` in diagram. loci and refused_points are the
    results of `follow_loci`. record is the data of the fit.
    """

    file: SceneFile
    scene: Scene
    swept: xr.Dataset | None
    attractors: tuple[Attractor, ...] | None
    orbits: tuple[Orbit, ...] | None
    branches: tuple[Branch, ...] | None = None
    diagram: Diagram | None = None
    loci: tuple[Locus, ...] | None = None
    refused_points: tuple[tuple[Special, str], ...] | None = None
    margin: Margin | None = None
    fit: Fit | None = None
    record: ImpactRecord | SampleRecord | None = None
    map: xr.Dataset | None = None

    @cached_property
    def stretches(self) -> list[Stretch]:
        """Stretches of the swept diagram, empty without a sweep."""
        if self.swept is None:
            return []
        return find_stretches(
            self.swept, self.scene, DEFAULT_SETTLE if self.file.sweep is None else self.file.sweep.settle
        )

    @property
    def diagram_parameter(self) -> str | None:
        """Parameter of the diagram, that of the sweep or else of the branches; None without a diagram."""
        table = self.file.sweep or self.file.branch_table
        return None if table is None else table.parameter

    @property
    def diagram_scene(self) -> Scene:
        """Scene of the diagram, except for its parameter."""
        return self.scene if self.file.sweep is not None else self.scene_of_table(self.file.branch_table)

    def scene_of_table(self, table: TableWithValues) -> Scene:
        """Return the scene of a table with values `at`; for None the scene of the file."""
        return self.scene if table is None else self.scene.replace(**table.at)

    def diagram_value(self, table: TableWithValues) -> float | None:
        """Return the value of the diagram's parameter for results of a table, None if they do not belong to it."""
        if table is None or self.diagram_parameter is None or not self._is_in_diagram(table):
            return None
        return float(self.scene_of_table(table).parameter(self.diagram_parameter))

    @property
    def diagram_branches(self) -> tuple[Branch, ...]:
        """Branches that belong to the diagram: none for another parameter or another scene."""
        table, branches = self.file.branch_table, self.branches or ()
        return branches if table and table.parameter == self.diagram_parameter and self._is_in_diagram(table) else ()

    def _is_in_diagram(self, table):
        """Return True if the scene of a table is that of the diagram, except for its parameter."""
        diagram_scene = self.diagram_scene
        table_scene = replace_unchecked(
            self.scene_of_table(table), {self.diagram_parameter: diagram_scene.parameter(self.diagram_parameter)}
        )
        return all(
            float(diagram_scene.parameter(key)) == float(table_scene.parameter(key)) for key in diagram_scene.names
        )

    @property
    def other_orbits(self) -> tuple[Orbit, ...]:
        """Orbits that are not among the attractors; mirror images are indices of this tuple."""
        file, orbits = self.file, self.orbits or ()
        if file.attractors is None or file.orbits is None or file.attractors.at != file.orbits.at:
            return orbits
        indices = [
            k
            for k, orbit in enumerate(orbits)
            if not any(_lies_on_attractor(orbit, attractor) for attractor in self.attractors or ())
        ]
        new_indices: dict[int | None, int] = {old_index: new_index for new_index, old_index in enumerate(indices)}
        return tuple(replace(orbits[k], mirror_of=new_indices.get(orbits[k].mirror_of)) for k in indices)


def run_studies(file, record=None, progress=False, store=None):
    """Run the analyses of a scene file.

    Parameters
    ----------
    file : SceneFile
        Tables of the file.
    record : ImpactRecord or SampleRecord, optional
        Record of a [fit].
    progress : bool, optional
        Show progress bars on stderr.
    store : Store, optional
        Store of a [map].

    Returns
    -------
    StudyResults
        The results.

    Raises
    ------
    SceneError
        If no orbit that can be continued is found at the start of a branch, or a record has less data than the fit
        needs.
    """
    scene = file.scene.make()
    sweep_data, attractors, orbits, branches, diagram, loci_results = None, None, None, None, None, (None, None)
    # The fit and the branch run first: a record may not suffice for the fit, and a start may lead to no orbit.
    fit = None if file.fit is None else _fit_record(scene, file.fit, record)
    if file.branch is not None:
        branches = _follow_branches(scene.replace(**file.branch.at), file.branch, progress)
    if file.explore is not None:
        diagram = _explore(scene.replace(**file.explore.at), file.explore, progress)
        branches = diagram.branches
    if file.locus is not None:
        loci_results = _follow_loci(branches, file.locus, progress)
    if file.sweep is not None:
        sweep_data = _run_sweep(scene, file.sweep, progress)
    if file.attractors is not None:
        attractors = _find_attractors(scene.replace(**file.attractors.at), file.attractors, progress)
    if file.orbits is not None:
        orbits = _find_orbits(scene.replace(**file.orbits.at), file.orbits, progress)
    margin_result = None if file.margin is None else _compute_margin(scene.replace(**file.margin.at), file.margin)
    map_data = None if file.map is None else _compute_map(scene.replace(**file.map.at), file.map, progress, store)
    if sweep_data is attractors is orbits is branches is margin_result is fit is map_data is None:
        sweep_data = _motion_from_rest(scene)
    return StudyResults(
        file,
        scene,
        sweep_data,
        attractors,
        orbits,
        branches,
        diagram,
        *loci_results,
        margin_result,
        fit,
        record,
        map_data,
    )


def _run_sweep(scene, table, progress):
    """Run the legs of a sweep side by side, as lanes."""
    values = np.stack([table.values(leg) for leg in table.legs], axis=-1)
    start = State(*(np.array([getattr(leg.start, key) for leg in table.legs]) for key in ("x", "v")))
    with tqdm(desc="sweep", total=len(values), unit=" values", mininterval=0.5, disable=not progress) as bar:
        settings = {"progress": lambda n_done: bar.update(n_done - bar.n), "max_seconds": table.max_seconds}
        sweep_data = sweep(scene, table.parameter, values, start, table.settle, table.keep, **settings)
    if "stopped" in sweep_data.attrs:  # keeps the completed values
        sweep_data = sweep_data.isel(step=(sweep_data["status"] >= 0).all("lane").values)
    return _name_legs(sweep_data, [leg.name for leg in table.legs])


def _find_attractors(scene, table, progress):
    with tqdm(desc="attractors", total=table.starts, unit=" starts", disable=not progress) as bar:
        attractors = find_attractors(scene, table.starts, table.seed, max_seconds=table.max_seconds)
        bar.update(table.starts)
    return attractors


def _find_orbits(scene, table, progress):
    with tqdm(desc="orbits", total=table.starts, unit=" starts", disable=not progress) as bar:
        orbits = find_orbits(scene, table.max_period, table.starts, table.seed)
        bar.update(table.starts)
    return orbits


def _follow_branches(scene, table, progress):
    with tqdm(desc="branches", unit=" branches", disable=not progress) as bar:
        try:
            orbit = find_orbit(scene, State(table.start.x, table.start.v), settle=table.settle)
            branches = follow_tree(
                orbit,
                table.parameter,
                table.bounds,
                table.max_period,
                lambda n_branches: bar.update(n_branches - bar.n),
                largest_step=table.largest_step,
                max_seconds=table.max_seconds,
            )
        except OrbitError as error:
            rule = f"must lead to an orbit that can be followed ({error})"
            raise SceneError("branch.start", rule, {"x": table.start.x, "v": table.start.v}) from None
        bar.update(len(branches) - bar.n)
    return branches


def _explore(scene, table, progress):
    settings = {"max_period": table.max_period, "seed": table.seed, "budget": table.budget}
    settings["max_seconds"] = table.max_seconds
    with tqdm(desc="explore", unit=" branches", disable=not progress) as bar:
        try:
            return explore(
                scene,
                table.parameter,
                table.bounds,
                **settings,
                progress=lambda n_branches: bar.update(n_branches - bar.n),
            )
        except ArgumentError as error:
            raise SceneError(f"explore.{error.key}", error.rule, error.value, error.index) from None


def _follow_loci(branches, table, progress):
    total = count_points(branches, table.bounds, table.kinds)
    with tqdm(desc="loci", total=total, unit=" points", disable=not progress) as bar:
        return follow_loci(
            branches,
            table.parameters,
            table.bounds,
            table.kinds,
            table.largest_step,
            lambda n_points: bar.update(n_points - bar.n),
            table.max_seconds,
        )


def _lies_on_attractor(orbit, attractor):
    """Return True if the state of an orbit is a point of a periodic attractor."""
    if orbit.state.phase or not attractor.periods:
        return False
    point = np.array([orbit.state.x, orbit.state.v])
    return bool(abs(attractor.points - point).max(axis=1).min() <= STATE_TOLERANCE * (1.0 + abs(point).max()))


def _compute_margin(scene, table):
    try:
        orbit = find_orbit(scene, State(table.start.x, table.start.v), settle=table.settle)
        settings = table.kinds, table.directions, table.seed
        return margin(orbit, table.free, table.bounds, *settings, max_seconds=table.max_seconds)
    except OrbitError as error:
        rule = f"must lead to an orbit that can be followed ({error})"
        raise SceneError("margin.start", rule, {"x": table.start.x, "v": table.start.v}) from None


def _fit_record(scene, table, record):
    try:
        return fitted(scene, record, table.free, table.bounds)
    except ArgumentError as error:
        raise SceneError(f"fit.{error.key}", error.rule, error.value, error.index) from None


def _compute_map(scene, table, progress, store):
    with _progress_bar(not progress) as report_progress:
        return map_parameters(
            scene, **table.arguments, store=store, progress=report_progress, max_seconds=table.max_seconds
        )


@contextmanager
def _progress_bar(silent):
    """Yield a function of each `Progress` that updates a bar on stderr."""
    with tqdm(desc="map", unit=" cells", unit_scale=True, mininterval=0.5, disable=silent) as bar:

        def report_progress(progress):
            if bar.total is None:
                bar.reset(progress.total)
                bar.initial = bar.n = progress.done
            bar.set_postfix(undecided=progress.undecided, refresh=False)
            bar.update(progress.done - bar.n)

        yield report_progress


def _motion_from_rest(scene):
    """Return the motion from rest at 0, or at the wall that excludes 0, as a sweep of one value."""
    start = jax.tree.map(lambda leaf: np.reshape(leaf, 1), clamp_to_walls(scene, State(0.0, 0.0)))
    sweep_data = sweep(scene, "amplitude", np.reshape(scene.amplitude, (1, 1)), start, DEFAULT_SETTLE, DEFAULT_KEEP)
    return _name_legs(sweep_data, ["rest"])


def _name_legs(sweep_data, leg_names):
    """Return the sweep with named legs in place of lanes."""
    return sweep_data.rename(lane="leg").assign_coords(leg=leg_names)

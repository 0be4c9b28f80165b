"""Run the analyses of a scene file, or simulate the motion from rest if the file has no analyses."""

from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial

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
from ..design.fit import fit
from ..design.fit_result import Fit
from ..design.margin import margin
from ..design.margin_result import Margin
from ..design.records import ImpactRecord, SampleRecord
from ..flight.wall_positions import adapt_to_moved_walls
from ..loci.loci_of_branches import count_points_to_follow, follow_loci
from ..loci.locus import Locus
from ..orbits.find import find_orbit, find_orbits
from ..orbits.orbit import Orbit, OrbitError
from ..scene.check import SceneError
from ..scene.scene import Scene, replace_unchecked
from ..scene.state import State
from ..surveys.map import map_parameters
from .schema import (
    AttractorsTable,
    BasinsTable,
    BranchTable,
    ExploreTable,
    MapTable,
    MarginTable,
    OrbitsTable,
    SceneFile,
)
from .sweep_periods import SweepStretch, find_sweep_stretches
from .validate import prefix_error_keys

# Tables with values `at`.
TableWithValues = (
    AttractorsTable | OrbitsTable | BranchTable | ExploreTable | MarginTable | BasinsTable | MapTable | None
)

DEFAULT_SETTLE, DEFAULT_KEEP = 300, 100  # drive periods from rest, without a sweep
STATE_TOLERANCE = 1e-6  # relative distance within which the states of an orbit and an attractor are equal


@dataclass(frozen=True)
class StudyResults:
    """Results of the analyses of a scene file; the results of analyses that the file does not request are None.

    Attributes
    ----------
    file : SceneFile
        Tables of the scene file.
    scene : Scene
        Scene of the file.
    swept : xarray.Dataset or None
        Result of `sweep` with a dimension ``leg``. If the file has no analyses, the sweep has one
        value and one leg, "rest".
    attractors : tuple of Attractor or None
        Attractors of the table [attractors].
    orbits : tuple of Orbit or None
        Periodic orbits of the table [orbits].
    branches : tuple of Branch or None
        Branches of the table [branch], or of the diagram.
    diagram : Diagram or None
        Diagram of the table [explore].
    loci : tuple of Locus or None
        Loci of the table [locus].
    refused_points : tuple of (Special, str) or None
        Special points whose loci were not continued, with the reasons.
    margin : Margin or None
        Margin of the table [margin].
    fit : Fit or None
        Fit of the table [fit].
    record : ImpactRecord or SampleRecord or None
        Measured record of the fit.
    map : xarray.Dataset or None
        Map of the table [map].
    """

    file: SceneFile
    scene: Scene
    swept: xr.Dataset | None = None
    attractors: tuple[Attractor, ...] | None = None
    orbits: tuple[Orbit, ...] | None = None
    branches: tuple[Branch, ...] | None = None
    diagram: Diagram | None = None
    loci: tuple[Locus, ...] | None = None
    refused_points: tuple[tuple[Special, str], ...] | None = None
    margin: Margin | None = None
    fit: Fit | None = None
    record: ImpactRecord | SampleRecord | None = None
    map: xr.Dataset | None = None

    @cached_property
    def stretches(self) -> list[SweepStretch]:
        """Stretches of the swept diagram with equal periods; empty without a sweep."""
        if self.swept is None:
            return []
        return find_sweep_stretches(
            self.swept, self.scene, DEFAULT_SETTLE if self.file.sweep is None else self.file.sweep.settle
        )

    @property
    def diagram_parameter(self) -> str | None:
        """Parameter of the sweep, or of the branches if the file has no sweep; None if the file has neither."""
        diagram_table = self.file.sweep or self.file.branch_table
        return None if diagram_table is None else diagram_table.parameter

    @property
    def diagram_scene(self) -> Scene:
        """Scene of the diagram; the value of the diagram's parameter has no meaning."""
        return self.scene if self.file.sweep is not None else self.scene_of_table(self.file.branch_table)

    def scene_of_table(self, analysis_table: TableWithValues) -> Scene:
        """Return the scene with the values in `at` of a table; the scene of the file if `analysis_table` is None."""
        return self.scene if analysis_table is None else self.scene.replace(**analysis_table.at)

    def diagram_value(self, analysis_table: TableWithValues) -> float | None:
        """Return the value of the diagram's parameter in the scene of a table.

        The value is None if the results of the table do not belong to the diagram.
        """
        if analysis_table is None or self.diagram_parameter is None or not self._is_in_diagram(analysis_table):
            return None
        return float(self.scene_of_table(analysis_table).parameter(self.diagram_parameter))

    @property
    def diagram_branches(self) -> tuple[Branch, ...]:
        """Branches that belong to the diagram; empty if their parameter or their scene differs from the diagram's."""
        branch_table, branches = self.file.branch_table, self.branches or ()
        return (
            branches
            if branch_table and branch_table.parameter == self.diagram_parameter and self._is_in_diagram(branch_table)
            else ()
        )

    def _is_in_diagram(self, analysis_table):
        """Return True if the scene of a table differs from that of the diagram at most in the diagram's parameter."""
        diagram_scene = self.diagram_scene
        table_scene = replace_unchecked(
            self.scene_of_table(analysis_table),
            {self.diagram_parameter: diagram_scene.parameter(self.diagram_parameter)},
        )
        return all(
            float(diagram_scene.parameter(parameter_name)) == float(table_scene.parameter(parameter_name))
            for parameter_name in diagram_scene.names
        )

    @property
    def other_orbits(self) -> tuple[Orbit, ...]:
        """Orbits of [orbits] that do not lie on an attractor; their `mirror_of` are indices of this tuple.

        If the tables [attractors] and [orbits] have different values in `at`, the tuple contains all orbits.
        """
        scene_file, orbits = self.file, self.orbits or ()
        if (
            scene_file.attractors is None
            or scene_file.orbits is None
            or scene_file.attractors.at != scene_file.orbits.at
        ):
            return orbits
        other_indices = [
            index
            for index, orbit in enumerate(orbits)
            if not any(_lies_on_attractor(orbit, attractor) for attractor in self.attractors or ())
        ]
        new_indices: dict[int | None, int] = {old_index: new_index for new_index, old_index in enumerate(other_indices)}
        return tuple(
            replace(orbits[index], mirror_of=new_indices.get(orbits[index].mirror_of)) for index in other_indices
        )


def run_studies(scene_file, measured_record=None, show_progress=False, map_store=None):
    """Run the analyses of a scene file.

    Parameters
    ----------
    scene_file : SceneFile
        Tables of the scene file.
    measured_record : ImpactRecord or SampleRecord, optional
        Measured record for a [fit].
    show_progress : bool, optional
        Show progress bars on stderr.
    map_store : Store, optional
        Store for a [map].

    Returns
    -------
    StudyResults
        Results of all analyses.

    Raises
    ------
    SceneError
        If the start of a branch or margin does not lead to an orbit that can be continued, or the record has less data
        than the fit needs.
    """
    results = StudyResults(scene_file, scene_file.scene.make(), record=measured_record)
    if scene_file.analyses.keys().isdisjoint({*_FUNCTION_BY_TABLE, "map"}):
        return replace(results, swept=_motion_from_rest(results.scene))
    progress_bar = partial(_progress_bar, disable=not show_progress)
    for table_name, run_analysis in _FUNCTION_BY_TABLE.items():
        if table_name in scene_file.analyses:
            results = replace(results, **run_analysis(results, scene_file.analyses[table_name], progress_bar))
    if scene_file.map is not None:
        results = replace(results, map=_compute_map(results, scene_file.map, show_progress, map_store))
    return results


@contextmanager
def _progress_bar(description, unit, total=None, **options):
    """Show a progress bar on stderr during the block; yield a function that sets the number of completed units."""
    with tqdm(desc=description, unit=f" {unit}", total=total, **options) as bar:
        yield lambda n_completed: bar.update(n_completed - bar.n)


def _run_sweep(results, sweep_table, progress_bar):
    """Run all legs of a sweep at the same time, as lanes."""
    leg_values = np.stack([sweep_table.values(leg) for leg in sweep_table.legs], axis=-1)
    initial_states = State(
        *(np.array([getattr(leg.start, coordinate_name) for leg in sweep_table.legs]) for coordinate_name in ("x", "v"))
    )
    with progress_bar("sweep", "values", len(leg_values), mininterval=0.5) as set_progress:
        sweep_data = sweep(
            results.scene,
            sweep_table.parameter,
            leg_values,
            initial_states,
            sweep_table.settle,
            sweep_table.keep,
            progress=set_progress,
            max_seconds=sweep_table.max_seconds,
        )
    if "stopped" in sweep_data.attrs:  # keeps the completed values
        sweep_data = sweep_data.isel(step=(sweep_data["status"] >= 0).all("lane").values)
    return {"swept": _name_legs(sweep_data, [leg.name for leg in sweep_table.legs])}


def _find_attractors(results, attractors_table, progress_bar):
    n_starts = attractors_table.starts
    with progress_bar("attractors", "starts", n_starts) as set_progress:
        attractors = find_attractors(
            results.scene_of_table(attractors_table),
            n_starts,
            attractors_table.seed,
            max_seconds=attractors_table.max_seconds,
        )
        set_progress(n_starts)
    return {"attractors": attractors}


def _find_orbits(results, orbits_table, progress_bar):
    scene, n_starts = results.scene_of_table(orbits_table), orbits_table.starts
    with progress_bar("orbits", "starts", n_starts) as set_progress:
        orbits = find_orbits(scene, orbits_table.max_period, n_starts, orbits_table.seed)
        set_progress(n_starts)
    return {"orbits": orbits}


def _follow_branches(results, branch_table, progress_bar):
    with (
        progress_bar("branches", "branches") as set_progress,
        _orbit_from_start("branch", results, branch_table) as orbit,
    ):
        branches = follow_tree(
            orbit,
            branch_table.parameter,
            branch_table.bounds,
            branch_table.max_period,
            set_progress,
            largest_step=branch_table.largest_step,
            max_seconds=branch_table.max_seconds,
        )
        set_progress(len(branches))
    return {"branches": branches}


@contextmanager
def _orbit_from_start(table_name, results, analysis_table):
    """Yield the orbit that the motion from the initial state of a table approaches.

    An OrbitError of the search or of the block becomes a SceneError for this initial state.
    """
    x, v = analysis_table.start.x, analysis_table.start.v
    try:
        yield find_orbit(results.scene_of_table(analysis_table), State(x, v), settle=analysis_table.settle)
    except OrbitError as error:
        rule = f"must lead to an orbit that can be followed ({error})"
        raise SceneError(f"{table_name}.start", rule, {"x": x, "v": v}) from None


def _explore(results, explore_table, progress_bar):
    with progress_bar("explore", "branches") as set_progress, prefix_error_keys("explore."):
        diagram = explore(
            results.scene_of_table(explore_table),
            explore_table.parameter,
            explore_table.bounds,
            max_period=explore_table.max_period,
            seed=explore_table.seed,
            budget=explore_table.budget,
            max_seconds=explore_table.max_seconds,
            progress=set_progress,
        )
    return {"diagram": diagram, "branches": diagram.branches}


def _follow_loci(results, locus_table, progress_bar):
    n_total_points = count_points_to_follow(results.branches, locus_table.bounds, locus_table.kinds)
    with progress_bar("loci", "points", n_total_points) as set_progress:
        loci, refused_points = follow_loci(
            results.branches,
            locus_table.parameters,
            locus_table.bounds,
            locus_table.kinds,
            locus_table.largest_step,
            set_progress,
            locus_table.max_seconds,
        )
    return {"loci": loci, "refused_points": refused_points}


def _compute_margin(results, margin_table, _):
    with _orbit_from_start("margin", results, margin_table) as orbit:
        margin_result = margin(
            orbit,
            margin_table.free,
            margin_table.bounds,
            margin_table.kinds,
            margin_table.directions,
            margin_table.seed,
            max_seconds=margin_table.max_seconds,
        )
    return {"margin": margin_result}


def _fit_parameters(results, fit_table, _):
    with prefix_error_keys("fit."):
        return {"fit": fit(results.scene, results.record, fit_table.free, fit_table.bounds)}


def _compute_map(results, map_table, show_progress, map_store):
    with tqdm(desc="map", unit=" cells", unit_scale=True, mininterval=0.5, disable=not show_progress) as bar:

        def report_progress(progress):
            if bar.total is None:
                bar.reset(progress.total)
                bar.initial = bar.n = progress.done
            bar.set_postfix(undecided=progress.undecided, refresh=False)
            bar.update(progress.done - bar.n)

        return map_parameters(
            results.scene_of_table(map_table),
            **map_table.arguments,
            store=map_store,
            progress=report_progress,
            max_seconds=map_table.max_seconds,
        )


# Functions that run the analysis of a table and return {field of `StudyResults`: value}, in the order of a run. The fit
# and the branch run first: a record may not suffice for the fit, and a start may lead to no orbit.
_FUNCTION_BY_TABLE = {
    "fit": _fit_parameters,
    "branch": _follow_branches,
    "explore": _explore,
    "locus": _follow_loci,
    "sweep": _run_sweep,
    "attractors": _find_attractors,
    "orbits": _find_orbits,
    "margin": _compute_margin,
}


def _lies_on_attractor(orbit, attractor):
    """Return True if the state of an orbit is a point of a periodic attractor."""
    if orbit.state.phase or not attractor.periods:
        return False
    orbit_point = np.array([orbit.state.x, orbit.state.v])
    return bool(
        abs(attractor.points - orbit_point).max(axis=1).min() <= STATE_TOLERANCE * (1.0 + abs(orbit_point).max())
    )


def _motion_from_rest(scene):
    """Return the motion from rest as a sweep with one value.

    The motion starts at 0, or at the nearest wall if 0 is not between the walls.
    """
    rest_state = jax.tree.map(lambda leaf: np.reshape(leaf, 1), adapt_to_moved_walls(scene, State(0.0, 0.0)))
    sweep_data = sweep(
        scene, "amplitude", np.reshape(scene.amplitude, (1, 1)), rest_state, DEFAULT_SETTLE, DEFAULT_KEEP
    )
    return _name_legs(sweep_data, ["rest"])


def _name_legs(sweep_data, leg_names):
    """Rename the dimension ``lane`` of a sweep to ``leg`` and add the names of the legs."""
    return sweep_data.rename(lane="leg").assign_coords(leg=leg_names)

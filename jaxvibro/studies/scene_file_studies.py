"""Run the analyses of a scene file, or simulate the motion from rest if the file has no analyses."""

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
from ..design.fit_result import Fit
from ..design.margin import Margin, margin
from ..design.records import ImpactRecord, SampleRecord
from ..flight.wall_positions import adapt_to_moved_walls
from ..loci.loci_of_branches import count_points_to_follow, follow_loci
from ..loci.locus import Locus
from ..orbits.find import find_orbit
from ..orbits.find_orbits import find_orbits
from ..orbits.orbit import Orbit, OrbitError
from ..scene.check import ArgumentError, SceneError
from ..scene.scene import Scene, replace_unchecked
from ..scene.state import State
from ..surveys.map import map_parameters
from .schema import AttractorsTable, BranchTable, ExploreTable, MarginTable, OrbitsTable, SceneFile
from .sweep_periods import SweepStretch, find_sweep_stretches

# Tables with values `at`.
TableWithValues = AttractorsTable | OrbitsTable | BranchTable | ExploreTable | MarginTable | None

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
    scene = scene_file.scene.make()
    sweep_data, attractors, orbits, branches, diagram, loci_and_refusals = None, None, None, None, None, (None, None)
    # The fit and the branch run first: a record may not suffice for the fit, and a start may lead to no orbit.
    fit = None if scene_file.fit is None else _fit_parameters(scene, scene_file.fit, measured_record)
    if scene_file.branch is not None:
        branches = _follow_branches(scene.replace(**scene_file.branch.at), scene_file.branch, show_progress)
    if scene_file.explore is not None:
        diagram = _explore(scene.replace(**scene_file.explore.at), scene_file.explore, show_progress)
        branches = diagram.branches
    if scene_file.locus is not None:
        loci_and_refusals = _follow_loci(branches, scene_file.locus, show_progress)
    if scene_file.sweep is not None:
        sweep_data = _run_sweep(scene, scene_file.sweep, show_progress)
    if scene_file.attractors is not None:
        attractors = _find_attractors(scene.replace(**scene_file.attractors.at), scene_file.attractors, show_progress)
    if scene_file.orbits is not None:
        orbits = _find_orbits(scene.replace(**scene_file.orbits.at), scene_file.orbits, show_progress)
    margin_result = (
        None if scene_file.margin is None else _compute_margin(scene.replace(**scene_file.margin.at), scene_file.margin)
    )
    map_data = (
        None
        if scene_file.map is None
        else _compute_map(scene.replace(**scene_file.map.at), scene_file.map, show_progress, map_store)
    )
    if sweep_data is attractors is orbits is branches is margin_result is fit is map_data is None:
        sweep_data = _motion_from_rest(scene)
    return StudyResults(
        scene_file,
        scene,
        sweep_data,
        attractors,
        orbits,
        branches,
        diagram,
        *loci_and_refusals,
        margin_result,
        fit,
        measured_record,
        map_data,
    )


def _run_sweep(scene, sweep_table, show_progress):
    """Run all legs of a sweep at the same time, as lanes."""
    leg_values = np.stack([sweep_table.values(leg) for leg in sweep_table.legs], axis=-1)
    initial_states = State(
        *(np.array([getattr(leg.start, coordinate_name) for leg in sweep_table.legs]) for coordinate_name in ("x", "v"))
    )
    with tqdm(
        desc="sweep", total=len(leg_values), unit=" values", mininterval=0.5, disable=not show_progress
    ) as progress_bar:
        sweep_settings = {
            "progress": lambda n_done: progress_bar.update(n_done - progress_bar.n),
            "max_seconds": sweep_table.max_seconds,
        }
        sweep_data = sweep(
            scene,
            sweep_table.parameter,
            leg_values,
            initial_states,
            sweep_table.settle,
            sweep_table.keep,
            **sweep_settings,
        )
    if "stopped" in sweep_data.attrs:  # keeps the completed values
        sweep_data = sweep_data.isel(step=(sweep_data["status"] >= 0).all("lane").values)
    return _name_legs(sweep_data, [leg.name for leg in sweep_table.legs])


def _find_attractors(scene, attractors_table, show_progress):
    with tqdm(
        desc="attractors", total=attractors_table.starts, unit=" starts", disable=not show_progress
    ) as progress_bar:
        attractors = find_attractors(
            scene, attractors_table.starts, attractors_table.seed, max_seconds=attractors_table.max_seconds
        )
        progress_bar.update(attractors_table.starts)
    return attractors


def _find_orbits(scene, orbits_table, show_progress):
    with tqdm(desc="orbits", total=orbits_table.starts, unit=" starts", disable=not show_progress) as progress_bar:
        orbits = find_orbits(scene, orbits_table.max_period, orbits_table.starts, orbits_table.seed)
        progress_bar.update(orbits_table.starts)
    return orbits


def _follow_branches(scene, branch_table, show_progress):
    with tqdm(desc="branches", unit=" branches", disable=not show_progress) as progress_bar:
        try:
            orbit = find_orbit(scene, State(branch_table.start.x, branch_table.start.v), settle=branch_table.settle)
            branches = follow_tree(
                orbit,
                branch_table.parameter,
                branch_table.bounds,
                branch_table.max_period,
                lambda n_branches: progress_bar.update(n_branches - progress_bar.n),
                largest_step=branch_table.largest_step,
                max_seconds=branch_table.max_seconds,
            )
        except OrbitError as error:
            rule = f"must lead to an orbit that can be followed ({error})"
            raise SceneError("branch.start", rule, {"x": branch_table.start.x, "v": branch_table.start.v}) from None
        progress_bar.update(len(branches) - progress_bar.n)
    return branches


def _explore(scene, explore_table, show_progress):
    explore_settings = {
        "max_period": explore_table.max_period,
        "seed": explore_table.seed,
        "budget": explore_table.budget,
    }
    explore_settings["max_seconds"] = explore_table.max_seconds
    with tqdm(desc="explore", unit=" branches", disable=not show_progress) as progress_bar:
        try:
            return explore(
                scene,
                explore_table.parameter,
                explore_table.bounds,
                **explore_settings,
                progress=lambda n_branches: progress_bar.update(n_branches - progress_bar.n),
            )
        except ArgumentError as error:
            raise SceneError(f"explore.{error.key}", error.rule, error.value, error.index) from None


def _follow_loci(branches, locus_table, show_progress):
    n_total_points = count_points_to_follow(branches, locus_table.bounds, locus_table.kinds)
    with tqdm(desc="loci", total=n_total_points, unit=" points", disable=not show_progress) as progress_bar:
        return follow_loci(
            branches,
            locus_table.parameters,
            locus_table.bounds,
            locus_table.kinds,
            locus_table.largest_step,
            lambda n_points: progress_bar.update(n_points - progress_bar.n),
            locus_table.max_seconds,
        )


def _lies_on_attractor(orbit, attractor):
    """Return True if the state of an orbit is a point of a periodic attractor."""
    if orbit.state.phase or not attractor.periods:
        return False
    orbit_point = np.array([orbit.state.x, orbit.state.v])
    return bool(
        abs(attractor.points - orbit_point).max(axis=1).min() <= STATE_TOLERANCE * (1.0 + abs(orbit_point).max())
    )


def _compute_margin(scene, margin_table):
    try:
        orbit = find_orbit(scene, State(margin_table.start.x, margin_table.start.v), settle=margin_table.settle)
        margin_settings = margin_table.kinds, margin_table.directions, margin_table.seed
        return margin(
            orbit, margin_table.free, margin_table.bounds, *margin_settings, max_seconds=margin_table.max_seconds
        )
    except OrbitError as error:
        rule = f"must lead to an orbit that can be followed ({error})"
        raise SceneError("margin.start", rule, {"x": margin_table.start.x, "v": margin_table.start.v}) from None


def _fit_parameters(scene, fit_table, measured_record):
    try:
        return fitted(scene, measured_record, fit_table.free, fit_table.bounds)
    except ArgumentError as error:
        raise SceneError(f"fit.{error.key}", error.rule, error.value, error.index) from None


def _compute_map(scene, map_table, show_progress, map_store):
    with _map_progress_bar(not show_progress) as progress_callback:
        return map_parameters(
            scene, **map_table.arguments, store=map_store, progress=progress_callback, max_seconds=map_table.max_seconds
        )


@contextmanager
def _map_progress_bar(is_silent):
    """Yield a function of `Progress` that updates a progress bar on stderr."""
    with tqdm(desc="map", unit=" cells", unit_scale=True, mininterval=0.5, disable=is_silent) as progress_bar:

        def report_progress(progress):
            if progress_bar.total is None:
                progress_bar.reset(progress.total)
                progress_bar.initial = progress_bar.n = progress.done
            progress_bar.set_postfix(undecided=progress.undecided, refresh=False)
            progress_bar.update(progress.done - progress_bar.n)

        yield report_progress


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

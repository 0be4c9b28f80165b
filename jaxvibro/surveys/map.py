"""Maps: what a scene settles on at each cell of a grid over any of its parameters."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Float, Real

from continuation.limits import limits_of

from ..attractors.sweep import UNITS_TEXT, equation_text, other_parameters, static_attributes
from ..flight.wall_positions import clamp_to_walls
from ..maps.initial_conditions import states_in_box
from ..output import label_codes
from ..output.units import scales_attributes, unit_of
from ..scene import check
from ..scene.codes import Status
from ..scene.scene import Scene
from ..scene.scene_table import scene_toml, scene_toml_or_empty
from ..scene.state import State, check_start
from ..scene.unit_mistakes import require_scene_units
from ..stores.filling import Progress, Store, complete_study
from ..stores.study import Column, Grid, fingerprint_axis
from . import cell_columns, coexisting_attractors
from .motions import classify_motions

MAX_CHUNK_LANES, MIN_CHUNK_LANES = (
    4096,
    512,
)  # of a chunk: the most, and the fewest where a small map is cut for many workers
MIN_CHUNKS = 16  # that it is cut into then
CARRIED_CHUNK_LANES = 512  # the same where motions are carried along: each row is then one lane's work from end to end
MAX_PERIODS = 5000  # drive periods after which a motion that has not recurred is called chaotic or undecided
DIRECTIONS = (1, -1)
QUANTITIES = ("label", "exponent")
REST_STATE = State(0.0, 0.0)


@check.host_only("use strobe")
def map_parameters(
    scene: Scene,
    grid: Mapping[str, Real[ArrayLike, " values"] | Sequence[float]],
    start: State | int = REST_STATE,
    quantities: str | Sequence[str] = QUANTITIES,
    along: str | None = None,
    settle: int = 300,
    patience: int = MAX_PERIODS,
    seed: int = 0,
    chunk: int | None = None,
    store: Store | None = None,
    progress: Callable[[Progress], object] | None = None,
    *,
    max_seconds: float | None = None,
) -> xr.Dataset:
    """What a scene settles on at each cell of a grid over some of its parameters: an xarray.Dataset.

    scene: a single one. grid: {name: values} of one parameter or more, dotted for a wall's, each a row in rising order;
    the first is the Dataset's first dimension. start: a `State` at which every cell starts, or so many random starts a
    cell, drawn from `seed` in each cell's `initial_conditions.box`, alike in all. along: the name of a parameter of the
    grid along which the motion is carried, from its first value up and from its last one down: the end at one value
    starts the next, as in `sweep`; a motion that is lost starts anew. settle: drive periods before recurrence is looked
    for, at each cell; patience: those after which a motion that has not recurred is called chaotic, where its exponent
    exceeds 0.01 by three standard errors, or undecided. chunk: lanes that are worked out together. store: a `Store` to
    keep the map in and to go on with; None: in memory. progress: called with a `Progress` after each chunk.

    quantities, of which label and status are always there: "label" and "period" (of the orbit; 0 chaotic, -1
    undecided); "exponent", with exponent_error: the largest, per drive period; "state": x, v, contact at the end, on
    Sigma; "loads": largest_speed and work_rate of each wall, as of `wall_loads`, over an orbit's periods, or 64 of
    another motion; with random starts "attractors", how many there are.

    Dataset, along the grid: label: a whole number (`label_codes`: 1000000 n + 1000 p + q of P n p q, 999 for inf, 1
    chaotic, 0 undecided, -1 not done); its flag_values and flag_meanings tell those that occur. status: the worst met.
    With `along` a dimension "way" more: 1 up, -1 down. With random starts a dimension "attractor", the largest share
    first, and share: of the starts, 0 beyond the last attractor; unresolved: of those that are undecided.

    max_seconds: wall-clock time, s, after which no chunk is begun; None is no limit. The label of a cell that is not
    done is -1, and the attribute `stopped` says why; a later call with the same store goes on.

    Raises ArgumentError for arguments that cannot be, before any work, and what the store raises.
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    study = make_study(scene, grid, start, quantities, along, settle, patience, seed, chunk)
    return add_label_flags(complete_study(study, store, progress, limits))


def add_label_flags(data: xr.Dataset) -> xr.Dataset:
    """A map's Dataset with the labels that occur in it."""
    codes = np.unique(data["label"].values).tolist()
    label_texts = " ".join(label_codes.label_of(code).replace(" ", "_") for code in codes)
    label = data["label"].assign_attrs(flag_values=np.array(codes, np.int32), flag_meanings=label_texts)
    return data.assign(label=label)


@dataclass(frozen=True)
class MapStudy:
    """A map as a `Study`. values: of each parameter of the grid; n_starts: how many random ones, 0 for those at
    `state`; carry_axis: the place of the parameter that is carried along, None for none; chunk_lanes: lanes of a
    chunk."""

    scene: Scene
    names: tuple[str, ...]
    values: tuple[Float[np.ndarray, " values"], ...]
    state: State
    n_starts: int
    quantities: tuple[str, ...]
    carry_axis: int | None
    settle: int
    max_periods: int
    seed: int
    chunk_lanes: int

    @property
    def _lanes_per_cell(self):
        """Of a cell."""
        return len(DIRECTIONS) if self.carry_axis is not None else max(1, self.n_starts)

    @cached_property
    def grid(self) -> Grid:
        shape, capacity = [len(row) for row in self.values], max(1, self.chunk_lanes // self._lanes_per_cell)
        chunk_shape = list(shape)  # whole rows, as many as there is room for, of what is carried along all
        for axis in reversed(range(len(shape))):
            if axis != self.carry_axis:
                chunk_shape[axis] = -(-shape[axis] // -(-shape[axis] // capacity))  # of one size, as far as that goes
                capacity = capacity // chunk_shape[axis] if chunk_shape[axis] == shape[axis] else 1
        return Grid(dict(zip(self.names, shape, strict=True)), tuple(chunk_shape))

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        return cell_columns.make_columns(self.scene, self.quantities, self.carry_axis is not None, self.n_starts)

    @cached_property
    def identity(self) -> Mapping[str, str]:
        setting_values: dict[str, Any] = {
            "settle": self.settle,
            "patience": self.max_periods,
            "along": None if self.carry_axis is None else self.names[self.carry_axis],
        }
        if self.n_starts:
            setting_values |= {"starts": self.n_starts, "seed": self.seed}
        else:
            setting_values |= {"start": [float(value) for value in jax.tree.leaves(self.state)]}
        axis_rows = zip(self.names, self.values, strict=True)
        return {
            "scene": scene_toml(self._first_scene),
            **{name: fingerprint_axis(row) for name, row in axis_rows},
            **{name: repr(value) for name, value in setting_values.items()},
            "quantities": repr(self.quantities),
            "dtype": str(self.scene.dtype),
        }

    @property
    def _first_scene(self):
        """The scene of the first cell: what it had there itself does not matter."""
        return self.scene.replace(**{name: row[0] for name, row in zip(self.names, self.values, strict=True)})

    @cached_property
    def frame(self) -> xr.Dataset:
        coords: dict[str, Any] = {
            name: (name, row, {"long_name": name, "units": unit_of(name)})
            for name, row in zip(self.names, self.values, strict=True)
        }
        if self.carry_axis is not None:
            coords["way"] = (
                "way",
                np.array(DIRECTIONS),
                {"long_name": f"way of {self.names[self.carry_axis]}: 1 up, -1 down"},
            )
        attrs = {
            "equation": equation_text(self.scene),
            "units": UNITS_TEXT,
            **static_attributes(self.scene),
            **scales_attributes(self.scene),
        }
        common_names = set.intersection(*(set(other_parameters(self.scene, name)) for name in self.names))
        attrs |= {key: float(self.scene.parameter(key)) for key in self.scene.names if key in common_names}
        attrs |= {"settle": self.settle, "patience": self.max_periods, "walls": " ".join(self.scene.walls) or "none"}
        attrs |= {"along": self.names[self.carry_axis]} if self.carry_axis is not None else {}
        attrs |= {"starts": self.n_starts, "seed": self.seed} if self.n_starts else {}
        attrs["scene_file"] = scene_toml_or_empty(self._first_scene)
        return xr.Dataset(coords=coords, attrs=attrs)

    def compute(self, number: int, frame: Any) -> tuple[dict[str, np.ndarray], int]:
        cell_slices = self.grid.chunk_slices(number)
        values = [row[cell_slice] for row, cell_slice in zip(self.values, cell_slices, strict=True)]
        if self.carry_axis is not None:
            return self._compute_carried(values)
        shape = tuple(len(row) for row in values)
        cell_scenes = self._scene_at(np.repeat(_cell_values(values), self._lanes_per_cell, axis=1))
        state = self._start_state(cell_scenes, int(np.prod(shape)))
        cell_motions = classify_motions(cell_scenes, state, self.settle, self.max_periods)
        if not self.n_starts:
            columns = cell_columns.motion_columns(cell_scenes, cell_motions, self.columns)
            return _reshape_columns(columns, shape), int((columns["label"] == label_codes.UNDECIDED).sum())
        columns = coexisting_attractors.attractor_columns(cell_scenes, cell_motions, self.n_starts, self.columns)
        return _reshape_columns(columns, shape), int((columns["unresolved"] > 0).sum())

    def _scene_at(self, cell_values):
        """The scene of each of some cells, (parameters, cells)."""
        return self.scene.replace(**dict(zip(self.names, cell_values, strict=True)))

    def _start_state(self, cell_scenes, n_cells):
        if self.n_starts:
            draws = np.random.default_rng(self.seed).random((self.n_starts, 2))
            return states_in_box(cell_scenes, np.tile(draws, (n_cells, 1)))
        return jax.tree.map(lambda leaf: np.full(n_cells * self._lanes_per_cell, leaf, self.scene.dtype), self.state)

    def _compute_carried(self, values):
        """As `compute`, of rows along which the motion is carried both ways."""
        rows, carry_axis = [row for step, row in enumerate(values) if step != self.carry_axis], self.carry_axis
        lane_values = _cell_values(rows) if rows else np.empty((0, 1))
        lane_values, n_rows, n_values = (
            np.repeat(lane_values, len(DIRECTIONS), axis=1),
            lane_values.shape[1],
            len(values[carry_axis]),
        )
        start_state = state = jax.tree.map(
            lambda leaf: np.full(n_rows * len(DIRECTIONS), leaf, self.scene.dtype), self.state
        )
        step_columns: list[dict[str, np.ndarray]] = []
        for step in range(n_values):
            step_values = np.tile(values[carry_axis][[step, n_values - 1 - step]], n_rows)
            lane_scenes = self._scene_at(np.insert(lane_values, carry_axis, step_values, axis=0))
            lane_motions = classify_motions(
                lane_scenes, clamp_to_walls(lane_scenes, state), self.settle, self.max_periods
            )
            step_columns.append(cell_columns.motion_columns(lane_scenes, lane_motions, self.columns))
            state = jax.tree.map(
                lambda start_leaf, leaf, invalid=lane_motions.status >= Status.CAP: np.where(invalid, start_leaf, leaf),
                start_state,
                lane_motions.state,
            )
        n_undecided = sum(
            int((columns_at_step["label"] == label_codes.UNDECIDED).sum()) for columns_at_step in step_columns
        )
        shape, columns = [len(row) for row in rows], {}
        for name in step_columns[0]:
            array = np.stack(
                [
                    columns_at_step[name].reshape(n_rows, len(DIRECTIONS), *columns_at_step[name].shape[1:])
                    for columns_at_step in step_columns
                ]
            )
            array = np.stack([array[:, :, 0], array[::-1, :, 1]], axis=2)  # both in the order of the values
            array = array.reshape(n_values, *shape, *array.shape[2:])
            columns[name] = np.moveaxis(array, 0, carry_axis)
        return columns, n_undecided


def _cell_values(rows):
    """The values at all cells, (parameters, cells), the last parameter fastest."""
    return np.stack([grid_values.ravel() for grid_values in np.meshgrid(*rows, indexing="ij")])


def _reshape_columns(columns, shape):
    return {name: array.reshape(*shape, *array.shape[1:]) for name, array in columns.items()}


def make_study(
    scene,
    grid,
    start=REST_STATE,
    quantities=QUANTITIES,
    along=None,
    settle=300,
    patience=MAX_PERIODS,
    seed=0,
    chunk=None,
):
    """The `MapStudy` of checked arguments. Raises ArgumentError."""
    check.require_single(scene)
    if not isinstance(grid, Mapping) or not grid:
        raise check.ArgumentError("grid", "must be {name: values} of one parameter or more", grid)
    values = []
    for name, row in grid.items():
        check.require_parameter(name, scene.names, name)
        row = check.finite_array(name, row, scene.dtype)
        if row.ndim != 1 or not len(row) or not (np.diff(row) > 0).all():
            raise check.ArgumentError(name, "must be a row of numbers in rising order, at least one", row)
        require_scene_units(f"grid.{name}", scene, name, row)
        values.append(row)
    names = tuple(grid)
    if along is not None and along not in names:
        raise check.ArgumentError("along", f"must be a parameter of the grid ({', '.join(names)}), or None", along)
    n_starts = 0 if isinstance(start, State) else check.whole_number("start", start, 1)
    if n_starts and along is not None:
        raise check.ArgumentError("start", "must be a State where the motion is carried along", start)
    quantities = cell_columns.check_quantities(scene, quantities, n_starts)
    settle, patience = check.whole_number("settle", settle, 0), check.whole_number("patience", patience, 1)
    n_lanes = math.prod(map(len, values)) * max(1, n_starts)
    default_lanes = (
        CARRIED_CHUNK_LANES if along is not None else min(MAX_CHUNK_LANES, max(MIN_CHUNK_LANES, n_lanes // MIN_CHUNKS))
    )
    chunk_lanes = default_lanes if chunk is None else check.whole_number("chunk", chunk, 1)
    state = REST_STATE if n_starts else _check_state(start)
    axis_values = [row.reshape([-1 if axis == k else 1 for axis in range(len(names))]) for k, row in enumerate(values)]
    cell_scenes = scene.replace(**dict(zip(names, axis_values, strict=True)))
    if not n_starts:
        check_start(cell_scenes, state, "at each cell")
    carry_axis = None if along is None else names.index(along)
    seed = check.whole_number("seed", seed, 0)
    return MapStudy(
        scene, names, tuple(values), state, n_starts, quantities, carry_axis, settle, patience, seed, chunk_lanes
    )


def _check_state(start_state):
    """A `State` of finite numbers."""
    components = {
        key: check.finite_array(f"start.{key}", getattr(start_state, key), np.float64)
        for key in ("x", "v", "phase", "contact")
    }
    for key, component in components.items():
        if component.shape:
            raise check.ArgumentError(f"start.{key}", "must be a number", component)
    return State(*(float(component) for component in components.values()))

"""Classify the motion at each cell of a grid over any parameters of a scene."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Float, Real

from continuation.branch_segment import make_limits

from ..attractors.dataset_attributes import other_parameters, survey_attributes
from ..attractors.survey_arguments import check_survey_values, is_increasing
from ..flight.wall_positions import adapt_to_moved_walls
from ..maps.initial_conditions import states_in_box
from ..output import label_codes
from ..output.units import unit_of
from ..scene import check
from ..scene.scene import Scene
from ..scene.scene_table import scene_toml, scene_toml_or_empty
from ..scene.state import State, Status, check_start_within_walls
from ..stores.study import Column, Grid, Progress, Store, complete_study, fingerprint_array
from . import map_columns
from .motion_classification import classify_motions

MAX_CHUNK_LANES, MIN_CHUNK_LANES = (
    4096,
    512,
)  # lanes of a chunk: the most, and the fewest if a small map is divided among many workers
MIN_CHUNKS = 16  # fewest chunks of a map, if they are not too small
CARRIED_CHUNK_LANES = 512  # lanes of a chunk if motions are carried along: each row is the work of one lane
MAX_PERIODS = 5000  # drive periods after which a motion without recurrence is chaotic or undecided
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
    """Classify the motion at each cell of a grid over parameters of the scene.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    grid : mapping of str to array_like
        Values of one or more parameters, for example of ``"amplitude"`` or ``"left.position"``. The values of each
        parameter must increase. The first parameter is the first dimension of the result.
    start : State or int, optional
        Initial state of every cell, or the number of random initial states of a cell. Random states are drawn from
        `seed` in the box of initial states of each cell, with the same relative positions in all cells.
    quantities : str or sequence of str, optional
        Quantities to compute: any of ``"label"``, ``"period"``, ``"exponent"``, ``"state"``, ``"loads"`` and, with
        random initial states, ``"attractors"``. The label and the status are always present.
    along : str, optional
        Parameter of the grid along which the motion is carried, upwards from its first value and downwards from its
        last one, as in `sweep`. After a status of CAP or worse the motion restarts from the initial
        state.
    settle : int, optional
        Drive periods at each cell before recurrence is tested.
    patience : int, optional
        Drive periods after which a motion that has not recurred is classified as chaotic, if its exponent exceeds 0.01
        by three standard errors, or else as undecided.
    seed : int, optional
        Seed of the random draw.
    chunk : int, optional
        Lanes that are computed together.
    store : Store, optional
        Store that keeps the map and from which the computation resumes. None keeps it in memory.
    progress : callable, optional
        Called with a `Progress` after each chunk.
    max_seconds : float, optional
        Wall-clock time, in s, after which no chunk is started. None is no limit.

    Returns
    -------
    xarray.Dataset
        Variables along the dimensions of the grid: ``label``, an integer (1000000 n + 1000 p + q for P n p q, 999 for
        inf, 1 chaotic, 0 undecided, -1 not done), whose attributes ``flag_values`` and ``flag_meanings`` list the
        labels that occur; ``status``, the worst status of the motion. With ``"period"``: drive periods of the orbit, 0
        chaotic, -1 undecided. With ``"exponent"``: the largest Lyapunov exponent per drive period, and
        ``exponent_error``. With ``"state"``: ``x``, ``v`` and ``contact`` on the section at the end. With ``"loads"``:
        ``largest_speed`` and ``work_rate`` of each wall, as in `wall_loads`, over the periods of the orbit, or over 64
        periods of a chaotic motion. With ``"attractors"``: the number of attractors. With `along` there is a dimension
        ``way``: 1 up, -1 down. With random initial states there is a dimension ``attractor``, the largest share first,
        and the variables ``share``, the fraction of the initial states, 0 beyond the last attractor, and
        ``unresolved``, the fraction that is undecided.

    Raises
    ------
    ArgumentError
        If an argument is invalid. All arguments are checked before any computation.

    See Also
    --------
    sweep : Sweep one parameter and record the stroboscopic states.
    basins : Compute the basins of attraction on a grid of initial states.

    Notes
    -----
    After `max_seconds`, cells that are not done have the label -1, and the attribute ``stopped`` gives the reason. A
    later call with the same store resumes. Exceptions of the store propagate.

    Examples
    --------
    >>> data = jv.map_parameters(scene, {"amplitude": [1.5, 2.0]})
    >>> data["label"].values.tolist(), data["exponent"].values.round(3).tolist()
    ([1000000, 1001001], [-0.15, -0.863])
    """
    computation_limits = make_limits(None, max_seconds, None, check.ArgumentError)
    map_study = make_map_study(scene, grid, start, quantities, along, settle, patience, seed, chunk)
    return add_flag_attributes(complete_study(map_study, store, progress, computation_limits))


def add_flag_attributes(data: xr.Dataset) -> xr.Dataset:
    """Add the labels that occur in a map as flags of its label variable.

    Parameters
    ----------
    data : xarray.Dataset
        Map with a variable ``label``.

    Returns
    -------
    xarray.Dataset
        Map whose label has the attributes ``flag_values`` and ``flag_meanings``.
    """
    cell_codes = np.unique(data["label"].values).tolist()
    label_texts = " ".join(label_codes.label_of(cell_code).replace(" ", "_") for cell_code in cell_codes)
    label_variable = data["label"].assign_attrs(flag_values=np.array(cell_codes, np.int32), flag_meanings=label_texts)
    return data.assign(label=label_variable)


@dataclass(frozen=True)
class MapStudy:
    """Map over parameters as a `Study`.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    names : tuple of str
        Parameters of the grid.
    values : tuple of ndarray
        Values of each parameter.
    state : State
        Initial state of every cell.
    n_starts : int
        Number of random initial states of a cell; 0 uses `state`.
    quantities : tuple of str
        Quantities to compute.
    carry_axis : int or None
        Index of the parameter along which the motion is carried.
    settle : int
        Drive periods before recurrence is tested.
    max_periods : int
        Drive periods after which a motion is classified without recurrence.
    seed : int
        Seed of the random draw.
    chunk_lanes : int
        Lanes of a chunk.
    """

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
        """Number of lanes of a cell."""
        return len(DIRECTIONS) if self.carry_axis is not None else max(1, self.n_starts)

    @cached_property
    def grid(self) -> Grid:
        """Grid of the cells, divided into chunks of nearly equal size."""
        grid_shape, max_chunk_cells = (
            [len(parameter_values) for parameter_values in self.values],
            max(1, self.chunk_lanes // self._lanes_per_cell),
        )
        chunk_shape = list(grid_shape)  # as many whole rows as fit; the carried parameter is not divided
        for axis_index in reversed(range(len(grid_shape))):
            if axis_index != self.carry_axis:
                chunk_shape[axis_index] = -(
                    -grid_shape[axis_index] // -(-grid_shape[axis_index] // max_chunk_cells)
                )  # of nearly equal size
                max_chunk_cells = (
                    max_chunk_cells // chunk_shape[axis_index]
                    if chunk_shape[axis_index] == grid_shape[axis_index]
                    else 1
                )
        return Grid(dict(zip(self.names, grid_shape, strict=True)), tuple(chunk_shape))

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        """Columns of a cell."""
        return map_columns.make_columns(self.scene, self.quantities, self.carry_axis is not None, self.n_starts)

    @cached_property
    def identity(self) -> Mapping[str, str]:
        """Texts that identify the study in a store."""
        setting_values: dict[str, Any] = {
            "settle": self.settle,
            "patience": self.max_periods,
            "along": None if self.carry_axis is None else self.names[self.carry_axis],
        }
        if self.n_starts:
            setting_values |= {"starts": self.n_starts, "seed": self.seed}
        else:
            setting_values |= {"start": [float(value) for value in jax.tree.leaves(self.state)]}
        named_axis_values = zip(self.names, self.values, strict=True)
        return {
            "scene": scene_toml(self._first_scene),
            **{name: fingerprint_array(parameter_values) for name, parameter_values in named_axis_values},
            **{name: repr(value) for name, value in setting_values.items()},
            "quantities": repr(self.quantities),
            "dtype": str(self.scene.dtype),
        }

    @property
    def _first_scene(self):
        """Scene of the first cell; the grid replaces the values of its parameters in `scene`."""
        return self.scene.replace(**{name: row[0] for name, row in zip(self.names, self.values, strict=True)})

    @cached_property
    def frame(self) -> xr.Dataset:
        """Coordinates and attributes of the map."""
        coords: dict[str, Any] = {
            name: (name, parameter_values, {"long_name": name, "units": unit_of(name)})
            for name, parameter_values in zip(self.names, self.values, strict=True)
        }
        if self.carry_axis is not None:
            coords["way"] = (
                "way",
                np.array(DIRECTIONS),
                {"long_name": f"way of {self.names[self.carry_axis]}: 1 up, -1 down"},
            )
        fixed_parameter_names = set.intersection(*(set(other_parameters(self.scene, name)) for name in self.names))
        attrs = {
            **survey_attributes(self.scene),
            **{key: float(self.scene.parameter(key)) for key in self.scene.names if key in fixed_parameter_names},
            "settle": self.settle,
            "patience": self.max_periods,
            **({"along": self.names[self.carry_axis]} if self.carry_axis is not None else {}),
            **({"starts": self.n_starts, "seed": self.seed} if self.n_starts else {}),
            "scene_file": scene_toml_or_empty(self._first_scene),
        }
        return xr.Dataset(coords=coords, attrs=attrs)

    def compute(self, number: int, frame: Any) -> tuple[dict[str, np.ndarray], int]:
        """Return the columns of a chunk, and the number of undecided cells."""
        cell_slices = self.grid.chunk_slices(number)
        chunk_axis_values = [
            parameter_values[cell_slice] for parameter_values, cell_slice in zip(self.values, cell_slices, strict=True)
        ]
        if self.carry_axis is not None:
            return self._compute_carried(chunk_axis_values)
        chunk_shape = tuple(len(parameter_values) for parameter_values in chunk_axis_values)
        cell_scenes = self._scene_at(np.repeat(_cell_values(chunk_axis_values), self._lanes_per_cell, axis=1))
        start_states = self._start_state(cell_scenes, int(np.prod(chunk_shape)))
        cell_motions = classify_motions(cell_scenes, start_states, self.settle, self.max_periods)
        if not self.n_starts:
            columns = map_columns.motion_columns(cell_scenes, cell_motions, self.columns)
            return _reshape_columns(columns, chunk_shape), int((columns["label"] == label_codes.UNDECIDED).sum())
        columns = map_columns.attractor_columns(cell_scenes, cell_motions, self.n_starts, self.columns)
        return _reshape_columns(columns, chunk_shape), int((columns["unresolved"] > 0).sum())

    def _scene_at(self, cell_values):
        """Return the scene with one lane per cell; cell_values: parameter values, (parameters, cells)."""
        return self.scene.replace(**dict(zip(self.names, cell_values, strict=True)))

    def _start_state(self, cell_scenes, n_cells):
        """Return the initial states of the lanes of some cells."""
        if self.n_starts:
            random_box_coordinates = np.random.default_rng(self.seed).random((self.n_starts, 2))
            return states_in_box(cell_scenes, np.tile(random_box_coordinates, (n_cells, 1)))
        return jax.tree.map(lambda leaf: np.full(n_cells * self._lanes_per_cell, leaf, self.scene.dtype), self.state)

    def _compute_carried(self, chunk_axis_values):
        """Return the result of `compute` if the motion is carried along a parameter, in both directions."""
        fixed_axis_values, carry_axis = (
            [
                parameter_values
                for axis_index, parameter_values in enumerate(chunk_axis_values)
                if axis_index != self.carry_axis
            ],
            self.carry_axis,
        )
        fixed_lane_values = _cell_values(fixed_axis_values) if fixed_axis_values else np.empty((0, 1))
        fixed_lane_values, n_fixed_cells, n_carried_values = (
            np.repeat(fixed_lane_values, len(DIRECTIONS), axis=1),
            fixed_lane_values.shape[1],
            len(chunk_axis_values[carry_axis]),
        )
        restart_state = state = jax.tree.map(
            lambda leaf: np.full(n_fixed_cells * len(DIRECTIONS), leaf, self.scene.dtype), self.state
        )
        columns_by_step: list[dict[str, np.ndarray]] = []
        for step_index in range(n_carried_values):
            carried_values = np.tile(
                chunk_axis_values[carry_axis][[step_index, n_carried_values - 1 - step_index]], n_fixed_cells
            )
            lane_scenes = self._scene_at(np.insert(fixed_lane_values, carry_axis, carried_values, axis=0))
            lane_motions = classify_motions(
                lane_scenes, adapt_to_moved_walls(lane_scenes, state), self.settle, self.max_periods
            )
            columns_by_step.append(map_columns.motion_columns(lane_scenes, lane_motions, self.columns))
            state = jax.tree.map(
                lambda start_leaf, leaf, invalid=lane_motions.status >= Status.CAP: np.where(invalid, start_leaf, leaf),
                restart_state,
                lane_motions.state,
            )
        n_undecided = sum(
            int((columns_at_step["label"] == label_codes.UNDECIDED).sum()) for columns_at_step in columns_by_step
        )
        shape, columns = [len(parameter_values) for parameter_values in fixed_axis_values], {}
        for name in columns_by_step[0]:
            array = np.stack(
                [
                    columns_at_step[name].reshape(n_fixed_cells, len(DIRECTIONS), *columns_at_step[name].shape[1:])
                    for columns_at_step in columns_by_step
                ]
            )
            array = np.stack([array[:, :, 0], array[::-1, :, 1]], axis=2)  # both directions in the order of the values
            array = array.reshape(n_carried_values, *shape, *array.shape[2:])
            columns[name] = np.moveaxis(array, 0, carry_axis)
        return columns, n_undecided


def _cell_values(axis_values):
    """Return the parameter values of all cells, (parameters, cells); the last parameter varies fastest."""
    return np.stack([values_on_grid.ravel() for values_on_grid in np.meshgrid(*axis_values, indexing="ij")])


def _reshape_columns(columns, shape):
    return {name: array.reshape(*shape, *array.shape[1:]) for name, array in columns.items()}


def make_map_study(
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
    """Check the arguments of `map_parameters` and return the study.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    grid : mapping of str to array_like
        Values of one or more parameters.
    start : State or int, optional
        Initial state, or number of random initial states.
    quantities : str or sequence of str, optional
        Quantities to compute.
    along : str, optional
        Parameter along which the motion is carried.
    settle : int, optional
        Drive periods before recurrence is tested.
    patience : int, optional
        Drive periods after which a motion is classified without recurrence.
    seed : int, optional
        Seed of the random draw.
    chunk : int, optional
        Lanes of a chunk.

    Returns
    -------
    MapStudy
        Study of the map.

    Raises
    ------
    ArgumentError
        If an argument is invalid.
    """
    check.require_single_scene(scene)
    if not isinstance(grid, Mapping) or not grid:
        raise check.ArgumentError("grid", "must be a mapping {name: values} of one or more parameters", grid)
    axis_values = [
        check_survey_values(
            scene,
            name,
            parameter_values,
            f"grid.{name}",
            "must be one or more numbers in increasing order",
            is_increasing,
        )
        for name, parameter_values in grid.items()
    ]
    names = tuple(grid)
    if along is not None and along not in names:
        raise check.ArgumentError("along", f"must be a parameter of the grid ({', '.join(names)}), or None", along)
    n_starts = 0 if isinstance(start, State) else check.check_whole_number("start", start, 1)
    if n_starts and along is not None:
        raise check.ArgumentError("start", "must be a State if the motion is carried along a parameter", start)
    quantities = map_columns.check_quantities(scene, quantities, n_starts)
    settle, patience = check.check_whole_number("settle", settle, 0), check.check_whole_number("patience", patience, 1)
    n_lanes = math.prod(map(len, axis_values)) * max(1, n_starts)
    default_chunk_lanes = (
        CARRIED_CHUNK_LANES if along is not None else min(MAX_CHUNK_LANES, max(MIN_CHUNK_LANES, n_lanes // MIN_CHUNKS))
    )
    chunk_lanes = default_chunk_lanes if chunk is None else check.check_whole_number("chunk", chunk, 1)
    state = REST_STATE if n_starts else _check_start_numbers(start)
    broadcast_values = [
        parameter_values.reshape(
            [-1 if other_axis_index == axis_index else 1 for other_axis_index in range(len(names))]
        )
        for axis_index, parameter_values in enumerate(axis_values)
    ]
    cell_scenes = scene.replace(**dict(zip(names, broadcast_values, strict=True)))
    if not n_starts:
        check_start_within_walls(cell_scenes, state, "at each cell")
    carry_axis = None if along is None else names.index(along)
    seed = check.check_whole_number("seed", seed, 0)
    return MapStudy(
        scene, names, tuple(axis_values), state, n_starts, quantities, carry_axis, settle, patience, seed, chunk_lanes
    )


def _check_start_numbers(start_state):
    """Check that the components of a state are single finite numbers and return the state."""
    components = {
        component_name: check.check_finite_array(
            f"start.{component_name}", getattr(start_state, component_name), np.float64
        )
        for component_name in ("x", "v", "phase", "contact")
    }
    for component_name, component in components.items():
        if component.shape:
            raise check.ArgumentError(f"start.{component_name}", "must be a number", component)
    return State(*(float(component) for component in components.values()))

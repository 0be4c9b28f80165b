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
        Values of one or more parameters, for example of ``"amplitude"`` or ``"left.position"``. Each row of values is
        increasing. The first parameter is the first dimension of the result.
    start : State or int, optional
        Initial state of every cell, or the number of random initial states of a cell. Random states are drawn from
        `seed` in the box of initial states of each cell, with the same relative positions in all cells.
    quantities : str or sequence of str, optional
        Quantities to compute, any of ``"label"``, ``"period"``, ``"exponent"``, ``"state"``, ``"loads"`` and, with
        random initial states, ``"attractors"``. The label and the status are always present.
    along : str, optional
        Parameter of the grid along which the motion is carried, upwards from its first value and downwards from its
        last one, as in `sweep`. A motion that is lost restarts from the initial state.
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
        labels that occur; ``status``, the worst of the motion. With ``"period"``: drive periods of the orbit, 0
        chaotic, -1 undecided. With ``"exponent"``: the largest Lyapunov exponent per drive period, and
        ``exponent_error``. With ``"state"``: ``x``, ``v`` and ``contact`` on the section at the end. With ``"loads"``:
        ``largest_speed`` and ``work_rate`` of each wall, as in `wall_loads`, over the periods of the orbit, or 64
        periods of another motion. With ``"attractors"``: the number of attractors. With `along` there is a dimension
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
    later call with the same store resumes. The errors of the store are passed on.

    Examples
    --------
    >>> data = jv.map_parameters(scene, {"amplitude": [1.5, 2.0]})
    >>> data["label"].values.tolist(), data["exponent"].values.round(3).tolist()
    ([1000000, 1001001], [-0.15, -0.863])
    """
    limits = limits_of(None, max_seconds, None, check.ArgumentError)
    study = make_study(scene, grid, start, quantities, along, settle, patience, seed, chunk)
    return add_label_flags(complete_study(study, store, progress, limits))


def add_label_flags(data: xr.Dataset) -> xr.Dataset:
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
    codes = np.unique(data["label"].values).tolist()
    label_texts = " ".join(label_codes.label_of(code).replace(" ", "_") for code in codes)
    label = data["label"].assign_attrs(flag_values=np.array(codes, np.int32), flag_meanings=label_texts)
    return data.assign(label=label)


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
        """Cells, cut into chunks of nearly equal size."""
        shape, capacity = [len(row) for row in self.values], max(1, self.chunk_lanes // self._lanes_per_cell)
        chunk_shape = list(shape)  # as many whole rows as fit; the carried parameter is not divided
        for axis in reversed(range(len(shape))):
            if axis != self.carry_axis:
                chunk_shape[axis] = -(-shape[axis] // -(-shape[axis] // capacity))  # of nearly equal size
                capacity = capacity // chunk_shape[axis] if chunk_shape[axis] == shape[axis] else 1
        return Grid(dict(zip(self.names, shape, strict=True)), tuple(chunk_shape))

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        """Columns of a cell."""
        return cell_columns.make_columns(self.scene, self.quantities, self.carry_axis is not None, self.n_starts)

    @cached_property
    def identity(self) -> Mapping[str, str]:
        """Texts that identify the map."""
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
        """Scene of the first cell; the scene's own values of the grid's parameters do not matter."""
        return self.scene.replace(**{name: row[0] for name, row in zip(self.names, self.values, strict=True)})

    @cached_property
    def frame(self) -> xr.Dataset:
        """Coordinates and attributes of the map."""
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
        """Return the columns of a chunk, and the number of undecided cells."""
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
        """Return the scene at each of some cells, (parameters, cells)."""
        return self.scene.replace(**dict(zip(self.names, cell_values, strict=True)))

    def _start_state(self, cell_scenes, n_cells):
        """Return the initial states of the lanes of some cells."""
        if self.n_starts:
            draws = np.random.default_rng(self.seed).random((self.n_starts, 2))
            return states_in_box(cell_scenes, np.tile(draws, (n_cells, 1)))
        return jax.tree.map(lambda leaf: np.full(n_cells * self._lanes_per_cell, leaf, self.scene.dtype), self.state)

    def _compute_carried(self, values):
        """Return the result of `compute` for rows along which the motion is carried in both directions."""
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
            array = np.stack([array[:, :, 0], array[::-1, :, 1]], axis=2)  # both directions in the order of the values
            array = array.reshape(n_values, *shape, *array.shape[2:])
            columns[name] = np.moveaxis(array, 0, carry_axis)
        return columns, n_undecided


def _cell_values(rows):
    """Return the values at all cells, (parameters, cells), the last parameter fastest."""
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
    check.require_single(scene)
    if not isinstance(grid, Mapping) or not grid:
        raise check.ArgumentError("grid", "must be a mapping {name: values} of one or more parameters", grid)
    values = []
    for name, row in grid.items():
        check.require_parameter(name, scene.names, name)
        row = check.finite_array(name, row, scene.dtype)
        if row.ndim != 1 or not len(row) or not (np.diff(row) > 0).all():
            raise check.ArgumentError(name, "must be one or more numbers in increasing order", row)
        require_scene_units(f"grid.{name}", scene, name, row)
        values.append(row)
    names = tuple(grid)
    if along is not None and along not in names:
        raise check.ArgumentError("along", f"must be a parameter of the grid ({', '.join(names)}), or None", along)
    n_starts = 0 if isinstance(start, State) else check.whole_number("start", start, 1)
    if n_starts and along is not None:
        raise check.ArgumentError("start", "must be a State if the motion is carried along a parameter", start)
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
    """Return the state with finite numbers, checked."""
    components = {
        key: check.finite_array(f"start.{key}", getattr(start_state, key), np.float64)
        for key in ("x", "v", "phase", "contact")
    }
    for key, component in components.items():
        if component.shape:
            raise check.ArgumentError(f"start.{key}", "must be a number", component)
    return State(*(float(component) for component in components.values()))

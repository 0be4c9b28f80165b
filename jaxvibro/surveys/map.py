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

from ..attractors.sweep import UNITS, equation, others, static
from ..flight.wall_positions import fit
from ..maps.initial_conditions import placed
from ..output import label_codes
from ..output.units import scales_in, unit_of
from ..scene import check
from ..scene.codes import Status
from ..scene.scene import Scene
from ..scene.scene_table import scene_text, scene_text_or_none
from ..scene.state import State, check_start
from ..scene.unit_slips import require_scene_units
from ..stores.filling import Progress, Store, done
from ..stores.study import Column, Grid, axis_text
from . import cell_columns, coexisting
from .motions import motions

LANES, FEWEST = 4096, 512  # of a chunk: the most, and the fewest where a small map is cut for many workers
PARTS = 16  # that it is cut into then
CARRIED = 512  # the same where motions are carried along: each row is then one lane's work from end to end
PATIENCE = 5000  # drive periods after which a motion that has not recurred is called chaotic or undecided
WAYS = (1, -1)
QUANTITIES = ("label", "exponent")
REST = State(0.0, 0.0)


@check.host("use strobe")
def map_parameters(
    scene: Scene,
    grid: Mapping[str, Real[ArrayLike, " values"] | Sequence[float]],
    start: State | int = REST,
    quantities: str | Sequence[str] = QUANTITIES,
    along: str | None = None,
    settle: int = 300,
    patience: int = PATIENCE,
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
    study = study_of(scene, grid, start, quantities, along, settle, patience, seed, chunk)
    return told(done(study, store, progress, limits))


def told(data: xr.Dataset) -> xr.Dataset:
    """A map's Dataset with the labels that occur in it."""
    found = np.unique(data["label"].values).tolist()
    words = " ".join(label_codes.label_of(code).replace(" ", "_") for code in found)
    label = data["label"].assign_attrs(flag_values=np.array(found, np.int32), flag_meanings=words)
    return data.assign(label=label)


@dataclass(frozen=True)
class MapStudy:
    """A map as a `Study`. values: of each parameter of the grid; starts: how many random ones, 0 for those at `state`;
    along: the place of the parameter that is carried along, None for none; size: lanes of a chunk."""

    scene: Scene
    names: tuple[str, ...]
    values: tuple[Float[np.ndarray, " values"], ...]
    state: State
    starts: int
    quantities: tuple[str, ...]
    along: int | None
    settle: int
    patience: int
    seed: int
    size: int

    @property
    def _lanes(self):
        """Of a cell."""
        return len(WAYS) if self.along is not None else max(1, self.starts)

    @cached_property
    def grid(self) -> Grid:
        shape, room = [len(each) for each in self.values], max(1, self.size // self._lanes)
        part = list(shape)  # whole rows, as many as there is room for, of what is carried along all
        for axis in reversed(range(len(shape))):
            if axis != self.along:
                part[axis] = -(-shape[axis] // -(-shape[axis] // room))  # of one size, as far as that goes
                room = room // part[axis] if part[axis] == shape[axis] else 1
        return Grid(dict(zip(self.names, shape, strict=True)), tuple(part))

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        return cell_columns.columns(self.scene, self.quantities, self.along is not None, self.starts)

    @cached_property
    def identity(self) -> Mapping[str, str]:
        given: dict[str, Any] = {
            "settle": self.settle,
            "patience": self.patience,
            "along": None if self.along is None else self.names[self.along],
        }
        if self.starts:
            given |= {"starts": self.starts, "seed": self.seed}
        else:
            given |= {"start": [float(each) for each in jax.tree.leaves(self.state)]}
        rows = zip(self.names, self.values, strict=True)
        return {
            "scene": scene_text(self._first),
            **{name: axis_text(row) for name, row in rows},
            **{name: repr(each) for name, each in given.items()},
            "quantities": repr(self.quantities),
            "dtype": str(self.scene.dtype),
        }

    @property
    def _first(self):
        """The scene of the first cell: what it had there itself does not matter."""
        return self.scene.replace(**{name: row[0] for name, row in zip(self.names, self.values, strict=True)})

    @cached_property
    def frame(self) -> xr.Dataset:
        coords: dict[str, Any] = {
            name: (name, row, {"long_name": name, "units": unit_of(name)})
            for name, row in zip(self.names, self.values, strict=True)
        }
        if self.along is not None:
            coords["way"] = ("way", np.array(WAYS), {"long_name": f"way of {self.names[self.along]}: 1 up, -1 down"})
        attrs = {"equation": equation(self.scene), "units": UNITS, **static(self.scene), **scales_in(self.scene)}
        common = set.intersection(*(set(others(self.scene, name)) for name in self.names))
        attrs |= {key: float(self.scene.parameter(key)) for key in self.scene.names if key in common}
        attrs |= {"settle": self.settle, "patience": self.patience, "walls": " ".join(self.scene.walls) or "none"}
        attrs |= {"along": self.names[self.along]} if self.along is not None else {}
        attrs |= {"starts": self.starts, "seed": self.seed} if self.starts else {}
        attrs["scene_file"] = scene_text_or_none(self._first)
        return xr.Dataset(coords=coords, attrs=attrs)

    def compute(self, number: int, frame: Any) -> tuple[dict[str, np.ndarray], int]:
        cut = self.grid.cut(number)
        values = [row[part] for row, part in zip(self.values, cut, strict=True)]
        if self.along is not None:
            return self._carried(values)
        shape = tuple(len(row) for row in values)
        here = self._there(np.repeat(_cells(values), self._lanes, axis=1))
        state = self._begun(here, int(np.prod(shape)))
        found = motions(here, state, self.settle, self.patience)
        if not self.starts:
            columns = cell_columns.of_motions(here, found, self.columns)
            return _shaped(columns, shape), int((columns["label"] == label_codes.UNDECIDED).sum())
        columns = coexisting.of_starts(here, found, self.starts, self.columns)
        return _shaped(columns, shape), int((columns["unresolved"] > 0).sum())

    def _there(self, cells):
        """The scene of each of some cells, (parameters, cells)."""
        return self.scene.replace(**dict(zip(self.names, cells, strict=True)))

    def _begun(self, here, cells):
        if self.starts:
            draws = np.random.default_rng(self.seed).random((self.starts, 2))
            return placed(here, np.tile(draws, (cells, 1)))
        return jax.tree.map(lambda leaf: np.full(cells * self._lanes, leaf, self.scene.dtype), self.state)

    def _carried(self, values):
        """As `compute`, of rows along which the motion is carried both ways."""
        rows, axis = [row for k, row in enumerate(values) if k != self.along], self.along
        lanes = _cells(rows) if rows else np.empty((0, 1))
        lanes, count, length = np.repeat(lanes, len(WAYS), axis=1), lanes.shape[1], len(values[axis])
        start = state = jax.tree.map(lambda leaf: np.full(count * len(WAYS), leaf, self.scene.dtype), self.state)
        parts: list[dict[str, np.ndarray]] = []
        for k in range(length):
            value = np.tile(values[axis][[k, length - 1 - k]], count)
            here = self._there(np.insert(lanes, axis, value, axis=0))
            found = motions(here, fit(here, state), self.settle, self.patience)
            parts.append(cell_columns.of_motions(here, found, self.columns))
            state = jax.tree.map(
                lambda old, new, bad=found.status >= Status.CAP: np.where(bad, old, new), start, found.state
            )
        undecided = sum(int((part["label"] == label_codes.UNDECIDED).sum()) for part in parts)
        shape, columns = [len(row) for row in rows], {}
        for name in parts[0]:
            whole = np.stack([part[name].reshape(count, len(WAYS), *part[name].shape[1:]) for part in parts])
            whole = np.stack([whole[:, :, 0], whole[::-1, :, 1]], axis=2)  # both in the order of the values
            whole = whole.reshape(length, *shape, *whole.shape[2:])
            columns[name] = np.moveaxis(whole, 0, axis)
        return columns, undecided


def _cells(rows):
    """The values at all cells, (parameters, cells), the last parameter fastest."""
    return np.stack([each.ravel() for each in np.meshgrid(*rows, indexing="ij")])


def _shaped(columns, shape):
    return {name: each.reshape(*shape, *each.shape[1:]) for name, each in columns.items()}


def study_of(
    scene, grid, start=REST, quantities=QUANTITIES, along=None, settle=300, patience=PATIENCE, seed=0, chunk=None
):
    """The `MapStudy` of checked arguments. Raises ArgumentError."""
    check.require_single(scene)
    if not isinstance(grid, Mapping) or not grid:
        raise check.ArgumentError("grid", "must be {name: values} of one parameter or more", grid)
    values = []
    for name, row in grid.items():
        check.require_known(name, scene.names, name)
        row = check.number(name, row, scene.dtype)
        if row.ndim != 1 or not len(row) or not (np.diff(row) > 0).all():
            raise check.ArgumentError(name, "must be a row of numbers in rising order, at least one", row)
        require_scene_units(f"grid.{name}", scene, name, row)
        values.append(row)
    names = tuple(grid)
    if along is not None and along not in names:
        raise check.ArgumentError("along", f"must be a parameter of the grid ({', '.join(names)}), or None", along)
    starts = 0 if isinstance(start, State) else check.whole("start", start, 1)
    if starts and along is not None:
        raise check.ArgumentError("start", "must be a State where the motion is carried along", start)
    quantities = cell_columns.checked(scene, quantities, starts)
    settle, patience = check.whole("settle", settle, 0), check.whole("patience", patience, 1)
    cells = math.prod(map(len, values)) * max(1, starts)
    usual = CARRIED if along is not None else min(LANES, max(FEWEST, cells // PARTS))
    size = usual if chunk is None else check.whole("chunk", chunk, 1)
    state = REST if starts else _single(start)
    edges = [row.reshape([-1 if axis == k else 1 for axis in range(len(names))]) for k, row in enumerate(values)]
    everywhere = scene.replace(**dict(zip(names, edges, strict=True)))
    if not starts:
        check_start(everywhere, state, "at each cell")
    place = None if along is None else names.index(along)
    seed = check.whole("seed", seed, 0)
    return MapStudy(scene, names, tuple(values), state, starts, quantities, place, settle, patience, seed, size)


def _single(start):
    """A `State` of finite numbers."""
    parts = {
        key: check.number(f"start.{key}", getattr(start, key), np.float64) for key in ("x", "v", "phase", "contact")
    }
    for key, each in parts.items():
        if each.shape:
            raise check.ArgumentError(f"start.{key}", "must be a number", each)
    return State(*(float(each) for each in parts.values()))

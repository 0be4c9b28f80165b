"""Sweep a parameter; the final state at each value is the initial state at the next value."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import lax
from jaxtyping import ArrayLike, Float, Real

from continuation.branch_segment import UNLIMITED, make_limits, partial_result_reason
from continuation.hostcall import persistent_jit

from ..compiled.kernel_calls import BLOCK_WIDTH
from ..compiled.lane_arithmetic import COMPILER_OPTIONS
from ..flight.wall_positions import adapt_to_moved_walls
from ..maps.strobe import strobe
from ..output.units import LENGTH, SPEED, unit_of
from ..scene import check
from ..scene.scene import Scene
from ..scene.scene_table import scene_toml
from ..scene.state import State, Status, check_start_within_walls
from ..stores.study import Column, Grid, Store, complete_study, fingerprint_array
from .dataset_attributes import STATUS_FLAGS, add_fixed_values, other_parameters, survey_attributes
from .survey_arguments import SEQUENCE_RULE, check_start_state, check_survey_values


@dataclass(frozen=True)
class SweepStudy:
    """Lanes of a sweep as a `Study`.

    Parameters
    ----------
    template_scene : Scene
        Scene of the first lane. It has the parameters that all lanes share.
    name : str
        Swept parameter.
    lane_inputs : tuple
        Scene with lanes, values of shape (count, lanes), and initial states.
    run_lanes : callable
        Function of scene, values, initial states, name and settings. Returns x and v of shape (count, lanes, keep) and
        status of shape (count, lanes).
    settings : tuple of int
        Drive periods discarded and recorded at each value.
    """

    template_scene: Scene
    name: str
    lane_inputs: tuple[Scene, Float[np.ndarray, "count lanes"], State]
    run_lanes: Callable[..., Any]
    settings: tuple[int, int]

    @cached_property
    def grid(self) -> Grid:
        """Grid of the lanes, divided into blocks."""
        return Grid({"lane": self.lane_inputs[1].shape[1]}, (BLOCK_WIDTH,))

    @property
    def columns(self) -> dict[str, Column]:
        """Columns x, v and status of each lane."""
        step_dims, float_dtype = {"step": len(self.lane_inputs[1])}, np.dtype(self.template_scene.dtype)
        columns = {
            name: Column(float_dtype, np.nan, {}, {**step_dims, "period": self.settings[1]}) for name in ("x", "v")
        }
        return columns | {"status": Column(np.dtype(np.int32), -1, {}, step_dims)}

    @cached_property
    def identity(self) -> dict[str, str]:
        """Texts that identify the study in a store."""
        scene, values, start_state = self.lane_inputs
        lane_values = {name: np.asarray(scene.parameter(name)) for name in scene.names if name != self.name}
        lane_values |= {
            f"start.{name}": np.asarray(getattr(start_state, name)) for name in ("x", "v", "phase", "contact")
        }
        return {
            "scene": scene_toml(self.template_scene),
            self.name: fingerprint_array(values),
            **{name: fingerprint_array(array) for name, array in lane_values.items()},
            "settings": repr(self.settings),
            "dtype": str(self.template_scene.dtype),
        }

    @property
    def frame(self) -> xr.Dataset:
        """Dataset without variables."""
        return xr.Dataset(attrs={"swept": self.name})

    def compute(self, number: int, frame: xr.Dataset) -> tuple[dict[str, np.ndarray], int]:
        """Return the columns of a block of lanes, and the number of values with a status of CAP or worse."""
        (block_slice,) = self.grid.chunk_slices(number)
        scene, values, start_state = self.lane_inputs
        block_inputs = jax.tree.map(lambda leaf: leaf[block_slice], (scene, start_state))
        x, v, status = self.run_lanes(
            block_inputs[0], values[:, block_slice], block_inputs[1], self.name, *self.settings
        )
        results = {"x": x, "v": v, "status": status}
        return {name: np.moveaxis(array, 1, 0) for name, array in results.items()}, int((status >= Status.CAP).sum())


VALUES_PER_CHUNK = 16  # values between two calls of `progress`


@check.host_only("use strobe")
def sweep(
    scene: Scene,
    name: str,
    values: Real[ArrayLike, "..."] | Sequence[float],
    state: State,
    settle: int = 300,
    keep: int = 100,
    chunk: int = VALUES_PER_CHUNK,
    progress: Callable[[int], object] | None = None,
    store: Store | None = None,
    *,
    max_seconds: float | None = None,
) -> xr.Dataset:
    """Sweep a parameter and record the stroboscopic states after a transient.

    The parameter takes the values in their order. The final state at each value is the initial state at the next value.
    The result is a bifurcation diagram by simulation.

    Parameters
    ----------
    scene : Scene
        Scene, single or with lanes.
    name : str
        Parameter of the scene, for example ``"amplitude"`` or ``"left.position"``.
    values : array_like
        Values of the parameter. Array of shape (count,), or (count, ...) with lanes: the first axis is the sequence of
        values, and the others broadcast with the scene and the state, as in `strobe`. Each lane is a sweep of its own.
    state : State
        Initial state at the first value; its fields broadcast with the lanes.
    settle : int, optional
        Drive periods discarded at each value.
    keep : int, optional
        Drive periods recorded at each value.
    chunk : int, optional
        Values between two calls of `progress`. It does not change the result.
    progress : callable, optional
        Called with the number of values done, or with a store with the number of lanes done.
    store : Store, optional
        Store that keeps the results of many lanes, 64 lanes at a time, and from which the sweep resumes. None keeps
        them in memory.
    max_seconds : float, optional
        Wall-clock time, in s, after which no chunk of values (with a store: of lanes) is started. None is no limit.

    Returns
    -------
    xarray.Dataset
        Variables ``x`` and ``v`` on the section at the phase of the state, with dimensions (name, lane, period), and
        ``status`` with dimensions (name, lane). Without lanes there is no dimension ``lane``; several axes of lanes are
        called ``lane_0``, ``lane_1``, ... If the values have lanes of their own, the first dimension is called ``step``
        and the values are a coordinate with dimensions (step, lane). The other parameters are attributes, or
        coordinates if they have lanes.

    Raises
    ------
    ArgumentError
        If the name is unknown, the values are not finite or break a rule of the scene, the initial state is beyond a
        wall, or a count is invalid. All arguments are checked before any computation.

    See Also
    --------
    map_parameters : Classify the motion at each cell of a parameter grid.
    follow : Continue a periodic orbit in one parameter.

    Notes
    -----
    If a change of the value would put the mass beyond a rigid wall, the mass is moved onto the wall. A lane whose
    status is CAP or worse (see `Impacts`) has nan at this value and restarts from the initial state at the next value.

    After `max_seconds`, the values that are not done have nan and the status -1, and the attribute ``stopped`` gives
    the reason. A later call with the same store resumes. Exceptions of the store propagate.

    Examples
    --------
    >>> data = jv.sweep(scene, "amplitude", [1.9, 2.0, 2.1], state, settle=50, keep=10)
    >>> data["x"].dims, data["x"].shape
    (('amplitude', 'period'), (3, 10))
    """
    computation_limits = make_limits(None, max_seconds, None, check.ArgumentError)
    settle, keep = check.check_whole_number("settle", settle, 0), check.check_whole_number("keep", keep, 1)
    chunk = check.check_whole_number("chunk", chunk, 1)
    values, state = _check_arguments(scene, name, values, state)
    lane_shape = np.broadcast_shapes(values.shape[1:], scene.shape, *map(np.shape, jax.tree.leaves(state)))
    lane_inputs = _flatten_lanes(lane_shape, scene, values, state)
    if store is None:
        results = _run_sweep(*lane_inputs, name, settle, keep, chunk, progress, computation_limits)
        n_done_values = int((results[2] >= 0).all(axis=1).sum())
        stopped_attrs = (
            {}
            if n_done_values == len(values)
            else {"stopped": partial_result_reason(n_done_values, len(values), "values")}
        )
    else:
        template_scene = jax.tree.map(lambda leaf: leaf[0], lane_inputs[0])
        sweep_study = SweepStudy(template_scene, name, lane_inputs, _run_lanes, (settle, keep))
        data = complete_study(
            sweep_study, store, progress and (lambda record: progress(record.done)), computation_limits
        )
        stopped_attrs = {key: data.attrs[key] for key in ("stopped",) if key in data.attrs}
        results = [np.moveaxis(data[key].values, 0, 1) for key in ("x", "v", "status")]
    arrays = [array.reshape(len(values), *lane_shape, *array.shape[2:]) for array in results]
    return _make_dataset(scene, name, values, state, arrays).assign_attrs(stopped_attrs)


def _check_arguments(scene, name, values, state) -> tuple[Float[np.ndarray, " count *lanes"], State]:
    """Check values and state and return both as arrays of the scene's type."""
    values = check_survey_values(
        scene, name, values, "values", SEQUENCE_RULE, lambda array: array.ndim > 0 and array.shape[0] > 0
    )
    n_new_axes = max(0, len(scene.shape) - (values.ndim - 1))
    aligned_values = values.reshape(values.shape[0], *[1] * n_new_axes, *values.shape[1:])
    scene.replace(**{name: aligned_values})
    state = check_start_state(state, scene.dtype, [("scene", np.empty(scene.shape)), (name, values[0])])
    check_start_within_walls(scene.replace(**{name: aligned_values[0]}), state, "at the first value")
    return values, state


def _flatten_lanes(lane_shape, scene, values, state) -> tuple[Scene, Float[np.ndarray, "count lanes"], State]:
    """Return scene, values (count, lanes) and state with their lanes along one axis."""
    n_lanes = math.prod(lane_shape)

    def flatten_leaf(leaf):
        return np.broadcast_to(leaf, lane_shape).reshape(n_lanes)

    return (
        jax.tree.map(flatten_leaf, scene),
        np.stack([flatten_leaf(value) for value in values]),
        jax.tree.map(flatten_leaf, state),
    )


def _run_lanes(scene, values, start_state, name, settle, keep):
    """Sweep some lanes without progress reports, as `SweepStudy` requires."""
    return _run_sweep(scene, values, start_state, name, settle, keep, VALUES_PER_CHUNK, None)


def _run_sweep(scene, values, start_state, name, settle, keep, chunk_size, progress, computation_limits=UNLIMITED):
    """Return x and v (count, lanes, keep) and status (count, lanes), which is -1 after the time limit."""
    state, results = start_state, []
    for first_value_index in range(0, len(values), chunk_size):
        if results and computation_limits.expired:
            n_remaining, n_lanes = len(values) - first_value_index, values.shape[1]
            nan_states = np.full((n_remaining, keep, n_lanes), np.nan, values.dtype)
            results.append([nan_states, nan_states, np.full((n_remaining, n_lanes), -1, np.int32)])
            break
        chunk_values = values[first_value_index : first_value_index + chunk_size]
        padded_values = np.pad(chunk_values, ((0, chunk_size - len(chunk_values)), (0, 0)), mode="edge")
        state, arrays = _sweep_chunk(
            scene, padded_values, len(chunk_values), start_state, state, settle, name=name, keep=keep
        )
        results.append([np.asarray(array)[: len(chunk_values)] for array in arrays])
        if progress is not None:
            progress(first_value_index + len(chunk_values))
    x, v, status = (np.concatenate(arrays) for arrays in zip(*results, strict=True))
    return np.moveaxis(x, 1, 2), np.moveaxis(v, 1, 2), status


@persistent_jit(static_argnames=("name", "keep"), compiler_options=COMPILER_OPTIONS)
def _sweep_chunk(scene, values, n_values, start_state, state, settle, *, name, keep):
    """Return the state after the first `n_values` values, and x, v (values, keep, lanes), status (values, lanes)."""
    values_by_lanes_shape = values.shape
    state_record = jnp.zeros((values_by_lanes_shape[0], keep, values_by_lanes_shape[1]), values.dtype)
    status = jnp.zeros(values_by_lanes_shape, jnp.int32)

    def sweep_value(value_index, carry):
        state, *records_of_all_values = carry
        scene_at_value = scene.replace(**{name: values[value_index]})
        state, x, v, status = _settle_at_value(
            scene_at_value, adapt_to_moved_walls(scene_at_value, state), settle, keep
        )
        is_invalid = status >= Status.CAP
        state = jax.tree.map(lambda start_leaf, leaf: jnp.where(is_invalid, start_leaf, leaf), start_state, state)
        return state, *(
            array.at[value_index].set(value) for array, value in zip(records_of_all_values, (x, v, status), strict=True)
        )

    state, *state_record = lax.fori_loop(0, n_values, sweep_value, (state, state_record, state_record, status))
    return state, state_record


def _settle_at_value(scene, state, settle, keep):
    """Return the state after settle + keep periods, x and v (keep, lanes) of the last periods, and the worst status."""

    def advance_period(period, carry):
        state, x, v, status = carry
        state, impacts = strobe(scene, state, slots=0)
        record_index = jnp.maximum(period - settle, 0)
        worst_status = jnp.where(
            status >= Status.CAP, status, jnp.where(impacts.status >= Status.CAP, impacts.status, Status.OK)
        )
        return state, x.at[record_index].set(state.x), v.at[record_index].set(state.v), worst_status

    blank_record = jnp.zeros((keep, *state.x.shape), state.x.dtype)
    state, x, v, status = lax.fori_loop(
        0, settle + keep, advance_period, (state, blank_record, blank_record, jnp.zeros(state.x.shape, jnp.int32))
    )
    is_invalid = status >= Status.CAP
    return state, jnp.where(is_invalid, jnp.nan, x), jnp.where(is_invalid, jnp.nan, v), status


def _make_dataset(scene, name, values, state, result_arrays):
    """Return the Dataset of x, v (count, lanes..., keep) and status (count, lanes...)."""
    x, v, status = result_arrays
    lane_dims = ["lane"] if status.ndim == 2 else [f"lane_{axis}" for axis in range(status.ndim - 1)]
    step_dim = name if values.ndim == 1 else "step"
    value_array = (
        values if values.ndim == 1 else np.stack([np.broadcast_to(value, status.shape[1:]) for value in values])
    )
    coords = {
        name: ([step_dim, *lane_dims][: value_array.ndim], value_array, {"long_name": name, "units": unit_of(name)}),
        "period": ("period", np.arange(x.shape[-1]), {"long_name": "drive periods after those left out"}),
    }
    attrs = survey_attributes(scene, swept=name)
    add_fixed_values(coords, attrs, other_parameters(scene, name) | {"phase": state.phase}, lane_dims, status.shape[1:])
    variables = {
        "x": ([step_dim, *lane_dims, "period"], x, {"long_name": "position on Sigma", "units": LENGTH}),
        "v": ([step_dim, *lane_dims, "period"], v, {"long_name": "velocity on Sigma", "units": SPEED}),
        "status": ([step_dim, *lane_dims], status, {"long_name": "worst status at this value", **STATUS_FLAGS}),
    }
    return xr.Dataset(variables, coords, attrs)

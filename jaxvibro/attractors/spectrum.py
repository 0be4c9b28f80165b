"""Compute both Lyapunov exponents of the attractor against a parameter, with error bars."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Float, Real

from continuation.branch_segment import UNLIMITED, make_limits, partial_result_reason

from ..compiled.kernel_calls import BLOCK_WIDTH
from ..maps.iterate import take_lanes
from ..maps.sticking_phase_intervals import NO_STICKING, StickingPhaseIntervals, find_sticking_phases
from ..output.units import unit_of
from ..scene import check
from ..scene.scene import Scene
from ..scene.scene_table import scene_toml
from ..scene.state import State, check_start_within_walls, make_state_arrays
from ..stores.engines import SerialPool, n_usable_cores
from ..stores.study import Column, Grid, Store, complete_study, fingerprint_array
from .chaotic_exponents import estimate_exponents, run_until_recurrence
from .dataset_attributes import STATUS_FLAGS, add_fixed_values, other_parameters, survey_attributes
from .orbit_exponents import ExponentEstimate, compute_orbit_exponents, undefined_estimate
from .survey_arguments import SEQUENCE_RULE, check_start_state, check_survey_values
from .tangent_growth import RECORDED_PERIODS, start_tangents

# Columns of each value: the sizes of the fields of `ExponentEstimate`, then the stored fields of
# `StickingPhaseIntervals`.
COLUMN_SIZES = {"exponent": 2, "error": 2, "impacts": 3, "within": 2, "periods": 0, "status": 0, "count": 0}
STICKING_COLUMNS = ("rests", "rate")


@dataclass(frozen=True)
class SpectrumStudy:
    """Lyapunov exponents at the values of a parameter as a `Study`.

    Parameters
    ----------
    scene : Scene
        Scene without lanes, with the other parameters.
    name : str
        Parameter.
    values : ndarray
        Values of the parameter. Array of shape (values,).
    state : State
        Initial state at each value. Leaves of shape (values,).
    compute_block_exponents : callable
        Function of a scene with one lane per value, states and settings. Returns the `ExponentEstimate` and the
        `StickingPhaseIntervals` of each value.
    settings : tuple
        Drive periods discarded, target standard error, largest number of drive periods averaged.
    """

    scene: Scene
    name: str
    values: Float[np.ndarray, " values"]
    state: State
    compute_block_exponents: Callable[..., Any]
    settings: tuple[int, float, int]

    @cached_property
    def grid(self) -> Grid:
        """Grid of the values, divided into blocks."""
        return Grid({self.name: len(self.values)}, (BLOCK_WIDTH,))

    @property
    def columns(self) -> dict[str, Column]:
        """Columns of the fields of `ExponentEstimate` and `StickingPhaseIntervals`."""
        float_dtype = np.dtype(np.float64)
        return {
            name: Column(float_dtype, np.nan, {}, {f"{name}_place": n_components} if n_components else {})
            for name, n_components in (COLUMN_SIZES | dict.fromkeys(STICKING_COLUMNS, 0)).items()
        }

    @cached_property
    def identity(self) -> dict[str, str]:
        """Texts that identify the study in a store."""
        return {
            "scene": scene_toml(self.scene),
            self.name: fingerprint_array(self.values),
            **{
                f"start.{name}": fingerprint_array(getattr(self.state, name)) for name in ("x", "v", "phase", "contact")
            },
            "settings": repr(self.settings),
            "dtype": str(self.scene.dtype),
        }

    @cached_property
    def frame(self) -> xr.Dataset:
        """Dataset with the values as its coordinate."""
        return xr.Dataset(coords={self.name: self.values})

    def compute(self, number: int, frame: xr.Dataset) -> tuple[dict[str, np.ndarray], int]:
        """Return the columns of a block of values, and the number of values without an exponent."""
        (block_slice,) = self.grid.chunk_slices(number)
        values = self.values[block_slice]
        state = jax.tree.map(lambda leaf: leaf[block_slice], self.state)
        exponent_estimates, sticking_phases = self.compute_block_exponents(
            self.scene.replace(**{self.name: values}), state, *self.settings
        )
        columns = {
            name: np.array([getattr(record_of_value, name) for record_of_value in exponent_estimates], float)
            for name in COLUMN_SIZES
        }
        columns["rests"] = np.array([sticking_phase.count for sticking_phase in sticking_phases], float)
        columns["rate"] = np.array([sticking_phase.growth_rate for sticking_phase in sticking_phases], float)
        return columns, int(np.isnan(columns["exponent"][:, 0]).sum())


def read_estimates(data: xr.Dataset) -> tuple[list[ExponentEstimate], list[StickingPhaseIntervals]]:
    """Return the `ExponentEstimate` and the `StickingPhaseIntervals` of each value from a study's Dataset."""
    integer_defaults = {"periods": 0, "status": -1, "count": 0}  # at a value that is not done
    integer_columns = {
        name: data[name].fillna(value).values.astype(int).tolist() for name, value in integer_defaults.items()
    }
    field_columns = [integer_columns[name] if name in integer_columns else data[name].values for name in COLUMN_SIZES]
    sticking_rows = zip(data["rests"].values, data["rate"].values, strict=True)
    sticking_phases = [
        NO_STICKING._replace(count=count, growth_rate=growth_rate) for count, growth_rate in sticking_rows
    ]
    return [ExponentEstimate(*estimate_fields) for estimate_fields in zip(*field_columns, strict=True)], sticking_phases


FEW_ROUNDS, MANY_ROUNDS = 8, 64  # rounds until most values have settled, and until the others are averaged


@check.host_only("use monodromy")
def spectrum(
    scene: Scene,
    name: str,
    values: Real[ArrayLike, "..."] | Sequence[float],
    state: State,
    settle: int = 300,
    error: Real[ArrayLike, ""] = 2e-3,
    most: int = 2**20,
    progress: Callable[[int], object] | None = None,
    store: Store | None = None,
    *,
    max_seconds: float | None = None,
) -> xr.Dataset:
    """Compute both Lyapunov exponents of the motion for many values of a parameter.

    If a motion recurs after n drive periods, n at most 32, the exponents are ``ln abs(mu) / n`` with the multipliers mu
    of the periodic orbit. All other exponents are averages along 64 copies of the motion.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    name : str
        Parameter of the scene, for example ``"amplitude"`` or ``"left.position"``.
    values : array_like
        Values of the parameter. Array of shape (count,).
    state : State
        Initial state at every value. Its fields are numbers, or arrays with one number for each value.
    settle : int, optional
        Drive periods discarded.
    error : float, optional
        Standard error, per drive period, at which the average ends if neither exponent has a larger one.
    most : int, optional
        Approximate number of drive periods, summed over the copies, at which the average ends.
    progress : callable, optional
        Called with the number of values done.
    store : Store, optional
        Store that keeps the results, 64 values at a time, and from which the computation resumes. None keeps them in
        memory.
    max_seconds : float, optional
        Wall-clock time, in s, after which no value (with a store: no block of values) is started. None is no limit.

    Returns
    -------
    xarray.Dataset
        Variables along `name`: ``exponent`` and ``error`` (name, order), the larger exponent first, per drive period;
        the error is a standard error, or the rounding error for an orbit. ``impacts``: impacts per period.
        ``impacts_on`` (name, wall): impacts per period on each wall, among the first 32 in a period; an entry into a
        soft wall is an impact. ``within`` (name, wall): time inside a soft wall per drive period, 0 for a rigid wall.
        ``periods``: drive periods of the orbit, 0 if none was recognised. ``count``: drive periods averaged.
        ``status``: as in `Impacts`. ``rests``: number of times per period at which the mass begins to stick.
        ``between``: logarithmic growth rate of the fastest growing tangents between sticking phases, per drive period
        of the time between these phases, nan if there is no such rate. The growth includes the impacts of complete
        chatter, and the rate is accurate to a few hundredths.

    Raises
    ------
    ArgumentError
        If an argument is invalid for `sweep`, the error is not positive, or a count is invalid.

    See Also
    --------
    sweep : Sweep a parameter and record the stroboscopic states.

    Notes
    -----
    The sum of the exponents is ``-2 gamma T``, plus ``2 ln R`` times ``impacts_on`` for each rigid wall, minus
    ``2 (gamma2 - gamma)`` times ``within`` for each soft wall, where T is the drive period. For a user-defined force
    the sum is computed from the derivatives of the stroboscopic map.

    - Both exponents are -inf if the mass sticks to a wall, since later states then do not depend on its past.
    - The second exponent is -inf if a wall that is hit has ``R = 0`` and the mass does not stick.
    - Both exponents are nan if a period has more than 32 impacts in flight (status full), or at an impact with zero
      speed (status nonfinite).

    Standard errors are batch means. After `max_seconds`, the values that are not done have nan and the status -1, and
    the attribute ``stopped`` gives the reason. A later call with the same store resumes. Exceptions of the store
    propagate.

    References
    ----------
    Benettin et al., Meccanica 15 (1980) 9-20. Impacts: Mueller, Chaos, Solitons and Fractals 5 (1995) 1671-1681. Sum of
    the exponents: paper, (38).

    Examples
    --------
    >>> data = jv.spectrum(scene, "amplitude", [2.0, 2.1], state, settle=50)
    >>> data["exponent"].values.round(4).tolist()
    [[-0.8629, -0.8629], [-0.8629, -0.8629]]
    """
    computation_limits = make_limits(None, max_seconds, None, check.ArgumentError)
    check.require_single_scene(scene)
    settle, most = check.check_whole_number("settle", settle, 0), check.check_whole_number("most", most, 1)
    target_error = check.check_finite_array("error", error, np.float64)
    check.require("error", "must be greater than 0", target_error, target_error > 0)
    values, state = _check_arguments(scene, name, values, state)
    start_states = jax.tree.map(lambda leaf: np.broadcast_to(leaf, values.shape), state)
    if store is None:
        with ThreadPoolExecutor(n_usable_cores()) as executor:
            scene_lanes = scene.replace(**{name: values})
            report_n_done = progress or (lambda n_done: None)
            exponent_estimates, sticking_phases = _compute_all_exponents(
                executor,
                scene_lanes,
                start_states,
                settle,
                float(target_error),
                most,
                report_n_done,
                computation_limits,
            )
        n_done_values = sum(int(exponent_estimate.status >= 0) for exponent_estimate in exponent_estimates)
        stopped_attrs = (
            {}
            if n_done_values == len(values)
            else {"stopped": partial_result_reason(n_done_values, len(values), "values")}
        )
    else:
        spectrum_study = SpectrumStudy(
            scene, name, values, start_states, _compute_in_this_thread, (settle, float(target_error), most)
        )
        data = complete_study(
            spectrum_study, store, progress and (lambda record: progress(record.done)), computation_limits
        )
        exponent_estimates, sticking_phases = read_estimates(data)
        stopped_attrs = {key: data.attrs[key] for key in ("stopped",) if key in data.attrs}
    return _make_dataset(scene, name, values, state, exponent_estimates, sticking_phases).assign_attrs(stopped_attrs)


def _check_arguments(scene, parameter_name, values, state) -> tuple[Float[np.ndarray, " count"], State]:
    """Check values and state and return both as arrays of the scene's type."""
    values = check_survey_values(
        scene, parameter_name, values, "values", SEQUENCE_RULE, lambda array: array.ndim == 1 and array.size > 0
    )
    scene_lanes = scene.replace(**{parameter_name: values})
    state = check_start_state(make_state_arrays(scene, state), scene.dtype, [(parameter_name, values)])
    check_start_within_walls(scene_lanes, state, "at each value")
    return values, state


def _compute_in_this_thread(scene_lanes, state, settle, target_error, max_periods):
    """Run `_compute_all_exponents` in this thread."""
    return _compute_all_exponents(
        SerialPool, scene_lanes, state, settle, target_error, max_periods, lambda n_done: None
    )


def _compute_all_exponents(
    executor, scene_lanes, state, settle, target_error, max_periods, report_n_done, computation_limits=UNLIMITED
):
    """Return the `ExponentEstimate` and the `StickingPhaseIntervals` (count per period) of each value, in order.

    The status of an estimate is -1 if the time limit was reached before it was computed.
    """
    run = _SpectrumRun(executor, scene_lanes, computation_limits)
    run.settle_values(state, settle)
    run.estimate_orbits(run.settled_lanes)
    report_n_done(len(run.estimates))
    averaged_indices = run.average_values(target_error, max_periods, report_n_done)
    run.estimate_orbits(averaged_indices)
    value_indices = range(len(state.x))
    exponent_estimates = [run.estimates.get(value_index, undefined_estimate(-1)) for value_index in value_indices]
    return exponent_estimates, [run.find_sticking_phases(value_index) for value_index in value_indices]


class _SpectrumRun:
    """Computation of the exponents at many values.

    Attributes
    ----------
    executor : Executor
        Executor whose threads compute blocks of values.
    scene_lanes : Scene
        Scene with one lane per value.
    computation_limits : Limits
        Time limit. Values that are not settled before the limit have no entry in `settled_lanes`.
    settled_lanes : dict of int to SettledLanes
        Motion after the transient as a single lane, by index of the value.
    estimates : dict of int to ExponentEstimate
        Exponents, by index of the value.
    """

    def __init__(self, executor, scene_lanes, computation_limits):
        self.executor, self.scene_lanes, self.computation_limits = executor, scene_lanes, computation_limits
        self.settled_lanes, self.estimates = {}, {}

    def settle_values(self, state, settle):
        """Simulate all values until they recur, and estimate the exponents of motions without a finite state."""

        def settle_block(indices):
            """Simulate a block of values for the first rounds."""
            return run_until_recurrence(
                take_lanes(self.scene_lanes, indices), start_tangents(take_lanes(state, indices)), settle, FEW_ROUNDS
            )

        def settle_block_longer(indices):
            """Simulate unsettled values for further rounds."""
            return run_until_recurrence(
                take_lanes(self.scene_lanes, indices),
                _concatenate_lanes(self.settled_lanes[value_index].lanes for value_index in indices),
                0,
                MANY_ROUNDS,
            )

        self.settled_lanes = self._map_blocks(settle_block, list(range(len(state.x))))
        longer_settled_lanes = self._map_blocks(
            settle_block_longer,
            [value_index for value_index, lane in self.settled_lanes.items() if lane.is_nonrecurrent],
        )
        self.settled_lanes = {
            value_index: lane
            for value_index, lane in (self.settled_lanes | longer_settled_lanes).items()
            if value_index in longer_settled_lanes or not lane.is_nonrecurrent
        }
        self.estimates = {
            value_index: undefined_estimate(lane.status[0])
            for value_index, lane in self.settled_lanes.items()
            if not lane.has_finite_state
        }

    def estimate_orbits(self, indices):
        """Estimate the exponents of values that have settled on a periodic orbit, unless the orbit is repelling."""

        def solve_orbit_block(indices):
            """Compute the exponents of the periodic orbits of a block."""
            state, periods = _concatenate_lanes(
                (self.settled_lanes[value_index].lanes.state, self.settled_lanes[value_index].periods)
                for value_index in indices
            )
            return compute_orbit_exponents(take_lanes(self.scene_lanes, indices), state, periods)

        periodic_indices = [value_index for value_index in indices if self.settled_lanes[value_index].periods[0]]
        block_estimates = _map_in_order(self.executor, solve_orbit_block, _split_into_blocks(periodic_indices))
        orbit_estimates = [
            take_lanes(block_estimate, lane_index)
            for block_estimate in block_estimates
            for lane_index in range(len(block_estimate.periods))
        ]
        self.estimates |= {
            value_index: exponent_estimate
            for value_index, exponent_estimate in zip(periodic_indices, orbit_estimates, strict=True)
            if not exponent_estimate.is_repelling
        }

    def average_values(self, target_error, max_periods, report_n_done):
        """Average the exponents of values without an estimate; return the indices of the averaged values."""

        def average_value(value_index):
            """Average the exponents at one value; return None after the time limit."""
            return (
                None
                if self.computation_limits.expired
                else estimate_exponents(
                    take_lanes(self.scene_lanes, value_index),
                    self.settled_lanes[value_index],
                    target_error,
                    max_periods,
                )
            )

        averaged_indices = []
        indices = [value_index for value_index in self.settled_lanes if value_index not in self.estimates]
        for value_index, average in zip(indices, _map_in_order(self.executor, average_value, indices), strict=True):
            if average is not None:
                averaged_indices.append(value_index)
                self.estimates[value_index], recurrent_lane = average
                if recurrent_lane is not None:
                    self.settled_lanes[value_index] = recurrent_lane
                report_n_done(len(self.estimates))
        return averaged_indices

    def find_sticking_phases(self, value_index):
        """Return the `StickingPhaseIntervals` of a value, with their count per period; nan without an estimate."""
        if value_index not in self.estimates:
            return NO_STICKING._replace(count=np.nan)
        exponent_estimate = self.estimates[value_index]
        if not np.isneginf(exponent_estimate.exponent[0]):
            return NO_STICKING
        n_periods = exponent_estimate.periods or RECORDED_PERIODS
        state = jax.tree.map(lambda leaf: leaf[0], self.settled_lanes[value_index].lanes.state)
        sticking_phases = find_sticking_phases(take_lanes(self.scene_lanes, value_index), state, n_periods)
        return sticking_phases._replace(count=sticking_phases.count / n_periods)

    def _map_blocks(self, block_function, indices):
        """Apply a function to blocks of indices; return {index: tree of one lane} of the blocks within the limit."""

        def run_block(index_block):
            """Return the result of a block, None after the time limit."""
            return None if self.computation_limits.expired else block_function(index_block)

        lane_trees, index_blocks = {}, _split_into_blocks(indices)
        block_trees = _map_in_order(self.executor, run_block, index_blocks)
        for index_block, block_tree in zip(index_blocks, block_trees, strict=True):
            if block_tree is not None:
                lane_trees.update(zip(index_block.tolist(), _split_lanes(block_tree), strict=True))
        return lane_trees


def _concatenate_lanes(lane_trees):
    """Concatenate trees of lanes along their last axis."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1), *lane_trees)


def _split_lanes(block_tree):
    """Split a tree of lanes into trees of one lane each."""
    leaves, tree_structure = jax.tree.flatten(block_tree)
    return [
        tree_structure.unflatten([leaf[..., lane_index : lane_index + 1] for leaf in leaves])
        for lane_index in range(leaves[0].shape[-1])
    ]


def _split_into_blocks(indices):
    """Split a list of indices into arrays of at most `BLOCK_WIDTH` indices."""
    return [
        np.array(indices[block_start : block_start + BLOCK_WIDTH])
        for block_start in range(0, len(indices), BLOCK_WIDTH)
    ]


def _map_in_order(executor, function, items):
    """Yield the results of a function of each item in order.

    The first item runs alone, because otherwise several threads would compile the same function.
    """
    yield from map(function, items[:1])
    yield from executor.map(function, items[1:])


def _make_dataset(scene, name, values, state, exponent_estimates, sticking_phases):
    """Return the Dataset of the `ExponentEstimate` and the `StickingPhaseIntervals` of each value."""
    exponent, error, impacts, time_in_walls, periods, status, count = (
        np.stack(field_arrays) for field_arrays in zip(*exponent_estimates, strict=True)
    )
    coords = {
        name: (name, values, {"long_name": name, "units": unit_of(name)}),
        "order": ("order", [1, 2], {"long_name": "place among the exponents, the larger first"}),
        "wall": ("wall", ["left", "right"]),
    }
    attrs = survey_attributes(scene, swept=name)
    add_fixed_values(coords, attrs, other_parameters(scene, name) | {"phase": state.phase}, name, values.shape)
    rate_attrs = {"units": "per drive period"}
    variables = {
        "exponent": ([name, "order"], exponent, {"long_name": "Lyapunov exponents", **rate_attrs}),
        "error": ([name, "order"], error, {"long_name": "standard errors of the exponents", **rate_attrs}),
        "rests": (
            name,
            [float(phases_at_value.count) for phases_at_value in sticking_phases],
            {"long_name": "comings to rest on a wall", **rate_attrs},
        ),
        "between": (
            name,
            [phases_at_value.growth_rate for phases_at_value in sticking_phases],
            {"long_name": "largest growth between rests", **rate_attrs},
        ),
        "impacts": (name, impacts[:, 0], {"long_name": "impacts", **rate_attrs}),
        "impacts_on": ([name, "wall"], impacts[:, 1:], {"long_name": "impacts on a wall", **rate_attrs}),
        "within": (
            [name, "wall"],
            time_in_walls,
            {"long_name": "time within a soft wall", "units": "t per drive period"},
        ),
        "periods": (name, periods, {"long_name": "drive periods of the orbit, 0 where none was recognised"}),
        "count": (name, count, {"long_name": "drive periods averaged"}),
        "status": (name, status, {"long_name": "worst status at this value", **STATUS_FLAGS}),
    }
    return xr.Dataset(variables, coords, attrs)

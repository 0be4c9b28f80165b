"""Compute both Lyapunov exponents of the attractor against a parameter, with error bars."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
import xarray as xr
from jaxtyping import ArrayLike, Float, Real

from continuation.computation_limits import UNLIMITED, make_limits, partial_result_reason

from ..compiled.kernel_calls import BLOCK_WIDTH
from ..maps.long_iteration import take_lanes
from ..maps.sticking_phase_intervals import NO_STICKING, find_sticking_phases
from ..output.units import scales_attributes, unit_of
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import State, check_start_within_walls, make_state_arrays
from ..scene.unit_mistakes import require_scene_units
from ..stores.engines import SerialPool, n_usable_cores
from ..stores.study_completion import Store, complete_study
from .chaotic_exponents import estimate_exponents, run_until_recurrence
from .lyapunov_study import SpectrumStudy, read_estimates
from .orbit_exponents import compute_orbit_exponents, undefined_estimate
from .sweep import (
    STATUS_FLAGS,
    UNITS_TEXT,
    check_start_state,
    equation_text,
    non_parameter_attributes,
    other_parameters,
)
from .tangent_growth import RECORDED_PERIODS, start_tangents

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
    if target_error.shape:
        raise check.ArgumentError("error", "must be a single number", error)
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
    check.require_parameter(parameter_name, scene.names, parameter_name)
    values = check.check_finite_array(parameter_name, values, scene.dtype)
    if values.ndim != 1 or len(values) == 0:
        raise check.ArgumentError(parameter_name, "must be a sequence of at least one value", values)
    require_scene_units("values", scene, parameter_name, values)
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
    value_indices = np.arange(len(state.x))

    def settle_block(indices):
        """Simulate a block of values for the first rounds; return None after the time limit."""
        return (
            None
            if computation_limits.expired
            else run_until_recurrence(
                take_lanes(scene_lanes, indices), start_tangents(take_lanes(state, indices)), settle, FEW_ROUNDS
            )
        )

    def settle_longer(indices):
        """Simulate unsettled values for further rounds; return None after the time limit."""
        if computation_limits.expired:
            return None
        return run_until_recurrence(
            take_lanes(scene_lanes, indices),
            _concatenate_lanes(settled_lane_by_index[value_index].lanes for value_index in indices),
            0,
            MANY_ROUNDS,
        )

    def solve_orbit_block(indices):
        """Compute the exponents of the periodic orbits of a block."""
        state, periods = _concatenate_lanes(
            (settled_lane_by_index[value_index].lanes.state, settled_lane_by_index[value_index].periods)
            for value_index in indices
        )
        return compute_orbit_exponents(take_lanes(scene_lanes, indices), state, periods)

    def average_value(value_index):
        """Average the exponents at one value; return (None, None) after the time limit."""
        return (
            (None, None)
            if computation_limits.expired
            else estimate_exponents(
                take_lanes(scene_lanes, value_index), settled_lane_by_index[value_index], target_error, max_periods
            )
        )

    settled_lane_by_index = _map_and_split_blocks(executor, settle_block, value_indices)
    unsettled_indices = np.array(
        [value_index for value_index, settled_lane in settled_lane_by_index.items() if settled_lane.is_nonrecurrent],
        int,
    )
    longer_settled_by_index = _map_and_split_blocks(executor, settle_longer, unsettled_indices)
    settled_lane_by_index = {
        value_index: settled_lane
        for value_index, settled_lane in (settled_lane_by_index | longer_settled_by_index).items()
        if value_index in longer_settled_by_index or not settled_lane.is_nonrecurrent
    }
    estimate_by_index = {
        value_index: undefined_estimate(settled_lane.status[0])
        for value_index, settled_lane in settled_lane_by_index.items()
        if not settled_lane.has_finite_state
    }
    estimate_by_index |= _estimate_stable_orbits(
        executor,
        solve_orbit_block,
        [value_index for value_index, settled_lane in settled_lane_by_index.items() if settled_lane.periods[0]],
    )
    report_n_done(len(estimate_by_index))
    nonperiodic_indices = [value_index for value_index in settled_lane_by_index if value_index not in estimate_by_index]
    for value_index, (exponent_estimate, recurrent_lanes) in zip(
        nonperiodic_indices, _map_in_order(executor, average_value, nonperiodic_indices), strict=True
    ):
        if exponent_estimate is None:
            continue
        estimate_by_index[value_index] = exponent_estimate
        if recurrent_lanes is not None:
            settled_lane_by_index[value_index] = recurrent_lanes
        report_n_done(len(estimate_by_index))
    estimate_by_index |= _estimate_stable_orbits(
        executor,
        solve_orbit_block,
        [
            value_index
            for value_index in nonperiodic_indices
            if value_index in estimate_by_index and settled_lane_by_index[value_index].periods[0]
        ],
    )
    sticking_phases = [
        NO_STICKING if value_index in estimate_by_index else NO_STICKING._replace(count=np.nan)
        for value_index in value_indices.tolist()
    ]
    for value_index in (
        value_index
        for value_index, exponent_estimate in estimate_by_index.items()
        if np.isneginf(exponent_estimate.exponent[0])
    ):
        lane_scene, state = (
            take_lanes(scene_lanes, value_index),
            jax.tree.map(lambda leaf: leaf[0], settled_lane_by_index[value_index].lanes.state),
        )
        sticking_phases[value_index] = find_sticking_phases(
            lane_scene, state, estimate_by_index[value_index].periods or RECORDED_PERIODS
        )
        sticking_phases[value_index] = sticking_phases[value_index]._replace(
            count=sticking_phases[value_index].count / (estimate_by_index[value_index].periods or RECORDED_PERIODS)
        )
    return [
        estimate_by_index.get(value_index, undefined_estimate(-1)) for value_index in value_indices.tolist()
    ], sticking_phases


def _concatenate_lanes(lane_trees):
    """Concatenate trees of lanes along their last axis."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1), *lane_trees)


def _split_lanes(block_trees):
    """Split trees of lanes into trees of one lane each."""
    lane_trees = []
    for block_tree in block_trees:
        leaves, tree_structure = jax.tree.flatten(block_tree)
        lane_trees += [
            tree_structure.unflatten([leaf[..., lane_index : lane_index + 1] for leaf in leaves])
            for lane_index in range(leaves[0].shape[-1])
        ]
    return lane_trees


def _map_blocks(executor, block_function, indices):
    """Return the list of a function's results for blocks of the indices."""
    return list(
        _map_in_order(
            executor,
            block_function,
            [indices[block_start : block_start + BLOCK_WIDTH] for block_start in range(0, len(indices), BLOCK_WIDTH)],
        )
    )


def _map_and_split_blocks(executor, block_function, indices):
    """Apply a function to blocks of indices; return {index: tree of one lane}, without blocks whose result is None."""
    index_blocks = [
        indices[block_start : block_start + BLOCK_WIDTH] for block_start in range(0, len(indices), BLOCK_WIDTH)
    ]
    blocks_and_trees = zip(index_blocks, _map_in_order(executor, block_function, index_blocks), strict=True)
    indices_and_lane_trees = [
        (index_block.tolist(), _split_lanes([block_tree]))
        for index_block, block_tree in blocks_and_trees
        if block_tree is not None
    ]
    return {
        value_index: lane_tree
        for index_block, lane_trees in indices_and_lane_trees
        for value_index, lane_tree in zip(index_block, lane_trees, strict=True)
    }


def _map_in_order(executor, function, items):
    """Yield the results of a function of each item in order.

    The first item runs alone, because otherwise several threads would compile the same function.
    """
    yield from map(function, items[:1])
    yield from executor.map(function, items[1:])


def _estimate_stable_orbits(executor, solve_orbit_block, indices):
    """Return {index: `ExponentEstimate`} of values with a periodic orbit; values with a repelling orbit are omitted."""
    block_estimates = _map_blocks(executor, solve_orbit_block, np.array(indices, int))
    exponent_estimates = [
        take_lanes(block_estimate, lane_index)
        for block_estimate in block_estimates
        for lane_index in range(len(block_estimate.periods))
    ]
    return {
        value_index: exponent_estimate
        for value_index, exponent_estimate in zip(indices, exponent_estimates, strict=True)
        if not exponent_estimate.is_repelling
    }


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
    attrs = {
        "equation": equation_text(scene),
        "units": UNITS_TEXT,
        "swept": name,
        **non_parameter_attributes(scene),
        **scales_attributes(scene),
    }
    for other_parameter_name, value in (other_parameters(scene, name) | {"phase": state.phase}).items():
        if np.ndim(value):
            coords[other_parameter_name] = (name, value)
        else:
            attrs[other_parameter_name] = float(value)
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

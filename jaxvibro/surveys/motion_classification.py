"""Classify the motions of many lanes, each with its own scene: periodic, chaotic or undecided.

Lanes are simulated until they recur or reach the largest number of periods. Lanes that have not recurred are sorted by
their number of impacts and regrouped, so that the lanes of a block need similar computing times. The result of a lane
depends neither on the other lanes nor on earlier computations of the process.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from continuation.hostcall import persistent_jit

from ..attractors.chaotic_exponents import standard_error
from ..attractors.classify_attractors import MIN_CHAOS_EXPONENT
from ..attractors.orbit_exponents import compute_orbit_exponents
from ..attractors.tangent_growth import (
    RECORDED_PERIODS,
    TangentLanes,
    run_tangents,
    start_tangents,
    worse_status,
)
from ..attractors.transients import compute_return_distances, find_recurrence_periods
from ..compiled.kernel_calls import BLOCK_WIDTH
from ..compiled.lane_arithmetic import COMPILER_OPTIONS
from ..maps.initial_conditions import initial_box
from ..maps.iterate import take_lanes, take_padded_block
from ..maps.sticking_phase_intervals import find_sticking_phases
from ..maps.strobe import strobe
from ..scene.check import MAX_ORBIT_PERIODS
from ..scene.scene import Scene
from ..scene.state import State, Status

BLOCK_PERIODS = 16  # periods whose growth is summed
CERTAIN_ERRORS = 3.0  # standard errors by which a chaotic exponent must exceed `MIN_CHAOS_EXPONENT`
UNDECIDED, CHAOTIC = -1, 0  # codes in place of the periods of an orbit
RETURN_TOLERANCE = 1e-3  # relative to the largest x and v: distance of a settled state from an earlier one
SAMPLE_ROUNDS = 8  # times `RECORDED_PERIODS` of a motion that does not recur are kept


class MotionResults(NamedTuple):
    """Classification of the motions of many lanes, as NumPy arrays.

    Attributes
    ----------
    state : State
        Final states on the section.
    status : ndarray
        Worst status. Array of shape (lanes,).
    periods : ndarray
        Drive periods of the orbit, or `CHAOTIC` or `UNDECIDED`. Array of shape (lanes,).
    impact_counts : ndarray
        Impacts of a periodic orbit on the left and the right wall per period of the orbit, else 0. Array of shape
        (2, lanes).
    endless : ndarray
        Walls at which the mass sticks after complete chatter: 1 left, 2 right, 3 both. Array of shape (lanes,).
    exponent : ndarray
        Largest Lyapunov exponent per drive period; nan if unknown. Array of shape (lanes,).
    error : ndarray
        Standard error of the exponent; nan if unknown. Array of shape (lanes,).
    points : ndarray
        x and v on the section over the last periods, nan before the first recorded period. Array of shape
        (periods, lanes, 2).
    """

    state: State
    status: Int[np.ndarray, " lanes"]
    periods: Int[np.ndarray, " lanes"]
    impact_counts: Int[np.ndarray, "2 lanes"]
    endless: Int[np.ndarray, " lanes"]
    exponent: Float[np.ndarray, " lanes"]
    error: Float[np.ndarray, " lanes"]
    points: Float[np.ndarray, "periods lanes 2"]


def classify_motions(scene: Scene, state: State, settle: int, max_periods: int) -> MotionResults:
    """Classify the motions of many lanes as periodic, chaotic or undecided.

    Parameters
    ----------
    scene : Scene
        Scene, with parameters that are numbers or of shape (lanes,).
    state : State
        Initial states. Leaves of shape (lanes,).
    settle : int
        Drive periods before recurrence is tested.
    max_periods : int
        Drive periods after which a lane that has not recurred is classified by its exponent.

    Returns
    -------
    MotionResults
        Classification of each lane.
    """
    n_lanes = int(np.size(state.x))
    state, status = _advance_all_lanes(scene, state, settle)
    results = MotionResults(
        state,
        status,
        np.full(n_lanes, UNDECIDED),
        np.zeros((2, n_lanes), int),
        np.zeros(n_lanes, int),
        np.full(n_lanes, np.nan),
        np.full(n_lanes, np.nan),
        np.full((SAMPLE_ROUNDS * RECORDED_PERIODS, n_lanes, 2), np.nan, scene.dtype),
    )
    _classify_lanes(scene, results, np.flatnonzero(status < Status.CAP), settle, max_periods)
    return results


def _advance_all_lanes(scene, state, periods):
    """Return (state, worst status) of lanes after some periods."""
    n_lanes = len(state.x)
    block_inputs = [
        take_padded_block((scene, state), block_start, BLOCK_WIDTH) for block_start in range(0, n_lanes, BLOCK_WIDTH)
    ]
    block_results = [_advance_lane_block(*block_input, periods) for block_input in block_inputs]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:n_lanes], *block_results)


@persistent_jit(compiler_options=COMPILER_OPTIONS)
def _advance_lane_block(scene, state, periods):
    def advance_period(_, carry):
        state, status = carry
        state, impacts = strobe(scene, state, slots=0)
        return state, worse_status(status, jnp.where(impacts.status >= Status.CAP, impacts.status, Status.OK))

    return lax.fori_loop(0, periods, advance_period, (state, jnp.zeros(state.x.shape, jnp.int32)))


def _classify_lanes(scene, results, lanes, settle, max_periods):
    """Simulate lanes until they recur or reach the largest number of periods, and store their classification."""
    if not len(lanes):
        return
    scene_lanes, elapsed_periods, growth_by_round = take_lanes(scene, lanes), settle + RECORDED_PERIODS, []
    tangent_lanes, period_records = run_tangents(
        scene_lanes, start_tangents(take_lanes(results.state, lanes)), RECORDED_PERIODS
    )
    max_state_magnitude, status = _max_state_magnitude(scene_lanes, period_records), period_records.status
    previous_distances = _return_distance_if_near(period_records.points, max_state_magnitude)
    while len(lanes):
        tangent_lanes, period_records = run_tangents(scene_lanes, tangent_lanes, RECORDED_PERIODS)
        status = worse_status(status, period_records.status, np)
        elapsed_periods += RECORDED_PERIODS
        first_point_row = len(growth_by_round) % SAMPLE_ROUNDS * RECORDED_PERIODS
        end_point_row = first_point_row + RECORDED_PERIODS
        results.points[first_point_row:end_point_row, lanes] = period_records.points
        growth_by_round.append(
            np.ascontiguousarray(period_records.log_growth.T).reshape(len(lanes), -1, BLOCK_PERIODS).sum(axis=-1)
        )
        return_distances = _return_distance_if_near(period_records.points, max_state_magnitude)
        recurrence_periods = find_recurrence_periods(
            return_distances, previous_distances, RECORDED_PERIODS, max_state_magnitude, scene.dtype
        )
        is_finished = (status >= Status.CAP) | (recurrence_periods > 0) | (elapsed_periods >= max_periods)
        is_periodic = (recurrence_periods > 0) & (status < Status.CAP)
        _store_states(results, lanes[is_finished], take_lanes(tangent_lanes, is_finished), status[is_finished])
        results.points[:, lanes[is_finished]] = np.roll(results.points[:, lanes[is_finished]], -end_point_row, axis=0)
        _store_orbits(
            scene,
            results,
            lanes[is_periodic],
            recurrence_periods[is_periodic],
            period_records,
            np.flatnonzero(is_periodic),
        )
        _store_nonrecurrent(
            results, lanes, np.flatnonzero(is_finished & ~is_periodic & (status < Status.CAP)), growth_by_round
        )
        continuing_indices = np.flatnonzero(~is_finished)
        continuing_indices = continuing_indices[
            np.argsort(period_records.n_impacts[:, continuing_indices].sum(axis=0), kind="stable")
        ]
        previous_distances = return_distances[:, continuing_indices]
        lanes, scene_lanes, tangent_lanes, max_state_magnitude, status, growth_by_round = take_lanes(
            (lanes, scene_lanes, tangent_lanes, max_state_magnitude, status, growth_by_round), continuing_indices
        )


def _return_distance_if_near(section_points, max_state_magnitude):
    """Return `compute_return_distances` of lanes whose last state is near an earlier state, inf for other lanes."""
    nearest_return_distance = (
        abs(section_points[-1] - section_points[-1 - MAX_ORBIT_PERIODS : -1]).max(axis=-1).min(axis=0)
    )
    near_lanes = np.flatnonzero(nearest_return_distance <= RETURN_TOLERANCE * max_state_magnitude)
    return_distances = np.full((MAX_ORBIT_PERIODS, section_points.shape[1]), np.inf)
    return_distances[:, near_lanes] = compute_return_distances(section_points[:, near_lanes])
    return return_distances


def _max_state_magnitude(scene, period_records):
    """Return the largest magnitude of x and v of each lane."""
    x_min, x_max, _ = initial_box(scene)
    max_speed = np.nanmax(np.where(np.isfinite(period_records.v), abs(period_records.v), 0.0), axis=0)
    return np.maximum(np.maximum(abs(x_min), abs(x_max)), max_speed)


def _store_states(results, lanes, end_lanes: TangentLanes, status):
    """Store the final states and statuses of lanes."""
    for component_array, new_values in zip(
        jax.tree.leaves(results.state), jax.tree.leaves(end_lanes.state), strict=True
    ):
        component_array[lanes] = new_values
    results.status[lanes] = status


def _store_orbits(scene, results, lanes, periods, period_records, simulated_lane_indices):
    """Store the results of periodic orbits. A lane on a repelling orbit, or without an exponent, remains undecided.

    simulated_lane_indices: indices of `lanes` in `period_records`.
    """
    for n_periods in np.unique(periods).tolist():
        has_n_periods = periods == n_periods
        group_lanes, group_lane_indices = lanes[has_n_periods], simulated_lane_indices[has_n_periods]
        exponent_estimate = compute_orbit_exponents(
            take_lanes(scene, group_lanes), take_lanes(results.state, group_lanes), periods[has_n_periods]
        )
        results.impact_counts[:, group_lanes] = [
            np.rint(impacts_per_period[-n_periods:, group_lane_indices].sum(axis=0))
            for impacts_per_period in (period_records.left_impacts, period_records.right_impacts)
        ]
        results.exponent[group_lanes], results.error[group_lanes] = (
            exponent_estimate.exponent[:, 0],
            exponent_estimate.error[:, 0],
        )
        results.periods[group_lanes[~(np.isnan(results.exponent[group_lanes]) | exponent_estimate.is_repelling)]] = (
            n_periods
        )
    for lane in lanes[np.isneginf(results.exponent[lanes])].tolist():
        scene_and_state = take_lanes(scene, lane), jax.tree.map(lambda leaf, lane=lane: leaf[lane], results.state)
        chatter_walls = (
            find_sticking_phases(*scene_and_state, int(results.periods[lane])).chatter_walls
            if results.periods[lane] > 0
            else ""
        )
        results.endless[lane] = ("L" in chatter_walls) + 2 * ("R" in chatter_walls)


def _store_nonrecurrent(results, lanes, simulated_lane_indices, growth_by_round):
    """Store motions that have not recurred: as chaotic if the exponent is positive beyond doubt, else as undecided."""
    if not len(simulated_lane_indices):
        return
    block_sums = np.concatenate(
        [round_growth[simulated_lane_indices] for round_growth in growth_by_round], axis=1
    )  # one row per lane, so that a sum does not depend on other lanes
    growth_rate = block_sums.mean(axis=1) / BLOCK_PERIODS
    error = np.array([standard_error(row[:, None], BLOCK_PERIODS) for row in block_sums])
    is_certainly_chaotic = growth_rate - CERTAIN_ERRORS * error > MIN_CHAOS_EXPONENT
    nonrecurrent_lanes = lanes[simulated_lane_indices]
    results.exponent[nonrecurrent_lanes], results.error[nonrecurrent_lanes] = growth_rate, error
    results.periods[nonrecurrent_lanes[is_certainly_chaotic]] = CHAOTIC

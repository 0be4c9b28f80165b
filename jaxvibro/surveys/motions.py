"""Classify the motions of many lanes, each with its own scene: periodic, chaotic or undecided.

Lanes are simulated until they recur or until the largest number of periods. Lanes that have not recurred are regrouped
and sorted by the work of a period, so that no lane of a block waits long for another. The result of a lane does not
depend on the other lanes, nor on earlier computations of the process.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from continuation.persistent_jit import persistent_jit

from ..attractors.batch_means import standard_error
from ..attractors.classify import MIN_CHAOS_EXPONENT
from ..attractors.orbit_exponents import compute_orbit_exponents
from ..attractors.recurrence import recurrence_distances, recurrence_periods
from ..attractors.tangent import (
    RECORDED_PERIODS,
    TangentLanes,
    run_tangents,
    start_tangents,
    worse_status,
    worse_status_on_host,
)
from ..compiled.compiler_hints import COMPILER_OPTIONS
from ..compiled.kernels import BLOCK_WIDTH
from ..maps.initial_conditions import initial_box
from ..maps.long_run import padded_block, take_lanes
from ..maps.sticking_phases import find_sticking_phases
from ..maps.strobe import strobe
from ..scene.check import MAX_ORBIT_PERIODS
from ..scene.codes import Status
from ..scene.scene import Scene
from ..scene.state import State

BLOCK_PERIODS = 16  # periods whose growth is summed
CERTAIN_ERRORS = 3.0  # standard errors by which a chaotic exponent must exceed `MIN_CHAOS_EXPONENT`
UNDECIDED, CHAOTIC = -1, 0  # codes in place of the periods of an orbit
RETURN_TOLERANCE = 1e-3  # relative to the largest x and v: distance of a settled state from an earlier one
SAMPLE_ROUNDS = 8  # times `RECORDED_PERIODS` of a motion that does not recur are kept


class MotionResults(NamedTuple):
    """Classification of lanes, as NumPy arrays, lanes last.

    Attributes
    ----------
    state : State
        Final states on the section.
    status : ndarray
        Worst status. Array of shape (lanes,).
    periods : ndarray
        Drive periods of the orbit, or `CHAOTIC` or `UNDECIDED`. Array of shape (lanes,).
    impact_counts : ndarray
        Impacts on the left and the right wall in these periods; 0 if not periodic. Array of shape (2, lanes).
    endless : ndarray
        Walls at which the mass sticks after complete chatter: 1 left, 2 right, 3 both. Array of shape (lanes,).
    exponent : ndarray
        Largest Lyapunov exponent per drive period; nan if unknown. Array of shape (lanes,).
    error : ndarray
        Standard error of the exponent; nan if unknown. Array of shape (lanes,).
    points : ndarray
        x and v on the section over the last periods, nan before the record. Array of shape (periods, lanes, 2).
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
    state, status = _advance_lanes(scene, state, settle)
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


def _advance_lanes(scene, state, periods):
    """Return (state, worst status) of lanes after some periods."""
    n_lanes = len(state.x)
    blocks = [padded_block((scene, state), start, BLOCK_WIDTH) for start in range(0, n_lanes, BLOCK_WIDTH)]
    block_results = [_advance_block(*block, periods) for block in blocks]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:n_lanes], *block_results)


@persistent_jit(compiler_options=COMPILER_OPTIONS)
def _advance_block(scene, state, periods):
    def advance_period(_, carry):
        state, status = carry
        state, impacts = strobe(scene, state, slots=0)
        return state, worse_status(status, jnp.where(impacts.status >= Status.CAP, impacts.status, Status.OK))

    return lax.fori_loop(0, periods, advance_period, (state, jnp.zeros(state.x.shape, jnp.int32)))


def _classify_lanes(scene, results, lanes, settle, max_periods):
    """Simulate lanes until they recur or reach the largest number of periods, and store their classification."""
    lane_scenes, elapsed_periods = take_lanes(scene, lanes), settle
    if not len(lanes):
        return
    tangent_lanes, records = run_tangents(
        lane_scenes, start_tangents(take_lanes(results.state, lanes)), RECORDED_PERIODS
    )
    scale, status = _state_scale(lane_scenes, records), records.status
    previous_distances, elapsed_periods, growth_sums = (
        _recurrence_distances(records.points, scale),
        elapsed_periods + RECORDED_PERIODS,
        [],
    )
    while len(lanes):
        tangent_lanes, records = run_tangents(lane_scenes, tangent_lanes, RECORDED_PERIODS)
        status = worse_status_on_host(status, records.status)
        elapsed_periods += RECORDED_PERIODS
        results.points[
            (ring_offset := len(growth_sums) % SAMPLE_ROUNDS * RECORDED_PERIODS) : ring_offset + RECORDED_PERIODS, lanes
        ] = records.points
        growth_sums.append(np.ascontiguousarray(records.growth.T).reshape(len(lanes), -1, BLOCK_PERIODS).sum(axis=-1))
        distances = _recurrence_distances(records.points, scale)
        periods = recurrence_periods(distances, previous_distances, RECORDED_PERIODS, scale, scene.dtype)
        is_finished = (status >= Status.CAP) | (periods > 0) | (elapsed_periods >= max_periods)
        is_periodic = (periods > 0) & (status < Status.CAP)
        _store_states(results, lanes[is_finished], take_lanes(tangent_lanes, is_finished), status[is_finished])
        results.points[:, lanes[is_finished]] = np.roll(
            results.points[:, lanes[is_finished]], -ring_offset - RECORDED_PERIODS, axis=0
        )
        _store_orbits(scene, results, lanes[is_periodic], periods[is_periodic], records, np.flatnonzero(is_periodic))
        _store_chaos(results, lanes, np.flatnonzero(is_finished & ~is_periodic & (status < Status.CAP)), growth_sums)
        order = np.flatnonzero(~is_finished)
        order = order[np.argsort(records.n_impacts[:, order].sum(axis=0), kind="stable")]
        lanes, lane_scenes, scale, status, previous_distances = (
            lanes[order],
            take_lanes(lane_scenes, order),
            scale[order],
            status[order],
            distances[:, order],
        )
        tangent_lanes, growth_sums = take_lanes(tangent_lanes, order), [block[order] for block in growth_sums]


def _recurrence_distances(points, scale):
    """Return `recurrence_distances` of lanes whose last state is near an earlier one; infinite for unsettled lanes."""
    nearest_return = abs(points[-1] - points[-1 - MAX_ORBIT_PERIODS : -1]).max(axis=-1).min(axis=0)
    near_lanes = np.flatnonzero(nearest_return <= RETURN_TOLERANCE * scale)
    distances = np.full((MAX_ORBIT_PERIODS, points.shape[1]), np.inf)
    distances[:, near_lanes] = recurrence_distances(points[:, near_lanes])
    return distances


def _state_scale(scene, records):
    """Return the largest magnitude of x and v of each lane."""
    x_min, x_max, _ = initial_box(scene)
    max_speed = np.nanmax(np.where(np.isfinite(records.v), abs(records.v), 0.0), axis=0)
    return np.maximum(np.maximum(abs(x_min), abs(x_max)), max_speed)


def _store_states(results, lanes, end_lanes: TangentLanes, status):
    """Store the final states and statuses of lanes."""
    for array, values in zip(jax.tree.leaves(results.state), jax.tree.leaves(end_lanes.state), strict=True):
        array[lanes] = values
    results.status[lanes] = status


def _store_orbits(scene, results, lanes, periods, records, record_indices):
    """Store the attracting periodic orbits; record_indices: indices of their lanes in the records."""
    for n_periods in np.unique(periods).tolist():
        same_period = periods == n_periods
        group_lanes, group_records = lanes[same_period], record_indices[same_period]
        estimate = compute_orbit_exponents(
            take_lanes(scene, group_lanes), take_lanes(results.state, group_lanes), periods[same_period]
        )
        results.impact_counts[:, group_lanes] = [
            np.rint(counts[-n_periods:, group_records].sum(axis=0))
            for counts in (records.left_impacts, records.right_impacts)
        ]
        results.exponent[group_lanes], results.error[group_lanes] = estimate.exponent[:, 0], estimate.error[:, 0]
        results.periods[group_lanes[~(np.isnan(results.exponent[group_lanes]) | estimate.is_repelling)]] = n_periods
    for lane in lanes[np.isneginf(results.exponent[lanes])].tolist():
        lane_inputs = take_lanes(scene, lane), jax.tree.map(lambda leaf, lane=lane: leaf[lane], results.state)
        chatter_walls = (
            find_sticking_phases(*lane_inputs, int(results.periods[lane])).chatter_walls
            if results.periods[lane] > 0
            else ""
        )
        results.endless[lane] = ("L" in chatter_walls) + 2 * ("R" in chatter_walls)


def _store_chaos(results, lanes, record_indices, growth_sums):
    """Store motions that have not recurred, as chaotic if their exponent is positive beyond doubt."""
    if not len(record_indices):
        return
    block_sums = np.concatenate(
        [block[record_indices] for block in growth_sums], axis=1
    )  # one row per lane, so that a sum does not depend on other lanes
    growth_rate = block_sums.mean(axis=1) / BLOCK_PERIODS
    error = np.array([standard_error(row[:, None], BLOCK_PERIODS) for row in block_sums])
    is_certain = growth_rate - CERTAIN_ERRORS * error > MIN_CHAOS_EXPONENT
    chaos_lanes = lanes[record_indices]
    results.exponent[chaos_lanes], results.error[chaos_lanes] = growth_rate, error
    results.periods[chaos_lanes[is_certain]] = CHAOTIC

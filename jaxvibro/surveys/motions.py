"""What very many lanes settle on, each a scene of its own: a periodic orbit, chaos, or nothing that is certain.

Lanes are run on until they recur, or until patience ends; those that have not recurred are put together and sorted by
how much work a period of theirs is, so that no lane of a block waits for long. A lane's result is its own: it does not
depend on the lanes beside it, nor on what the process did before.
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
CERTAIN_ERRORS = 3.0  # standard errors by which the exponent of chaos must exceed `MIN_CHAOS_EXPONENT`
UNDECIDED, CHAOTIC = -1, 0  # in place of the periods of an orbit
RETURN_TOLERANCE = 1e-3  # of x and v, the largest: how near a state that has settled is to one before
SAMPLE_ROUNDS = 8  # times LAPS periods of a motion that does not recur, which are kept


class MotionResults(NamedTuple):
    """What lanes have settled on: NumPy arrays, lanes last.

    state: where they are, on Sigma; status: the worst met; periods: of the orbit, CHAOTIC or UNDECIDED; impact_counts:
    impacts on the left and on the right wall in so many periods, (2, lanes), 0 where not periodic; endless: on which
    walls the mass comes to rest by complete chatter, 1 left, 2 right, 3 both; exponent, error: the largest Lyapunov
    exponent per drive period, and its standard error, nan where it is not known; points: x and v on Sigma of the last
    periods, (periods, lanes, 2), nan before what was kept."""

    state: State
    status: Int[np.ndarray, " lanes"]
    periods: Int[np.ndarray, " lanes"]
    impact_counts: Int[np.ndarray, "2 lanes"]
    endless: Int[np.ndarray, " lanes"]
    exponent: Float[np.ndarray, " lanes"]
    error: Float[np.ndarray, " lanes"]
    points: Float[np.ndarray, "periods lanes 2"]


def classify_motions(scene: Scene, state: State, settle: int, max_periods: int) -> MotionResults:
    """What lanes settle on.

    scene: its numbers single or (lanes,); state: leaves (lanes,); settle: drive periods before recurrence is looked
    for; max_periods: those after which a lane that has not recurred is taken for what it then looks like.
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
    """(state, worst status) of lanes so many periods later."""
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
    """Runs lanes on until they recur or patience ends, and puts into `results` what is seen of them."""
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
    """`recurrence_distances` of the lanes whose last state has been nearly met before, infinite of others: they have
    not settled."""
    nearest_return = abs(points[-1] - points[-1 - MAX_ORBIT_PERIODS : -1]).max(axis=-1).min(axis=0)
    near_lanes = np.flatnonzero(nearest_return <= RETURN_TOLERANCE * scale)
    distances = np.full((MAX_ORBIT_PERIODS, points.shape[1]), np.inf)
    distances[:, near_lanes] = recurrence_distances(points[:, near_lanes])
    return distances


def _state_scale(scene, records):
    """Of x and v, the largest, of each lane."""
    x_min, x_max, _ = initial_box(scene)
    max_speed = np.nanmax(np.where(np.isfinite(records.v), abs(records.v), 0.0), axis=0)
    return np.maximum(np.maximum(abs(x_min), abs(x_max)), max_speed)


def _store_states(results, lanes, end_lanes: TangentLanes, status):
    for array, values in zip(jax.tree.leaves(results.state), jax.tree.leaves(end_lanes.state), strict=True):
        array[lanes] = values
    results.status[lanes] = status


def _store_orbits(scene, results, lanes, periods, records, record_indices):
    """Puts periodic orbits into `results`, those that draw in; record_indices: of the lanes among those of the laps."""
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
    """Puts the motions that have not recurred into `results`, as chaotic where their exponent is beyond doubt."""
    if not len(record_indices):
        return
    block_sums = np.concatenate(
        [block[record_indices] for block in growth_sums], axis=1
    )  # a row a lane: the order of a sum is its own
    growth_rate = block_sums.mean(axis=1) / BLOCK_PERIODS
    error = np.array([standard_error(row[:, None], BLOCK_PERIODS) for row in block_sums])
    is_certain = growth_rate - CERTAIN_ERRORS * error > MIN_CHAOS_EXPONENT
    chaos_lanes = lanes[record_indices]
    results.exponent[chaos_lanes], results.error[chaos_lanes] = growth_rate, error
    results.periods[chaos_lanes[is_certain]] = CHAOTIC

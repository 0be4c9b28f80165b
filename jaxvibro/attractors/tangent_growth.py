"""Estimate the growth of tangent vectors and of the distance of two nearby trajectories.

The vector is normalised every period, and the logarithm of its growth is recorded (Benettin et al., Meccanica 15, 1980,
9-20). Its growth follows from the derivative of the stroboscopic map as in `monodromy`, with the saltation at impacts
(Mueller, Chaos, Solitons and Fractals 5, 1995, 1671-1681).

Estimate the largest Lyapunov exponent from two nearby trajectories (Benettin, Galgani and Strelcyn). The distance is
renormalised every few periods, and the logarithms of its growth are averaged.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from continuation.array_type import Array
from continuation.hostcall import persistent_jit

from ..compiled.kernel_calls import BLOCK_WIDTH, call_as_kernel
from ..compiled.lane_arithmetic import COMPILER_OPTIONS, choose
from ..flight.wall_positions import wall_states
from ..maps.iterate import final_states, take_padded_block
from ..maps.monodromy import strobe_with_matrix_state
from ..maps.reference_strobe import REPLAY_SLOTS
from ..scene.scene import SIDES
from ..scene.state import State, Status

RECORDED_PERIODS = 64  # largest number of recorded periods
BLOCKS_PER_CALL = 4  # blocks of a call: the host's work for each call keeps other threads waiting
MATRIX_SLICE = slice(6, 10)  # entries of the derivative in the record of a period


class TangentLanes(NamedTuple):
    """States of lanes with unit tangent vectors.

    Parameters
    ----------
    state : State
        States. Leaves of shape (lanes,).
    tangent_x : array
        Components of the tangents along x. Array of shape (lanes,).
    tangent_v : array
        Components of the tangents along v. Array of shape (lanes,).
    """

    state: State
    tangent_x: Float[Array, " lanes"]
    tangent_v: Float[Array, " lanes"]


class PeriodRecords(NamedTuple):
    """Records of the last periods of lanes, at most `RECORDED_PERIODS`, as NumPy arrays of shape (periods, lanes).

    Attributes
    ----------
    x : ndarray
        Positions at the end of a period.
    v : ndarray
        Velocities at the end of a period.
    log_growth : ndarray
        Logarithm of the growth of the tangent; -inf if the mass stuck to a wall.
    left_impacts : ndarray
        Impacts on the left wall; at most `reference_strobe.REPLAY_SLOTS` together with the right wall.
    right_impacts : ndarray
        Impacts on the right wall.
    n_impacts : ndarray
        All impacts, recorded or not.
    matrix : ndarray
        Derivative of each period by rows. Array of shape (periods, lanes, 4).
    time_in_walls : ndarray
        Time inside the left and the right wall, 0 for a rigid wall. Array of shape (periods, lanes, 2).
    status : ndarray
        Worst status of all simulated periods. Array of shape (lanes,).
    """

    x: Float[np.ndarray, "periods lanes"]
    v: Float[np.ndarray, "periods lanes"]
    log_growth: Float[np.ndarray, "periods lanes"]
    left_impacts: Float[np.ndarray, "periods lanes"]
    right_impacts: Float[np.ndarray, "periods lanes"]
    n_impacts: Float[np.ndarray, "periods lanes"]
    matrix: Float[np.ndarray, "periods lanes 4"]
    time_in_walls: Float[np.ndarray, "periods lanes 2"]
    status: Int[np.ndarray, " lanes"]

    @property
    def points(self) -> Float[np.ndarray, "periods lanes 2"]:
        """Positions and velocities at the ends of the periods, (periods, lanes, 2)."""
        return np.stack([self.x, self.v], -1)


def start_tangents(state):
    """Return `TangentLanes` at a state, with tangents in a generic direction.

    Parameters
    ----------
    state : State
        States. Leaves of shape (lanes,).

    Returns
    -------
    TangentLanes
        Lanes.
    """
    ones = np.ones_like(state.x)
    return TangentLanes(state, 0.6 * ones, 0.8 * ones)


def worse_status(earlier_status, later_status, array_module=jnp):
    """Return the worse of two successive statuses; an earlier status of CAP or worse is kept.

    Parameters
    ----------
    earlier_status : array
        Status before.
    later_status : array
        Status afterwards.
    array_module : module, optional
        jax.numpy, or numpy for host arrays of any shape, without compilation.

    Returns
    -------
    array
        Worse status.
    """
    return array_module.where(
        earlier_status >= Status.CAP, earlier_status, array_module.maximum(earlier_status, later_status)
    )


def run_tangents(scene, tangent_lanes, periods):
    """Simulate lanes with tangents and record the last periods.

    Parameters
    ----------
    scene : Scene
        Scene, without lanes or with one lane for each of `tangent_lanes`. Each of the two cases compiles separately.
    tangent_lanes : TangentLanes
        States and tangents of any number of lanes. A compiled call runs `BLOCKS_PER_CALL` blocks of `BLOCK_WIDTH`
        lanes.
    periods : int
        Drive periods, at least 1. A new number needs no compilation.

    Returns
    -------
    tangent_lanes : TangentLanes
        Lanes at the end.
    records : PeriodRecords
        Records of the last periods. The status of a lane is as in `Impacts`; FULL if a period had more than
        `reference_strobe.REPLAY_SLOTS` impacts, NONFINITE if the derivative does not exist, as at an impact
        with zero speed.
    """
    n_lanes, strip_width = len(tangent_lanes.state.x), BLOCKS_PER_CALL * BLOCK_WIDTH
    strip_results = [
        _run_strip(*take_padded_block((scene, tangent_lanes), first_lane, strip_width), n_lanes - first_lane, periods)
        for first_lane in range(0, n_lanes, strip_width)
    ]
    end_lanes, record_rows, worst_status = jax.tree.map(_concatenate_strips, *strip_results)
    record_rows = record_rows[..., :n_lanes][:periods]
    if periods > RECORDED_PERIODS:
        record_rows = np.roll(record_rows, -(periods % RECORDED_PERIODS), axis=0)
    end_lanes, worst_status = jax.tree.map(lambda leaf: leaf[:n_lanes], (end_lanes, worst_status))
    time_in_walls = np.zeros((*record_rows[:, 0].shape, 2), record_rows.dtype)
    for soft_wall_index, side in enumerate(scene.soft_sides):
        time_in_walls[..., SIDES.index(side)] = record_rows[:, MATRIX_SLICE.stop + soft_wall_index]
    return end_lanes, PeriodRecords(
        *np.moveaxis(record_rows, 1, 0)[: MATRIX_SLICE.start],
        np.moveaxis(record_rows[:, MATRIX_SLICE], 1, 2),
        time_in_walls,
        worst_status,
    )


def _concatenate_strips(*strips):
    """Concatenate strips along the last axis; a single strip is not copied."""
    return np.asarray(strips[0]) if len(strips) == 1 else np.concatenate(strips, axis=-1)


@persistent_jit(compiler_options=COMPILER_OPTIONS)
def _run_strip(scene, tangent_lanes, n_valid_lanes, periods):
    """Run `_run_block` on the blocks of a strip that contain its first `n_valid_lanes` lanes.

    A strip has `BLOCKS_PER_CALL` blocks. The result of the other blocks is 0.
    """
    n_lanes, dtype = BLOCKS_PER_CALL * BLOCK_WIDTH, tangent_lanes.state.x.dtype

    def update_block(block_index, strip_results):
        def take_block(leaf):
            return lax.dynamic_slice_in_dim(leaf, block_index * BLOCK_WIDTH, BLOCK_WIDTH) if jnp.ndim(leaf) else leaf

        def store_block(strip_array, block_values):
            return lax.dynamic_update_slice_in_dim(strip_array, block_values, block_index * BLOCK_WIDTH, -1)

        return jax.tree.map(
            store_block, strip_results, _run_block(*jax.tree.map(take_block, (scene, tangent_lanes)), periods)
        )

    empty_rows = jnp.zeros((RECORDED_PERIODS, MATRIX_SLICE.stop + len(scene.soft_sides), n_lanes), dtype)
    empty_results = jax.tree.map(jnp.zeros_like, tangent_lanes), empty_rows, jnp.zeros(n_lanes, jnp.int32)
    return lax.fori_loop(0, jnp.minimum(BLOCKS_PER_CALL, -(-n_valid_lanes // BLOCK_WIDTH)), update_block, empty_results)


def _run_block(scene, tangent_lanes, periods):
    """Return (lanes at the end, records of the last periods, worst status) of a block of lanes.

    The records have the shape (RECORDED_PERIODS, numbers of a record, lanes). Period i is in row i modulo
    `RECORDED_PERIODS`.
    """
    lane_shape = tangent_lanes.state.x.shape

    def advance_period(period, carry):
        tangent_lanes, period_ring, worst_status = carry
        x, v, contact, tangent_x, tangent_v, status, *record = call_as_kernel(_run_period, scene, tangent_lanes)
        tangent_lanes = TangentLanes(State(x, v, tangent_lanes.state.phase, contact), tangent_x, tangent_v)
        period_row = jnp.stack([x, v, *record])  # a ring for each number would cost as much as the rest
        return (
            tangent_lanes,
            lax.dynamic_update_index_in_dim(period_ring, period_row, period % RECORDED_PERIODS, 0),
            worse_status(worst_status, status),
        )

    period_ring = jnp.zeros(
        (RECORDED_PERIODS, MATRIX_SLICE.stop + len(scene.soft_sides), *lane_shape), tangent_lanes.state.x.dtype
    )
    return lax.fori_loop(0, periods, advance_period, (tangent_lanes, period_ring, jnp.zeros(lane_shape, jnp.int32)))


def _run_period(scene, tangent_lanes):
    """Return x, v, contact, the tangent, the status and the record of one period.

    The record consists of the logarithmic growth, the impacts on the left wall, on the right wall and in total, the
    four entries of the derivative of the map, and the time inside each soft wall.
    """
    end_state, impacts, is_sticking, monodromy_state = strobe_with_matrix_state(
        scene, tangent_lanes.state, 1, REPLAY_SLOTS
    )
    has_too_many_impacts = (impacts.count > REPLAY_SLOTS) & ~is_sticking
    matrix = [
        choose(has_too_many_impacts, jnp.nan, choose(is_sticking, 0.0, entry)) for entry in monodromy_state.matrix
    ]
    xx, xv, vx, vv = matrix
    tangent_x, tangent_v = (
        xx * tangent_lanes.tangent_x + xv * tangent_lanes.tangent_v,
        vx * tangent_lanes.tangent_x + vv * tangent_lanes.tangent_v,
    )
    tangent_growth = lax.sqrt(tangent_x * tangent_x + tangent_v * tangent_v)
    is_growth_finite = (tangent_growth > 0) & jnp.isfinite(tangent_growth)
    status = choose(
        has_too_many_impacts,
        Status.FULL,
        choose(jnp.isfinite(tangent_growth), lax.full_like(impacts.count, 0), Status.NONFINITE),
    )
    status = choose(impacts.status >= Status.CAP, impacts.status, status)
    n_recorded_impacts = lax.min(impacts.count, jnp.int32(REPLAY_SLOTS)).astype(tangent_growth.dtype)
    right_minus_left_impacts = jnp.sum(impacts.side.astype(tangent_growth.dtype), axis=-1)
    return (
        *(end_state.x, end_state.v, end_state.contact),
        *(
            choose(is_growth_finite, tangent_x / tangent_growth, tangent_lanes.tangent_x),
            choose(is_growth_finite, tangent_v / tangent_growth, tangent_lanes.tangent_v),
        ),
        status,
        *(
            lax.log(tangent_growth),
            0.5 * (n_recorded_impacts - right_minus_left_impacts),
            0.5 * (n_recorded_impacts + right_minus_left_impacts),
        ),
        impacts.count.astype(tangent_growth.dtype),
        *matrix,
        *monodromy_state.total_contact_times,
    )


RENORMALISATION_PERIODS = 5  # periods between two renormalisations
N_RENORMALISATIONS = 200  # renormalisations; the second half is averaged


def largest_exponents(scene, state, max_state_magnitude):
    """Return (mean, standard error) of each lane's largest exponent per period, shape (lanes,).

    scene: single; state: leaves (lanes,), after the transient; max_state_magnitude: largest magnitude of x and v. Mean
    and error are nan if a lane or its companion has a status of CAP or worse. The mean is -inf if the exponent is too
    low to be measured: the distance shrinks to rounding within `RENORMALISATION_PERIODS`, as after an impact with R =
    0.
    """
    machine_eps = np.finfo(scene.dtype).eps
    n_lanes, separation = len(state.x), machine_eps**0.5 * max_state_magnitude
    state_direction = np.tile(np.array([[0.6], [0.8]], scene.dtype), n_lanes)
    growth_rates, is_invalid = [], np.zeros(n_lanes, bool)
    for _ in range(N_RENORMALISATIONS):
        lanes_and_companions = _add_companions(scene, state, separation * state_direction)
        initial_difference = _companions_minus_lanes(lanes_and_companions, n_lanes)
        lanes_and_companions, status = final_states(
            scene, lanes_and_companions, RENORMALISATION_PERIODS, max_single_lanes=0
        )
        is_invalid |= (status >= Status.CAP).reshape(2, n_lanes).any(axis=0)
        final_difference = _companions_minus_lanes(lanes_and_companions, n_lanes)
        final_distance = abs(final_difference).max(axis=0)
        is_resolvable = final_distance > 16.0 * machine_eps * max_state_magnitude
        growth_rates.append(
            np.log(
                final_distance / abs(initial_difference).max(axis=0), where=is_resolvable, out=np.full(n_lanes, -np.inf)
            )
            / RENORMALISATION_PERIODS
        )
        state_direction = np.where(
            final_distance > 0, final_difference / np.where(final_distance > 0, final_distance, 1.0), state_direction
        )
        state = jax.tree.map(lambda leaf: leaf[:n_lanes], lanes_and_companions)
    late_growth_rates = np.stack(growth_rates[N_RENORMALISATIONS // 2 :])
    is_resolvable = np.isfinite(late_growth_rates).all(axis=0)
    mean_growth_rate, error = (
        late_growth_rates.mean(axis=0),
        np.where(is_resolvable, late_growth_rates, 0.0).std(axis=0) / len(late_growth_rates) ** 0.5,
    )
    return np.where(is_invalid, np.nan, mean_growth_rate), np.where(is_invalid, np.nan, error)


def _add_companions(scene, state, offset):
    """Return the lanes followed by their companions, whose x and v differ by `offset`.

    The offset is reversed if the companion would be beyond a wall.
    """
    (x_min, _), (x_max, _) = jax.tree.map(np.asarray, wall_states(scene, state.phase[0]))
    x = state.x + offset[0]
    signed_offset = np.where((x < x_min) | (x > x_max), -offset, offset)
    companion_state = State(
        state.x + signed_offset[0], state.v + signed_offset[1], state.phase, np.zeros_like(state.contact)
    )
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), state, companion_state)


def _companions_minus_lanes(lanes_and_companions, n_lanes):
    """Return x and v of the companions minus those of their lanes, shape (2, lanes)."""
    return np.stack(
        [
            lanes_and_companions.x[n_lanes:] - lanes_and_companions.x[:n_lanes],
            lanes_and_companions.v[n_lanes:] - lanes_and_companions.v[:n_lanes],
        ]
    )

"""Simulate lanes with a tangent vector each, recorded period by period.

The vector is normalised every period and the logarithm of its growth recorded (Benettin et al., Meccanica 15, 1980,
9-20). The derivative is that of `monodromy`, saltation at impacts included (Mueller, Chaos, Solitons and Fractals 5,
1995, 1671-1681).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from continuation.array_type import Array
from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import COMPILER_OPTIONS, choose
from ..compiled.kernels import BLOCK_WIDTH, call_as_kernel
from ..maps.long_run import padded_block
from ..maps.monodromy import strobe_with_product
from ..maps.one_period import REPLAY_SLOTS
from ..scene.codes import Status
from ..scene.scene import SIDES
from ..scene.state import State

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
        Component along x. Array of shape (lanes,).
    tangent_v : array
        Component along v. Array of shape (lanes,).
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
    growth : ndarray
        Logarithm of the growth of the tangent; -inf if the mass stuck to a wall.
    left_impacts : ndarray
        Impacts on the left wall; at most `one_period.REPLAY_SLOTS` together with the right wall.
    right_impacts : ndarray
        Impacts on the right wall.
    n_impacts : ndarray
        All impacts.
    matrix : ndarray
        Derivative of each period by rows. Array of shape (periods, lanes, 4).
    time_within : ndarray
        Time inside each wall, left and right, 0 for a rigid one. Array of shape (periods, lanes, 2).
    status : ndarray
        Worst status of all simulated periods. Array of shape (lanes,).
    """

    x: Float[np.ndarray, "periods lanes"]
    v: Float[np.ndarray, "periods lanes"]
    growth: Float[np.ndarray, "periods lanes"]
    left_impacts: Float[np.ndarray, "periods lanes"]
    right_impacts: Float[np.ndarray, "periods lanes"]
    n_impacts: Float[np.ndarray, "periods lanes"]
    matrix: Float[np.ndarray, "periods lanes 4"]
    time_within: Float[np.ndarray, "periods lanes 2"]
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


def worse_status(earlier, later):
    """Return the worse of two successive statuses; a lane that has ended keeps its reason.

    Parameters
    ----------
    earlier : array
        Status before.
    later : array
        Status afterwards.

    Returns
    -------
    array
        Worse status.
    """
    return jnp.where(earlier >= Status.CAP, earlier, jnp.maximum(earlier, later))


def worse_status_on_host(earlier, later):
    """Apply `worse_status` to host arrays of any shape, without compilation.

    Parameters
    ----------
    earlier : ndarray
        Status before.
    later : ndarray
        Status afterwards.

    Returns
    -------
    ndarray
        Worse status.
    """
    return np.where(np.asarray(earlier) >= Status.CAP, earlier, np.maximum(earlier, later))


def run_tangents(scene, lanes, periods):
    """Simulate lanes with tangents and record the last periods.

    Parameters
    ----------
    scene : Scene
        Scene, without lanes or with one lane for each lane; the two are compiled separately.
    lanes : TangentLanes
        Lanes, any number. They run in blocks of `BLOCK_WIDTH`, `BLOCKS_PER_CALL` blocks in a call.
    periods : int
        Drive periods, at least 1. A new number needs no compilation.

    Returns
    -------
    lanes : TangentLanes
        Lanes at the end.
    records : PeriodRecords
        Records of the last periods. The status of a lane is as in `Impacts`; FULL if a period had more than
        `one_period.REPLAY_SLOTS` impacts, NONFINITE if the derivative does not exist, as at an impact with zero speed.
    """
    n_lanes, strip_width = len(lanes.state.x), BLOCKS_PER_CALL * BLOCK_WIDTH
    strips = [
        _run_strip(*padded_block((scene, lanes), start, strip_width), n_lanes - start, periods)
        for start in range(0, n_lanes, strip_width)
    ]
    end_lanes, rows, worst_status = jax.tree.map(_concatenate_strips, *strips)
    rows = rows[..., :n_lanes][:periods]
    if periods > RECORDED_PERIODS:
        rows = np.roll(rows, -(periods % RECORDED_PERIODS), axis=0)
    end_lanes, worst_status = jax.tree.map(lambda leaf: leaf[:n_lanes], (end_lanes, worst_status))
    time_within = np.zeros((*rows[:, 0].shape, 2), rows.dtype)
    for soft_index, side in enumerate(scene.soft_sides):
        time_within[..., SIDES.index(side)] = rows[:, MATRIX_SLICE.stop + soft_index]
    return end_lanes, PeriodRecords(
        *np.moveaxis(rows, 1, 0)[: MATRIX_SLICE.start],
        np.moveaxis(rows[:, MATRIX_SLICE], 1, 2),
        time_within,
        worst_status,
    )


def _concatenate_strips(*strips):
    """Concatenate strips along the last axis; a single strip is not copied."""
    return np.asarray(strips[0]) if len(strips) == 1 else np.concatenate(strips, axis=-1)


@persistent_jit(compiler_options=COMPILER_OPTIONS)
def _run_strip(scene, lanes, n_active, periods):
    """Return the result of `_run_block` for the first `n_active` lanes of a strip, and 0 for the others."""
    n_lanes, dtype = BLOCKS_PER_CALL * BLOCK_WIDTH, lanes.state.x.dtype

    def update_block(block_index, results):
        def take_block(leaf):
            return lax.dynamic_slice_in_dim(leaf, block_index * BLOCK_WIDTH, BLOCK_WIDTH) if jnp.ndim(leaf) else leaf

        def store_block(array, block_values):
            return lax.dynamic_update_slice_in_dim(array, block_values, block_index * BLOCK_WIDTH, -1)

        return jax.tree.map(store_block, results, _run_block(*jax.tree.map(take_block, (scene, lanes)), periods))

    rows = jnp.zeros((RECORDED_PERIODS, MATRIX_SLICE.stop + len(scene.soft_sides), n_lanes), dtype)
    empty = jax.tree.map(jnp.zeros_like, lanes), rows, jnp.zeros(n_lanes, jnp.int32)
    return lax.fori_loop(0, jnp.minimum(BLOCKS_PER_CALL, -(-n_active // BLOCK_WIDTH)), update_block, empty)


def _run_block(scene, lanes, periods):
    """Return (lanes, last periods as a ring (RECORDED_PERIODS, numbers, lanes), worst status).

    Period i is row i modulo `RECORDED_PERIODS`.
    """
    shape = lanes.state.x.shape

    def advance_period(period, carry):
        lanes, ring, worst_status = carry
        x, v, contact, tangent_x, tangent_v, status, *record = call_as_kernel(_run_period, scene, lanes)
        lanes = TangentLanes(State(x, v, lanes.state.phase, contact), tangent_x, tangent_v)
        row = jnp.stack([x, v, *record])  # a ring for each number would cost as much as the rest
        return (
            lanes,
            lax.dynamic_update_index_in_dim(ring, row, period % RECORDED_PERIODS, 0),
            worse_status(worst_status, status),
        )

    ring = jnp.zeros((RECORDED_PERIODS, MATRIX_SLICE.stop + len(scene.soft_sides), *shape), lanes.state.x.dtype)
    return lax.fori_loop(0, periods, advance_period, (lanes, ring, jnp.zeros(shape, jnp.int32)))


def _run_period(scene, lanes):
    """Return the state, tangent, status and record of one period.

    The record is growth, impacts on the left, on the right, all, M, and the time inside each soft wall.
    """
    end_state, impacts, is_sticking, path_data = strobe_with_product(scene, lanes.state, 1, REPLAY_SLOTS)
    overflow = (impacts.count > REPLAY_SLOTS) & ~is_sticking
    matrix = [choose(overflow, jnp.nan, choose(is_sticking, 0.0, entry)) for entry in path_data.matrix]
    a, b, c, d = matrix
    tangent_x, tangent_v = a * lanes.tangent_x + b * lanes.tangent_v, c * lanes.tangent_x + d * lanes.tangent_v
    growth = lax.sqrt(tangent_x * tangent_x + tangent_v * tangent_v)
    is_growth_finite = (growth > 0) & jnp.isfinite(growth)
    status = choose(
        overflow, Status.FULL, choose(jnp.isfinite(growth), lax.full_like(impacts.count, 0), Status.NONFINITE)
    )
    status = choose(impacts.status >= Status.CAP, impacts.status, status)
    n_recorded = lax.min(impacts.count, jnp.int32(REPLAY_SLOTS)).astype(growth.dtype)
    side_sum = jnp.sum(impacts.side.astype(growth.dtype), axis=-1)
    return (
        *(end_state.x, end_state.v, end_state.contact),
        *(
            choose(is_growth_finite, tangent_x / growth, lanes.tangent_x),
            choose(is_growth_finite, tangent_v / growth, lanes.tangent_v),
        ),
        status,
        *(lax.log(growth), 0.5 * (n_recorded - side_sum), 0.5 * (n_recorded + side_sum)),
        impacts.count.astype(growth.dtype),
        *matrix,
        *path_data.contact_times,
    )

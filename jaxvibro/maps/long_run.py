"""Iterate many lanes over many periods: by the fast path as long as possible, then by both tiers.

Compiling both tiers takes three times as long as compiling the fast path, and most lanes never need the reference path.
A lane that the fast path gives up stops there: the host computes this period by the reference path, and the lane
resumes with the others that have stopped. If this costs more than compiling both tiers, both are compiled and do the
rest. The choice depends on the lanes alone.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import COMPILER_OPTIONS
from ..scene.codes import Status
from . import one_period, two_tiers
from .strobe import strobe

MAX_RECORDED_PERIODS = 64  # the last periods of a run, which are recorded
REFERENCE_COST = 32  # cost of a reference period of one lane on the host, in periods of a block
MAX_RETRY_COST = 20_000  # in periods of a block: half a second, less than compiling both tiers


def run_periods(scene, state, periods, slots, block_width, record_periods=True):
    """Return (state, worst status, ring buffers of the recorded periods) of lanes, in blocks of a given width.

    `scene` is a single one or has a number for each lane. The ring buffers hold x, v, contact, times, sides and speeds;
    period i is row i modulo `MAX_RECORDED_PERIODS`. The status FULL refers to the recorded periods only. The buffers
    are empty without `record_periods`.
    """
    n_lanes = len(state.x)
    n_done, fast = np.zeros(n_lanes, np.int32), two_tiers.has_fast_path(scene)
    results = _run_in_blocks(scene, state, n_done, periods, slots, block_width, fast, record_periods)
    if not fast:
        return results[0], results[1], results[3]
    cost = 0
    while (unfinished := np.flatnonzero(results[2] < periods)).size:
        n_blocks = -(-unfinished.size // block_width)
        cost += REFERENCE_COST * unfinished.size + n_blocks * int(periods - results[2][unfinished].min())
        fast = cost <= MAX_RETRY_COST
        if fast:
            results = _run_reference_period(scene, results, unfinished, periods, slots)
        arguments, n_done_before = (scene, results[0]), results[2][unfinished]
        unfinished_arguments = jax.tree.map(
            lambda leaf, lanes=unfinished: leaf[lanes] if np.ndim(leaf) else leaf, arguments
        )
        new_results = _run_in_blocks(
            *unfinished_arguments, n_done_before, periods, slots, block_width, fast, record_periods
        )
        results = _merge_results(results, unfinished, new_results, n_done_before)
    return results[0], results[1], results[3]


def _run_in_blocks(scene, state, n_done, periods, slots, block_width, fast, record_periods):
    """Return (state, status, periods done, ring buffers) of lanes, each run from its own first period `n_done`."""
    n_lanes = len(n_done)
    blocks = [padded_block((scene, state, n_done), start, block_width) for start in range(0, n_lanes, block_width)]
    runs = [_run_block(*block, periods, slots, fast) for block in blocks]
    return join_blocks(runs if record_periods else [(*run[:3], ()) for run in runs], n_lanes)


def padded_block(lanes, start, block_width):
    """Select a block of lanes and repeat the last lane if there are too few.

    Parameters
    ----------
    lanes : pytree of array
        Numbers with the lanes as first axis, or scalars, which are shared and stay scalars.
    start : int
        First lane.
    block_width : int
        Number of lanes of the block.

    Returns
    -------
    pytree of array
        The block.
    """
    indices = np.arange(start, start + block_width)
    return jax.tree.map(lambda leaf: np.asarray(leaf).take(indices, 0, mode="clip") if np.ndim(leaf) else leaf, lanes)


def take_lanes(tree, lanes):
    """Select lanes of a tree.

    Parameters
    ----------
    tree : pytree of array
        Numbers with the lanes as first axis, or scalars, which are shared and stay scalars.
    lanes : array of int or bool
        Selection of lanes.

    Returns
    -------
    pytree of numpy.ndarray
        Numbers of the selected lanes.
    """
    return jax.tree.map(lambda leaf: np.asarray(leaf)[lanes] if np.ndim(leaf) else np.asarray(leaf), tree)


def join_blocks(runs, n_lanes):
    """Join the results of blocks and cut them to `n_lanes` lanes; ring buffers come last, with periods first."""
    *end_arrays, ring_buffers = zip(*runs, strict=True)
    end_arrays = (jax.tree.map(lambda *parts: np.concatenate(parts)[:n_lanes], *parts) for parts in end_arrays)
    return *end_arrays, tuple(np.concatenate(parts, axis=1)[:, :n_lanes] for parts in zip(*ring_buffers, strict=True))


def unroll_ring_buffers(ring_buffers, periods):
    """Return the recorded periods of ring buffers in order of time."""
    shift = -(periods % MAX_RECORDED_PERIODS) if periods > MAX_RECORDED_PERIODS else 0
    return [np.roll(ring_buffer, shift, axis=0)[: min(periods, MAX_RECORDED_PERIODS)] for ring_buffer in ring_buffers]


def _run_reference_period(scene, results, lanes, periods, slots):
    """Advance some lanes by one period of the reference path."""
    state, status, n_done, ring_buffers = results
    state, status, n_done = jax.tree.map(np.array, state), np.array(status), np.array(n_done)
    for lane in lanes:
        lane_arguments = jax.tree.map(
            lambda leaf, lane=lane: np.asarray(leaf[lane] if np.ndim(leaf) else leaf), (scene, state)
        )
        end, impacts = _reference_strobe(*lane_arguments, slots)
        period = n_done[lane]
        status[lane] = max(status[lane], _recorded_status(impacts.status, period >= periods - MAX_RECORDED_PERIODS))
        n_done[lane] += 1
        for old, new in zip(jax.tree.leaves(state), jax.tree.leaves(end), strict=True):
            old[lane] = new
        period_data = (end.x, end.v, end.contact, impacts.time, impacts.side, impacts.speed)
        for old, values in zip(ring_buffers, period_data, strict=False):
            old[period % MAX_RECORDED_PERIODS, lane] = values
    return state, status, n_done, ring_buffers


def _recorded_status(status, is_recorded):
    return int(status) if status >= Status.CAP or (is_recorded and status == Status.FULL) else int(Status.OK)


def _merge_results(results, lanes, new_results, n_done_before):
    """Merge the results of a later run of some lanes, which began with the periods `n_done_before`."""
    (state, status, n_done, ring_buffers), (new_state, new_status, new_n_done, new_buffers) = results, new_results
    for old, new in zip(jax.tree.leaves((state, n_done)), jax.tree.leaves((new_state, new_n_done)), strict=True):
        old[lanes] = new
    status[lanes] = np.where(status[lanes] >= Status.CAP, status[lanes], np.maximum(status[lanes], new_status))
    row_period = (
        new_n_done - 1 - (new_n_done - 1 - np.arange(MAX_RECORDED_PERIODS)[:, None]) % MAX_RECORDED_PERIODS
    )  # the period that each row holds
    is_new_row = row_period >= n_done_before
    for old, new in zip(ring_buffers, new_buffers, strict=True):
        old[:, lanes] = np.where(is_new_row[..., None] if new.ndim > 2 else is_new_row, new, old[:, lanes])
    return state, status, n_done, ring_buffers


@persistent_jit(static_argnums=2, compiler_options=COMPILER_OPTIONS, numpy_first=True)
def _reference_strobe(scene, state, slots):
    """Return (State, Impacts) of a period of one lane by the reference path."""
    return one_period.strobe(scene, state, 1, slots, 1)


@persistent_jit(static_argnames=("slots", "fast"), compiler_options=COMPILER_OPTIONS)
def _run_block(scene, state, n_done, periods, slots, fast):
    """Return (state, status, periods done, ring buffers) of a block; a lane begins with its period `n_done`.

    With `fast`, only the fast path is used, and a lane that it gives up stops at the end of the period before.
    """
    lanes = state.x.shape
    lane_rows = jnp.zeros((MAX_RECORDED_PERIODS, *lanes), state.x.dtype)
    slot_rows = jnp.zeros((MAX_RECORDED_PERIODS, *lanes, slots), state.x.dtype)
    ring_buffers = (lane_rows, lane_rows, lane_rows, slot_rows, slot_rows.astype(jnp.int32), slot_rows)

    def is_unfinished(carry):
        period, _, _, n_done, _ = carry
        return (period < periods) & jnp.any(n_done >= period)

    def run_period(carry):
        period, state, status, n_done, ring_buffers = carry
        if fast:
            (end_state, impacts), given_up = two_tiers.fast_strobe(scene, state, slots, 1)
            advances = (n_done == period) & ~given_up
        else:
            end_state, impacts = strobe(scene, state, slots=slots)
            advances = n_done == period
        is_full = (impacts.status == Status.FULL) & (period >= periods - MAX_RECORDED_PERIODS)
        new_status = jnp.where(impacts.status >= Status.CAP, impacts.status, jnp.where(is_full, Status.FULL, Status.OK))
        new_status = jnp.where(status >= Status.CAP, status, jnp.maximum(status, new_status))
        period_data = (end_state.x, end_state.v, end_state.contact, impacts.time, impacts.side, impacts.speed)
        ring_buffers = tuple(
            ring_buffer.at[period % MAX_RECORDED_PERIODS].set(values)
            for ring_buffer, values in zip(ring_buffers, period_data, strict=True)
        )
        state = jax.tree.map(lambda new, old: jnp.where(advances, new, old), end_state, state)
        return period + 1, state, jnp.where(advances, new_status, status), n_done + advances, ring_buffers

    start = jnp.min(n_done), state, jnp.zeros(lanes, jnp.int32), n_done, ring_buffers
    return lax.while_loop(is_unfinished, run_period, start)[1:]

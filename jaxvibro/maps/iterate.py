"""Iterate many states over many periods, by the fast path and the reference path, and record the last periods.

Iterate many lanes over many periods by the fast path, with the reference path where it is needed. Compiling both paths
takes three times as long as compiling the fast path, and most lanes never need the reference path. If the fast path
gives up a lane, the lane stops, the host computes the period by the reference path, and the lane resumes together with
other stopped lanes. If this procedure would cost more than compiling both paths, a function with both paths is compiled
and finishes the run. The choice depends only on the lanes.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int

from continuation.hostcall import persistent_jit

from ..compiled.kernel_calls import BLOCK_WIDTH
from ..compiled.lane_arithmetic import COMPILER_OPTIONS
from ..scene.state import State, Status
from . import reference_strobe, two_tier_strobe
from .strobe import concrete_strobe, strobe

MAX_RECORDED_PERIODS = 64  # the last periods of a run, which are recorded
REFERENCE_COST = 32  # cost of a reference period of one lane on the host, in periods of a block
MAX_RETRY_COST = 20_000  # in periods of a block: half a second, less than compiling both tiers


def iterate_in_batches(scene, state, periods, slots, block_width, is_recording_periods=True):
    """Iterate lanes in blocks and return (state, worst status, ring buffers of the recorded periods).

    `scene` is a single scene, or a batch with one scene for each lane. The ring buffers hold x, v, contact, times,
    sides and speeds. Period i is stored in row i modulo `MAX_RECORDED_PERIODS`. The status FULL refers to the recorded
    periods only. The ring buffers are empty if `is_recording_periods` is false.
    """
    n_lanes = len(state.x)
    n_periods_done, is_fast_path_only = np.zeros(n_lanes, np.int32), two_tier_strobe.has_fast_path(scene)
    lane_results = _iterate_blocks(
        scene, state, n_periods_done, periods, slots, block_width, is_fast_path_only, is_recording_periods
    )
    if not is_fast_path_only:
        return lane_results[0], lane_results[1], lane_results[3]
    retry_cost = 0
    while (unfinished_lanes := np.flatnonzero(lane_results[2] < periods)).size:
        n_blocks = -(-unfinished_lanes.size // block_width)
        retry_cost += REFERENCE_COST * unfinished_lanes.size + n_blocks * int(
            periods - lane_results[2][unfinished_lanes].min()
        )
        is_fast_path_only = retry_cost <= MAX_RETRY_COST
        if is_fast_path_only:
            lane_results = _advance_by_reference(scene, lane_results, unfinished_lanes, periods, slots)
        arguments, n_periods_before = (scene, lane_results[0]), lane_results[2][unfinished_lanes]
        unfinished_arguments = jax.tree.map(
            lambda leaf, lanes=unfinished_lanes: leaf[lanes] if np.ndim(leaf) else leaf, arguments
        )
        new_results = _iterate_blocks(
            *unfinished_arguments,
            n_periods_before,
            periods,
            slots,
            block_width,
            is_fast_path_only,
            is_recording_periods,
        )
        lane_results = _merge_lane_results(lane_results, unfinished_lanes, new_results, n_periods_before)
    return lane_results[0], lane_results[1], lane_results[3]


def _iterate_blocks(scene, state, n_periods_done, periods, slots, block_width, is_fast_path_only, is_recording_periods):
    """Return (state, status, periods done, ring buffers) of lanes; each lane starts after `n_periods_done` periods."""
    n_lanes = len(n_periods_done)
    arguments_by_block = [
        take_padded_block((scene, state, n_periods_done), first_lane, block_width)
        for first_lane in range(0, n_lanes, block_width)
    ]
    block_results = [
        _iterate_block(*arguments_of_block, periods, slots, is_fast_path_only)
        for arguments_of_block in arguments_by_block
    ]
    return join_blocks(
        block_results if is_recording_periods else [(*block_result[:3], ()) for block_result in block_results], n_lanes
    )


def take_padded_block(lane_arguments, first_lane, block_width):
    """Select a block of lanes; repeat the last lane if there are too few.

    Parameters
    ----------
    lane_arguments : pytree of array
        Arrays with the lanes as first axis, or scalars for all lanes, which remain scalars.
    first_lane : int
        First lane.
    block_width : int
        Number of lanes of the block.

    Returns
    -------
    pytree of array
        The block.
    """
    lane_indices = np.arange(first_lane, first_lane + block_width)
    return jax.tree.map(
        lambda leaf: np.asarray(leaf).take(lane_indices, 0, mode="clip") if np.ndim(leaf) else leaf, lane_arguments
    )


def take_lanes(lane_tree, lane_selection):
    """Select lanes of a tree.

    Parameters
    ----------
    lane_tree : pytree of array
        Arrays with the lanes as first axis, or scalars for all lanes, which remain scalars.
    lane_selection : array of int or bool
        Selection of lanes.

    Returns
    -------
    pytree of numpy.ndarray
        Arrays of the selected lanes.
    """
    return jax.tree.map(lambda leaf: np.asarray(leaf)[lane_selection] if np.ndim(leaf) else np.asarray(leaf), lane_tree)


def join_blocks(block_results, n_lanes):
    """Join the results of blocks and truncate them to `n_lanes` lanes; ring buffers are the last result of a block."""
    *final_arrays, ring_buffers = zip(*block_results, strict=True)
    final_arrays = (
        jax.tree.map(lambda *parts: np.concatenate(parts)[:n_lanes], *block_parts) for block_parts in final_arrays
    )
    return *final_arrays, tuple(
        np.concatenate(block_parts, axis=1)[:, :n_lanes] for block_parts in zip(*ring_buffers, strict=True)
    )


def unroll_ring_buffers(ring_buffers, periods):
    """Return the recorded periods of ring buffers in order of time."""
    row_shift = -(periods % MAX_RECORDED_PERIODS) if periods > MAX_RECORDED_PERIODS else 0
    return [
        np.roll(ring_buffer, row_shift, axis=0)[: min(periods, MAX_RECORDED_PERIODS)] for ring_buffer in ring_buffers
    ]


def _advance_by_reference(scene, lane_results, lane_indices, periods, slots):
    """Advance the listed lanes by one period of the reference path."""
    state, status, n_periods_done, ring_buffers = lane_results
    state, status, n_periods_done = jax.tree.map(np.array, state), np.array(status), np.array(n_periods_done)
    for lane in lane_indices:
        lane_arguments = jax.tree.map(
            lambda leaf, lane=lane: np.asarray(leaf[lane] if np.ndim(leaf) else leaf), (scene, state)
        )
        end_state, impacts = _reference_strobe(*lane_arguments, slots)
        period_index = n_periods_done[lane]
        status[lane] = max(
            status[lane], _status_to_record(impacts.status, period_index >= periods - MAX_RECORDED_PERIODS)
        )
        n_periods_done[lane] += 1
        for old, new in zip(jax.tree.leaves(state), jax.tree.leaves(end_state), strict=True):
            old[lane] = new
        period_data = (end_state.x, end_state.v, end_state.contact, impacts.time, impacts.side, impacts.speed)
        for old, values in zip(ring_buffers, period_data, strict=False):
            old[period_index % MAX_RECORDED_PERIODS, lane] = values
    return state, status, n_periods_done, ring_buffers


def _status_to_record(status, is_recorded_period):
    return int(status) if status >= Status.CAP or (is_recorded_period and status == Status.FULL) else int(Status.OK)


def _merge_lane_results(lane_results, lane_indices, new_results, n_periods_before):
    """Merge the results of a later run of the listed lanes, which started after `n_periods_before` periods."""
    (state, status, n_periods_done, ring_buffers), (new_state, new_status, new_n_periods_done, new_buffers) = (
        lane_results,
        new_results,
    )
    for old, new in zip(
        jax.tree.leaves((state, n_periods_done)), jax.tree.leaves((new_state, new_n_periods_done)), strict=True
    ):
        old[lane_indices] = new
    status[lane_indices] = np.where(
        status[lane_indices] >= Status.CAP, status[lane_indices], np.maximum(status[lane_indices], new_status)
    )
    period_of_row = (
        new_n_periods_done
        - 1
        - (new_n_periods_done - 1 - np.arange(MAX_RECORDED_PERIODS)[:, None]) % MAX_RECORDED_PERIODS
    )  # the period that each row holds
    is_new_row = period_of_row >= n_periods_before
    for old, new in zip(ring_buffers, new_buffers, strict=True):
        old[:, lane_indices] = np.where(
            is_new_row[..., None] if new.ndim > 2 else is_new_row, new, old[:, lane_indices]
        )
    return state, status, n_periods_done, ring_buffers


@persistent_jit(static_argnums=2, compiler_options=COMPILER_OPTIONS, numpy_first=True)
def _reference_strobe(scene, state, slots):
    """Return (State, Impacts) of a period of one lane by the reference path."""
    return reference_strobe.reference_strobe(scene, state, 1, slots, 1)


@persistent_jit(static_argnames=("slots", "is_fast_path_only"), compiler_options=COMPILER_OPTIONS)
def _iterate_block(scene, state, n_periods_done, periods, slots, is_fast_path_only):
    """Return (state, status, periods done, ring buffers) of a block; each lane starts after `n_periods_done` periods.

    If `is_fast_path_only` is true, only the fast path is used, and a lane stops before the first period that the fast
    path gives up."""
    lane_shape = state.x.shape
    empty_lane_rows = jnp.zeros((MAX_RECORDED_PERIODS, *lane_shape), state.x.dtype)
    empty_slot_rows = jnp.zeros((MAX_RECORDED_PERIODS, *lane_shape, slots), state.x.dtype)
    ring_buffers = (
        empty_lane_rows,
        empty_lane_rows,
        empty_lane_rows,
        empty_slot_rows,
        empty_slot_rows.astype(jnp.int32),
        empty_slot_rows,
    )

    def is_unfinished(carry):
        period_index, _, _, n_periods_done, _ = carry
        return (period_index < periods) & jnp.any(n_periods_done >= period_index)

    def advance_period(carry):
        period_index, state, status, n_periods_done, ring_buffers = carry
        if is_fast_path_only:
            (end_state, impacts), is_given_up = two_tier_strobe.fast_strobe(scene, state, slots, 1)
            is_advancing = (n_periods_done == period_index) & ~is_given_up
        else:
            end_state, impacts = strobe(scene, state, slots=slots)
            is_advancing = n_periods_done == period_index
        is_recorded_full = (impacts.status == Status.FULL) & (period_index >= periods - MAX_RECORDED_PERIODS)
        new_status = jnp.where(
            impacts.status >= Status.CAP, impacts.status, jnp.where(is_recorded_full, Status.FULL, Status.OK)
        )
        new_status = jnp.where(status >= Status.CAP, status, jnp.maximum(status, new_status))
        period_data = (end_state.x, end_state.v, end_state.contact, impacts.time, impacts.side, impacts.speed)
        ring_buffers = tuple(
            ring_buffer.at[period_index % MAX_RECORDED_PERIODS].set(period_values)
            for ring_buffer, period_values in zip(ring_buffers, period_data, strict=True)
        )
        state = jax.tree.map(lambda new, old: jnp.where(is_advancing, new, old), end_state, state)
        return (
            period_index + 1,
            state,
            jnp.where(is_advancing, new_status, status),
            n_periods_done + is_advancing,
            ring_buffers,
        )

    initial_carry = jnp.min(n_periods_done), state, jnp.zeros(lane_shape, jnp.int32), n_periods_done, ring_buffers
    return lax.while_loop(is_unfinished, advance_period, initial_carry)[1:]


PERIOD_SLOTS = 16  # impacts recorded in a period
MAX_SINGLE_LANES = 8  # lanes up to which a call runs them one by one
MAX_HOST_PERIODS = 1024  # total periods of a few lanes up to which the host strobes them, without compiling a run
HOST_SLOTS = 4  # impacts that the host records unless a period has more; the default of `strobe`


class IteratedStates(NamedTuple):
    """Final states and recorded last periods of lanes, as NumPy arrays with axes (periods, lanes, slots).

    Attributes
    ----------
    state : State
        Final states, with leaves of shape (lanes,).
    status : numpy.ndarray of int
        Worst status of each lane. FULL refers to the recorded periods only.
    x, v, contact : numpy.ndarray
        State at the end of each recorded period, of shape (periods, lanes).
    time, side, speed : numpy.ndarray
        Impacts in each recorded period, as in `Impacts`, of shape (periods, lanes, slots). Times are since the start of
        the period.
    """

    state: State
    status: Int[np.ndarray, " lanes"]
    x: Float[np.ndarray, "periods lanes"]
    v: Float[np.ndarray, "periods lanes"]
    contact: Float[np.ndarray, "periods lanes"]
    time: Float[np.ndarray, "periods lanes slots"]
    side: Int[np.ndarray, "periods lanes slots"]
    speed: Float[np.ndarray, "periods lanes slots"]

    @property
    def points(self) -> Float[np.ndarray, "periods lanes 2"]:
        """Positions and velocities at the ends of the recorded periods, array of shape (periods, lanes, 2)."""
        return np.stack([self.x, self.v], -1)

    def select_lanes(
        self, lane_selection: Bool[np.ndarray, " lanes"] | Int[np.ndarray, " some"] | list[int] | slice
    ) -> "IteratedStates":
        """Return the iterates of the selected lanes.

        Parameters
        ----------
        lane_selection : array of bool or int, list of int, or slice
            Selection of lanes.

        Returns
        -------
        IteratedStates
            Iterates of these lanes.
        """
        selected_state = jax.tree.map(lambda leaf: leaf[lane_selection], self.state)
        return IteratedStates(
            selected_state, self.status[lane_selection], *(period_rows[:, lane_selection] for period_rows in self[2:])
        )


def iterate(scene, state, periods, slots=PERIOD_SLOTS, max_single_lanes=MAX_SINGLE_LANES):
    """Iterate states over drive periods and record the last periods.

    Parameters
    ----------
    scene : Scene
        A single scene, or a batch with one scene for each lane.
    state : State
        Initial states, with leaves of shape (lanes,).
    periods : int
        Number of drive periods, at least 1. A new value needs no compilation.
    slots : int, optional
        Number of impacts recorded in a period.
    max_single_lanes : int, optional
        Up to this number, lanes are run one by one. The results differ by rounding from the results of a block.

    Returns
    -------
    IteratedStates
        Final states and the last periods, at most `MAX_RECORDED_PERIODS`.
    """
    n_lanes, lanes_per_block = len(state.x), _lanes_per_block(state, slots, max_single_lanes)
    if lanes_per_block == 1 and n_lanes * periods <= MAX_HOST_PERIODS:
        arguments_by_lane = [take_padded_block((scene, state), lane, 1) for lane in range(n_lanes)]
        results_by_lane = [
            _iterate_on_host(*arguments_of_lane, periods, _slots_of_scene(scene, slots))
            for arguments_of_lane in arguments_by_lane
        ]
        end_state, worst_status, ring_buffers = join_blocks(results_by_lane, n_lanes)
    else:
        end_state, worst_status, ring_buffers = iterate_in_batches(
            scene, state, periods, _slots_of_scene(scene, slots), lanes_per_block
        )
    return IteratedStates(end_state, worst_status, *unroll_ring_buffers(ring_buffers, periods))


def final_states(scene, state, periods, max_single_lanes=MAX_SINGLE_LANES):
    """Iterate states over drive periods without recording them, by the compiled function of `iterate`.

    Parameters
    ----------
    scene : Scene
        A single scene, or a batch with one scene for each lane.
    state : State
        Initial states, with leaves of shape (lanes,).
    periods : int
        Number of drive periods, at least 1.
    max_single_lanes : int, optional
        Up to this number, lanes are run one by one.

    Returns
    -------
    end : State
        Final states.
    status : numpy.ndarray of int
        Worst status of each lane.
    """
    return iterate_in_batches(
        scene,
        state,
        periods,
        _slots_of_scene(scene, PERIOD_SLOTS),
        _lanes_per_block(state, PERIOD_SLOTS, max_single_lanes),
        is_recording_periods=False,
    )[:2]


def _lanes_per_block(state, slots, max_single_lanes):
    """Return the number of lanes of a block; the number is 1 for few lanes, which then compile and run faster."""
    return 1 if len(state.x) <= max_single_lanes else max(1, BLOCK_WIDTH * PERIOD_SLOTS // slots)


def _slots_of_scene(scene, slots):
    return 0 if scene.left is None and scene.right is None else slots


def _iterate_on_host(scene, state, periods, slots):
    """Iterate one lane by a call of the map for each period; the results are those of `iterate_in_batches`."""
    scene, state = jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf).reshape(()), (scene, state)))
    worst_status, first_attempt_slots = int(Status.OK), min(HOST_SLOTS, slots)
    ring_buffers = [np.zeros((MAX_RECORDED_PERIODS, 1), state.x.dtype) for _ in range(3)]
    empty_slot_fills = (
        (np.inf, state.x.dtype),
        (0, np.int32),
        (0.0, state.x.dtype),
    )  # time, side and speed of an empty slot
    ring_buffers += [
        np.full((MAX_RECORDED_PERIODS, 1, slots), *fill_value_and_dtype) for fill_value_and_dtype in empty_slot_fills
    ]
    for period_index in range(periods):
        is_recorded = period_index >= periods - MAX_RECORDED_PERIODS
        end_state, impacts = concrete_strobe(scene, state, 1, first_attempt_slots, False)
        if is_recorded and first_attempt_slots < slots and int(impacts.status) == Status.FULL:
            end_state, impacts = concrete_strobe(scene, state, 1, slots, False)
        status = int(impacts.status)
        if worst_status < Status.CAP and (is_recorded or status >= Status.CAP):
            worst_status = max(worst_status, status)
        state = end_state
        if is_recorded:
            period_data = (end_state.x, end_state.v, end_state.contact, impacts.time, impacts.side, impacts.speed)
            for ring_buffer, values in zip(ring_buffers, period_data, strict=True):
                ring_buffer[
                    (period_index % MAX_RECORDED_PERIODS, 0, *(slice(axis_length) for axis_length in values.shape))
                ] = values
    return (
        jax.tree.map(lambda leaf: np.asarray(leaf).reshape(1), state),
        np.array([worst_status], np.int32),
        tuple(ring_buffers),
    )

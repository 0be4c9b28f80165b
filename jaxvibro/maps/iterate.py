"""Iterate many states over many periods in blocks of one compiled shape, and record the last periods."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from ..compiled.kernel_calls import BLOCK_WIDTH
from ..scene.codes import Status
from ..scene.state import State
from .long_iteration import (
    MAX_RECORDED_PERIODS,
    iterate_in_batches,
    join_blocks,
    take_padded_block,
    unroll_ring_buffers,
)
from .strobe import concrete_strobe

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

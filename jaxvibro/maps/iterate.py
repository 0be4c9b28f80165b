"""Iterate many states over any number of periods, in blocks of one compiled shape; record the last periods."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from ..compiled.kernels import BLOCK_WIDTH
from ..scene.codes import Status
from ..scene.state import State
from .long_run import MAX_RECORDED_PERIODS, join_blocks, padded_block, run_periods, unroll_ring_buffers
from .strobe import concrete_strobe

PERIOD_SLOTS = 16  # impacts recorded in a period
MAX_SINGLE_LANES = 8  # lanes up to which a call runs them one by one
MAX_HOST_PERIODS = 1024  # total periods of a few lanes up to which the host strobes them, without compiling a run
HOST_SLOTS = 4  # impacts that the host records unless a period has more; the default of `strobe`


class Iterates(NamedTuple):
    """Final states of lanes and their last periods: NumPy arrays with periods first, then lanes, then slots.

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
        """Positions and velocities at the ends of the kept periods, shape (periods, lanes, 2)."""
        return np.stack([self.x, self.v], -1)

    def select_lanes(
        self, selection: Bool[np.ndarray, " lanes"] | Int[np.ndarray, " some"] | list[int] | slice
    ) -> "Iterates":
        """Return the iterates of some lanes.

        Parameters
        ----------
        selection : array of bool or int, list of int, or slice
            Selection of lanes.

        Returns
        -------
        Iterates
            Iterates of these lanes.
        """
        end_state = jax.tree.map(lambda leaf: leaf[selection], self.state)
        return Iterates(end_state, self.status[selection], *(rows[:, selection] for rows in self[2:]))


def iterate(scene, state, periods, slots=PERIOD_SLOTS, max_single_lanes=MAX_SINGLE_LANES):
    """Iterate states over drive periods and record the last periods.

    Parameters
    ----------
    scene : Scene
        A single scene, or one with a number for each lane.
    state : State
        Initial states, with leaves of shape (lanes,).
    periods : int
        Number of drive periods, at least 1. Other values need no compilation.
    slots : int, optional
        Number of impacts recorded in a period.
    max_single_lanes : int, optional
        Up to this number, lanes are run one by one. They differ by rounding from those of a block.

    Returns
    -------
    Iterates
        Final states and the last periods, at most `MAX_RECORDED_PERIODS`.
    """
    n_lanes, width = len(state.x), _block_width(state, slots, max_single_lanes)
    if width == 1 and n_lanes * periods <= MAX_HOST_PERIODS:
        blocks = [padded_block((scene, state), lane, 1) for lane in range(n_lanes)]
        runs = [_iterate_on_host(*block, periods, _required_slots(scene, slots)) for block in blocks]
        end_state, worst_status, ring_buffers = join_blocks(runs, n_lanes)
    else:
        end_state, worst_status, ring_buffers = run_periods(scene, state, periods, _required_slots(scene, slots), width)
    return Iterates(end_state, worst_status, *unroll_ring_buffers(ring_buffers, periods))


def final_states(scene, state, periods, max_single_lanes=MAX_SINGLE_LANES):
    """Iterate states over drive periods without recording them, by the compiled function of `iterate`.

    Parameters
    ----------
    scene : Scene
        A single scene, or one with a number for each lane.
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
    return run_periods(
        scene,
        state,
        periods,
        _required_slots(scene, PERIOD_SLOTS),
        _block_width(state, PERIOD_SLOTS, max_single_lanes),
        record_periods=False,
    )[:2]


def _block_width(state, slots, max_single_lanes):
    """Return the number of lanes of a block; few lanes run one by one, which compiles and runs faster than a block."""
    return 1 if len(state.x) <= max_single_lanes else max(1, BLOCK_WIDTH * PERIOD_SLOTS // slots)


def _required_slots(scene, slots):
    return 0 if scene.left is None and scene.right is None else slots


def _iterate_on_host(scene, state, periods, slots):
    """Iterate one lane by strobes from the host; results as for `run_periods`."""
    scene, state = jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf).reshape(()), (scene, state)))
    worst_status, first_slots = int(Status.OK), min(HOST_SLOTS, slots)
    ring_buffers = [np.zeros((MAX_RECORDED_PERIODS, 1), state.x.dtype) for _ in range(3)]
    empty_slot_values = (
        (np.inf, state.x.dtype),
        (0, np.int32),
        (0.0, state.x.dtype),
    )  # time, side and speed of an empty slot
    ring_buffers += [
        np.full((MAX_RECORDED_PERIODS, 1, slots), *value_and_dtype) for value_and_dtype in empty_slot_values
    ]
    for period in range(periods):
        is_recorded = period >= periods - MAX_RECORDED_PERIODS
        end_state, impacts = concrete_strobe(scene, state, 1, first_slots, False)
        if is_recorded and first_slots < slots and int(impacts.status) == Status.FULL:
            end_state, impacts = concrete_strobe(scene, state, 1, slots, False)
        status = int(impacts.status)
        if worst_status < Status.CAP and (is_recorded or status >= Status.CAP):
            worst_status = max(worst_status, status)
        state = end_state
        if is_recorded:
            period_data = (end_state.x, end_state.v, end_state.contact, impacts.time, impacts.side, impacts.speed)
            for ring_buffer, values in zip(ring_buffers, period_data, strict=True):
                ring_buffer[(period % MAX_RECORDED_PERIODS, 0, *(slice(size) for size in values.shape))] = values
    return (
        jax.tree.map(lambda leaf: np.asarray(leaf).reshape(1), state),
        np.array([worst_status], np.int32),
        tuple(ring_buffers),
    )

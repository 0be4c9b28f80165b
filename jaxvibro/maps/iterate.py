"""Trails: many states run on for any number of periods, in blocks of one compiled shape; the last periods are kept."""

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
MAX_SINGLE_LANES = 8  # lanes that are run one by one, where no more are asked for at once
MAX_HOST_PERIODS = (
    1024  # periods of a few lanes, in all, up to which they are strobed from the host: no compiled run is made
)
HOST_SLOTS = 4  # impacts that the host's strobe records, where no period has more: as many as `strobe` by itself


class Iterates(NamedTuple):
    """The ends of some lanes, and their last periods; NumPy arrays, periods first, then lanes, then slots.

    state: x, v, phase, contact (lanes); status: the worst met, FULL of the kept periods only; x, v, contact: at the end
    of each kept period; time, side, speed: of the impacts in it, time since its start (see `Impacts`).
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
        """The trail of some of the lanes."""
        end_state = jax.tree.map(lambda leaf: leaf[selection], self.state)
        return Iterates(end_state, self.status[selection], *(rows[:, selection] for rows in self[2:]))


def iterate(scene, state, periods, slots=PERIOD_SLOTS, max_single_lanes=MAX_SINGLE_LANES):
    """Runs a state's lanes on: a `Iterates` of the last periods, at most KEEP.

    scene: a single one, or a lane of a batch each; state: leaves of shape (lanes,); periods: whole number >= 1, no
    compilation of its own. max_single_lanes: so many lanes are run one by one, and differ by a rounding from those of a
    block."""
    n_lanes, width = len(state.x), _block_width(state, slots, max_single_lanes)
    if width == 1 and n_lanes * periods <= MAX_HOST_PERIODS:
        blocks = [padded_block((scene, state), lane, 1) for lane in range(n_lanes)]
        runs = [_iterate_on_host(*block, periods, _required_slots(scene, slots)) for block in blocks]
        end_state, worst_status, ring_buffers = join_blocks(runs, n_lanes)
    else:
        end_state, worst_status, ring_buffers = run_periods(scene, state, periods, _required_slots(scene, slots), width)
    return Iterates(end_state, worst_status, *unroll_ring_buffers(ring_buffers, periods))


def final_states(scene, state, periods, max_single_lanes=MAX_SINGLE_LANES):
    """(state, status) of a state's lanes so many periods later; the same compiled run as `iterate`'s."""
    return run_periods(
        scene,
        state,
        periods,
        _required_slots(scene, PERIOD_SLOTS),
        _block_width(state, PERIOD_SLOTS, max_single_lanes),
        record_periods=False,
    )[:2]


def _block_width(state, slots, max_single_lanes):
    """Lanes of a block: a few are run one by one, which compiles and runs faster than a block of which most is idle."""
    return 1 if len(state.x) <= max_single_lanes else max(1, BLOCK_WIDTH * PERIOD_SLOTS // slots)


def _required_slots(scene, slots):
    return 0 if scene.left is None and scene.right is None else slots


def _iterate_on_host(scene, state, periods, slots):
    """As `_run`, of one lane, by strobes from the host."""
    scene, state = jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf).reshape(()), (scene, state)))
    worst_status, first_slots = int(Status.OK), min(HOST_SLOTS, slots)
    ring_buffers = [np.zeros((MAX_RECORDED_PERIODS, 1), state.x.dtype) for _ in range(3)]
    empty_slot_values = (
        (np.inf, state.x.dtype),
        (0, np.int32),
        (0.0, state.x.dtype),
    )  # time, side and speed of no impact
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

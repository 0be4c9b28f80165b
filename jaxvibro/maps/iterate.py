"""Trails: many states run on for any number of periods, in blocks of one compiled shape; the last periods are kept."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from ..compiled.kernels import WIDTH
from ..scene.codes import Status
from ..scene.state import State
from .long_run import KEEP, in_order, joined, padded, run_on
from .strobe import from_host

SLOTS = 16  # impacts recorded in a period
FEW = 8  # lanes that are run one by one, where no more are asked for at once
SHORT = 1024  # periods of a few lanes, in all, up to which they are strobed from the host: no compiled run is made
RECORDED = 4  # impacts that the host's strobe records, where no period has more: as many as `strobe` by itself


class Trail(NamedTuple):
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

    def lanes(self, chosen: Bool[np.ndarray, " lanes"] | Int[np.ndarray, " some"] | list[int] | slice) -> "Trail":
        """The trail of some of the lanes."""
        ends = jax.tree.map(lambda leaf: leaf[chosen], self.state)
        return Trail(ends, self.status[chosen], *(part[:, chosen] for part in self[2:]))


def iterate(scene, state, periods, slots=SLOTS, few=FEW):
    """Runs a state's lanes on: a `Trail` of the last periods, at most KEEP.

    scene: a single one, or a lane of a batch each; state: leaves of shape (lanes,); periods: whole number >= 1, no
    compilation of its own. few: so many lanes are run one by one, and differ by a rounding from those of a block.
    """
    size, width = len(state.x), _width(state, slots, few)
    if width == 1 and size * periods <= SHORT:
        blocks = [padded((scene, state), lane, 1) for lane in range(size)]
        runs = [_strobed(*block, periods, _needed(scene, slots)) for block in blocks]
        end, worst, kept = joined(runs, size)
    else:
        end, worst, kept = run_on(scene, state, periods, _needed(scene, slots), width)
    return Trail(end, worst, *in_order(kept, periods))


def ends(scene, state, periods, few=FEW):
    """(state, status) of a state's lanes so many periods later; the same compiled run as `iterate`'s."""
    return run_on(scene, state, periods, _needed(scene, SLOTS), _width(state, SLOTS, few), kept=False)[:2]


def _width(state, slots, few):
    """Lanes of a block: a few are run one by one, which compiles and runs faster than a block of which most is idle."""
    return 1 if len(state.x) <= few else max(1, WIDTH * SLOTS // slots)


def _needed(scene, slots):
    return 0 if scene.left is None and scene.right is None else slots


def _strobed(scene, state, periods, slots):
    """As `_run`, of one lane, by strobes from the host."""
    scene, state = jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf).reshape(()), (scene, state)))
    worst, few = int(Status.OK), min(RECORDED, slots)
    ring = [np.zeros((KEEP, 1), state.x.dtype) for _ in range(3)]
    empty = (np.inf, state.x.dtype), (0, np.int32), (0.0, state.x.dtype)  # time, side and speed of no impact
    ring += [np.full((KEEP, 1, slots), *each) for each in empty]
    for k in range(periods):
        kept = k >= periods - KEEP
        end, impacts = from_host(scene, state, 1, few, False)
        if kept and few < slots and int(impacts.status) == Status.FULL:
            end, impacts = from_host(scene, state, 1, slots, False)
        told = int(impacts.status)
        if worst < Status.CAP and (kept or told >= Status.CAP):
            worst = max(worst, told)
        state = end
        if kept:
            row = (end.x, end.v, end.contact, impacts.time, impacts.side, impacts.speed)
            for old, part in zip(ring, row, strict=True):
                old[(k % KEEP, 0, *(slice(size) for size in part.shape))] = part
    return jax.tree.map(lambda leaf: np.asarray(leaf).reshape(1), state), np.array([worst], np.int32), tuple(ring)

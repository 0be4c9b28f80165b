"""Trails: many states run on for any number of periods, in blocks of one compiled shape; the last periods are kept."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Bool, Float, Int

from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import OPTIONS, WIDTH
from ..scene.codes import Status
from ..scene.state import State
from .strobe import from_host, strobe

KEEP = 64  # periods kept, of however many have been run
SLOTS = 16  # impacts recorded in a period
FEW = 8  # lanes that are run one by one, and differ by a rounding from those of a block
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


def iterate(scene, state, periods, slots=SLOTS):
    """Runs a state's lanes on: a `Trail` of the last periods, at most KEEP.

    scene: a single one, or a lane of a batch each; state: leaves of shape (lanes,); periods: whole number >= 1, no
    compilation of its own.
    """
    size, width = len(state.x), _width(state, slots)
    blocks = [padded((scene, state), first, width) for first in range(0, size, width)]
    run = _strobed if width == 1 and size * periods <= SHORT else _run
    runs = [run(*block, periods, _needed(scene, slots)) for block in blocks]
    ends = jax.tree.map(lambda *parts: np.concatenate(parts)[:size], *[run[0] for run in runs])
    worst = np.concatenate([run[1] for run in runs])[:size]
    count = min(periods, KEEP)
    kept = [np.concatenate(parts, axis=1)[:, :size] for parts in zip(*(run[2] for run in runs), strict=True)]
    kept = [np.roll(part, -(periods % KEEP) if periods > KEEP else 0, axis=0)[:count] for part in kept]
    return Trail(ends, worst, *kept)


def ends(scene, state, periods):
    """(state, status) of a state's lanes so many periods later; the same compiled run as `iterate`'s."""
    size, width = len(state.x), _width(state, SLOTS)
    blocks = [padded((scene, state), first, width) for first in range(0, size, width)]
    runs = [_run(*block, periods, _needed(scene, SLOTS))[:2] for block in blocks]
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:size], *runs)


def _width(state, slots):
    """Lanes of a block: a few are run one by one, which compiles and runs faster than a block of which most is idle."""
    return 1 if len(state.x) <= FEW else max(1, WIDTH * SLOTS // slots)


def _needed(scene, slots):
    return 0 if scene.left is None and scene.right is None else slots


def padded(lanes, first, width):
    """So many of a tree's lanes, the last one again where there are fewer; numbers that all share stay."""

    def part(leaf):
        if not np.shape(leaf):
            return leaf
        some = leaf[first : first + width]
        return np.pad(some, (0, width - len(some)), mode="edge")

    return jax.tree.map(part, lanes)


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


@persistent_jit(static_argnames="slots", compiler_options=OPTIONS)
def _run(scene, state, periods, slots):
    """(state, status, the kept periods as a ring: period i is row i modulo KEEP)."""
    lanes = state.x.shape
    numbers = jnp.zeros((KEEP, *lanes), state.x.dtype)
    record = jnp.zeros((KEEP, *lanes, slots), state.x.dtype)
    ring = (numbers, numbers, numbers, record, record.astype(jnp.int32), record)

    def one(k, carry):
        state, status, ring = carry
        state, impacts = strobe(scene, state, slots=slots)
        full = (impacts.status == Status.FULL) & (k >= periods - KEEP)
        new = jnp.where(impacts.status >= Status.CAP, impacts.status, jnp.where(full, Status.FULL, Status.OK))
        status = jnp.where(status >= Status.CAP, status, jnp.maximum(status, new))
        row = (state.x, state.v, state.contact, impacts.time, impacts.side, impacts.speed)
        return state, status, tuple(old.at[k % KEEP].set(part) for old, part in zip(ring, row, strict=True))

    return lax.fori_loop(0, periods, one, (state, jnp.zeros(lanes, jnp.int32), ring))

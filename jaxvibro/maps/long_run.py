"""Lanes run on for many periods by lean steps alone, as long as those take them; else by both tiers.

Compiling both tiers takes three times as long as the lean one alone, and most lanes never need the full one. A lane
that lean steps give up stops there: its period is done in full by the host, and it goes on with the others that have
stopped. Where that would be more work than compiling both tiers, they are compiled and do the rest. Which way is taken
depends on the lanes alone.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import OPTIONS
from ..scene.codes import Status
from . import one_period, two_tiers
from .strobe import strobe

KEEP = 64  # periods kept, of however many have been run
IN_FULL = 32  # periods of a block, which a period of one lane that the host does in full is worth
PATIENCE = 20_000  # periods of blocks, run again or worth as much: half a second, less than compiling


def run_on(scene, state, periods, slots, width, kept=True):
    """(state, the worst status, the kept periods as a ring) of lanes, in blocks of so many.

    scene: a single one, or a lane of a batch each; the ring: x, v, contact, times, sides, speeds; period i is row i
    modulo KEEP; status: FULL of the kept periods only. kept: whether these are asked for.
    """
    size = len(state.x)
    begun, lean = np.zeros(size, np.int32), two_tiers.takes(scene)
    found = _blocks(scene, state, begun, periods, slots, width, lean, kept)
    if not lean:
        return found[0], found[1], found[3]
    spent = 0
    while (due := np.flatnonzero(found[2] < periods)).size:
        blocks = -(-due.size // width)
        spent += IN_FULL * due.size + blocks * int(periods - found[2][due].min())
        lean = spent <= PATIENCE
        if lean:
            found = _in_full(scene, found, due, periods, slots)
        given, now = (scene, found[0]), found[2][due]
        some = jax.tree.map(lambda leaf, due=due: leaf[due] if np.ndim(leaf) else leaf, given)
        later = _blocks(*some, now, periods, slots, width, lean, kept)
        found = _put(found, due, later, now)
    return found[0], found[1], found[3]


def _blocks(scene, state, begun, periods, slots, width, lean, kept):
    """(state, status, periods done, ring) of any number of lanes, each run on from the period that it begins with."""
    size = len(begun)
    blocks = [padded((scene, state, begun), first, width) for first in range(0, size, width)]
    runs = [_run(*block, periods, slots, lean) for block in blocks]
    return joined(runs if kept else [(*run[:3], ()) for run in runs], size)


def padded(lanes, first, width):
    """So many of a tree's lanes, the last one again where there are fewer; numbers that all share stay."""
    places = np.arange(first, first + width)
    return jax.tree.map(lambda leaf: np.asarray(leaf).take(places, 0, mode="clip") if np.ndim(leaf) else leaf, lanes)


def some(tree, lanes):
    """The tree of some lanes, NumPy's arrays; a number that all lanes share stays one."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[lanes] if np.ndim(leaf) else np.asarray(leaf), tree)


def joined(runs, size):
    """The results of blocks as those of so many lanes; what they end with is a ring, whose first axis is periods."""
    *ends, rings = zip(*runs, strict=True)
    ends = (jax.tree.map(lambda *parts: np.concatenate(parts)[:size], *parts) for parts in ends)
    return *ends, tuple(np.concatenate(parts, axis=1)[:, :size] for parts in zip(*rings, strict=True))


def in_order(ring, periods):
    """A ring's kept periods, the first one first."""
    turn = -(periods % KEEP) if periods > KEEP else 0
    return [np.roll(part, turn, axis=0)[: min(periods, KEEP)] for part in ring]


def _in_full(scene, found, lanes, periods, slots):
    """The results with the next period of some lanes, by full steps."""
    state, status, begun, ring = found
    state, status, begun = jax.tree.map(np.array, state), np.array(status), np.array(begun)
    for lane in lanes:
        one = jax.tree.map(lambda leaf, lane=lane: np.asarray(leaf[lane] if np.ndim(leaf) else leaf), (scene, state))
        end, impacts = _full(*one, slots)
        k = begun[lane]
        status[lane] = max(status[lane], _told(impacts.status, k >= periods - KEEP))
        begun[lane] += 1
        for old, new in zip(jax.tree.leaves(state), jax.tree.leaves(end), strict=True):
            old[lane] = new
        row = (end.x, end.v, end.contact, impacts.time, impacts.side, impacts.speed)
        for old, part in zip(ring, row, strict=False):
            old[k % KEEP, lane] = part
    return state, status, begun, ring


def _told(status, kept):
    return int(status) if status >= Status.CAP or (kept and status == Status.FULL) else int(Status.OK)


def _put(found, lanes, later, begun):
    """The results with those of a later run of some lanes, which began with these periods."""
    (state, status, done, ring), (new_state, new_status, new_done, new_ring) = found, later
    for old, new in zip(jax.tree.leaves((state, done)), jax.tree.leaves((new_state, new_done)), strict=True):
        old[lanes] = new
    status[lanes] = np.where(status[lanes] >= Status.CAP, status[lanes], np.maximum(status[lanes], new_status))
    last = new_done - 1 - (new_done - 1 - np.arange(KEEP)[:, None]) % KEEP  # the period that a row has
    flown = last >= begun
    for old, new in zip(ring, new_ring, strict=True):
        old[:, lanes] = np.where(flown[..., None] if new.ndim > 2 else flown, new, old[:, lanes])
    return state, status, done, ring


@persistent_jit(static_argnums=2, compiler_options=OPTIONS, numpy_first=True)
def _full(scene, state, slots):
    """(State, Impacts) of a period of one lane by full steps."""
    return one_period.strobe(scene, state, 1, slots, 1)


@persistent_jit(static_argnames=("slots", "lean"), compiler_options=OPTIONS)
def _run(scene, state, begun, periods, slots, lean):
    """(state, status, periods done, the kept periods as a ring); a lane begins with the period `begun`.

    lean: by lean steps alone: a lane that they give up stops at the end of the period before.
    """
    lanes = state.x.shape
    numbers = jnp.zeros((KEEP, *lanes), state.x.dtype)
    record = jnp.zeros((KEEP, *lanes, slots), state.x.dtype)
    ring = (numbers, numbers, numbers, record, record.astype(jnp.int32), record)

    def going(carry):
        k, _, _, done, _ = carry
        return (k < periods) & jnp.any(done >= k)

    def one(carry):
        k, state, status, done, ring = carry
        if lean:
            (new, impacts), given_up = two_tiers.lean_alone(scene, state, slots, 1)
            goes = (done == k) & ~given_up
        else:
            new, impacts = strobe(scene, state, slots=slots)
            goes = done == k
        full = (impacts.status == Status.FULL) & (k >= periods - KEEP)
        told = jnp.where(impacts.status >= Status.CAP, impacts.status, jnp.where(full, Status.FULL, Status.OK))
        told = jnp.where(status >= Status.CAP, status, jnp.maximum(status, told))
        row = (new.x, new.v, new.contact, impacts.time, impacts.side, impacts.speed)
        ring = tuple(old.at[k % KEEP].set(part) for old, part in zip(ring, row, strict=True))
        state = jax.tree.map(lambda new, old: jnp.where(goes, new, old), new, state)
        return k + 1, state, jnp.where(goes, told, status), done + goes, ring

    start = jnp.min(begun), state, jnp.zeros(lanes, jnp.int32), begun, ring
    return lax.while_loop(going, one, start)[1:]

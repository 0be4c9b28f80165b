"""The stroboscopic map in two tiers: lean steps first, full ones for the lanes that those give up.

Which tier does a lane's period depends on the lane alone, so that a batch may be cut and permuted as one likes. A
period of many begins with the state that the one before has ended with: it is a strobe of its own.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
from jax import lax

from ..compiled.blocks import in_blocks
from ..compiled.compiler_hints import WIDTH, choose, one_kernel
from ..flight import impact_log, lean, lean_numbers
from ..flight.coefficients import frame
from ..flight.entry import enter
from ..scene.codes import Status
from ..scene.state import Impacts, State
from . import one_period


def strobe(scene, state, periods, slots, least, clearance=False):
    """(State, Impacts) of numbers that broadcast, in blocks of so many lanes at least."""
    return recorded(scene, state, periods, slots, least, clearance)[0]


def recorded(scene, state, periods, slots, least, clearance=False):
    """((State, Impacts), when the mass was last released from a wall, -1: never), as `strobe`."""
    if clearance or not takes(scene):
        return one_period.recorded(scene, state, periods, slots, least, clearance)
    scene, state, shape = _flat(scene, state)
    out = _tried(scene, state, slots, least)
    if periods > 1:
        out = lax.fori_loop(1, periods, partial(_again, scene, slots, least), out)
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]) if shape else leaf, out)


def lean_alone(scene, state, slots, least):
    """((State, Impacts), whether a lane was given up: then the rest of what is said of it is of no meaning)."""
    scene, state, shape = _flat(scene, state)
    out = _in_blocks(scene, state, slots, least)
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]) if shape else leaf, out)


def takes(scene):
    """Whether the lean tier knows such a scene: rigid walls, in double precision."""
    walls = [wall for wall in (scene.left, scene.right) if wall is not None]
    return bool(walls) and not any(wall.soft for wall in walls) and scene.dtype == jnp.float64


def _flat(scene, state):
    """(scene, state, shape): numbers that are scalars or of all lanes in one axis, and the shape of the lanes."""
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))
    state = replace(state, x=jnp.broadcast_to(state.x, shape))

    def flat(leaf):
        return jnp.broadcast_to(leaf, shape).reshape(-1) if jnp.ndim(leaf) else leaf

    return *jax.tree.map(flat, (scene, state)), shape


def _in_blocks(scene, state, slots, least):
    def run(given):
        return one_kernel(_lean, *given, slots=slots)

    def empty(count):
        return one_period.blank(count, slots, scene.dtype), jnp.zeros(count, bool)

    return in_blocks(run, (scene, state), empty, least)


def _lean(scene, state, slots):
    """((State, Impacts), whether a lane was given up) of a period by lean steps."""
    built = frame(scene)
    numbers = lean_numbers.numbers(built)
    path, fault = enter(built, state)
    lanes = lean.begin(numbers, path, fault == Status.OK)
    lanes, log, rows = lean.run(numbers, lanes, *impact_log.empty(state.x, slots, built.period))
    times, sides, speeds = impact_log.rows(rows)
    good = fault == Status.OK
    full = choose(log.count > slots, lax.full_like(fault, Status.FULL), Status.OK)
    x, v = choose(good, lanes.x, jnp.nan), choose(good, lanes.v * numbers.pace, jnp.nan)
    impacts = Impacts(
        time=times,
        side=sides,
        speed=speeds,
        count=log.count.astype(jnp.int32),
        least_speed=log.least_speed,
        least_clearance=None,
        status=choose(good, full, fault).astype(jnp.int32),
    )
    end = State(x, v, jnp.broadcast_to(state.phase, x.shape), jnp.zeros_like(x))
    return (end, impacts), lanes.left == lean_numbers.GIVEN_UP


def _tried(scene, state, slots, least):
    """As `recorded`, of one period, of flat numbers: by lean steps, then by full ones where those give up."""
    out, given_up = _in_blocks(scene, state, slots, least)
    again = partial(_full, scene, state, slots, given_up)
    return lax.cond(jnp.any(given_up), again, lambda same: same, (out, jnp.full_like(state.x, -1.0)))


def _full(scene, state, slots, due, out):
    """The results with those of some lanes replaced, a block at a time."""
    run = partial(one_kernel, one_period.through, periods=1, slots=slots)
    if not due.shape:
        return run(scene, state)
    count, width = len(due), min(WIDTH, len(due))
    places = jnp.append(jnp.nonzero(due, size=count, fill_value=count)[0], jnp.full(width, count))

    def block(k, out):
        some = lax.dynamic_slice_in_dim(places, k * width, width)
        lanes = jax.tree.map(lambda leaf: leaf.at[some].get(mode="clip") if jnp.ndim(leaf) else leaf, (scene, state))
        return jax.tree.map(lambda all, new: all.at[some].set(new, mode="drop"), out, run(*lanes))

    return lax.fori_loop(0, -(-jnp.sum(due) // width), block, out)


def _again(scene, slots, least, k, past):
    """The results with those of one period more, the k-th from 0."""
    (state, seen), freed = past
    (end, new), late = _tried(scene, state, slots, least)
    begun = k * frame(scene).period
    lost = seen.status >= Status.CAP
    status = jnp.where(lost, seen.status, jnp.maximum(seen.status, new.status))
    place = jnp.arange(slots) - seen.count[..., None]

    def put(old, rows):
        return jnp.where(place >= 0, jnp.take_along_axis(rows, jnp.maximum(place, 0), -1), old)

    impacts = Impacts(
        time=put(seen.time, new.time + jnp.asarray(begun)[..., None]),
        side=put(seen.side, new.side),
        speed=put(seen.speed, new.speed),
        count=seen.count + new.count,
        least_speed=jnp.minimum(seen.least_speed, new.least_speed),
        least_clearance=None,
        status=jnp.where((status == Status.OK) & (seen.count + new.count > slots), Status.FULL, status),
    )
    return (end, impacts), jnp.where(late >= 0, late + begun, freed)

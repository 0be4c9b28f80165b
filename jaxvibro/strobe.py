"""The stroboscopic map: the state one or more drive periods later, and the impacts on the way.

One flat loop over a block of lanes: at each turn every lane flies a step, lands and rebounds, or is done.
"""

import math
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
from jax import lax

from . import check, clearance, log
from .entry import enter
from .flight import micro
from .frame import frame
from .impact import STUCK
from .lanes import OPTIONS, WIDTH, choose, one_kernel

OK, FULL, CAP, INVALID, NONFINITE = range(5)
STATUS = ("ok", "full", "cap", "invalid", "nonfinite")
IMPACTS = 1000  # of one lane in one period, the cap
STEPS = 8  # times the steps that a flight alone would take, the cap on the rest
MOST_STEPS = 1e6  # of one lane in one period: more would be a hang


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class State:
    """A state at a phase of the drive: x, v (lengths of the scene, lengths per t), phase (rad), contact.

    contact: 0 free, -1 or +1 has landed on the left or right wall and leaves it, -2 or +2 rests on it.
    """

    x: jax.Array
    v: jax.Array
    phase: jax.Array = 0.0
    contact: jax.Array = 0.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Impacts:
    """The impacts of a strobe, in order; slots are the last axis.

    time: since the strobe's start, in t (inf: empty); side: -1 left, +1 right, 0 empty; speed: abs(y- - v_b), 0 empty;
    count: of all impacts; least_speed: of them, inf if none; least_clearance: the smallest distance to a wall at a
    turning point of x - x_b towards it, inf if none; status: 0 OK, 1 FULL (more impacts than slots; the state is
    right), 2 CAP (1,000 impacts or a million steps in a period), 3 INVALID (a bad scene, or a start beyond a wall),
    4 NONFINITE (a number that is not finite, or lengths beyond 1e-123 to 1e123); from CAP on the state is nan.
    """

    time: jax.Array
    side: jax.Array
    speed: jax.Array
    count: jax.Array
    least_speed: jax.Array
    least_clearance: jax.Array
    status: jax.Array


def strobe(scene, state, periods=1, slots=32):
    """The state after a number of drive periods, and the impacts on the way: (State, Impacts).

    scene: a `Scene`; state: a `State` at its phase; their numbers broadcast together, and the results have that shape.
    periods: whole number >= 1; slots: impacts to record, >= 0. The state's phase comes back unchanged. An impact at the
    end belongs to the period that ends: the state is the one after it, and its contact says so. A start on a wall and
    moving into it rebounds at time 0.

    Raises SceneError for periods, slots or a state that cannot be; all else is a status of each lane (`Impacts`).
    """
    periods, slots = check.whole("periods", periods, 1), check.whole("slots", slots, 0)
    state = real_state(scene, state)
    traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((scene, state)))
    return (_inner if traced else _outer)(scene, state, periods, slots)


def real_state(scene, state):
    """The state with every number an array of the scene's type; refused where it is none, or fits no batch."""
    if not isinstance(state, State):
        raise check.SceneError("state", "must be a State", state)
    keys = ("x", "v", "phase", "contact")
    found = [jnp.asarray(check.real(f"state.{key}", getattr(state, key), scene.dtype)) for key in keys]
    leaves = [
        ("scene", jnp.zeros(scene.shape)),
        *((f"state.{key}", each) for key, each in zip(keys, found, strict=True)),
    ]
    check.shapes_agree(leaves)
    return State(*found)


def _strobe(scene, state, periods, slots):
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))
    run = partial(one_kernel, partial(_lanes, periods=periods, slots=slots))
    if not shape:
        return run(scene, state)
    count = math.prod(shape)
    width = min(WIDTH, 1 << (count - 1).bit_length()) if count else 1
    blocks = -(-count // width)

    def block(leaf):
        flat = jnp.broadcast_to(leaf, shape).reshape(count)
        return jnp.pad(flat, (0, blocks * width - count), mode="edge").reshape(blocks, width)

    def unblock(leaf):
        flat = jnp.moveaxis(leaf, 1, -1) if leaf.ndim == 3 else leaf
        return flat.reshape(blocks * width, *leaf.shape[1:-1])[:count].reshape(*shape, *leaf.shape[1:-1])

    out = lax.map(lambda lanes: run(*lanes), jax.tree.map(block, (scene, state)))
    return jax.tree.map(unblock, out)


_inner = jax.jit(_strobe, static_argnums=(2, 3))
_outer = jax.jit(_strobe, static_argnums=(2, 3), compiler_options=OPTIONS)


def _lanes(scene, state, periods, slots):
    """The strobe of scene and state whose numbers all have one shape; slots come first."""
    built = frame(scene, jnp.shape(state.x))
    path, valid, finite = enter(built, state)
    start = path
    path = path._replace(rest=choose(valid & finite, built.period, 0.0))
    book = log.empty(path.x, slots, periods, clearance.nothing(built))
    cap = 4.0 * IMPACTS + jnp.minimum(STEPS * built.period / built.reach, MOST_STEPS)

    def going(carry):
        return jnp.any(carry[0].rest > 0)

    def turn(carry):
        path, book = travel(built, *carry)
        over = (path.rest == 0) & (book.turns > 1)
        path = jax.tree.map(partial(choose, over), _again(built, start, path), path)
        full = (book.count >= IMPACTS * periods) | (book.steps.astype(cap.dtype) > cap * periods)
        path = path._replace(rest=choose(full, 0.0, path.rest))
        return path, book._replace(turns=book.turns - over.astype(jnp.int32))

    path, book = lax.while_loop(going, turn, (path, book))
    book = book._replace(clearance=clearance.close(built, book.call, book.clearance))
    return finish(path, book, state, valid, finite, slots, cap)


def _again(frame, start, path):
    """The path at the start of its next period, its drive turned back by what rounding left of the last one."""
    low = path.rest_low + frame.period_low
    angle = -frame.frequency * low
    cosine, sine = start.cosine - angle * start.sine, start.sine + angle * start.cosine
    return path._replace(cosine=cosine, sine=sine, rest=frame.period, rest_low=low)


def travel(frame, path, book, begun=None):
    """One step of the lanes, written into the log; begun: the time at which the time to go is used up."""
    step = micro(frame, path)
    hit = (step.side != 0) & (abs(path.contact) != STUCK)
    if begun is None:
        begun = (book.periods - book.turns + 1).astype(path.rest.dtype) * frame.period
    time = begun - step.path.rest
    seen = clearance.note(frame, path, step, book.call, book.clearance)
    return step.path, log.write(book, hit, step.side, step.speed, time, seen, path.rest > 0)


def finish(path, book, state, valid, finite, slots, cap):
    """(State, Impacts) of a path at its end."""
    count = book.count
    capped = (count >= IMPACTS * book.periods) | (book.steps.astype(cap.dtype) > cap * book.periods)
    status = choose(count > slots, lax.full_like(count, FULL), OK)
    status = choose(capped, lax.full_like(count, CAP), status)
    status = choose(valid, status, INVALID)
    status = choose(finite & (jnp.isfinite(path.x) & jnp.isfinite(path.v) | ~valid), status, NONFINITE)
    good = status < CAP
    contact = jnp.sign(path.contact) * choose(abs(path.contact) == STUCK, STUCK, abs(jnp.sign(path.contact)))
    end = State(choose(good, path.x, jnp.nan), choose(good, path.v, jnp.nan), state.phase, choose(good, contact, 0.0))
    times, speeds = (
        jnp.concatenate(parts) if parts else jnp.zeros((0, *path.x.shape), path.x.dtype)
        for parts in (book.times, book.speeds)
    )
    sides = jnp.sign(speeds).astype(jnp.int32)
    return end, Impacts(times, sides, abs(speeds), count, book.least_speed, book.clearance, status)

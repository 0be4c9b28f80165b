"""The stroboscopic map: the state one or more drive periods later, and the impacts on the way."""

import math
from dataclasses import dataclass, replace
from functools import cache, partial

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap

from . import check, journey
from .entry import CAP, FULL, NONFINITE, OK, enter
from .frame import frame
from .impact import STUCK
from .lanes import OPTIONS, WIDTH, choose, one_kernel, positive, stage
from .path import CAPPED

LEAST = 16  # lanes of a block: fewer are compiled in another way, and differ by a rounding
STATUS = ("ok", "full", "cap", "invalid", "nonfinite")


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

    A mass whose hops certainly all end, infinitely many in a finite time, is put to rest on its wall: complete chatter.
    The hops up to there are recorded and counted, least_speed is 0, the status FULL.
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
    return (_within if traced else _outer)(scene, state, periods, slots)


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


def _strobe(scene, state, periods, slots, least):
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))
    run = partial(one_kernel, partial(_lanes, periods=periods, slots=slots))
    if not shape:
        return run(scene, state)
    count = math.prod(shape)
    width = min(WIDTH, max(least, 1 << (count - 1).bit_length()))
    total = max(count, width)
    leaves, tree = jax.tree.flatten((scene, replace(state, x=jnp.broadcast_to(state.x, shape))))

    def spread(leaf):
        flat = jnp.broadcast_to(leaf, shape).reshape(count)
        return jnp.pad(flat, (0, total - count), mode="edge" if count else "constant")

    leaves = [spread(leaf) if jnp.shape(leaf) else leaf for leaf in leaves]  # one number for all lanes stays one

    def put(block, out):
        start = jnp.minimum(block * width, total - width)  # the last block may repeat lanes of the one before
        lanes = [lax.dynamic_slice_in_dim(leaf, start, width) if jnp.shape(leaf) else leaf for leaf in leaves]
        done = run(*tree.unflatten(lanes))
        return jax.tree.map(lambda whole, part: lax.dynamic_update_slice_in_dim(whole, part, start, 0), out, done)

    out = lax.fori_loop(0, -(-total // width), put, _blank(total, slots, scene.dtype))
    return jax.tree.map(lambda part: part[:count].reshape(*shape, *part.shape[1:]), out)


def _blank(count, slots, dtype):
    """Results to fill in; arrays of one content would be filled once and copied, so times begin as they end, empty."""
    none = jnp.zeros(count, dtype)
    whole = jnp.zeros(count, jnp.int32)
    times, speeds = jnp.full((count, slots), jnp.inf, dtype), jnp.zeros((count, slots), dtype)
    sides = jnp.zeros((count, slots), jnp.int8)
    return State(none, none, none, none), Impacts(times, sides, speeds, whole, none, none, whole)


_inner = jax.jit(partial(_strobe, least=1), static_argnums=(2, 3))
_outer = jax.jit(partial(_strobe, least=LEAST), static_argnums=(2, 3), compiler_options=OPTIONS)


def _within(scene, state, periods, slots):
    """The strobe within other transformations: a caller's own vmap of it becomes a batch, in blocks as any other."""
    leaves, tree = jax.tree.flatten((scene, state))
    state, impacts = _mapped(tree, periods, slots)(*leaves)
    whole = {name: getattr(impacts, name).astype(jnp.int32) for name in ("count", "status")}
    return state, replace(impacts, side=impacts.side.astype(jnp.int8), **whole)


@cache
def _mapped(tree, periods, slots):
    """Numbers in, real numbers out: custom_vmap passes the tangents of nothing else on."""

    def plain(*leaves):
        scene, state = tree.unflatten(leaves)
        return jax.tree.map(lambda part: part.astype(scene.dtype), _inner(scene, state, periods, slots))

    run = custom_vmap(plain)

    @run.def_vmap
    def _(size, batched, *leaves):
        rank = max(jnp.ndim(leaf) - axis for leaf, axis in zip(leaves, batched, strict=True))

        def aligned(leaf, axis):
            own = jnp.shape(leaf)[1:] if axis else ()
            return leaf.reshape(size, *[1] * (rank - len(own)), *own) if axis else leaf

        out = plain(*map(aligned, leaves, batched))
        return out, jax.tree.map(lambda _: any(batched), out)

    return run


def _lanes(scene, state, periods, slots):
    """The strobe of scene and state whose numbers are scalars or of one shape."""
    built = frame(scene)
    path, fault = stage(enter, built, state)
    start = path.motion
    path = path._replace(rest=choose(fault == OK, built.period, 0.0))
    end = built.period if periods == 1 else built.period + lax.full_like(path.x, 0.0)
    limit = journey.cap(built, periods)
    again = partial(_again, built, start, (periods - 0.5) * built.period) if periods > 1 else None
    told = journey.run(built, journey.begin(built, path, slots, end), limit, again)
    return finish(told, state, fault)


def _again(frame, start, last, told):
    """A path that has ended a period begins the next, its drive turned back by what rounding left of the last one."""
    path, book = told.path, told.log
    over = (path.rest == 0) & (book.end < last)
    low = path.rest_low + frame.period_low
    angle = -frame.frequency * low
    cosine, sine = start.cosine - angle * start.sine, start.sine + angle * start.cosine
    turned = path.motion._replace(cosine=choose(over, cosine, path.cosine), sine=choose(over, sine, path.sine))
    rest, low = choose(over, frame.period, path.rest), choose(over, low, path.rest_low)
    path = path._replace(motion=turned, rest=rest, rest_low=low)
    end = choose(over, book.end + frame.period, book.end)
    return told._replace(path=path, log=book._replace(end=end))


def finish(told, state, fault):
    """(State, Impacts) of a journey at its end."""
    path, book, slots, calls = told
    full = (book.count > slots.times.shape[-1]) | (book.least_speed < 0)
    status = choose(full, lax.full_like(book.count, FULL), OK)
    status = choose(path.rest == CAPPED, CAP, status)
    status = choose(jnp.isfinite(path.x) & jnp.isfinite(path.v), status, NONFINITE)
    status = choose(fault == OK, status, fault)
    good = status < CAP
    contact = jnp.sign(path.contact) * choose(abs(path.contact) == STUCK, STUCK, abs(jnp.sign(path.contact)))
    phase = jnp.broadcast_to(state.phase, status.shape)
    end = State(choose(good, path.x, jnp.nan), choose(good, path.v, jnp.nan), phase, choose(good, contact, 0.0))
    none = jnp.full_like(path.x, jnp.inf)
    return end, Impacts(
        time=slots.times,
        side=(slots.speeds > 0).astype(jnp.int8) - (slots.speeds < 0).astype(jnp.int8),
        speed=abs(slots.speeds),
        count=book.count.astype(jnp.int32),
        least_speed=positive(book.least_speed),
        least_clearance=none if calls is None else calls.least,
        status=status.astype(jnp.int32),
    )

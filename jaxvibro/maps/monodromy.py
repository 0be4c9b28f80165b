"""The monodromy matrix as a product (paper, (37)): P for each flight, Q for each impact, never by autodiff.

P(t) is the matrix of the free flow. Q follows from the impact law and from when the wall is met: with u = v- - v_b,

    Q = ((-R, 0), ((a+ + R a- - (1 + R) a_b) / u, -R)),

a-, a+ the accelerations before and after, v_b, a_b the wall's velocity and acceleration. A mass that rests on a wall
forgets where it came from: M = 0.
"""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.blocks import LEAST, batched, in_blocks
from ..compiled.compiler_hints import OPTIONS, choose, stage
from ..compiled.kernels import one_kernel
from ..flight.coefficients import Stays, frame
from ..flight.flows import flow_of
from ..flight.impact import surface
from ..flight.soft_contact import bounce as restitution
from ..flight.soft_contact import gives
from ..flight.taylor import Now
from ..flight.wall import course_on, less
from ..scene import check
from ..scene.codes import Contact, Status
from ..scene.scene import Scene
from ..scene.state import State, real_state
from . import contact_matrix, one_period, pushed_matrix, start_within
from .contact_duration import product
from .one_period import SLOTS
from .onward import Onward
from .path_end import PathEnd

THROUGH = {Stays.NONE: None, Stays.SPRING: contact_matrix.through, Stays.PUSHED: pushed_matrix.through}


@check.typed
def monodromy(scene: Scene, state: State, periods: int = 1, slots: int = SLOTS) -> Float[jax.Array, "*lanes 2 2"]:
    """The derivative of `strobe`'s (x, v) by the given (x, v): shape (..., 2, 2), rows x and v of the end.

    scene, state, periods as for `strobe`; slots: impacts of a period that there is room for. nan where the strobe has
    no end (status from CAP on) or has more impacts than that and does not rest; zero where the mass rests on a wall.
    On an impact without speed the derivative does not exist: inf or nan.

    Raises ArgumentError as `strobe` does, and TypeError where it is itself to be differentiated.
    """
    periods, slots = check.whole("periods", periods, 1), check.whole("slots", slots, 1)
    leaves, tree = jax.tree.flatten((scene, real_state(scene, state)))
    traced = check.is_traced(*leaves)
    return (_within if traced else _at_once)(tree, periods, slots * periods)(*leaves)


@cache
def _within(tree, periods, slots):
    run = jax.custom_jvp(batched(jax.jit(partial(_matrices, tree, periods, slots, 1))))

    @run.defjvp
    def _(primals, tangents):
        raise TypeError("monodromy is a product without derivatives: differentiate jax.jacfwd of strobe instead")

    return run


@cache
def _at_once(tree, periods, slots):
    return jax.jit(partial(_matrices, tree, periods, slots, LEAST), compiler_options=OPTIONS)


def _matrices(tree, periods, slots, least, *leaves):
    """M of all lanes, block by block."""
    scene, state = tree.unflatten(leaves)
    shape = jnp.broadcast_shapes(*map(jnp.shape, leaves))

    def run(given):
        entries = one_kernel(_block, *given, periods=periods, slots=slots)
        return jnp.stack(entries, -1).reshape(*entries[0].shape, 2, 2)

    given = scene, replace(state, x=jnp.broadcast_to(state.x, shape))
    return in_blocks(run, given, lambda lanes: jnp.zeros((lanes, 2, 2), scene.dtype), least)


def _block(scene, state, periods, slots):
    """M of a block of lanes, by rows."""
    return with_strobe(scene, state, periods, slots)[2]


def with_strobe(scene, state, periods, slots, clearance=False):
    """(State, Impacts, M by rows) of a block of lanes, to be called within one kernel as `passage` is."""
    end, impacts, rests, way = passage(scene, state, periods, slots, clearance)
    lost = (impacts.status >= Status.CAP) | ((impacts.count > slots) & ~rests)
    return end, impacts, [choose(lost, jnp.nan, choose(rests, 0.0, each)) for each in way.matrix]


def passage(scene, state, periods, slots, clearance=False):
    """(end, impacts, rests, way) of a block of lanes: where `strobe` leads, and what M is made of.

    rests: whether the mass is on a wall at some time, which makes M zero whatever the product is. way: the `Onward` at
    the end, its matrix the product of P and Q, of no meaning with a status from CAP on, or with more impacts than
    slots. state.x has the lanes' shape, other numbers are scalars or of that shape. To be called within one kernel.
    """
    (end, impacts), (freed, *_) = one_period.through(scene, state, periods, slots, clearance)
    rests = (abs(end.contact) == Contact.STUCK) | (abs(state.contact) == Contact.STUCK) | (freed >= 0)
    return end, impacts, rests, _product(scene, state, impacts, end.contact, periods, slots)


def _product(scene, state, impacts, contact, periods, slots):
    """The `Onward` after P of each flight, Q of each impact, the matrix of each stay; contact: of every lane, at the
    end."""
    built, zero = frame(scene), lax.full_like(contact, 0.0)
    flow, through = flow_of(built), THROUGH[built.stays]
    rows = impacts.time, impacts.side.astype(zero.dtype), impacts.speed
    rows = [jnp.moveaxis(each, -1, 0) for each in rows]
    most = lax.min(jnp.max(impacts.count), jnp.int32(slots)) if built.walls else jnp.int32(0)

    def turn(carry):
        """A stay where one is due, a flight and the impact at its end, or, after all impacts, the flight to the end."""
        k, lanes, now = carry
        if lanes:
            now = through(built, lanes, k > 0, PathEnd(whole, contact), now)
        time, side, speed = (lax.dynamic_index_in_dim(each, k, keepdims=False) for each in rows)
        last = k == most
        hit = (side != 0) & ~last
        span = choose(last, whole - now.time, choose(hit, time - now.time, 0.0))
        place, cosine, sine, free = flow.passed(built, now.place, now.cosine, now.sine, span)
        matrix = product(free, now.matrix)
        if built.walls:
            bounce, shear = stage(saltation, built, side, speed, cosine, sine)
            after = product((-bounce, zero, shear, -bounce), matrix)
            matrix = tuple(choose(hit, new, old) for new, old in zip(after, matrix, strict=True))
        if built.walls and place:
            place = _bounced(built, hit, side, speed, bounce, cosine, sine, place)
        if lanes:
            lanes = choose(hit & gives(built, side), side * Contact.ENTERED, 0.0), zero, side * speed
        return k + 1, lanes, Onward(now.time + span, place, cosine, sine, matrix, now.within)

    cosine, sine = jnp.cos(state.phase) + zero, jnp.sin(state.phase) + zero
    whole, one = zero + periods * built.period, (zero + 1.0, zero, zero, zero + 1.0)
    place = () if flow.LINEAR and not through else (state.x + zero, state.v + zero)
    lanes = start_within.within(built, Now(*place, cosine, sine, zero), state.contact) if through else ()
    within = tuple(zero for each in built.contacts if each is not None)
    start = Onward(zero, () if flow.LINEAR else place, cosine, sine, one, within)
    return lax.while_loop(lambda carry: carry[0] <= most, turn, (jnp.int32(0), lanes, start))[-1]


def _bounced(frame, hit, side, speed, bounce, cosine, sine, place):
    """(x, v) of the lanes that hit after the impact, of others as it is."""
    aim = choose(hit, side, lax.full_like(side, float(frame.walls[0].sign)))
    where, pace = surface(frame, aim, cosine, sine)[:2]
    x, v = place
    return choose(hit, where, x), choose(hit, pace - bounce * side * speed, v)


def saltation(frame, side, speed, cosine, sine):
    """R and the lower left entry of Q, of an impact on a side with this speed; side 0: of none, any numbers."""
    where, pace, bend = course_on(frame, side, cosine, sine, 2)
    bounce = restitution(frame, side) + 0.0 * speed
    pace = 0.0 if pace is None else pace
    closing = side * speed
    accelerations = flow_of(frame).accelerations
    before, _ = accelerations(frame, where, pace + closing, cosine, sine)
    after, _ = accelerations(frame, where, pace - bounce * closing, cosine, sine)
    shift = after + bounce * before
    return bounce, less(shift, None if bend is None else (1.0 + bounce) * bend) / closing

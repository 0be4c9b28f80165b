"""What an impact, or a stay within a soft wall, makes of a mass that comes to a wall at a time with a speed.

Both are the same to the equations of the impacts (`impact_equations`): from where and when the next flight begins, and
how that changes with the impact's own time and speed. A stay takes time; it is as smooth as an impact where its speed
is zero.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from continuation.arrays import Array

from ..compiled.compiler_hints import choose
from ..flight import soft_contact
from ..flight.coefficients import Stays
from ..flight.flows import flow_of
from . import pushed_meeting, spring_meeting
from .meeting_wall import way

KINDS = {Stays.NONE: None, Stays.SPRING: spring_meeting, Stays.PUSHED: pushed_meeting}


class Meeting(NamedTuple):
    """Of each impact: the drive's cosine and sine; the wall's position, velocity and acceleration; R and the velocity
    against the wall; the acceleration before. And of the start of the flight that follows: the stay before it, None
    where all walls are rigid; (x, v); the drive's (cosine, sine); how (x, v) change with the impact's time and speed,
    the flight's start being kept; the velocity against the wall. gives: whether it is a stay, None where all walls are
    rigid; free: the free flow's matrix over it, beside a force of the user's own `pushed_meeting.Leaving.slopes`."""

    cosine: Float[Array, "*shape"]
    sine: Float[Array, "*shape"]
    where: Float[Array, "*shape"]
    pace: Float[Array, "*shape"]
    bend: Float[Array, "*shape"]
    bounce: Float[Array, "*shape"]
    closing: Float[Array, "*shape"]
    stay: Float[Array, "*shape"] | None
    state: tuple[Float[Array, "*shape"], Float[Array, "*shape"]]
    phasor: tuple[Float[Array, "*shape"], Float[Array, "*shape"]]
    by_time: tuple[Float[Array, "*shape"], Float[Array, "*shape"]]
    by_speed: tuple[Float[Array, "*shape"], Float[Array, "*shape"]]
    opening: Float[Array, "*shape"]
    gives: Bool[Array, "*shape"] | None = None
    free: tuple[Float[Array, "*shape"], ...] | None = None


def meeting(frame, sides, cosine, sine, speed, still=None, passed=None):
    """The `Meeting` of impacts on these sides, 0: of none, any numbers; arrays of one shape. still, passed: as of a
    `Cycle`, the latter beside no force of the user's own."""
    where, pace, bend = way(frame, sides, cosine, sine)
    closing, zero = sides * speed, jnp.zeros_like(speed)
    bounce = soft_contact.bounce(frame, sides) + zero
    v = pace - bounce * closing
    after, _ = flow_of(frame).accelerations(frame, where, v, cosine, sine)
    by_time, by_speed = (bounce * closing, bend - after), (zero, -bounce * sides)
    found = Meeting(
        cosine, sine, where, pace, bend, bounce, closing, None, (where, v), (cosine, sine), by_time, by_speed, v - pace
    )
    stays = KINDS[frame.stays]
    if stays is None:
        return found
    gives = soft_contact.gives(frame, sides)
    gives = gives if still is None else gives & (still == 0)
    soft, free = stays.left(frame, sides, gives, speed, found, passed)
    hard = found.state, found.phasor, found.by_time, found.by_speed, found.opening, zero
    state, phasor, by_time, by_speed, opening, stay = jax.tree.map(
        lambda soft, hard: jnp.where(gives, soft, hard), soft, hard
    )
    return found._replace(
        stay=stay,
        state=state,
        phasor=phasor,
        by_time=by_time,
        by_speed=by_speed,
        opening=opening,
        gives=gives,
        free=free,
    )


def jump(frame, met, sides):
    """(Q by rows, det Q) of each meeting (paper, (35)), for a stay S P S, S the saltation where the damping jumps."""
    stays, accelerations = KINDS[frame.stays], flow_of(frame).accelerations
    before, _ = accelerations(frame, met.where, met.pace + met.closing, met.cosine, met.sine)
    after, _ = accelerations(frame, *met.state, *met.phasor)
    shear = (after + met.bounce * before - (1.0 + met.bounce) * met.bend) / met.closing
    if stays is not None:
        shear = choose(met.bounce < 0, 0.0, shear)  # a touch does nothing
    hard = (-met.bounce, jnp.zeros_like(shear), shear, -met.bounce), met.bounce * met.bounce
    if stays is None:
        return hard
    soft = stays.matrix(frame, sides, met, before, after)
    return jax.tree.map(lambda soft, hard: jnp.where(met.gives, soft, hard), soft, hard)


def stayed(frame, met, sides, k, since, state):
    """(x, v) a time after the meetings in rows k: within the wall during the stay, else the state given."""
    return KINDS[frame.stays].inside(frame, met, sides, k, since, state)


def rate(frame, met, sides):
    """How fast the mass swings within soft walls at most, a scalar."""
    return KINDS[frame.stays].rate(frame, met, sides)


def reach(frame, met, sides):
    """How far stays can be followed in one piece, a scalar."""
    return KINDS[frame.stays].reach(frame, met, sides)

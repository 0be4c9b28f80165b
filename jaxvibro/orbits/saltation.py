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
from ..flight import flow, soft_contact
from ..flight.flight_state import accelerations
from ..flight.wall import course, picked
from ..maps.contact_duration import carried, share
from ..scene.codes import Contact
from . import pushed_meeting
from .stay import guess, leave


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


def meeting(frame, sides, cosine, sine, speed, still=None):
    """The `Meeting` of impacts on these sides, 0: of none, any numbers; arrays of one shape. still: as of a `Cycle`."""
    where, pace, bend = _way(frame, sides, cosine, sine)
    closing, zero = sides * speed, jnp.zeros_like(speed)
    bounce = soft_contact.bounce(frame, sides) + zero
    v = pace - bounce * closing
    after, _ = accelerations(frame, where, v, cosine, sine)
    by_time, by_speed = (bounce * closing, bend - after), (zero, -bounce * sides)
    found = Meeting(
        cosine, sine, where, pace, bend, bounce, closing, None, (where, v), (cosine, sine), by_time, by_speed, v - pace
    )
    return _softened(frame, sides, speed, found, still) if frame.soft else found


def _softened(frame, sides, speed, met, still):
    """The `Meeting` with stays in place of impacts where the wall is soft."""
    gives = soft_contact.gives(frame, sides)
    gives = gives if still is None else gives & (still == 0)
    if frame.pushes:
        return _pushed(frame, sides, gives, speed, met)
    side, none = choose(gives, sides, 0.0), jnp.zeros_like(speed)
    given = met.cosine, met.sine, speed
    out = leave(frame, side, *given, guess(frame, side, *given))
    where, pace, _ = _way(frame, sides, out.cosine, out.sine)
    here, (p00, p01, p11) = soft_contact.feeling(frame, side * Contact.ENTERED), out.free
    # at the end the damping jumps back, and with it the acceleration
    jump = 2.0 * (frame.damping - here.damping) * (pace + out.v)
    first = p00 * met.closing + p01 * out.pull, p11 * out.pull - here.stiffness * p01 * met.closing
    soft = (
        (where, pace + out.v),
        (out.cosine, out.sine),
        (-first[0], jump * out.later - first[1]),
        (sides * p01, sides * (p11 + jump * out.faster)),
        out.v,
        out.time,
    )
    hard = met.state, met.phasor, met.by_time, met.by_speed, met.opening, none
    state, phasor, by_time, by_speed, opening, stay = jax.tree.map(
        lambda soft, hard: jnp.where(gives, soft, hard), soft, hard
    )
    return met._replace(
        stay=stay,
        state=state,
        phasor=phasor,
        by_time=by_time,
        by_speed=by_speed,
        opening=opening,
        gives=gives,
        free=out.free,
    )


def _pushed(frame, sides, gives, speed, met):
    """The `Meeting` with stays beside a force of the user's own in place of impacts where the wall gives."""
    out = pushed_meeting.leave(frame, gives, sides, met.cosine, met.sine, speed)
    where, pace, bend = _way(frame, sides, out.cosine, out.sine)
    opening = sides * out.speed
    after, _ = accelerations(frame, where, pace + opening, out.cosine, out.sine)
    by_time, by_speed = pushed_meeting.at_a_time(out, out.speed, bend, after, sides)
    soft = (where, pace + opening), (out.cosine, out.sine), by_time, by_speed, opening, out.time
    hard = met.state, met.phasor, met.by_time, met.by_speed, met.opening, jnp.zeros_like(speed)
    told = jax.tree.map(lambda soft, hard: jnp.where(gives, soft, hard), soft, hard)
    names = "state", "phasor", "by_time", "by_speed", "opening", "stay"
    return met._replace(**dict(zip(names, told, strict=True)), gives=gives, free=out.slopes)


def _way(frame, sides, cosine, sine):
    """Position, velocity and acceleration of the walls on these sides."""
    ways = [course(wall, frame.frequency, cosine, sine, 2) for wall in frame.walls]
    return [0.0 * sides if each is None else each + 0.0 * sides for each in picked(sides, frame.walls, ways)]


def jump(frame, met, sides):
    """(Q by rows, det Q) of each meeting (paper, (35)), for a stay S P S, S the saltation where the damping jumps."""
    before, _ = accelerations(frame, met.where, met.pace + met.closing, met.cosine, met.sine)
    after, _ = accelerations(frame, *met.state, *met.phasor)
    shear = (after + met.bounce * before - (1.0 + met.bounce) * met.bend) / met.closing
    if frame.soft:
        shear = choose(met.bounce < 0, 0.0, shear)  # a touch does nothing
    hard = (-met.bounce, jnp.zeros_like(shear), shear, -met.bounce), met.bounce * met.bounce
    if not frame.soft:
        return hard
    if frame.pushes:
        _, _, bend = _way(frame, sides, *met.phasor)
        drawn = sides * (before - met.bend), sides * (after - bend)
        soft = pushed_meeting.matrix(met.free, drawn, (sides * met.closing, sides * met.opening))
        return jax.tree.map(lambda soft, hard: jnp.where(met.gives, soft, hard), soft, hard)
    touch, stay = choose(met.gives, sides * float(Contact.WITHIN), 0.0), jnp.maximum(met.stay, 0.0)
    _, pace, _ = _way(frame, sides, *met.phasor)
    soft = carried(frame, touch, stay, met.free, share(met.pace, met.closing), share(pace, met.opening))
    return jax.tree.map(lambda soft, hard: jnp.where(met.gives, soft, hard), soft, hard)


def stayed(frame, met, sides, k, since, state):
    """(x, v) a time after the meetings in rows k: within the wall during the stay, else the state given."""
    if frame.pushes:
        within = met.gives[k] & (since < met.stay[k])
        side, span = sides[k], jnp.where(within, since, 0.0)
        given = side, met.cosine[k], met.sine[k], side * met.closing[k]
        depth, rate = pushed_meeting.inside(frame, within, *given, span)
        where, pace, _ = _way(frame, side, *flow.rotated(*given[1:3], frame.frequency * span))
        return choose(within, where + side * depth, state[0]), choose(within, pace + side * rate, state[1])
    touch = choose(met.gives, sides * float(Contact.WITHIN), 0.0)[k]
    here = soft_contact.feeling(frame, touch)
    inside = (touch != 0) & (since < met.stay[k])
    span = choose(inside, since, 0.0)
    cosine, sine = met.cosine[k], met.sine[k]
    y, v = soft_contact.flown(
        here, touch, soft_contact.response(here, touch, span), (0.0 * span, met.closing[k]), cosine, sine
    )
    where, pace, _ = _way(frame, sides[k], *flow.rotated(cosine, sine, frame.frequency * span))
    return choose(inside, where + y, state[0]), choose(inside, pace + v, state[1])

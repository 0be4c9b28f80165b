"""The impact law, y+ - v_b = -R (y- - v_b) (paper, (4)), and what a mass does that has no speed left on a wall."""

from typing import NamedTuple

import jax
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, least, positive, two_sum
from ..scene.codes import Contact
from . import event, flow
from .flight_state import CAPPED, Path, SlowMotion, motion
from .flows import flow_of
from .soft_contact import bounce, gives
from .stays import stays_of
from .wall import course_on, less, picked
from .within_wall import counted, within

ENDLESS = -1.0  # the least speed of a chatter
HOPS = 4.85  # 2 (1 + sqrt(2)), and for rounding
NEAR = 0.25  # by what part of itself a speed may change up to the event: more, and it is rounding that is far from it


class Strike(NamedTuple):
    """What an event does: the speed against the wall before it, the least speed that follows, the contact after it.

    The speed is negative where the event is the end of a contact with a soft wall.
    """

    speed: Float[jax.Array, "*lanes"]
    least: Float[jax.Array, "*lanes"]
    contact: Float[jax.Array, "*lanes"]


def late(frame, path, side):
    """How much later than the end of a step its event is: one step of Halley's, from nearer than `event.landing`.

    What is left to the event of a slow impact may be rounding, which is not to be divided by its speed: none.
    """
    phasor = path.cosine, path.sine
    where, speed, bend = course_on(frame, side, *phasor, 2)
    presses = [flow_of(frame).press(frame, wall, *phasor, 1) for wall in frame.walls]
    push, change = picked(side, frame.walls, presses)
    pull, _ = _pulled(frame, path)
    where, speed, bend = counted(within(frame, path.contact), side, (where, speed, bend))
    closing, bending = less(path.v, speed), less(pull, bend)
    stuck = lax.abs(path.contact) == Contact.STUCK
    time = choose(stuck, -push, (where - path.x) - path.x_low) / choose(stuck, change, closing)
    turned = choose(stuck, time * frame.pace, bending * time / closing)
    time = time * choose(stuck, 1.0, 1.0 - 0.5 * turned)
    return choose((side != 0) & (lax.abs(turned) < NEAR), time, 0.0)


def strike(frame, path, side, late):
    """The `Strike` of an event: rebound, rest, release; a lane without one keeps what it has."""
    stuck = lax.abs(path.contact) == Contact.STUCK
    cosine, sine = _turned(frame, path, late)
    _, speed, push, change = surface(frame, choose(stuck, path.contact, side), cosine, sine)
    pull, jerk = _pulled(frame, path)
    inside = within(frame, path.contact)
    (speed,) = counted(inside, side, (speed,))
    closing = side * (path.v + late * (pull + 0.5 * late * jerk) - speed)
    again = bounce(frame, side)
    leaving = again * closing
    leaving = choose(lax.abs(leaving) > event.smallest(leaving.dtype), leaving, 0.0)
    state = settle(frame, leaving, side * push, side * change)
    rush, damping, rise = flow_of(frame).hops(frame, side, pull, closing, cosine, sine)
    ends = chatters(frame._replace(damping=damping), leaving, side * push, again, rush, path.to_go, rise)
    state = choose(stuck, Contact.RELEASED, choose(ends, Contact.STUCK, state))
    if inside is not None:
        state = choose(inside, Contact.LANDED, choose(gives(frame, side), Contact.ENTERED, state))
    least_speed = choose((state == Contact.STUCK) & (leaving > 0), ENDLESS, closing)
    return Strike(choose(stuck, 0.0, closing), least_speed, choose(side != 0, side * state, path.contact))


def _pulled(frame, path):
    """The acceleration of the mass and its rate of change."""
    bias = stays_of(frame).bias(frame, path)
    return flow_of(frame).accelerations(frame, path.x, path.v, path.cosine, path.sine, bias)


def part(frame, path, side, late, strike, time):
    """The path after the event: a lane without one goes on, one that rests is kept to its wall.

    One that enters a soft wall is from there on counted from it.
    """
    cosine, sine = _turned(frame, path, late)
    stuck = lax.abs(path.contact) == Contact.STUCK
    where, speed, _, _ = surface(frame, choose(stuck, path.contact, side), cosine, sine)
    on = (side != 0) | stuck
    leaving = bounce(frame, side) * strike.speed
    keeps = lax.abs(strike.contact) == Contact.LANDED
    inside = within(frame, path.contact)
    if inside is not None:
        enters = (side != 0) & (lax.abs(strike.contact) == Contact.ENTERED)
        keeps |= enters
        leaving = choose(enters | inside, -strike.speed, leaving)
        where, speed = counted(enters, side, (where, speed))
        frame = frame._replace(swift=choose(enters, 0.0, frame.swift))
    after = speed - side * choose(keeps, leaving, 0.0)
    x, v = choose(on, where, path.x), choose(on, after, path.v)
    moved = motion(frame, where, after, cosine, sine)
    slow = (choose(on, new, old) for new, old in zip(moved[:4], path.motion[:4], strict=True))
    moved = SlowMotion(*slow, cosine, sine)
    to_go, to_go_low = two_sum(path.to_go, path.to_go_low - late)
    idle = (time > 0) & ~on
    contact = choose(idle, 0.0, strike.contact)
    if inside is not None:
        inside &= side == 0
        contact = choose(inside & (time > 0), lax.sign(path.contact) * Contact.WITHIN, contact)
    to_go = choose(path.to_go == CAPPED, CAPPED, positive(to_go))
    return Path(x, choose(on, 0.0, path.x_low), v, moved, to_go, to_go_low, contact)


def _turned(frame, path, late):
    angle = frame.frequency * late
    return flow.turn(path.cosine, path.sine, -0.5 * angle * angle, angle)


def surface(frame, side, cosine, sine):
    """Position, speed, press and the press's change of the wall on a side."""
    where, speed = course_on(frame, side, cosine, sine, 1)
    presses = [flow_of(frame).press(frame, wall, cosine, sine, 1) for wall in frame.walls]
    return where, 0.0 if speed is None else speed, *picked(side, frame.walls, presses)


def settle(frame, leaving, push, change):
    """LANDED, STUCK or RELEASED: what follows on a wall from the speed of leaving it, the press and its change.

    A hop lower than rounding, leaving^2 / (2 push), is no hop: the mass rests. Without speed the press decides, then
    its change.
    """
    none = leaving == 0
    pressed = (push > 0) & (leaving * (leaving / frame.size) <= 4.0 * event.rounding(push.dtype) * push)
    held = pressed | (none & (push == 0) & (change >= 0))
    free = choose(none & (push == 0), Contact.RELEASED, lax.full_like(push, Contact.LANDED))
    return choose(held, Contact.STUCK, free)


def chatters(frame, leaving, push, bounce, rush, time, rise=None):
    """Whether all hops that follow, infinitely many, certainly end in so much time: complete chatter.

    While the press stays within push (1 +- e), a hop that leaves with speed u rises for at most u / (push (1 - e)), to
    h = u^2 / (2 push (1 - e)); it falls for at most sqrt(2) times that, if damping takes less than half of the press,
    and hits with at most k u, k^2 = (push (1 + e) + h) / (push (1 - e)). The speeds fall at least like ((1 + R) / 2)^n
    if R k <= (1 + R) / 2, which gives e, and the time of all hops is a geometric series.

    rise: how much the acceleration away from the wall grows per length from it, 1 or more; None for 1.
    """
    fall = 0.25 * (1.0 + bounce) * (1.0 + bounce)
    square = bounce * bounce
    share = least((fall - square) / (fall + 2.0 * square), 0.5)
    weak = push * (1.0 - share)
    span, high = HOPS * leaving, leaving * leaving
    bent = high if rise is None else high * rise
    time = time * weak * (1.0 - bounce)
    small = (rush * span <= share * push * weak * (1.0 - bounce)) & (bent <= 2.0 * share * push * weak)
    clear = (high < weak * frame.gap) & (8.0 * frame.damping * leaving <= weak)
    return (push > 0) & (leaving > 0) & (span <= time) & small & clear

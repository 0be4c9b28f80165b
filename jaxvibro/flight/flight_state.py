"""Where a lane is along its path, and which part of its motion the flow carries.

The swift part of the response to the drive, swift cos(theta), follows the drive's angle. What is left, x less it, feels
the force -2 swift Re((1 + gamma omega + i gamma omega) exp(i theta)) in place of A cos(theta): one that falls off as
the drive gets fast, so that the rounding of a step is small beside the motion. Any swift part would do; this one,
-A / (1 + omega^2 + 2 gamma omega), has no singular point and is never larger than the forced amplitude.
"""

from typing import NamedTuple

import jax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, stage, two_sum
from . import drive, flow, force_flow, soft_contact
from .wall import course

CAPPED = -1.0


class SlowMotion(NamedTuple):
    """What the flow carries: x and v less the swift part, with the low parts of their sums; the drive's angle."""

    slow_x: Float[jax.Array, "*lanes"]
    slow_x_low: Float[jax.Array, "*lanes"]
    slow_v: Float[jax.Array, "*lanes"]
    slow_v_low: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]


class Path(NamedTuple):
    """Where a lane is: x and its low part, v; the motion; the time to go and its low part; the contact.

    A lane that was given up has CAPPED to go, its low part 0.

    contact: 0 free; times the wall's sign: 1 has landed and leaves, 2 rests on the wall, 3 is within a soft wall, 4 has
    just entered it, 5 is released, no push on it. Within a wall x and v are counted from the wall's.
    """

    x: Float[jax.Array, "*lanes"]
    x_low: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    motion: SlowMotion
    to_go: Float[jax.Array, "*lanes"]
    to_go_low: Float[jax.Array, "*lanes"]
    contact: Float[jax.Array, "*lanes"]

    @property
    def cosine(self) -> Float[jax.Array, "..."]:
        return self.motion.cosine

    @property
    def sine(self) -> Float[jax.Array, "..."]:
        return self.motion.sine


def motion(frame, x, v, cosine, sine):
    """The `SlowMotion` of a position and a velocity."""
    slow_x, slow_v = -(frame.swift * cosine), frame.swift * frame.frequency * sine
    return SlowMotion(*two_sum(x, slow_x), *two_sum(v, slow_v), cosine, sine)


def place(frame, motion):
    """(x, its low part, v) of a motion."""
    slow_x, slow_x_low, slow_v, slow_v_low, cosine, sine = motion
    x, low = two_sum(slow_x, frame.swift * cosine)
    return x, low + slow_x_low, slow_v + (slow_v_low - frame.swift * frame.frequency * sine)


def moved(frame, motion, time, touch=None):
    """The `SlowMotion` a time later. touch: the lanes' contact, where they may be within a soft wall.

    Under a force of the user's own no longer than a step.
    """
    if frame.law is not None:
        return gone(frame, motion, time)
    if touch is None:
        gains, more = stage(flow.gains, frame.series, frame.frequency, time), None
        if frame.terms:
            lifted = [stage(flow.lifts, term.series, time) for term in frame.terms]
            more = stage(drive.moved, frame.terms, frame.frequency, *motion[4:], gains.move, lifted)
    else:
        gains = stage(soft_contact.gains, frame, touch, time)
        waves = stage(soft_contact.waves, frame, touch, time) if soft_contact.waved(frame) else []
        more = stage(soft_contact.pushed, frame, touch, motion, gains, waves)
    slow = stage(_carry, frame, motion, gains, touch, more)
    return SlowMotion(*slow, *stage(flow.turn, *motion[4:], gains.versed, gains.sined))


def gone(frame, motion, time, terms=None):
    """The `SlowMotion` a time later under a force of the user's own; terms: the coefficients of x, where known."""
    x, _, v = stage(place, frame, motion)
    dx, dv = force_flow.gained(frame, x, v, motion.cosine, motion.sine, time, terms)
    slow = stage(_added, motion, dx, dv)
    return SlowMotion(*slow, *stage(_turned, frame.frequency, motion.cosine, motion.sine, time))


def _added(motion, dx, dv):
    return *two_sum(motion.slow_x, dx + motion.slow_x_low), *two_sum(motion.slow_v, dv + motion.slow_v_low)


def _turned(frequency, cosine, sine, time):
    angle = frequency * time
    return flow.turn(cosine, sine, flow.versine(angle), flow.sinus(angle))


def _carry(frame, motion, gains, touch, more):
    """(slow_x, slow_x_low, slow_v, slow_v_low) after a flight; more: what the drive's force is not the cause of."""
    twist = frame.damping * frame.frequency
    along = -2.0 * frame.swift * (motion.cosine + twist * (motion.cosine - motion.sine))
    across = -2.0 * frame.swift * (motion.sine + twist * (motion.sine + motion.cosine))
    if touch is not None:
        inside = soft_contact.is_inside(touch)
        along = choose(inside, frame.force * motion.cosine, along)
        across = choose(inside, frame.force * motion.sine, across)
    stay, move, lift, lag = gains[:4]
    dx = stay * motion.slow_x + (move * motion.slow_v + (along * lift - across * lag))
    forced = along * (move - frame.frequency * lag) - across * (frame.frequency * lift)
    dv = (stay - 2.0 * frame.damping * move) * motion.slow_v + (
        forced - move * flow.pulled(frame.stiffness, motion.slow_x)
    )
    if more is not None:
        dx, dv = dx + more[0], dv + more[1]
    return _added(motion, dx, dv)


def remaining(path, time):
    """The time to go, and its low part, a time later."""
    to_go, low = two_sum(path.to_go, -time)
    return two_sum(to_go, low + path.to_go_low)


def absolute(frame, path):
    """(x, v) of the lanes, also of those that are within a soft wall."""
    x, v = path.x, path.v
    for wall, soft in zip(frame.walls, frame.contacts, strict=True):
        if soft is not None:
            where, pace = course(wall, frame.frequency, path.cosine, path.sine, 1)
            inside = soft_contact.is_inside(path.contact) & (path.contact * wall.sign > 0)
            x = choose(inside, where + path.x, x)
            v = v if pace is None else choose(inside, pace + path.v, v)
    return x, v


def accelerations(frame, x, v, cosine, sine, bias=(None, None)):
    """The acceleration of a free mass, and its rate of change; bias: see `flow.extend`."""
    if frame.law is not None:
        return tuple(force_flow.derivatives(frame, x, v, cosine, sine, 3)[2:])
    bias = drive.pushed(frame.terms, frame.frequency, cosine, sine, bias)
    force = frame.force * cosine, -(frame.force * sine) * frame.frequency
    return flow.extend(frame.frequency, frame.damping, frame.stiffness, force, bias, (x, v))[1]


def jet(frame, x, v, cosine, sine, order, bias=()):
    """x and its derivatives, two at a time so that each is computed once: at least as many as the order."""
    if frame.law is not None:
        return force_flow.derivatives(frame, x, v, cosine, sine, order)
    force, found = (frame.force * cosine, -(frame.force * sine) * frame.frequency), [x, v]
    bias = [*bias, *[None] * order]
    if frame.terms:
        bias = stage(drive.pushed, frame.terms, frame.frequency, cosine, sine, bias[:order])
    while len(found) <= order:
        pair = bias[len(found) - 2 : len(found)]
        force, new = stage(flow.extend, frame.frequency, frame.damping, frame.stiffness, force, pair, found[-2:])
        found += new
    return found

"""Where a lane is along its path, and which part of its motion the flow carries.

The swift part of the response to the drive, swift cos(theta), follows the drive's angle. What is left, x less it, feels
the force -2 swift Re((1 + gamma omega + i gamma omega) exp(i theta)) in place of A cos(theta): one that falls off as
the drive gets fast, so that the rounding of a step is small beside the motion. Any swift part would do; this one,
-A / (1 + omega^2 + 2 gamma omega), has no singular point and is never larger than the forced amplitude.
"""

from typing import NamedTuple

import jax

from . import flow
from .lanes import stage, two_sum

CAPPED = -1.0


class Motion(NamedTuple):
    """What the flow carries: x and v less the swift part, with the low parts of their sums; the drive's angle."""

    slow_x: jax.Array
    slow_x_low: jax.Array
    slow_v: jax.Array
    slow_v_low: jax.Array
    cosine: jax.Array
    sine: jax.Array


class Path(NamedTuple):
    """Where a lane is: x and its low part, v; the motion; the time to go and its low part; the contact.

    A lane that was given up has CAPPED to go.

    contact: 0 free; times the wall's sign: 1 has landed and leaves, 2 rests on the wall, 3 is released, no push on it.
    """

    x: jax.Array
    x_low: jax.Array
    v: jax.Array
    motion: Motion
    rest: jax.Array
    rest_low: jax.Array
    contact: jax.Array

    @property
    def cosine(self):
        return self.motion.cosine

    @property
    def sine(self):
        return self.motion.sine


def swift(frequency, damping, force):
    """The amplitude of the swift part."""
    return -force / (1.0 + frequency * frequency + 2.0 * damping * frequency)


def motion(frame, x, v, cosine, sine):
    """The `Motion` of a position and a velocity."""
    slow_x, slow_v = -(frame.swift * cosine), frame.swift * frame.frequency * sine
    return Motion(*two_sum(x, slow_x), *two_sum(v, slow_v), cosine, sine)


def place(frame, motion):
    """(x, its low part, v) of a motion."""
    slow_x, slow_x_low, slow_v, slow_v_low, cosine, sine = motion
    x, low = two_sum(slow_x, frame.swift * cosine)
    return x, low + slow_x_low, slow_v + (slow_v_low - frame.swift * frame.frequency * sine)


def moved(frame, motion, time):
    """The `Motion` a time later."""
    gains = stage(flow.gains, frame.series, frame.frequency, time)
    return Motion(*stage(_carry, frame, motion, gains), *stage(flow.turn, *motion[4:], gains.versed, gains.sined))


def _carry(frame, motion, gains):
    """(slow_x, slow_x_low, slow_v, slow_v_low) after a flight."""
    twist = frame.damping * frame.frequency
    along = -2.0 * frame.swift * (motion.cosine + twist * (motion.cosine - motion.sine))
    across = -2.0 * frame.swift * (motion.sine + twist * (motion.sine + motion.cosine))
    stay, move, lift, lag = gains[:4]
    dx = stay * motion.slow_x + (move * motion.slow_v + (along * lift - across * lag))
    forced = along * (move - frame.frequency * lag) - across * (frame.frequency * lift)
    dv = (stay - 2.0 * frame.damping * move) * motion.slow_v + (forced - move * motion.slow_x)
    return *two_sum(motion.slow_x, dx + motion.slow_x_low), *two_sum(motion.slow_v, dv + motion.slow_v_low)


def accelerations(frame, x, v, cosine, sine):
    """The acceleration of a free mass, and its rate of change."""
    pull = frame.force * cosine - x - 2.0 * frame.damping * v
    return pull, -(frame.force * sine) * frame.frequency - v - 2.0 * frame.damping * pull


def jet(frame, x, v, cosine, sine, order):
    """x and its derivatives, two at a time so that each is computed once: at least as many as the order."""
    force, found = (frame.force * cosine, -(frame.force * sine) * frame.frequency), [x, v]
    while len(found) <= order:
        force, new = stage(flow.extend, frame.frequency, frame.damping, force, found[-2:])
        found += new
    return found

"""Where a lane is along its path, and which part of its motion the flow carries.

The swift part of the response to the drive, swift cos(theta), follows the drive's angle. What is left, x less it, feels
the force -2 swift Re((1 + gamma omega + i gamma omega) exp(i theta)) in place of A cos(theta): one that falls off as
the drive gets fast, so that the rounding of a step is small beside the motion. Any swift part would do; this one,
-A / (1 + omega^2 + 2 gamma omega), has no singular point and is never larger than the forced amplitude.
"""

from typing import NamedTuple

import jax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, two_sum
from . import flow, soft_contact
from .wall_motion import wall_jet

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
    time_remaining: Float[jax.Array, "*lanes"]
    time_remaining_low: Float[jax.Array, "*lanes"]
    contact: Float[jax.Array, "*lanes"]

    @property
    def cosine(self) -> Float[jax.Array, "..."]:
        return self.motion.cosine

    @property
    def sine(self) -> Float[jax.Array, "..."]:
        return self.motion.sine


def split_motion(coeffs, x, v, cosine, sine):
    """The `SlowMotion` of a position and a velocity."""
    slow_x, slow_v = -(coeffs.swift_amplitude * cosine), coeffs.swift_amplitude * coeffs.frequency * sine
    return SlowMotion(*two_sum(x, slow_x), *two_sum(v, slow_v), cosine, sine)


def motion_state(coeffs, motion):
    """(x, its low part, v) of a motion."""
    slow_x, slow_x_low, slow_v, slow_v_low, cosine, sine = motion
    x, x_low = two_sum(slow_x, coeffs.swift_amplitude * cosine)
    return x, x_low + slow_x_low, slow_v + (slow_v_low - coeffs.swift_amplitude * coeffs.frequency * sine)


def add_increments(motion, dx, dv):
    """(slow_x, slow_x_low, slow_v, slow_v_low) of a motion that has gained so much."""
    return *two_sum(motion.slow_x, dx + motion.slow_x_low), *two_sum(motion.slow_v, dv + motion.slow_v_low)


def rotate_drive(frequency, cosine, sine, time):
    """The drive's cosine and sine a time later."""
    angle = frequency * time
    return flow.rotate(cosine, sine, flow.cos_less_1(angle), flow.sin_by_series(angle))


def subtract_time(path, time):
    """The time to go, and its low part, a time later."""
    time_remaining, low_part = two_sum(path.time_remaining, -time)
    return two_sum(time_remaining, low_part + path.time_remaining_low)


def absolute_state(coeffs, path):
    """(x, v) of the lanes, also of those that are within a soft wall."""
    x, v = path.x, path.v
    for wall, soft_flow in zip(coeffs.walls, coeffs.soft_flows, strict=True):
        if soft_flow is not None:
            wall_position, wall_velocity = wall_jet(wall, coeffs.frequency, path.cosine, path.sine, 1)
            is_inside_wall = soft_contact.is_inside(path.contact) & (path.contact * wall.sign > 0)
            x = choose(is_inside_wall, wall_position + path.x, x)
            v = v if wall_velocity is None else choose(is_inside_wall, wall_velocity + path.v, v)
    return x, v

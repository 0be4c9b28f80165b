"""Represent the state of a lane along its path, and the part of the motion that the flow advances.

The swift part of the response to the drive, swift cos(theta), follows the angle theta of the drive. The remaining slow
part of x is subject to the force -2 swift Re((1 + gamma omega + i gamma omega) exp(i theta)) instead of A cos(theta).
This force decreases as the drive frequency grows, so that the rounding error of a step is small relative to the motion.
Any swift amplitude is admissible. The present one, -A / (1 + omega^2 + 2 gamma omega), has no singularity and never
exceeds the amplitude of the forced response.
"""

from typing import NamedTuple

import jax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, two_sum
from . import flow, soft_contact
from .wall_motion import wall_jet

CAPPED = -1.0  # remaining time of a lane that exceeds the limits of `integrate.LoopLimits`


class SlowMotion(NamedTuple):
    """Slow part of the motion, which the flow advances, and the phasor of the drive.

    Attributes
    ----------
    slow_x : array
        Position less the swift part.
    slow_x_low : array
        Low part of `slow_x`.
    slow_v : array
        Velocity less the swift part.
    slow_v_low : array
        Low part of `slow_v`.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.
    """

    slow_x: Float[jax.Array, "*lanes"]
    slow_x_low: Float[jax.Array, "*lanes"]
    slow_v: Float[jax.Array, "*lanes"]
    slow_v_low: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]


class Path(NamedTuple):
    """State of a lane along its path.

    Inside a soft wall x and v are relative to the wall.

    Attributes
    ----------
    x : array
        Position.
    x_low : array
        Low part of the position.
    v : array
        Velocity.
    motion : SlowMotion
        Slow part of the motion.
    time_remaining : array
        Remaining time. `CAPPED` for a lane that exceeds the limits; its low part is then 0.
    time_remaining_low : array
        Low part of the remaining time.
    contact : array
        Contact code times the sign of the wall: 0 free, 1 landed and leaving, 2 sticking, 3 inside a soft wall, 4 just
        entered it, 5 released, without a contact force.
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
        """Cosine of the drive angle."""
        return self.motion.cosine

    @property
    def sine(self) -> Float[jax.Array, "..."]:
        """Sine of the drive angle."""
        return self.motion.sine


def split_motion(coeffs, x, v, cosine, sine):
    """Return the `SlowMotion` of a position and a velocity."""
    slow_x, slow_v = -(coeffs.swift_amplitude * cosine), coeffs.swift_amplitude * coeffs.frequency * sine
    return SlowMotion(*two_sum(x, slow_x), *two_sum(v, slow_v), cosine, sine)


def motion_state(coeffs, motion):
    """Return (x, its low part, v) of a motion."""
    slow_x, slow_x_low, slow_v, slow_v_low, cosine, sine = motion
    x, x_low = two_sum(slow_x, coeffs.swift_amplitude * cosine)
    return x, x_low + slow_x_low, slow_v + (slow_v_low - coeffs.swift_amplitude * coeffs.frequency * sine)


def add_increments(motion, dx, dv):
    """Return (slow_x, slow_x_low, slow_v, slow_v_low) of a motion after increments of x and v."""
    return *two_sum(motion.slow_x, dx + motion.slow_x_low), *two_sum(motion.slow_v, dv + motion.slow_v_low)


def rotate_drive(frequency, cosine, sine, time):
    """Return the phasor of the drive after a time."""
    angle = frequency * time
    return flow.rotate(cosine, sine, flow.cos_less_1(angle), flow.sin_by_series(angle))


def subtract_time(path, time):
    """Return the remaining time and its low part after a time."""
    time_remaining, low_part = two_sum(path.time_remaining, -time)
    return two_sum(time_remaining, low_part + path.time_remaining_low)


def absolute_state(coeffs, path):
    """Compute the absolute state of lanes, including those inside a soft wall.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    path : Path
        Path of the lanes.

    Returns
    -------
    x : array
        Position.
    v : array
        Velocity.
    """
    x, v = path.x, path.v
    for wall, soft_flow in zip(coeffs.walls, coeffs.soft_flows, strict=True):
        if soft_flow is not None:
            wall_position, wall_velocity = wall_jet(wall, coeffs.frequency, path.cosine, path.sine, 1)
            is_inside_wall = soft_contact.is_inside(path.contact) & (path.contact * wall.sign > 0)
            x = choose(is_inside_wall, wall_position + path.x, x)
            v = v if wall_velocity is None else choose(is_inside_wall, wall_velocity + path.v, v)
    return x, v

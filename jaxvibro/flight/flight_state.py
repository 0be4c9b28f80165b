"""Represent the state of a lane along its path, and the part of the motion that the flow advances.

The in-phase part of the motion, B cos(theta), follows the angle theta of the drive. The slow part, x - B cos(theta), is
subject to the force -2 B Re((1 + gamma omega + i gamma omega) exp(i theta)) instead of A cos(theta). This force
decreases as the drive frequency grows, so that the rounding error of a step is small relative to the motion. Any
amplitude B is admissible. The choice B = -A / (1 + omega^2 + 2 gamma omega) has no singularity for gamma > -1. For
gamma >= 0 the magnitude of B never exceeds the amplitude of the forced response.
"""

from typing import NamedTuple

import jax
from jaxtyping import Float

from ..compiled.lane_arithmetic import choose, two_sum
from . import flow, motion_in_soft_wall
from .wall_motion import wall_jet

CAPPED = -1.0  # remaining time of a lane that exceeds the limits of `integration_loop.LoopLimits`


class SlowMotion(NamedTuple):
    """Slow part of the motion, which the flow advances, and the phasor of the drive.

    Attributes
    ----------
    slow_x : array
        Position less the in-phase part.
    slow_x_low_part : array
        Low part of `slow_x`.
    slow_v : array
        Velocity less the in-phase part.
    slow_v_low_part : array
        Low part of `slow_v`.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.
    """

    slow_x: Float[jax.Array, "*lanes"]
    slow_x_low_part: Float[jax.Array, "*lanes"]
    slow_v: Float[jax.Array, "*lanes"]
    slow_v_low_part: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]


class Path(NamedTuple):
    """State of a lane along its path.

    Inside a soft wall x and v are relative to the wall.

    Attributes
    ----------
    x : array
        Position.
    x_low_part : array
        Low part of the position.
    v : array
        Velocity.
    motion : SlowMotion
        Slow part of the motion.
    time_remaining : array
        Remaining time. `CAPPED` for a lane that exceeds the limits; its low part is then 0.
    time_remaining_low_part : array
        Low part of the remaining time.
    contact : array
        Contact code times the sign of the wall: 0 free, 1 on the wall and moving away, 2 sticking, 3 inside a soft
        wall, 4 just entered a soft wall, 5 released without a contact force.
    """

    x: Float[jax.Array, "*lanes"]
    x_low_part: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    motion: SlowMotion
    time_remaining: Float[jax.Array, "*lanes"]
    time_remaining_low_part: Float[jax.Array, "*lanes"]
    contact: Float[jax.Array, "*lanes"]

    @property
    def cosine(self) -> Float[jax.Array, "..."]:
        """Cosine of the drive angle."""
        return self.motion.cosine

    @property
    def sine(self) -> Float[jax.Array, "..."]:
        """Sine of the drive angle."""
        return self.motion.sine


def make_slow_motion(coeffs, x, v, cosine, sine):
    """Return the `SlowMotion` of a position and a velocity."""
    slow_x, slow_v = -(coeffs.in_phase_amplitude * cosine), coeffs.in_phase_amplitude * coeffs.frequency * sine
    return SlowMotion(*two_sum(x, slow_x), *two_sum(v, slow_v), cosine, sine)


def state_of_slow_motion(coeffs, slow_motion):
    """Return (x, its low part, v) of a motion."""
    slow_x, slow_x_low_part, slow_v, slow_v_low_part, cosine, sine = slow_motion
    x, x_low_part = two_sum(slow_x, coeffs.in_phase_amplitude * cosine)
    return (
        x,
        x_low_part + slow_x_low_part,
        slow_v + (slow_v_low_part - coeffs.in_phase_amplitude * coeffs.frequency * sine),
    )


def add_to_slow_motion(slow_motion, dx, dv):
    """Return the first four fields of a `SlowMotion` after increments of x and v."""
    return *two_sum(slow_motion.slow_x, dx + slow_motion.slow_x_low_part), *two_sum(
        slow_motion.slow_v, dv + slow_motion.slow_v_low_part
    )


def rotate_drive_phasor(frequency, cosine, sine, time):
    """Return the phasor of the drive after a time of at most one longest step."""
    angle = frequency * time
    return flow.rotate_phasor(cosine, sine, flow.cos_less_1(angle), flow.sin_by_series(angle))


def reduce_time_remaining(path, time):
    """Return the remaining time of a path and its low part, reduced by a time."""
    time_remaining, subtraction_error = two_sum(path.time_remaining, -time)
    return two_sum(time_remaining, subtraction_error + path.time_remaining_low_part)


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
    for wall, _ in motion_in_soft_wall.soft_walls(coeffs):
        wall_position, wall_velocity = wall_jet(wall, coeffs.frequency, path.cosine, path.sine, 1)
        is_inside_wall = motion_in_soft_wall.is_inside_soft_wall(path.contact) & (path.contact * wall.sign > 0)
        x = choose(is_inside_wall, wall_position + path.x, x)
        v = v if wall_velocity is None else choose(is_inside_wall, wall_velocity + path.v, v)
    return x, v

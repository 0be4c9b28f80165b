"""Advance lanes in a fast step: the flight, the remaining time to an event, and the impact.

Times are in units of the longest step. The phasor of the drive is the cosine and sine of its angle.
"""

from ..compiled.lane_arithmetic import choose
from . import flow
from .wall_motion import select_by_side, select_lists_by_side, subtract_optional, wall_jet


def drive_forces(coeffs, cosine, sine):
    """Return the amplitude of the drive times the cosine and times the sine of its angle."""
    return coeffs.amplitude * cosine, coeffs.amplitude * sine


def propagate_free_flight(coeffs, x, v, drive_forces, propagator):
    """Return (x, v) after a flight, from the whole motion without a split into slow and in-phase parts."""
    force_cos, force_sin = drive_forces
    p00_minus_1, p01, cos_response, sin_response = propagator[:4]
    dx = p00_minus_1 * x + (p01 * v + (force_cos * cos_response - force_sin * sin_response))
    forced_velocity = force_cos * (p01 - coeffs.frequency * sin_response) - force_sin * (
        coeffs.frequency * cos_response
    )
    dv = (p00_minus_1 - coeffs.drag * p01) * v + (forced_velocity - p01 * (coeffs.stiffness * x))
    return x + dx, v + dv


def event_delay(coeffs, x, v, phasor, side):
    """Return the time from the end of a step to its event by one Halley step (see `impact.event_delay`)."""
    wall_derivs = [wall_jet(wall, coeffs.frequency, *phasor, 2) for wall in coeffs.walls]
    wall_position, wall_velocity, wall_acceleration = select_lists_by_side(side, coeffs.walls, wall_derivs)
    inverse_velocity = 1.0 / subtract_optional(v, wall_velocity)
    delay_to_event = (wall_position - x) * inverse_velocity
    delay_to_event = delay_to_event * (
        1.0
        - 0.5
        * subtract_optional(evaluate_acceleration(coeffs, x, v, phasor), wall_acceleration)
        * delay_to_event
        * inverse_velocity
    )
    return choose(side != 0, delay_to_event, 0.0)


def evaluate_acceleration(coeffs, x, v, phasor):
    """Return the acceleration."""
    return coeffs.amplitude * phasor[0] - coeffs.stiffness * x - coeffs.drag * v


def evaluate_jerk(coeffs, v, acceleration, sine):
    """Return the jerk, the time derivative of the acceleration."""
    return -(coeffs.frequency * coeffs.amplitude) * sine - coeffs.stiffness * v - coeffs.drag * acceleration


def impact_velocity(coeffs, x, v, phasor, delay):
    """Return the velocity before impact at an event that follows the end of a step after a delay."""
    flight_end_accel = evaluate_acceleration(coeffs, x, v, phasor)
    return v + delay * (flight_end_accel + 0.5 * delay * evaluate_jerk(coeffs, v, flight_end_accel, phasor[1]))


def rotate_drive_phasor(coeffs, phasor, delay):
    """Return the phasor of the drive after a delay."""
    return flow.rotate_phasor_by_small_angle(*phasor, coeffs.frequency * delay)


def wall_state(coeffs, cosine, sine, side):
    """Return position and velocity of the wall on a side."""
    return select_lists_by_side(
        side, coeffs.walls, [wall_jet(wall, coeffs.frequency, cosine, sine, 1) for wall in coeffs.walls]
    )


def restitution_of(coeffs, side):
    """Return the restitution of the wall on a side."""
    return select_by_side(side, coeffs.walls, [wall.restitution for wall in coeffs.walls])


def apply_rebound(coeffs, x, v, phasor, side, impact_velocity):
    """Return (x, v) after the impact at the end of a step, or unchanged without an impact."""
    wall_position, wall_velocity = wall_state(coeffs, *phasor, side)
    is_hit, restitution = side != 0, restitution_of(coeffs, side)
    new_velocity = (
        -restitution * impact_velocity
        if wall_velocity is None
        else wall_velocity - restitution * (impact_velocity - wall_velocity)
    )
    return choose(is_hit, wall_position, x), choose(is_hit, new_velocity, v)

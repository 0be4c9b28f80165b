"""Compute a contact phase within a linear soft wall, for the equations of the impacts.

The equations are evaluated often, for few lanes. The final state equals the result of `contact_duration`, but is
computed by `soft_wall_polynomial`. The arrays of `soft_wall_polynomial` need fewer operations; they do not suit the
kernels of a replay on many lanes. The derivative with respect to the initial state follows from the matrix of the free
flow alone. The velocity obeys the same linear equation as the displacement, with the time derivative of the force. Let
a be the acceleration, and let entry and exit be delayed by the same time. The derivative of the state at the exit with
respect to this delay is then (v, a) at the exit minus the product of the flow matrix and (v, a) at the entry.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from continuation.array_type import Array

from ..compiled.lane_arithmetic import choose
from ..flight import flow, motion_in_soft_wall, soft_wall_polynomial
from ..flight.soft_wall_exit import first_exit_time
from ..scene.state import Contact
from .contact_duration import MEMORY_STEPS, NEWTON_STEPS

MAX_PERIODS = 8.0  # largest duration of a contact phase in drive periods
NEWTON_TOLERANCE = 2.0**-30  # relative size of a Newton step after which the next is accurate to rounding


class ContactPhase(NamedTuple):
    """Contact phase within a soft wall and its derivatives.

    Attributes
    ----------
    time : Array
        Duration of the contact phase.
    v : Array
        Velocity relative to the wall at the exit.
    cosine, sine : Array
        Cosine and sine of the drive's phase at the exit.
    entry_acceleration : Array
        Acceleration relative to the wall at the entry.
    free_flow : tuple of Array
        (p00, p01, p11) of the free flow's matrix ((p00, p01), (-stiffness p01, p11)) over the contact phase.
    time_by_time, time_by_velocity : Array
        Derivatives of the exit time with respect to the time and the velocity of the entry.
    """

    time: Float[Array, "*lanes"]
    v: Float[Array, "*lanes"]
    cosine: Float[Array, "*lanes"]
    sine: Float[Array, "*lanes"]
    entry_acceleration: Float[Array, "*lanes"]
    free_flow: tuple[Float[Array, "*lanes"], Float[Array, "*lanes"], Float[Array, "*lanes"]]
    time_by_time: Float[Array, "*lanes"]
    time_by_velocity: Float[Array, "*lanes"]


def solve_contact_phase(coeffs, side, cosine, sine, speed, approx_duration):
    """Return the `ContactPhase` of lanes that enter a soft wall at a speed; values are arbitrary for side 0 (no wall).

    The result is a smooth function of the scene, the phase and the speed, also where the speed is zero. The duration
    has the sign of the speed. First and second derivatives are exact. `approx_duration` is the duration from
    `guess_contact_time`.
    """
    entered_wall_code = side * Contact.ENTERED
    contact_coeffs = motion_in_soft_wall.coeffs_by_lane(coeffs, entered_wall_code)
    polynomial_basis, entry_velocity, max_series_step = (
        soft_wall_polynomial.polynomial_basis(contact_coeffs, entered_wall_code),
        side * speed,
        lax.stop_gradient(contact_coeffs.max_step),
    )
    motion_polynomial = soft_wall_polynomial.displacement_polynomial(
        contact_coeffs,
        entered_wall_code,
        polynomial_basis,
        lax.full_like(entry_velocity, 0.0),
        entry_velocity,
        cosine,
        sine,
    )
    entry_acceleration = 2.0 * motion_polynomial[2] / (max_series_step * max_series_step)
    is_short = abs(approx_duration) <= max_series_step
    short_phase = _short_contact_phase(
        contact_coeffs,
        polynomial_basis,
        motion_polynomial,
        entry_velocity,
        entry_acceleration,
        choose(is_short, approx_duration, 0.0),
    )
    entry_velocity = choose(is_short, side + 0.0 * entry_velocity, entry_velocity)
    long_phase = _long_contact_phase(
        contact_coeffs,
        entered_wall_code,
        polynomial_basis,
        entry_velocity,
        entry_acceleration,
        cosine,
        sine,
        choose(is_short, 0.1 * max_series_step, approx_duration),
    )
    contact_time, exit_velocity, p00, p01, p11, exit_time_by_entry_time, exit_time_by_velocity = (
        choose(is_short, *short_and_long) for short_and_long in zip(short_phase, long_phase, strict=True)
    )
    exit_phasor = flow.rotate_phasor_by_angle(cosine, sine, coeffs.frequency * contact_time)
    return ContactPhase(
        contact_time,
        exit_velocity,
        *exit_phasor,
        entry_acceleration,
        (p00, p01, p11),
        exit_time_by_entry_time,
        exit_time_by_velocity,
    )


def guess_contact_time(coeffs, side, cosine, sine, speed, min_contact_time=None):
    """Return the duration of a contact phase until the first exit.

    If the speed is not positive, the duration is estimated from a parabola. The result has no derivatives. The result
    is nan if the mass remains within the wall for `MAX_PERIODS`. Exits before the time `min_contact_time` do not count;
    the mass must be within the wall at this time. None means 0.
    """
    coeffs, side, cosine, sine, speed = lax.stop_gradient((coeffs, side, cosine, sine, speed))
    entered_wall_code, entry_velocity = side * Contact.ENTERED, side * speed
    contact_coeffs = motion_in_soft_wall.coeffs_by_lane(coeffs, entered_wall_code)
    extra_force_derivs = motion_in_soft_wall.frame_force_derivs(coeffs, entered_wall_code, cosine, sine, 1)
    entry_acceleration, _ = contact_coeffs.flow.acceleration_and_jerk(
        contact_coeffs, 0.0 * entry_velocity, entry_velocity, cosine, sine, extra_force_derivs
    )
    is_entering = entered_wall_code * entry_velocity > 0
    max_time = MAX_PERIODS * coeffs.period + 0.0 * entry_velocity
    code_if_entering = choose(is_entering, entered_wall_code, 0.0)
    if min_contact_time is None:
        exit_time = first_exit_time(coeffs, code_if_entering, entry_velocity, cosine, sine, max_time)
    else:
        min_time = choose(is_entering, min_contact_time, 0.0)
        response_to_min_time = motion_in_soft_wall.contact_response(contact_coeffs, entered_wall_code, min_time)
        relative_displacement, velocity = motion_in_soft_wall.apply_response(
            contact_coeffs,
            entered_wall_code,
            response_to_min_time,
            (0.0 * entry_velocity, entry_velocity),
            cosine,
            sine,
        )
        phasor = flow.rotate_phasor_by_angle(cosine, sine, coeffs.frequency * min_time)
        exit_time = min_time + first_exit_time(
            coeffs, code_if_entering, velocity, *phasor, max_time, relative_displacement
        )
    parabola_time = -2.0 * entry_velocity / choose(entry_acceleration == 0, 1.0, entry_acceleration)
    parabola_time = lax.clamp(-contact_coeffs.max_step, parabola_time, contact_coeffs.max_step)
    return choose(is_entering, choose(exit_time < max_time, exit_time, jnp.nan), parabola_time)


def _short_contact_phase(
    contact_coeffs, polynomial_basis, motion_polynomial, entry_velocity, entry_acceleration, approx_duration
):
    """Return (time, velocity, p00, p01, p11, time_by_time, time_by_velocity) of a contact phase within one step.

    The displacement has a root at time 0, which is divided out of the polynomial. The quotients in the derivatives are
    reduced by the same factor. At the exit the displacement p01 v + f is zero, where v is the entry velocity and f is
    the displacement for zero entry velocity; therefore v = -f / p01.
    """
    max_series_step, quotient_polynomial = lax.stop_gradient((contact_coeffs.max_step, motion_polynomial[1:]))

    def is_unconverged(carry):
        time_fraction, fraction_change, n_iterations = carry
        return (n_iterations < NEWTON_STEPS) & jnp.any(abs(fraction_change) > NEWTON_TOLERANCE * abs(time_fraction))

    def newton_iteration(carry):
        time_fraction, _, n_iterations = carry
        next_fraction = _newton_step(quotient_polynomial, time_fraction)
        return next_fraction, next_fraction - time_fraction, n_iterations + 1

    time_fraction, *_ = lax.while_loop(
        is_unconverged,
        newton_iteration,
        (approx_duration / max_series_step, lax.full_like(approx_duration, jnp.inf), 0),
    )
    time_fraction = _newton_step(
        motion_polynomial[1:], _newton_step(motion_polynomial[1:], time_fraction)
    )  # two steps from the root: exact to the third derivative
    powers = soft_wall_polynomial.scaled_time_powers(time_fraction)
    _, position_series, velocity_series, *_ = polynomial_basis
    p00, p01_per_fraction = (
        1.0 + soft_wall_polynomial.evaluate_polynomial(position_series, powers),
        soft_wall_polynomial.evaluate_polynomial(velocity_series[1:], powers),
    )
    forced_quotient = soft_wall_polynomial.evaluate_polynomial(
        (motion_polynomial - entry_velocity * velocity_series)[2:], powers
    )
    velocity_per_fraction = (
        soft_wall_polynomial.evaluate_polynomial(
            soft_wall_polynomial.differentiate_polynomial(motion_polynomial[1:]), powers
        )
        / max_series_step
    )
    exit_time_by_entry_time, exit_time_by_velocity = (
        (p01_per_fraction * entry_acceleration - p00 * forced_quotient / p01_per_fraction) / velocity_per_fraction,
        -p01_per_fraction / velocity_per_fraction,
    )
    p01 = time_fraction * p01_per_fraction
    return (
        time_fraction * max_series_step,
        time_fraction * velocity_per_fraction,
        p00,
        p01,
        p00 - 2.0 * contact_coeffs.damping * p01,
        exit_time_by_entry_time,
        exit_time_by_velocity,
    )


def _newton_step(polynomial, time_fraction):
    """Improve a root of the polynomial with these coefficients by one Newton step."""
    powers = soft_wall_polynomial.scaled_time_powers(time_fraction)
    value, slope = (
        soft_wall_polynomial.evaluate_polynomial(coefficients, powers)
        for coefficients in (polynomial, soft_wall_polynomial.differentiate_polynomial(polynomial))
    )
    return time_fraction - value / slope


def _long_contact_phase(
    contact_coeffs,
    entered_wall_code,
    polynomial_basis,
    entry_velocity,
    entry_acceleration,
    cosine,
    sine,
    approx_duration,
):
    """Return the results of `_short_contact_phase` for a longer contact phase.

    `approx_duration` is accurate to rounding but has no derivatives. Two terms of the Taylor series of the time to the
    exit make first and second derivatives exact. For contact phases shorter than `MEMORY_STEPS` longest steps, the
    entry p01 of the flow matrix follows from zero displacement at the exit, as in
    `contact_duration.flow_matrix_in_contact`.
    """
    flow_response = soft_wall_polynomial.contact_response(
        contact_coeffs, entered_wall_code, polynomial_basis, approx_duration
    )
    (p00, p01, p11), zero = flow_response.free_flow, lax.full_like(entry_velocity, 0.0)
    forced_displacement, forced_velocity = motion_in_soft_wall.apply_response(
        contact_coeffs, entered_wall_code, flow_response, (zero, zero), cosine, sine
    )
    relative_displacement, velocity = forced_displacement + p01 * entry_velocity, forced_velocity + p11 * entry_velocity
    exit_phasor = flow.rotate_phasor_by_angle(cosine, sine, contact_coeffs.frequency * approx_duration)
    acceleration, jerk = contact_coeffs.flow.acceleration_and_jerk(
        contact_coeffs,
        relative_displacement,
        velocity,
        *exit_phasor,
        motion_in_soft_wall.frame_force_derivs(contact_coeffs, entered_wall_code, *exit_phasor, 1),
    )
    time_to_exit = -(relative_displacement / velocity) * (
        1.0 + 0.5 * acceleration * relative_displacement / (velocity * velocity)
    )
    drag, half_time_squared = 2.0 * contact_coeffs.damping, 0.5 * time_to_exit * time_to_exit
    p11_rate = -contact_coeffs.stiffness * p01 - drag * p11  # p11', which is p01''
    exit_velocity = velocity + acceleration * time_to_exit + jerk * half_time_squared
    forced_displacement = (
        forced_displacement
        + forced_velocity * time_to_exit
        + (acceleration - entry_velocity * p11_rate) * half_time_squared
    )
    p01_at_exit = p01 + p11 * time_to_exit + p11_rate * half_time_squared
    p00 = p00 - contact_coeffs.stiffness * (p01 * time_to_exit + p11 * half_time_squared)
    p11 = p11 + p11_rate * time_to_exit - (contact_coeffs.stiffness * p11 + drag * p11_rate) * half_time_squared
    p01 = choose(
        approx_duration < MEMORY_STEPS * contact_coeffs.max_step, -forced_displacement / entry_velocity, p01_at_exit
    )
    return (
        approx_duration + time_to_exit,
        exit_velocity,
        p00,
        p01,
        p11,
        (p00 * entry_velocity + p01 * entry_acceleration) / exit_velocity,
        -p01 / exit_velocity,
    )

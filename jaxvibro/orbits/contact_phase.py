"""Contact phase within a linear soft wall, for the equations of the impacts: repeated evaluations for few lanes.

The final state is that of `contact_duration`, computed by `soft_polynomial`. Its arrays need fewer operations but do
not fit the kernels of a replay, whose results are stages on many lanes. The derivative with respect to the initial
state follows from the matrix of the free flow alone. The velocity of a motion evolves as the motion does, but under the
rate of change of the force. So the effect of a later entry is the velocity at the end minus the free flow of velocity
and acceleration at the start.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from continuation.array_type import Array

from ..compiled.compiler_hints import choose
from ..flight import flow, soft_contact, soft_polynomial
from ..flight.flows import flow_of
from ..flight.soft_wall_exit import first_exit_time
from ..maps.contact_duration import MEMORY_STEPS, NEWTON_STEPS
from ..scene.codes import Contact

MAX_PERIODS = 8.0  # largest duration of a contact phase in drive periods
NEWTON_TOLERANCE = 2.0**-30  # relative size of a Newton step after which the next is accurate to rounding


class ContactPhase(NamedTuple):
    """Contact phase within a soft wall and its derivatives.

    `time` is its duration, `v` the velocity relative to the wall at its end, and `cosine`, `sine` those of the drive
    there. `entry_acceleration` is the acceleration relative to the wall at its start. `free_flow` is (p00, p01, p11) of
    the free flow's matrix ((p00, p01), (-stiffness p01, p11)) over this duration. `time_by_time` and `time_by_velocity`
    are the derivatives of the exit time with respect to the time and the velocity of the entry.
    """

    time: Float[Array, "*lanes"]
    v: Float[Array, "*lanes"]
    cosine: Float[Array, "*lanes"]
    sine: Float[Array, "*lanes"]
    entry_acceleration: Float[Array, "*lanes"]
    free_flow: tuple[Float[Array, "*lanes"], Float[Array, "*lanes"], Float[Array, "*lanes"]]
    time_by_time: Float[Array, "*lanes"]
    time_by_velocity: Float[Array, "*lanes"]


def solve_contact_phase(coeffs, side, cosine, sine, speed, approx_time):
    """Return the `ContactPhase` of lanes that enter a soft wall at a speed; values are arbitrary for side 0 (no wall).

    The result is smooth in all numbers, also where the speed passes through zero: the duration passes through zero with
    it and is negative beyond. First and second derivatives are exact. `approx_time` is the duration from
    `guess_contact_time`.
    """
    contact = side * Contact.ENTERED
    contact_coeffs = soft_contact.coeffs_by_lane(coeffs, contact)
    basis, v, max_step = (
        soft_polynomial.polynomial_basis(contact_coeffs, contact),
        side * speed,
        lax.stop_gradient(contact_coeffs.max_step),
    )
    polynomial = soft_polynomial.coefficients(contact_coeffs, contact, basis, lax.full_like(v, 0.0), v, cosine, sine)
    entry_acceleration = 2.0 * polynomial[2] / (max_step * max_step)
    is_short = abs(approx_time) <= max_step
    short_phase = _short_contact_phase(
        contact_coeffs, basis, polynomial, v, entry_acceleration, choose(is_short, approx_time, 0.0)
    )
    v = choose(is_short, side + 0.0 * v, v)
    long_phase = _long_contact_phase(
        contact_coeffs,
        contact,
        basis,
        v,
        entry_acceleration,
        cosine,
        sine,
        choose(is_short, 0.1 * max_step, approx_time),
    )
    contact_time, exit_velocity, p00, p01, p11, time_by_time, time_by_velocity = (
        choose(is_short, *short_and_long) for short_and_long in zip(short_phase, long_phase, strict=True)
    )
    exit_phasor = flow.rotate_by_angle(cosine, sine, coeffs.frequency * contact_time)
    return ContactPhase(
        contact_time, exit_velocity, *exit_phasor, entry_acceleration, (p00, p01, p11), time_by_time, time_by_velocity
    )


def guess_contact_time(coeffs, side, cosine, sine, speed, min_contact_time=None):
    """Return the duration of a contact phase: the first return, or a parabola's guess for zero speed into the wall.

    The result has no derivatives. It is nan if the mass does not leave within `MAX_PERIODS`. `min_contact_time` is a
    time at which the mass is within the wall, for any earlier motion; None means 0.
    """
    coeffs, side, cosine, sine, speed = lax.stop_gradient((coeffs, side, cosine, sine, speed))
    contact, v = side * Contact.ENTERED, side * speed
    contact_coeffs = soft_contact.coeffs_by_lane(coeffs, contact)
    bias = soft_contact.extra_force_derivs(coeffs, contact, cosine, sine, 1)
    entry_acceleration, _ = flow_of(contact_coeffs).acceleration_and_jerk(
        contact_coeffs, 0.0 * v, v, cosine, sine, bias
    )
    is_entering = contact * v > 0
    max_time = MAX_PERIODS * coeffs.period + 0.0 * v
    entry_contact = choose(is_entering, contact, 0.0)
    if min_contact_time is None:
        return_time = first_exit_time(coeffs, entry_contact, v, cosine, sine, max_time)
    else:
        min_time = choose(is_entering, min_contact_time, 0.0)
        flow_response = soft_contact.contact_response(contact_coeffs, contact, min_time)
        y, velocity = soft_contact.apply_response(contact_coeffs, contact, flow_response, (0.0 * v, v), cosine, sine)
        phasor = flow.rotate_by_angle(cosine, sine, coeffs.frequency * min_time)
        return_time = min_time + first_exit_time(coeffs, entry_contact, velocity, *phasor, max_time, y)
    parabola_time = -2.0 * v / choose(entry_acceleration == 0, 1.0, entry_acceleration)
    parabola_time = lax.clamp(-contact_coeffs.max_step, parabola_time, contact_coeffs.max_step)
    return choose(is_entering, choose(return_time < max_time, return_time, jnp.nan), parabola_time)


def _short_contact_phase(contact_coeffs, basis, polynomial, v, entry_acceleration, approx_time):
    """Return (time, velocity, p00, p01, p11, time_by_time, time_by_velocity) of a contact phase within one step.

    The root at 0 is divided out, also from the quotients by the velocity at the end: there y = v p01 + rest is zero, so
    v is -rest / p01.
    """
    max_step, constant_polynomial = lax.stop_gradient((contact_coeffs.max_step, polynomial[1:]))

    def is_unconverged(carry):
        step_fraction, step, count = carry
        return (count < NEWTON_STEPS) & jnp.any(abs(step) > NEWTON_TOLERANCE * abs(step_fraction))

    def newton_iteration(carry):
        step_fraction, _, count = carry
        next_fraction = _newton_step(constant_polynomial, step_fraction)
        return next_fraction, next_fraction - step_fraction, count + 1

    step_fraction, *_ = lax.while_loop(
        is_unconverged, newton_iteration, (approx_time / max_step, lax.full_like(approx_time, jnp.inf), 0)
    )
    step_fraction = _newton_step(
        polynomial[1:], _newton_step(polynomial[1:], step_fraction)
    )  # two steps from the root: exact to the third derivative
    powers = soft_polynomial.powers(step_fraction)
    _, position_terms, velocity_terms, *_ = basis
    p00, p01_per_fraction = (
        1.0 + soft_polynomial.evaluate(position_terms, powers),
        soft_polynomial.evaluate(velocity_terms[1:], powers),
    )
    forced_terms = soft_polynomial.evaluate((polynomial - v * velocity_terms)[2:], powers)
    exit_slope = soft_polynomial.evaluate(soft_polynomial.differentiate(polynomial[1:]), powers) / max_step
    time_by_time, time_by_velocity = (
        (p01_per_fraction * entry_acceleration - p00 * forced_terms / p01_per_fraction) / exit_slope,
        -p01_per_fraction / exit_slope,
    )
    p01 = step_fraction * p01_per_fraction
    return (
        step_fraction * max_step,
        step_fraction * exit_slope,
        p00,
        p01,
        p00 - 2.0 * contact_coeffs.damping * p01,
        time_by_time,
        time_by_velocity,
    )


def _newton_step(polynomial, step_fraction):
    """Improve a root of the polynomial with these coefficients by one Newton step."""
    powers = soft_polynomial.powers(step_fraction)
    value, slope = (
        soft_polynomial.evaluate(coefficients, powers)
        for coefficients in (polynomial, soft_polynomial.differentiate(polynomial))
    )
    return step_fraction - value / slope


def _long_contact_phase(contact_coeffs, contact, basis, entry_velocity, entry_acceleration, cosine, sine, approx_time):
    """Return the results of `_short_contact_phase` for a longer contact phase from a time that is accurate to rounding.

    The two first terms of the Taylor series in the remaining delay make second derivatives exact. Where p01 is small it
    follows from y = 0 at the end, as in `contact_duration.wall_to_wall_flow`.
    """
    flow_response = soft_polynomial.contact_response(contact_coeffs, contact, basis, approx_time)
    (p00, p01, p11), zero = flow_response.free_flow, lax.full_like(entry_velocity, 0.0)
    forced_y, forced_velocity = soft_contact.apply_response(
        contact_coeffs, contact, flow_response, (zero, zero), cosine, sine
    )
    y, velocity = forced_y + p01 * entry_velocity, forced_velocity + p11 * entry_velocity
    exit_phasor = flow.rotate_by_angle(cosine, sine, contact_coeffs.frequency * approx_time)
    acceleration, jerk = flow_of(contact_coeffs).acceleration_and_jerk(
        contact_coeffs,
        y,
        velocity,
        *exit_phasor,
        soft_contact.extra_force_derivs(contact_coeffs, contact, *exit_phasor, 1),
    )
    delay = -(y / velocity) * (1.0 + 0.5 * acceleration * y / (velocity * velocity))
    drag, half_square = 2.0 * contact_coeffs.damping, 0.5 * delay * delay
    p11_rate = -contact_coeffs.stiffness * p01 - drag * p11  # p11', which is p01''
    exit_velocity = velocity + acceleration * delay + jerk * half_square
    forced_y = forced_y + forced_velocity * delay + (acceleration - entry_velocity * p11_rate) * half_square
    p01_at_exit = p01 + p11 * delay + p11_rate * half_square
    p00 = p00 - contact_coeffs.stiffness * (p01 * delay + p11 * half_square)
    p11 = p11 + p11_rate * delay - (contact_coeffs.stiffness * p11 + drag * p11_rate) * half_square
    p01 = choose(approx_time < MEMORY_STEPS * contact_coeffs.max_step, -forced_y / entry_velocity, p01_at_exit)
    return (
        approx_time + delay,
        exit_velocity,
        p00,
        p01,
        p11,
        (p00 * entry_velocity + p01 * entry_acceleration) / exit_velocity,
        -p01 / exit_velocity,
    )

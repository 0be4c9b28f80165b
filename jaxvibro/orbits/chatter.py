"""Compute the bounces (hops) of a mass that sticks to a wall after complete chatter, or that nearly sticks.

The time tau is counted from the release, at which the contact force P becomes zero and the wall releases a sticking
mass. Before the release tau is negative. A bounce begins with the speed w away from the wall. At the time s after the
beginning its height is w s - P s^2 / 2 + ... The next bounce begins with R times the landing speed. The mass sticks if
infinitely many bounces end before tau = 0. This is practically certain if the total time of the bounces is short
compared with the time remaining. The total time is then 2 w / ((1 - R) P) (1 - 2/3 w (P' + gamma P) / (P^2 (1 - R))),
where P' is the time derivative of P and gamma is the damping. Further terms are at most about 1e-12 of
the time remaining.

The mass sticks if the speed w is at most a critical speed. Near the release P = -c tau with a constant c. There the
critical speed is (3/8) (1 - q^2) c tau^2, where q in (1/3, 1) is the root of (1 + q)(3 q - 1)^2 = 8 R q. A bounce at
this speed multiplies the time remaining by lam = (3 q - 1) / 2 and the speed by lam^2. The bounce multiplies a small
relative excess over the critical speed by mu = (1 + q)^2 / (2 q^2 (3 q - 1)) > 1 (Nordmark and Piiroinen, Phil. Trans.
R. Soc. A 367, 2009). The critical speed is therefore a smooth function of tau and of the scene: the stable manifold of
the map from bounce to bounce. The critical speed is computed by bisection, with a simulation of the bounces at each
speed. Heights are relative to the wall and therefore keep full relative accuracy, even if they are very small.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from continuation.array_type import Array

from ..contact.wall_at_contact import contact_force_derivatives, wall_derivatives
from ..flight import flow
from ..flight.motion_in_soft_wall import restitution_of

HOP_ORDER = 12  # order of the polynomial of a bounce
MAX_HOP_TIME = 0.4  # of `FlowCoefficients.max_step`: longer bounces do not belong to a series
COMPARISON_TIME = 0.3  # of `max_step`, before the release: time at which speeds are compared with the critical one
NEWTON_STEPS = 6  # from the root of a cubic to the landing
SERIES_TOLERANCE = 1e-4  # of the time remaining and of `max_step`: total time of bounces that the series completes
MAX_HOPS = 100_000
N_BISECTIONS = 62  # bisections of the bracket of the critical speed


class Hop(NamedTuple):
    """Bounce on a wall.

    Attributes
    ----------
    time : Array
        Flight time s of the whole bounce; arbitrary if the mass does not land.
    landing_speed : Array
        Speed relative to the wall at the landing; inf if the mass does not land.
    contact_force, force_rate : Array
        Contact force on the wall and its time derivative at the start of the bounce.
    height_jerk : Array
        Third time derivative of the height y at the start.
    terms : tuple of Array
        Taylor coefficients of y / s, where s is the time since the start.
    """

    time: Float[Array, ""]
    landing_speed: Float[Array, ""]
    contact_force: Float[Array, ""]
    force_rate: Float[Array, ""]
    height_jerk: Float[Array, ""]
    terms: tuple[Float[Array, ""], ...]


class ChatterEnd(NamedTuple):
    """End of a sequence of bounces.

    Attributes
    ----------
    sticking_time : Array
        Duration of sticking before the release; negative if the mass does not stick.
    first_hop_time : Array
        Flight time of the first bounce; `FlowCoefficients.max_step` if it is longer.
    height, velocity : Array
        State relative to the wall, away from it, at the requested times, of shape (times,); 0 outside the bounces.
    """

    sticking_time: Float[Array, ""]
    first_hop_time: Float[Array, ""]
    height: Float[Array, " times"]
    velocity: Float[Array, " times"]


def evaluate_hop(coeffs, side, phasor, speed):
    """Return the `Hop` of a mass that leaves a wall with a speed, or lifts off with zero speed.

    `phasor` is (cosine, sine) of the drive's phase at the start of the bounce.
    """
    wall_position, wall_velocity, *wall_derivs = wall_derivatives(coeffs, side, *phasor, HOP_ORDER)
    motion_jet = coeffs.flow.jet(coeffs, wall_position, wall_velocity - side * speed, *phasor, HOP_ORDER)
    height_derivs = [
        side * (wall_deriv - mass_deriv) for wall_deriv, mass_deriv in zip(wall_derivs, motion_jet[2:], strict=False)
    ]
    contact_force, force_rate = (side * derivative for derivative in contact_force_derivatives(coeffs, side, phasor))
    height_terms = (
        speed,
        *(height_deriv / math.factorial(order) for order, height_deriv in enumerate(height_derivs, 2)),
    )  # Taylor coefficients of y / s
    discriminant = height_terms[1] * height_terms[1] - 4.0 * height_terms[2] * speed
    lifts_off = (speed == 0) & (contact_force < 0)
    lands = jnp.where(lifts_off, height_terms[2] < 0, (discriminant > 0) & (height_terms[1] < 0))
    denominator = jnp.sqrt(jnp.where(lands, discriminant, 1.0)) - jnp.where(lands, height_terms[1], -1.0)
    lifted_flight_time = -height_terms[1] / jnp.where(lifts_off & lands, height_terms[2], 1.0)
    flight_time = jnp.where(lands, jnp.where(lifts_off, lifted_flight_time, 2.0 * speed / denominator), 0.0)
    for _ in range(NEWTON_STEPS):
        height_per_time, height_per_time_slope = _value_and_slope(height_terms, flight_time)
        flight_time = flight_time - jnp.where(
            lands, height_per_time / jnp.where(height_per_time_slope == 0, 1.0, height_per_time_slope), 0.0
        )
    _, height_per_time_slope = _value_and_slope(height_terms, flight_time)
    is_valid = lands & (flight_time >= 0) & (height_per_time_slope <= 0) & (flight_time <= coeffs.max_step)
    landing_speed = jnp.where(
        is_valid, -flight_time * height_per_time_slope, jnp.inf
    )  # y' = (y / s) + s (y / s)', and y is 0
    stays_on_wall = (speed == 0) & ~lifts_off
    return Hop(
        jnp.where(stays_on_wall, 0.0, flight_time),
        jnp.where(stays_on_wall, 0.0, landing_speed),
        contact_force,
        force_rate,
        height_derivs[1],
        height_terms,
    )


def _value_and_slope(height_terms, time):
    """Return (value, derivative) of the polynomial with these coefficients at a time."""
    value, slope = height_terms[-1], jnp.zeros_like(height_terms[-1])
    for coefficient in height_terms[-2::-1]:
        value, slope = value * time + coefficient, slope * time + value
    return value, slope


def compute_chatter_end(coeffs, side, release_phasor, tau, speed, elapsed_times):
    """Return the `ChatterEnd` of bounces that begin at tau with a speed, both scalars.

    `release_phasor` is (cosine, sine) of the drive's phase at the release. `elapsed_times`, of shape (times,), are the
    times since tau at which the height is evaluated.
    """
    restitution = restitution_of(coeffs, side) + 0.0 * speed
    zero = 0.0 * (tau + speed)

    def is_unfinished(carry):
        return (carry[-1] == 0) & (carry[3] < MAX_HOPS)

    def next_hop(carry):
        hop_tau, speed, sticking_duration, n_hops, first_hop_time, height, velocity, _ = carry
        phasor = flow.rotate_phasor_by_angle(*release_phasor, coeffs.frequency * hop_tau)
        hop = evaluate_hop(coeffs, side, phasor, speed)
        total_hop_time, is_series_accurate = _total_hop_time(coeffs, restitution, speed, hop)
        is_pressed_on_wall = (hop.contact_force > 0) | ((speed == 0) & (hop_tau + hop.time == hop_tau))
        sticks = (
            is_series_accurate & (total_hop_time <= SERIES_TOLERANCE * -hop_tau) & (hop_tau < 0) & is_pressed_on_wall
        )
        lands = (is_pressed_on_wall | (speed == 0)) & jnp.isfinite(hop.landing_speed) & (hop_tau + hop.time < 0)
        time_in_hop = elapsed_times - (hop_tau - tau)
        is_time_in_hop = (time_in_hop >= 0) & (time_in_hop < jnp.where(sticks, 0.0, hop.time)) & (lands | sticks)
        height_per_time, height_per_time_slope = _value_and_slope(
            hop.terms, jnp.where(is_time_in_hop, time_in_hop, 0.0)
        )
        height, velocity = (
            jnp.where(is_time_in_hop, time_in_hop * height_per_time, height),
            jnp.where(is_time_in_hop, height_per_time + time_in_hop * height_per_time_slope, velocity),
        )
        next_tau = hop_tau + jnp.where(lands, hop.time, 0.0)
        sticking_duration = jnp.where(
            sticks, -(hop_tau + total_hop_time), -jnp.maximum(next_tau, 0.0) - hop.time - (speed > 0)
        )
        return (
            jnp.where(sticks, hop_tau, next_tau),
            jnp.where(lands, restitution * hop.landing_speed, speed),
            sticking_duration,
            n_hops + 1.0,
            jnp.where(
                n_hops == 0,
                jnp.where(sticks | jnp.isfinite(hop.landing_speed), hop.time, coeffs.max_step),
                first_hop_time,
            ),
            height,
            velocity,
            (sticks | ~lands).astype(jnp.int32),
        )

    zeros = jnp.zeros_like(elapsed_times) + zero
    initial_carry = tau + zero, speed + zero, zero, zero, zero, zeros, zeros, jnp.int32(0)
    _, _, sticking_duration, _, first_hop_time, height, velocity, is_outcome_decided = lax.while_loop(
        is_unfinished, next_hop, initial_carry
    )
    return ChatterEnd(jnp.where(is_outcome_decided == 1, sticking_duration, -1.0), first_hop_time, height, velocity)


def _total_hop_time(coeffs, restitution, speed, hop):
    """Return (total time of this bounce and all later ones, True if this time is accurate to rounding)."""
    contact_force = jnp.where(hop.contact_force > 0, hop.contact_force, 1.0)
    drag = 0.5 * (hop.height_jerk + hop.force_rate)  # damping times the contact force
    relative_correction = speed * (hop.force_rate + drag) / (contact_force * contact_force * (1.0 - restitution))
    leading_time = 2.0 * speed / ((1.0 - restitution) * contact_force)
    return leading_time * (1.0 - 2.0 / 3.0 * relative_correction), (abs(relative_correction) <= SERIES_TOLERANCE) & (
        leading_time <= SERIES_TOLERANCE * coeffs.max_step
    )


def bounce_to_near_release(coeffs, side, release_phasor, tau, speed):
    """Return (tau, speed) after the first landing near the release, or at a start that is near the release."""
    restitution = restitution_of(coeffs, side)

    def is_far_from_release(carry):
        tau, speed = carry
        return (tau < -COMPARISON_TIME * coeffs.max_step) & jnp.isfinite(speed) & (speed > 0)

    def next_hop(carry):
        tau, speed = carry
        hop = evaluate_hop(coeffs, side, flow.rotate_phasor_by_angle(*release_phasor, coeffs.frequency * tau), speed)
        return tau + hop.time, restitution * hop.landing_speed

    zero = 0.0 * (tau + speed)
    return lax.while_loop(is_far_from_release, next_hop, (tau + zero, speed + zero))


def critical_speed(coeffs, side, release_phasor, tau):
    """Return the critical speed for sticking of a bounce that begins at tau < 0; 0 if tau >= 0."""
    force_sample_taus = tau * jnp.linspace(0.0, 1.0, 17)
    contact_forces = jax.vmap(
        lambda hop_tau: (
            side
            * contact_force_derivatives(
                coeffs, side, flow.rotate_phasor_by_angle(*release_phasor, coeffs.frequency * hop_tau)
            )[0]
        )
    )(force_sample_taus)
    no_query_times = jnp.zeros(0, tau.dtype)

    def bisect(_, carry):
        lower_speed, upper_speed = carry
        middle_speed = 0.5 * (lower_speed + upper_speed)
        sticks = compute_chatter_end(coeffs, side, release_phasor, tau, middle_speed, no_query_times).sticking_time > 0
        return jnp.where(sticks, middle_speed, lower_speed), jnp.where(sticks, upper_speed, middle_speed)

    max_speed = jnp.maximum(-2.0 * tau * jnp.max(contact_forces), 0.0)
    lower_speed, upper_speed = lax.fori_loop(0, N_BISECTIONS, bisect, (0.0 * max_speed, max_speed))
    return 0.5 * (lower_speed + upper_speed)

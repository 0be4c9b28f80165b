"""Compute the bounces of a mass that comes to stick on a wall, or only just fails to stick.

Time tau is counted from the release, the zero of the contact force P at which the wall releases a sticking mass: tau <
0 before it. A bounce leaves the wall at tau with a speed w. Its height y >= 0 starts as w s - P s^2 / 2 + ... and ends
with a landing, after which the mass leaves with R times the landing speed. The mass sticks if infinitely many bounces
end before tau = 0. This is practically certain if the total time of the bounces is short compared with the time
remaining. The total time is then 2 w / ((1 - R) P) (1 - 2/3 w (P' + gamma P) / (P^2 (1 - R))), which completes the
series; further terms are below rounding.

A mass that leaves with at most a critical speed comes to stick. Near the release, where P = -c tau, bounces at this
speed shrink in proportion. Let q in (1/3, 1) be the root of (1 + q)(3 q - 1)^2 = 8 R q. A bounce multiplies the time
remaining by lam = (3 q - 1) / 2 and the speed by lam^2, with w = 3 (1 - q^2) / 8 c tau^2, and multiplies an excess of
speed by mu = (1 + q)^2 / (2 q^2 (3 q - 1)) (Nordmark and Piiroinen, Phil. Trans. R. Soc. A 367, 2009). The critical
speed is therefore a smooth function of tau and of the scene: it is the stable manifold of this contraction. Bisection
computes it; the bounces decide which speeds lead to sticking. Their heights are relative to the wall and therefore keep
full relative accuracy, even if they are very low.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from continuation.array_type import Array

from ..flight import flow
from ..flight.flows import flow_of
from ..flight.soft_contact import restitution_of
from .wall_at_contact import contact_force_derivatives, wall_derivatives

HOP_ORDER = 12  # order of the polynomial of a bounce
MAX_HOP_TIME = 0.4  # of `FlowCoefficients.max_step`: longer bounces do not belong to a series
COMPARISON_TIME = 0.3  # of `max_step`, before the release: time at which speeds are compared with the critical one
NEWTON_STEPS = 6  # from the root of a cubic to the landing
SERIES_TOLERANCE = 1e-4  # of the time remaining and of `max_step`: total time of bounces that the series completes
MAX_HOPS = 100_000
N_BISECTIONS = 62  # bisections of the bracket of the critical speed


class Hop(NamedTuple):
    """Bounce on a wall.

    `time` is its flight time. `landing_speed` is the speed at its end relative to the wall, inf if it does not land.
    `contact_force` and `force_rate` are those of the wall at its start, `third_derivative` is that of the height y, and
    `terms` are the Taylor coefficients of y / s.
    """

    time: Float[Array, ""]
    landing_speed: Float[Array, ""]
    contact_force: Float[Array, ""]
    force_rate: Float[Array, ""]
    third_derivative: Float[Array, ""]
    terms: tuple[Float[Array, ""], ...]


class ChatterEnd(NamedTuple):
    """End of a sequence of bounces.

    `sticking_time` is the duration of sticking before the release, negative if the mass does not stick.
    `first_hop_time` is the flight time of the first bounce, `FlowCoefficients.max_step` if it is longer. `height` and
    `velocity` are relative to the wall, away from it, at the requested times.
    """

    sticking_time: Float[Array, ""]
    first_hop_time: Float[Array, ""]
    height: Float[Array, " times"]
    velocity: Float[Array, " times"]


def evaluate_hop(coeffs, side, phasor, speed):
    """Return the `Hop` of a mass that leaves a wall with a speed, or lifts off with zero speed.

    `phasor` is (cosine, sine) of the drive at its start.
    """
    wall_position, wall_velocity, *wall_derivs = wall_derivatives(coeffs, side, *phasor, HOP_ORDER)
    jet = flow_of(coeffs).jet(coeffs, wall_position, wall_velocity - side * speed, *phasor, HOP_ORDER)
    height_derivs = [
        side * (wall_deriv - mass_deriv) for wall_deriv, mass_deriv in zip(wall_derivs, jet[2:], strict=False)
    ]
    contact_force, force_rate = (side * derivative for derivative in contact_force_derivatives(coeffs, side, phasor))
    height_terms = (
        speed,
        *(height_deriv / math.factorial(k) for k, height_deriv in enumerate(height_derivs, 2)),
    )  # Taylor coefficients of y / s
    discriminant = height_terms[1] * height_terms[1] - 4.0 * height_terms[2] * speed
    lifts = (speed == 0) & (contact_force < 0)
    lands = jnp.where(lifts, height_terms[2] < 0, (discriminant > 0) & (height_terms[1] < 0))
    denominator = jnp.sqrt(jnp.where(lands, discriminant, 1.0)) - jnp.where(lands, height_terms[1], -1.0)
    lift_time = -height_terms[1] / jnp.where(lifts & lands, height_terms[2], 1.0)
    time = jnp.where(lands, jnp.where(lifts, lift_time, 2.0 * speed / denominator), 0.0)
    for _ in range(NEWTON_STEPS):
        height, slope = _horner(height_terms, time)
        time = time - jnp.where(lands, height / jnp.where(slope == 0, 1.0, slope), 0.0)
    _, slope = _horner(height_terms, time)
    is_valid = lands & (time >= 0) & (slope <= 0) & (time <= coeffs.max_step)
    landing_speed = jnp.where(is_valid, -time * slope, jnp.inf)  # y' = (y / s) + s (y / s)', and y is 0
    is_still = (speed == 0) & ~lifts
    return Hop(
        jnp.where(is_still, 0.0, time),
        jnp.where(is_still, 0.0, landing_speed),
        contact_force,
        force_rate,
        height_derivs[1],
        height_terms,
    )


def _horner(height_terms, time):
    """Return the value and the slope of a polynomial."""
    value, slope = height_terms[-1], jnp.zeros_like(height_terms[-1])
    for term in height_terms[-2::-1]:
        value, slope = value * time + term, slope * time + value
    return value, slope


def chatter_end(coeffs, side, release_phasor, tau, speed, elapsed_times):
    """Return the `ChatterEnd` of bounces that begin at tau with a speed, both scalars.

    `release_phasor` is (cosine, sine) of the drive at the release. `elapsed_times`, of shape (times,), are the times
    since tau at which the height is evaluated.
    """
    restitution = restitution_of(coeffs, side) + 0.0 * speed
    zero = 0.0 * (tau + speed)

    def is_unfinished(carry):
        return (carry[-1] == 0) & (carry[3] < MAX_HOPS)

    def next_hop(carry):
        hop_tau, speed, sticking_time, n_hops, first_hop_time, height, velocity, _ = carry
        phasor = flow.rotate_by_angle(*release_phasor, coeffs.frequency * hop_tau)
        hop = evaluate_hop(coeffs, side, phasor, speed)
        total_hop_time, is_accurate = _total_hop_time(coeffs, restitution, speed, hop)
        is_pressed = (hop.contact_force > 0) | ((speed == 0) & (hop_tau + hop.time == hop_tau))
        sticks = is_accurate & (total_hop_time <= SERIES_TOLERANCE * -hop_tau) & (hop_tau < 0) & is_pressed
        lands = (is_pressed | (speed == 0)) & jnp.isfinite(hop.landing_speed) & (hop_tau + hop.time < 0)
        time_in_hop = elapsed_times - (hop_tau - tau)
        is_in_hop = (time_in_hop >= 0) & (time_in_hop < jnp.where(sticks, 0.0, hop.time)) & (lands | sticks)
        y, slope = _horner(hop.terms, jnp.where(is_in_hop, time_in_hop, 0.0))
        height, velocity = (
            jnp.where(is_in_hop, time_in_hop * y, height),
            jnp.where(is_in_hop, y + time_in_hop * slope, velocity),
        )
        next_tau = hop_tau + jnp.where(lands, hop.time, 0.0)
        sticking_time = jnp.where(
            sticks, -(hop_tau + total_hop_time), -jnp.maximum(next_tau, 0.0) - hop.time - (speed > 0)
        )
        return (
            jnp.where(sticks, hop_tau, next_tau),
            jnp.where(lands, restitution * hop.landing_speed, speed),
            sticking_time,
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
    start = tau + zero, speed + zero, zero, zero, zero, zeros, zeros, jnp.int32(0)
    _, _, sticking_time, _, first_hop_time, height, velocity, done = lax.while_loop(is_unfinished, next_hop, start)
    return ChatterEnd(jnp.where(done == 1, sticking_time, -1.0), first_hop_time, height, velocity)


def _total_hop_time(coeffs, restitution, speed, hop):
    """Return (total time of all bounces from this one, True if it is accurate to rounding)."""
    contact_force = jnp.where(hop.contact_force > 0, hop.contact_force, 1.0)
    drag = 0.5 * (hop.third_derivative + hop.force_rate)  # damping times the contact force
    correction = speed * (hop.force_rate + drag) / (contact_force * contact_force * (1.0 - restitution))
    leading_time = 2.0 * speed / ((1.0 - restitution) * contact_force)
    return leading_time * (1.0 - 2.0 / 3.0 * correction), (abs(correction) <= SERIES_TOLERANCE) & (
        leading_time <= SERIES_TOLERANCE * coeffs.max_step
    )


def approach_release(coeffs, side, release_phasor, tau, speed):
    """Return (tau, speed) at the first landing near the release, or at the start if it is near."""
    restitution = restitution_of(coeffs, side)

    def is_unfinished(carry):
        tau, speed = carry
        return (tau < -COMPARISON_TIME * coeffs.max_step) & jnp.isfinite(speed) & (speed > 0)

    def next_hop(carry):
        tau, speed = carry
        hop = evaluate_hop(coeffs, side, flow.rotate_by_angle(*release_phasor, coeffs.frequency * tau), speed)
        return tau + hop.time, restitution * hop.landing_speed

    zero = 0.0 * (tau + speed)
    return lax.while_loop(is_unfinished, next_hop, (tau + zero, speed + zero))


def critical_speed(coeffs, side, release_phasor, tau):
    """Return the largest speed with which a mass that leaves a wall at tau < 0 comes to stick; 0 for other tau."""
    taus = tau * jnp.linspace(0.0, 1.0, 17)
    contact_forces = jax.vmap(
        lambda hop_tau: (
            side
            * contact_force_derivatives(
                coeffs, side, flow.rotate_by_angle(*release_phasor, coeffs.frequency * hop_tau)
            )[0]
        )
    )(taus)
    no_times = jnp.zeros(0, tau.dtype)

    def bisect(_, carry):
        lower, upper = carry
        middle = 0.5 * (lower + upper)
        sticks = chatter_end(coeffs, side, release_phasor, tau, middle, no_times).sticking_time > 0
        return jnp.where(sticks, middle, lower), jnp.where(sticks, upper, middle)

    max_speed = jnp.maximum(-2.0 * tau * jnp.max(contact_forces), 0.0)
    lower, upper = lax.fori_loop(0, N_BISECTIONS, bisect, (0.0 * max_speed, max_speed))
    return 0.5 * (lower + upper)

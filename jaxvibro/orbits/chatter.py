"""The hops by which a mass comes to rest on a wall, and those by which it just does not.

Time tau is counted from the release, the root of the press P where the wall lets a mass go that rests on it: tau < 0
before. A hop leaves the wall at tau with a speed w; its height y >= 0 starts as w s - P s^2 / 2 + ... and ends with
a landing, after which the mass leaves with R times the speed of it. A mass is at rest where infinitely many hops end
before tau = 0. That it does so is as good as sure where the time of all hops is short beside what is left: then it is
2 w / ((1 - R) P) (1 - 2/3 w (P' + gamma P) / (P^2 (1 - R))), by which the series is ended; the next terms are beyond
rounding.

Speeds up to a critical one come to rest. Near the release, where P = -c tau, hops at this speed shrink in proportion:
with q in (1/3, 1) the root of (1 + q)(3 q - 1)^2 = 8 R q the time left by lam = (3 q - 1) / 2 a hop, the speed by
lam^2, w = 3 (1 - q^2) / 8 c tau^2, and what a speed is too much grows by mu = (1 + q)^2 / (2 q^2 (3 q - 1))
(Nordmark and Piiroinen, Phil. Trans. R. Soc. A 367, 2009). So the critical speed is a smooth function of tau and of the
scene, the stable manifold of that shrinking, and is found by halving: which speeds end in rest is decided by hops,
whose heights are counted from the wall and so keep their digits however low they are.
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

HOP_ORDER = 12  # of a hop's polynomial
MAX_HOP_TIME = 0.4  # of `Frame.reach`: a hop that is longer is none of a series'
COMPARISON_TIME = 0.3  # of the same: so long before the release speeds are compared with the critical one
NEWTON_STEPS = 6  # of Newton's steps from a cubic's root to the landing
SERIES_TOLERANCE = 1e-4  # of what is left, or of the reach: so short are all further hops where the series is ended
MAX_HOPS = 100_000  # hops
N_BISECTIONS = 62  # of the bracket of the critical speed


class Hop(NamedTuple):
    """time: how long it is; landing_speed: the speed at its end, against the wall, inf times where it does not end;
    press, force_rate: of the wall at its start; third_derivative: y's third derivative there; terms: of its height."""

    time: Float[Array, ""]
    landing_speed: Float[Array, ""]
    contact_force: Float[Array, ""]
    force_rate: Float[Array, ""]
    third_derivative: Float[Array, ""]
    terms: tuple[Float[Array, ""], ...]


class ChatterEnd(NamedTuple):
    """sticking_time: how long the mass rests before the release, negative: it does not come to rest; first_hop_time:
    how long the first hop is, `Frame.reach` where it is longer; height, velocity: over the wall and away from it, at
    times asked for."""

    sticking_time: Float[Array, ""]
    first_hop_time: Float[Array, ""]
    height: Float[Array, " times"]
    velocity: Float[Array, " times"]


def evaluate_hop(coeffs, side, phasor, speed):
    """The `Hop` from a wall that a mass leaves with a speed, a number, or without one where it is drawn away; phasor:
    the drive's cosine and sine."""
    wall_position, wall_velocity, *wall_derivs = wall_derivatives(coeffs, side, *phasor, HOP_ORDER)
    jet = flow_of(coeffs).jet(coeffs, wall_position, wall_velocity - side * speed, *phasor, HOP_ORDER)
    height_derivs = [
        side * (wall_deriv - mass_deriv) for wall_deriv, mass_deriv in zip(wall_derivs, jet[2:], strict=False)
    ]
    contact_force, force_rate = (side * derivative for derivative in contact_force_derivatives(coeffs, side, phasor))
    height_terms = (
        speed,
        *(height_deriv / math.factorial(k) for k, height_deriv in enumerate(height_derivs, 2)),
    )  # of y / s
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
    """A polynomial and its slope."""
    value, slope = height_terms[-1], jnp.zeros_like(height_terms[-1])
    for term in height_terms[-2::-1]:
        value, slope = value * time + term, slope * time + value
    return value, slope


def chatter_end(coeffs, side, release_phasor, tau, speed, elapsed_times):
    """The `ChatterEnd` of hops that begin at tau with a speed, numbers. release_phasor: the drive's cosine and sine
    there; since: (times,) since tau, at which the mass is looked for."""
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
    """(how long all hops last from one on, whether that is right to rounding)."""
    contact_force = jnp.where(hop.contact_force > 0, hop.contact_force, 1.0)
    drag = 0.5 * (hop.third_derivative + hop.force_rate)  # damping times the press
    correction = speed * (hop.force_rate + drag) / (contact_force * contact_force * (1.0 - restitution))
    leading_time = 2.0 * speed / ((1.0 - restitution) * contact_force)
    return leading_time * (1.0 - 2.0 / 3.0 * correction), (abs(correction) <= SERIES_TOLERANCE) & (
        leading_time <= SERIES_TOLERANCE * coeffs.max_step
    )


def approach_release(coeffs, side, release_phasor, tau, speed):
    """(tau, speed) of the first landing, or of the start, from which on the release is near."""
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
    """The speed from which on a mass that leaves a wall at tau < 0 does not come to rest; 0 where tau is not."""
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

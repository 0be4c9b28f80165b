"""Fly a mass on a spring and a damper exactly. The interface is that of `force_flow`, see `flows`.

`coeffs` are the coefficients of each lane. Inside a soft wall x is relative to the wall, and `extra_force` is the
result of `soft_contact.extra_force_derivs`.
"""

from dataclasses import replace

import jax.numpy as jnp
from jax import lax

from ..compiled.compiler_hints import choose, stage
from ..scene.typical_scales import fast_part_amplitude
from . import drive, event, flow, soft_contact, wall_motion
from .flight_state import SlowMotion, add_increments
from .taylor import evaluate_taylor

LINEAR = True  # the matrix of a flight does not depend on its initial state


def look_ahead(coeffs, path):
    """Return (coefficients, None): the longest step is that of the coefficients."""
    return coeffs, None


def event_derivatives(coeffs, path, lookahead, extra_force):
    """Return x and its derivatives up to order `event.N_TERMS`."""
    return jet(coeffs, path.x, path.v, path.cosine, path.sine, event.N_TERMS, extra_force)


def lookahead_bounds(lookahead):
    """Return None: the coefficients contain the contact force and the remainder."""


def contact_forces_ahead(coeffs, path, bounds):
    """Return [(contact force and its derivatives, bound on the next derivative)] for each wall."""
    force_lists = [contact_force(coeffs, wall, path.cosine, path.sine, event.N_TERMS - 1) for wall in coeffs.walls]
    return list(zip(force_lists, coeffs.force_remainders, strict=True))


def remainder_bound(coeffs, derivatives, bounds, is_sticking, force_remainder, wall_remainder, taylor_weights):
    """Return the bound on the remainder of an event's polynomial, in lengths, for free and for sticking lanes."""
    sixth_deriv, seventh_deriv = (
        flow.spring_force(coeffs.root_stiffness, lax.abs(derivatives[6])),
        lax.abs(derivatives[7]),
    )
    free_remainder = (
        coeffs.max_step * (coeffs.jet_bound + coeffs.jet_bound_slope * (sixth_deriv + seventh_deriv)) + seventh_deriv
    )
    return (choose(is_sticking, force_remainder, free_remainder) + wall_remainder) * taylor_weights[event.N_TERMS]


def advance_motion(coeffs, motion, time, contact, lookahead):
    """Return the motion after a step."""
    return propagate(coeffs, motion, time, contact)


def propagate(coeffs, motion, time, contact=None):
    """Return the `SlowMotion` after a time.

    `contact` is the contact of the lanes if any may be inside a soft wall, and None otherwise.
    """
    if contact is None:
        propagator, increments = stage(flow.step_propagator, coeffs.series, coeffs.frequency, time), None
        if coeffs.drive_terms:
            drive_responses = [stage(flow.drive_responses, term.series, time) for term in coeffs.drive_terms]
            increments = stage(
                drive.term_increments,
                coeffs.drive_terms,
                coeffs.frequency,
                *motion[4:],
                propagator.p01,
                drive_responses,
            )
    else:
        propagator = stage(soft_contact.lane_propagator, coeffs, contact, time)
        extra_responses = (
            stage(soft_contact.harmonic_responses, coeffs, contact, time)
            if soft_contact.has_harmonic_forces(coeffs)
            else []
        )
        increments = stage(soft_contact.extra_increments, coeffs, contact, motion, propagator, extra_responses)
    slow_parts = stage(_slow_part_after, coeffs, motion, propagator, contact, increments)
    return SlowMotion(*slow_parts, *stage(flow.rotate, *motion[4:], propagator.cos_less_1, propagator.sin_angle))


def _slow_part_after(coeffs, motion, propagator, contact, increments):
    """Return (slow_x, slow_x_low, slow_v, slow_v_low) after a flight.

    `increments` are the changes that the first term of the drive does not cause.
    """
    gamma_omega = coeffs.damping * coeffs.frequency
    force_cos = -2.0 * coeffs.swift_amplitude * (motion.cosine + gamma_omega * (motion.cosine - motion.sine))
    force_sin = -2.0 * coeffs.swift_amplitude * (motion.sine + gamma_omega * (motion.sine + motion.cosine))
    if contact is not None:
        is_inside_wall = soft_contact.is_inside(contact)
        force_cos = choose(is_inside_wall, coeffs.amplitude * motion.cosine, force_cos)
        force_sin = choose(is_inside_wall, coeffs.amplitude * motion.sine, force_sin)
    p00_minus_1, p01, cos_response, sin_response = propagator[:4]
    dx = p00_minus_1 * motion.slow_x + (p01 * motion.slow_v + (force_cos * cos_response - force_sin * sin_response))
    forced_velocity = force_cos * (p01 - coeffs.frequency * sin_response) - force_sin * (
        coeffs.frequency * cos_response
    )
    dv = (p00_minus_1 - 2.0 * coeffs.damping * p01) * motion.slow_v + (
        forced_velocity - p01 * flow.spring_force(coeffs.stiffness, motion.slow_x)
    )
    if increments is not None:
        dx, dv = dx + increments[0], dv + increments[1]
    return add_increments(motion, dx, dv)


def acceleration_and_jerk(coeffs, x, v, cosine, sine, extra_force=(None, None)):
    """Return the acceleration of a free mass and its rate; for `extra_force` see `flow.extend_jet`."""
    extra_force = drive.add_term_derivatives(coeffs.drive_terms, coeffs.frequency, cosine, sine, extra_force)
    force_pair = coeffs.amplitude * cosine, -(coeffs.amplitude * sine) * coeffs.frequency
    return flow.extend_jet(coeffs.frequency, coeffs.damping, coeffs.stiffness, force_pair, extra_force, (x, v))[1]


def jet(coeffs, x, v, cosine, sine, order, extra_force=()):
    """Return x and its derivatives, at least up to an order, two at a time so that each is computed once."""
    force_pair, derivs = (coeffs.amplitude * cosine, -(coeffs.amplitude * sine) * coeffs.frequency), [x, v]
    extra_force = [*extra_force, *[None] * order]
    if coeffs.drive_terms:
        extra_force = stage(
            drive.add_term_derivatives, coeffs.drive_terms, coeffs.frequency, cosine, sine, extra_force[:order]
        )
    while len(derivs) <= order:
        extra_pair = extra_force[len(derivs) - 2 : len(derivs)]
        force_pair, new_derivs = stage(
            flow.extend_jet, coeffs.frequency, coeffs.damping, coeffs.stiffness, force_pair, extra_pair, derivs[-2:]
        )
        derivs += new_derivs
    return derivs


def jet_at_point(coeffs, point, order, extra_force=()):
    """Return x and its derivatives up to order + 1 at a `taylor.ExpansionPoint`."""
    return _free_jet(coeffs, point.x, point.v, _force_derivatives(coeffs, point, order, extra_force))


def _force_derivatives(coeffs, point, order, extra_force=()):
    """Return the force and its derivatives up to order - 1."""
    derivs = [coeffs.amplitude * point.cosine, -(coeffs.amplitude * point.sine) * coeffs.frequency]
    while len(derivs) < order:
        derivs.append(-(coeffs.frequency * coeffs.frequency) * derivs[-2])
    extra_derivs = drive.add_term_derivatives(
        coeffs.drive_terms, coeffs.frequency, point.cosine, point.sine, [*extra_force, *[None] * order][:order]
    )
    return [
        force_deriv if extra_deriv is None else force_deriv + extra_deriv
        for force_deriv, extra_deriv in zip(derivs[:order], extra_derivs, strict=False)
    ]


def _free_jet(coeffs, x, v, force_derivs):
    """Return x and its derivatives under given forces."""
    derivs = [x, v]
    for force_deriv in force_derivs:
        derivs.append(force_deriv - flow.spring_force(coeffs.stiffness, derivs[-2]) - 2.0 * coeffs.damping * derivs[-1])
    return derivs


def propagate_back(coeffs, point, x, v, delay, order, extra_force=()):
    """Return x and v at a point of a flight that is at x, v after a short delay."""
    force_derivs = _force_derivatives(coeffs, point, order, extra_force)
    derivs = _free_jet(coeffs, x, v, [evaluate_taylor(force_derivs[k:], delay, order - 1 - k) for k in range(order)])
    return evaluate_taylor(derivs, -delay, order), evaluate_taylor(derivs[1:], -delay, order)


def contact_force(coeffs, wall, cosine, sine, order):
    """Return the force along x on a sticking mass relative to the wall, and its derivatives."""
    force_derivs = wall_motion.contact_force(
        wall, coeffs.amplitude, coeffs.frequency, coeffs.damping, cosine, sine, order
    )
    return drive.add_term_derivatives(coeffs.drive_terms, coeffs.frequency, cosine, sine, force_derivs)


def chatter_bounds(coeffs, side, acceleration, approach_speed, cosine, sine):
    """Return (bound on the rate of the contact force, damping, None) for chatter on a wall.

    The force growth is None, because the spring pulls the mass back.
    """
    return wall_motion.select_by_side(side, coeffs.walls, coeffs.force_rate_bounds), coeffs.damping, None


def shortest_step(coeffs, flights):
    """Return the longest step, which does not depend on the motion."""
    return coeffs.max_step


def fly(coeffs, x, v, cosine, sine, time):
    """Return (x, v, cosine, sine) after any time >= 0."""
    x, v, angle_pair, _ = _fly_with_responses(coeffs, x, v, cosine, sine, time)
    return x, v, *flow.rotate(cosine, sine, *angle_pair)


def fly_with_matrix(coeffs, x, v, cosine, sine, time):
    """Return ((x, v) after a time, derivative with respect to the initial state as in `flow_matrix.apply_matrix`)."""
    x, v, _, free_flow = _fly_with_responses(coeffs, x, v, cosine, sine, time)
    return (x, v), free_flow


def propagate_matrix(coeffs, state, cosine, sine, time):
    """Return (state, cosine, sine, matrix of the flow by rows) after a time.

    The matrix does not depend on the state; `state` is ().
    """
    (p00, p01, p11), _, angle_pair = flow.doubling_responses(coeffs.series, coeffs.frequency, coeffs.damping, time)
    return (), *flow.rotate(cosine, sine, *angle_pair), (p00, p01, -p01, p11)


def _fly_with_responses(coeffs, x, v, cosine, sine, time):
    """Return (x, v, rotation of the drive, matrix of the free flow) after a time."""
    free_flow, forced_flow, angle_pair = flow.doubling_responses(coeffs.series, coeffs.frequency, coeffs.damping, time)
    x, v = flow.apply_responses((free_flow, forced_flow), coeffs.amplitude * cosine, coeffs.amplitude * sine, x, v)
    if coeffs.drive_terms:
        term_responses = drive.term_responses(coeffs.drive_terms, coeffs.frequency, coeffs.damping, time)
        x, v = _add_drive_terms(coeffs, term_responses, cosine, sine, x, v)
    return x, v, angle_pair, free_flow


def _add_drive_terms(coeffs, responses, cosine, sine, x, v):
    """Return x and v including the response to the further drive terms."""
    dx, dv = drive.forced_response(coeffs.drive_terms, responses, coeffs.frequency, cosine, sine)
    return x + dx, v + dv


def flight_map(coeffs, duration):
    """Return the map of (x, v, cosine, sine) over a fixed duration."""
    free_flow, forced_flow, (cos_less_1, sin_angle) = flow.doubling_responses(
        coeffs.series, coeffs.frequency, coeffs.damping, duration
    )
    term_responses = drive.term_responses(coeffs.drive_terms, coeffs.frequency, coeffs.damping, duration)

    def advance_state(x, v, cosine, sine):
        x, v = flow.apply_responses((free_flow, forced_flow), coeffs.amplitude * cosine, coeffs.amplitude * sine, x, v)
        if coeffs.drive_terms:
            x, v = _add_drive_terms(coeffs, term_responses, cosine, sine, x, v)
        return x, v, *flow.rotate(cosine, sine, cos_less_1, sin_angle)

    return advance_state


def reverse_time(coeffs):
    """Return the coefficients of the flow with time reversed.

    The energy of x^(6) is at most exp(2 gamma t) times that without damping, for which
    `coefficients.compute_coefficients` computes the bounds.
    """
    energy_growth = jnp.exp(2.0 * coeffs.damping * coeffs.max_step)
    jet_bound_slope, force_bound = (
        coeffs.jet_bound_slope * energy_growth,
        drive.total_derivative_bound(coeffs.drive_terms, coeffs.amplitude, coeffs.frequency, 6),
    )
    return coeffs._replace(
        damping=-coeffs.damping,
        swift_amplitude=fast_part_amplitude(coeffs.frequency, -coeffs.damping, coeffs.amplitude),
        series=flow.flow_series(coeffs.frequency, -coeffs.damping),
        jet_bound=force_bound * (1.0 + jet_bound_slope * coeffs.max_step),
        jet_bound_slope=jet_bound_slope,
        drive_terms=tuple(_reverse_term(coeffs, term) for term in coeffs.drive_terms),
    )


def _reverse_term(coeffs, term):
    """Return a drive term with time reversed."""
    series = flow.flow_series(drive.angular_rate(term, coeffs.frequency), -coeffs.damping)
    return replace(term, sine=-term.sine, series=series)

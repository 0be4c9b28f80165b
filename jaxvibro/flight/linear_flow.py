"""Fly a mass on a spring and a damper exactly.

The interface is that of `force_flow`, see `flow_dispatch`. `coeffs` are the coefficients of each lane. Inside a soft
wall x is relative to the wall, and `frame_force` is the result of `motion_in_soft_wall.frame_force_derivs`.
"""

from dataclasses import replace

import jax.numpy as jnp
from jax import lax

from ..compiled.lane_arithmetic import call_without_inlining, choose
from ..scene.typical_scales import fast_part_amplitude
from . import event_certificates, flow, further_drive_terms, motion_in_soft_wall, wall_motion
from .flight_state import SlowMotion, add_to_slow_motion
from .taylor_polynomials import evaluate_taylor

LINEAR = True  # the matrix of a flight does not depend on its initial state


def prepare_lookahead(coeffs, path):
    """Return (coefficients, None): the coefficients of the linear flow already contain the longest step."""
    return coeffs, None


def motion_derivatives(coeffs, path, lookahead, frame_force):
    """Return x and its derivatives up to order `event_certificates.N_TERMS`."""
    return jet(coeffs, path.x, path.v, path.cosine, path.sine, event_certificates.N_TERMS, frame_force)


def forces_and_remainder(lookahead):
    """Return None, because the coefficients contain the bounds on the contact force and on the remainder."""


def contact_forces_ahead(coeffs, path, forces_and_remainder):
    """Return [(contact force and its derivatives, bound on the next derivative)] for each wall."""
    contact_force_derivs = [
        contact_force(coeffs, wall, path.cosine, path.sine, event_certificates.N_TERMS - 1) for wall in coeffs.walls
    ]
    return list(zip(contact_force_derivs, coeffs.force_remainder_bounds, strict=True))


def remainder_bound(
    coeffs,
    derivatives,
    forces_and_remainder,
    is_sticking,
    contact_remainder_bound,
    wall_remainder_bound,
    taylor_weights,
):
    """Return the bound on the remainder of an event's polynomial, in lengths, for free and for sticking lanes."""
    scaled_sixth_deriv, seventh_deriv = (
        flow.spring_force(coeffs.root_stiffness, lax.abs(derivatives[6])),
        lax.abs(derivatives[7]),
    )
    flight_remainder_bound = (
        coeffs.max_step * (coeffs.jet_bound + coeffs.jet_bound_slope * (scaled_sixth_deriv + seventh_deriv))
        + seventh_deriv
    )
    return (
        choose(is_sticking, contact_remainder_bound, flight_remainder_bound) + wall_remainder_bound
    ) * taylor_weights[event_certificates.N_TERMS]


def advance_motion(coeffs, motion, time, contact, lookahead):
    """Return the motion after a step."""
    return propagate_motion(coeffs, motion, time, contact)


def propagate_motion(coeffs, motion, time, contact=None):
    """Return the `SlowMotion` after a time of at most one step.

    `contact` is the contact of the lanes if any may be inside a soft wall, and None otherwise.
    """
    if contact is None:
        propagator, extra_increments = (
            call_without_inlining(flow.step_propagator, coeffs.series, coeffs.frequency, time),
            None,
        )
        if coeffs.drive_terms:
            term_drive_responses = [
                call_without_inlining(flow.drive_responses, term.series, time) for term in coeffs.drive_terms
            ]
            extra_increments = call_without_inlining(
                further_drive_terms.drive_term_increments,
                coeffs.drive_terms,
                coeffs.frequency,
                *motion[4:],
                propagator.p01,
                term_drive_responses,
            )
    else:
        propagator = call_without_inlining(motion_in_soft_wall.lane_propagator, coeffs, contact, time)
        extra_responses = (
            call_without_inlining(motion_in_soft_wall.harmonic_responses, coeffs, contact, time)
            if motion_in_soft_wall.has_harmonic_forces(coeffs)
            else []
        )
        extra_increments = call_without_inlining(
            motion_in_soft_wall.extra_increments, coeffs, contact, motion, propagator, extra_responses
        )
    slow_parts = call_without_inlining(_slow_parts_after_flight, coeffs, motion, propagator, contact, extra_increments)
    return SlowMotion(
        *slow_parts,
        *call_without_inlining(flow.rotate_phasor, *motion[4:], propagator.cos_less_1, propagator.sin_angle),
    )


def _slow_parts_after_flight(coeffs, motion, propagator, contact, extra_increments):
    """Return the first four fields of the `SlowMotion` after a flight.

    `extra_increments` are the increments of x and v due to the further drive terms and, inside a soft wall, due to
    `motion_in_soft_wall.frame_force_derivs`. None stands for zero.
    """
    gamma_omega = coeffs.damping * coeffs.frequency
    force_cos = -2.0 * coeffs.in_phase_amplitude * (motion.cosine + gamma_omega * (motion.cosine - motion.sine))
    force_sin = -2.0 * coeffs.in_phase_amplitude * (motion.sine + gamma_omega * (motion.sine + motion.cosine))
    if contact is not None:
        is_inside_wall = motion_in_soft_wall.is_inside_soft_wall(contact)
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
    if extra_increments is not None:
        dx, dv = dx + extra_increments[0], dv + extra_increments[1]
    return add_to_slow_motion(motion, dx, dv)


def acceleration_and_jerk(coeffs, x, v, cosine, sine, frame_force=(None, None)):
    """Return acceleration and jerk of a mass that does not stick to a wall.

    `frame_force` is a force and its time derivative, see `motion_in_soft_wall.frame_force_derivs`; None stands for
    zero.
    """
    frame_force = further_drive_terms.add_term_derivatives(
        coeffs.drive_terms, coeffs.frequency, cosine, sine, frame_force
    )
    drive_force_and_rate = coeffs.amplitude * cosine, -(coeffs.amplitude * sine) * coeffs.frequency
    return flow.extend_jet(
        coeffs.frequency, coeffs.damping, coeffs.stiffness, drive_force_and_rate, frame_force, (x, v)
    )[1]


def jet(coeffs, x, v, cosine, sine, order, frame_force=()):
    """Return x and its derivatives, at least up to an order.

    Each call of `flow.extend_jet` yields two derivatives and stores them, so that no derivative is recomputed.
    """
    drive_force_derivs, position_derivs = (
        (coeffs.amplitude * cosine, -(coeffs.amplitude * sine) * coeffs.frequency),
        [x, v],
    )
    frame_force = [*frame_force, *[None] * order]
    if coeffs.drive_terms:
        frame_force = call_without_inlining(
            further_drive_terms.add_term_derivatives,
            coeffs.drive_terms,
            coeffs.frequency,
            cosine,
            sine,
            frame_force[:order],
        )
    while len(position_derivs) <= order:
        two_frame_force_derivs = frame_force[len(position_derivs) - 2 : len(position_derivs)]
        drive_force_derivs, new_position_derivs = call_without_inlining(
            flow.extend_jet,
            coeffs.frequency,
            coeffs.damping,
            coeffs.stiffness,
            drive_force_derivs,
            two_frame_force_derivs,
            position_derivs[-2:],
        )
        position_derivs += new_position_derivs
    return position_derivs


def jet_at_point(coeffs, expansion_point, order, frame_force=()):
    """Return x and its derivatives up to order + 1 at a `taylor_polynomials.ExpansionPoint`."""
    return _free_jet(
        coeffs, expansion_point.x, expansion_point.v, _force_derivatives(coeffs, expansion_point, order, frame_force)
    )


def _force_derivatives(coeffs, expansion_point, order, frame_force=()):
    """Return the force and its derivatives up to order - 1."""
    drive_force_derivs = [
        coeffs.amplitude * expansion_point.cosine,
        -(coeffs.amplitude * expansion_point.sine) * coeffs.frequency,
    ]
    while len(drive_force_derivs) < order:
        drive_force_derivs.append(-(coeffs.frequency * coeffs.frequency) * drive_force_derivs[-2])
    extra_derivs = further_drive_terms.add_term_derivatives(
        coeffs.drive_terms,
        coeffs.frequency,
        expansion_point.cosine,
        expansion_point.sine,
        [*frame_force, *[None] * order][:order],
    )
    return [
        force_deriv if extra_deriv is None else force_deriv + extra_deriv
        for force_deriv, extra_deriv in zip(drive_force_derivs[:order], extra_derivs, strict=False)
    ]


def _free_jet(coeffs, x, v, force_derivs):
    """Return x and its derivatives under given forces."""
    position_derivs = [x, v]
    for force_deriv in force_derivs:
        position_derivs.append(
            force_deriv
            - flow.spring_force(coeffs.stiffness, position_derivs[-2])
            - 2.0 * coeffs.damping * position_derivs[-1]
        )
    return position_derivs


def state_before_delay(coeffs, expansion_point, x, v, delay, order, frame_force=()):
    """Return x and v at a `taylor_polynomials.ExpansionPoint` of a flight that reaches x, v after a short delay."""
    force_derivs = _force_derivatives(coeffs, expansion_point, order, frame_force)
    position_derivs = _free_jet(
        coeffs, x, v, [evaluate_taylor(force_derivs[k:], delay, order - 1 - k) for k in range(order)]
    )
    return evaluate_taylor(position_derivs, -delay, order), evaluate_taylor(position_derivs[1:], -delay, order)


def contact_force(coeffs, wall, cosine, sine, order):
    """Return the force along x on a sticking mass relative to the wall, and its derivatives."""
    force_derivs = wall_motion.contact_force(
        wall, coeffs.amplitude, coeffs.frequency, coeffs.damping, cosine, sine, order
    )
    return further_drive_terms.add_term_derivatives(coeffs.drive_terms, coeffs.frequency, cosine, sine, force_derivs)


def chatter_bounds(coeffs, side, acceleration, approach_speed, cosine, sine):
    """Return (bound on the time derivative of the contact force, damping, None) for chatter on a wall.

    The bound on the force gradient is None, which stands for 1, because the derivative of the spring force with respect
    to x is -1.
    """
    return wall_motion.select_by_side(side, coeffs.walls, coeffs.force_rate_bounds), coeffs.damping, None


def sampling_time_scale(coeffs, flights):
    """Return the longest step, which does not depend on the motion."""
    return coeffs.max_step


def fly(coeffs, x, v, cosine, sine, time):
    """Return (x, v, cosine, sine) after any time >= 0."""
    x, v, drive_rotation, _ = _fly_with_responses(coeffs, x, v, cosine, sine, time)
    return x, v, *flow.rotate_phasor(cosine, sine, *drive_rotation)


def fly_with_matrix(coeffs, x, v, cosine, sine, time):
    """Return ((x, v) after a time, matrix of the flight as in `flow_matrix.apply_matrix`)."""
    x, v, _, free_flow = _fly_with_responses(coeffs, x, v, cosine, sine, time)
    return (x, v), free_flow


def propagate_with_matrix(coeffs, state, cosine, sine, time):
    """Return (state, cosine, sine, matrix of the flow by rows) after a time.

    The state is the empty tuple, because the matrix of the linear flow does not depend on x and v.
    """
    (p00, p01, p11), _, drive_rotation = flow.doubling_responses(coeffs.series, coeffs.frequency, coeffs.damping, time)
    return (), *flow.rotate_phasor(cosine, sine, *drive_rotation), (p00, p01, -p01, p11)


def _fly_with_responses(coeffs, x, v, cosine, sine, time):
    """Return (x, v, rotation of the drive, matrix of the free flow) after a time."""
    free_flow, forced_flow, drive_rotation = flow.doubling_responses(
        coeffs.series, coeffs.frequency, coeffs.damping, time
    )
    x, v = flow.apply_responses((free_flow, forced_flow), coeffs.amplitude * cosine, coeffs.amplitude * sine, x, v)
    if coeffs.drive_terms:
        term_responses = further_drive_terms.term_responses(coeffs.drive_terms, coeffs.frequency, coeffs.damping, time)
        x, v = _add_drive_terms(coeffs, term_responses, cosine, sine, x, v)
    return x, v, drive_rotation, free_flow


def _add_drive_terms(coeffs, term_responses, cosine, sine, x, v):
    """Return x and v including the response to the further drive terms."""
    dx, dv = further_drive_terms.response_to_terms(coeffs.drive_terms, term_responses, coeffs.frequency, cosine, sine)
    return x + dx, v + dv


def flight_map(coeffs, duration):
    """Return the map of (x, v, cosine, sine) over a fixed duration."""
    free_flow, forced_flow, (cos_less_1, sin_angle) = flow.doubling_responses(
        coeffs.series, coeffs.frequency, coeffs.damping, duration
    )
    term_responses = further_drive_terms.term_responses(coeffs.drive_terms, coeffs.frequency, coeffs.damping, duration)

    def advance_state(x, v, cosine, sine):
        x, v = flow.apply_responses((free_flow, forced_flow), coeffs.amplitude * cosine, coeffs.amplitude * sine, x, v)
        if coeffs.drive_terms:
            x, v = _add_drive_terms(coeffs, term_responses, cosine, sine, x, v)
        return x, v, *flow.rotate_phasor(cosine, sine, cos_less_1, sin_angle)

    return advance_state


def reverse_time(coeffs):
    """Return the coefficients of the flow with time reversed.

    The square root of the energy of x^(6) increases at most by the factor exp(2 gamma t) relative to a motion without
    damping, for which `flight_coefficients.make_flow_coefficients` computes the bounds.
    """
    energy_growth = jnp.exp(2.0 * coeffs.damping * coeffs.max_step)
    jet_bound_slope, force_deriv_bound = (
        coeffs.jet_bound_slope * energy_growth,
        further_drive_terms.drive_derivative_bound(coeffs.drive_terms, coeffs.amplitude, coeffs.frequency, 6),
    )
    return coeffs._replace(
        damping=-coeffs.damping,
        in_phase_amplitude=fast_part_amplitude(coeffs.frequency, -coeffs.damping, coeffs.amplitude),
        series=flow.flow_series(coeffs.frequency, -coeffs.damping),
        jet_bound=force_deriv_bound * (1.0 + jet_bound_slope * coeffs.max_step),
        jet_bound_slope=jet_bound_slope,
        drive_terms=tuple(_reverse_term(coeffs, term) for term in coeffs.drive_terms),
    )


def _reverse_term(coeffs, term):
    """Return a drive term with time reversed."""
    series = flow.flow_series(further_drive_terms.term_angular_rate(term, coeffs.frequency), -coeffs.damping)
    return replace(term, sine=-term.sine, series=series)

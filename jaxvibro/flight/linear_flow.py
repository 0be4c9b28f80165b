"""What moves the mass between walls: spring and damper, exactly. The interface is that of `force_flow`.

frame: as the lanes feel it; within a soft wall x is counted from the wall, and bias is what `soft_contact.biases` says.
"""

from dataclasses import replace

import jax.numpy as jnp
from jax import lax

from ..compiled.compiler_hints import choose, stage
from ..scene.typical_scales import fast_part_amplitude
from . import drive, event, flow, soft_contact, wall_motion
from .flight_state import SlowMotion, add_increments
from .taylor import evaluate_taylor

LINEAR = True  # a flight's matrix is the same wherever it begins


def look_ahead(coeffs, path):
    """(frame, None): the longest step is the frame's."""
    return coeffs, None


def event_derivatives(coeffs, path, lookahead, extra_force):
    """x and its derivatives, as many as an event has terms and one."""
    return jet(coeffs, path.x, path.v, path.cosine, path.sine, event.N_TERMS, extra_force)


def lookahead_bounds(lookahead):
    """Nothing: the press and what is beyond the derivatives are the frame's."""


def contact_forces_ahead(coeffs, path, bounds):
    """[(the press on a wall, its derivatives; a bound on one more)] for each wall."""
    force_lists = [contact_force(coeffs, wall, path.cosine, path.sine, event.N_TERMS - 1) for wall in coeffs.walls]
    return list(zip(force_lists, coeffs.force_remainders, strict=True))


def remainder_bound(coeffs, derivatives, bounds, is_sticking, force_remainder, wall_remainder, taylor_weights):
    """What is beyond the terms of an event, in lengths, of lanes that are free and that rest."""
    sixth_deriv, seventh_deriv = (
        flow.spring_force(coeffs.root_stiffness, lax.abs(derivatives[6])),
        lax.abs(derivatives[7]),
    )
    free_remainder = (
        coeffs.max_step * (coeffs.jet_bound + coeffs.jet_bound_slope * (sixth_deriv + seventh_deriv)) + seventh_deriv
    )
    return (choose(is_sticking, force_remainder, free_remainder) + wall_remainder) * taylor_weights[event.N_TERMS]


def advance_motion(coeffs, motion, time, contact, lookahead):
    """The motion a step later."""
    return propagate(coeffs, motion, time, contact)


def propagate(coeffs, motion, time, contact=None):
    """The `SlowMotion` a time later. contact: the lanes' contact, where they may be within a soft wall."""
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
    """(slow_x, slow_x_low, slow_v, slow_v_low) after a flight; increments: what the drive's force is not the cause
    of."""
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
    """The acceleration of a free mass, and its rate of change; extra_force: see `flow.extend`."""
    extra_force = drive.add_term_derivatives(coeffs.drive_terms, coeffs.frequency, cosine, sine, extra_force)
    force_pair = coeffs.amplitude * cosine, -(coeffs.amplitude * sine) * coeffs.frequency
    return flow.extend_jet(coeffs.frequency, coeffs.damping, coeffs.stiffness, force_pair, extra_force, (x, v))[1]


def jet(coeffs, x, v, cosine, sine, order, extra_force=()):
    """x and its derivatives, two at a time so that each is computed once: at least as many as the order."""
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
    """x and its derivatives, one more than the order, at a `taylor.Now`."""
    return _free_jet(coeffs, point.x, point.v, _force_derivatives(coeffs, point, order, extra_force))


def _force_derivatives(coeffs, point, order, extra_force=()):
    """The force and its derivatives, one less than the order."""
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
    """x and its derivatives under these forces."""
    derivs = [x, v]
    for force_deriv in force_derivs:
        derivs.append(force_deriv - flow.spring_force(coeffs.stiffness, derivs[-2]) - 2.0 * coeffs.damping * derivs[-1])
    return derivs


def propagate_back(coeffs, point, x, v, delay, order, extra_force=()):
    """x and v now of a flight that is at x, v a little later."""
    force_derivs = _force_derivatives(coeffs, point, order, extra_force)
    derivs = _free_jet(coeffs, x, v, [evaluate_taylor(force_derivs[k:], delay, order - 1 - k) for k in range(order)])
    return evaluate_taylor(derivs, -delay, order), evaluate_taylor(derivs[1:], -delay, order)


def contact_force(coeffs, wall, cosine, sine, order):
    """How hard a mass that rests on a wall is driven along x relative to it, and its derivatives."""
    force_derivs = wall_motion.contact_force(
        wall, coeffs.amplitude, coeffs.frequency, coeffs.damping, cosine, sine, order
    )
    return drive.add_term_derivatives(coeffs.drive_terms, coeffs.frequency, cosine, sine, force_derivs)


def chatter_bounds(coeffs, side, acceleration, approach_speed, cosine, sine):
    """What says whether hops on a wall end: (how fast the press on it changes at most; the damping; None, as the spring
    draws the mass back)."""
    return wall_motion.select_by_side(side, coeffs.walls, coeffs.force_rate_bounds), coeffs.damping, None


def shortest_step(coeffs, flights):
    """The longest step, however the mass flies."""
    return coeffs.max_step


def fly(coeffs, x, v, cosine, sine, time):
    """(x, v, cosine, sine) after any time >= 0."""
    x, v, angle_pair, _ = _fly_with_responses(coeffs, x, v, cosine, sine, time)
    return x, v, *flow.rotate(cosine, sine, *angle_pair)


def fly_with_matrix(coeffs, x, v, cosine, sine, time):
    """((x, v) a time after; how they change with x, v at the start, a matrix as `response.through` takes it)."""
    x, v, _, free_flow = _fly_with_responses(coeffs, x, v, cosine, sine, time)
    return (x, v), free_flow


def propagate_matrix(coeffs, state, cosine, sine, time):
    """(place, cosine, sine, the flow's matrix by rows) a time after; state: (), as it has no part in the matrix."""
    (p00, p01, p11), _, angle_pair = flow.doubling_responses(coeffs.series, coeffs.frequency, coeffs.damping, time)
    return (), *flow.rotate(cosine, sine, *angle_pair), (p00, p01, -p01, p11)


def _fly_with_responses(coeffs, x, v, cosine, sine, time):
    """(x, v, the drive's turn, the free flow's matrix) a time after."""
    free_flow, forced_flow, angle_pair = flow.doubling_responses(coeffs.series, coeffs.frequency, coeffs.damping, time)
    x, v = flow.apply_responses((free_flow, forced_flow), coeffs.amplitude * cosine, coeffs.amplitude * sine, x, v)
    if coeffs.drive_terms:
        term_responses = drive.term_responses(coeffs.drive_terms, coeffs.frequency, coeffs.damping, time)
        x, v = _add_drive_terms(coeffs, term_responses, cosine, sine, x, v)
    return x, v, angle_pair, free_flow


def _add_drive_terms(coeffs, responses, cosine, sine, x, v):
    """x and v with what the drive's further terms add to them."""
    dx, dv = drive.forced_response(coeffs.drive_terms, responses, coeffs.frequency, cosine, sine)
    return x + dx, v + dv


def flight_map(coeffs, duration):
    """(x, v, cosine, sine) -> the same a time after, for the same time again and again."""
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
    """The frame of the flow with time reversed.

    The energy of x^(6) is at most exp(2 gamma t) times that without damping, for which `coefficients.frame` has its
    bounds.
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
    series = flow.flow_series(drive.angular_rate(term, coeffs.frequency), -coeffs.damping)
    return replace(term, sine=-term.sine, series=series)

"""Fly a mass on a spring and a damper exactly.

The module is a `protocols.Flow`. `coeffs` are the coefficients of each lane. For lanes whose x is relative to a moving
wall, `frame_force` is the additional force.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jax import lax

from ..compiled.lane_arithmetic import call_without_inlining, choose
from ..scene import check
from ..scene.scene_properties import fast_part_amplitude
from . import event_certificates, flow, further_drive_terms, wall_motion
from .flight_coefficients import FlowCoefficients, common_fields
from .flight_state import SlowMotion, add_to_slow_motion
from .power_series import add_coefficients
from .taylor_polynomials import evaluate_taylor

MIN_DENOMINATOR = 1e-3  # lower bound of sqrt(D): at resonance without damping there is no steady motion


def make_coefficients(scene, kinds):
    """Compute the `FlowCoefficients` of a scene with a spring and a damper."""
    damping = jnp.asarray(scene.damping, scene.dtype)
    fields = common_fields(scene, kinds, damping)
    amplitude, frequency, walls, drive_terms = (
        fields[name] for name in ("amplitude", "frequency", "walls", "drive_terms")
    )
    max_angular_rate = flow.max_angular_rate(frequency, damping)
    for wall in walls:
        max_angular_rate = jnp.maximum(
            max_angular_rate, frequency * (wall.harmonic if wall.amplitude is not None else 1.0)
        )
    if drive_terms:
        max_angular_rate = jnp.maximum(
            max_angular_rate, frequency * float(further_drive_terms.highest_harmonic(drive_terms))
        )
    max_step = flow.MAX_SCALED_STEP / max_angular_rate
    # energy of x^(6): abs x^(6), abs x^(7) <= abs x^(6)(0) + abs x^(7)(0) + A omega^6 t; damping lowers it
    force_deriv_bound, jet_bound_slope = (
        further_drive_terms.drive_derivative_bound(drive_terms, amplitude, frequency, 6),
        jnp.sqrt(1.0 + 4.0 * damping * damping),
    )

    def derivative_bounds(order):
        """Return the bounds on the derivatives of the contact force, and of the position, of each wall."""
        return zip(
            *(
                wall_motion.wall_derivative_bounds(wall, amplitude, frequency, damping, order, drive_terms)
                for wall in walls
            ),
            strict=True,
        )

    force_remainder_bounds, wall_remainder_bounds = derivative_bounds(event_certificates.N_TERMS) if walls else ((), ())
    force_rate_bounds, _ = derivative_bounds(1) if walls else ((), ())
    return FlowCoefficients(
        **fields,
        damping=damping,
        in_phase_amplitude=fast_part_amplitude(frequency, damping, amplitude),
        series=flow.flow_series(frequency, damping),
        max_step=max_step,
        inverse_max_step=max_angular_rate / flow.MAX_SCALED_STEP,
        taylor_weights=event_certificates.taylor_weights(max_step),
        jet_bound=force_deriv_bound * (1.0 + jet_bound_slope * max_step),
        jet_bound_slope=jet_bound_slope,
        force_remainder_bounds=force_remainder_bounds,
        wall_remainder_bounds=wall_remainder_bounds,
        force_rate_bounds=force_rate_bounds,
    )


def steady_amplitude(scene, amplitude, frequency):
    """Return the amplitude of the steady motion under a harmonic force; bounded at resonance by `MIN_DENOMINATOR`."""
    damping = np.asarray(scene.damping, float)
    return amplitude / np.maximum(
        np.hypot((1.0 - frequency) * (1.0 + frequency), 2.0 * damping * frequency), MIN_DENOMINATOR
    )


def rates(scene):
    """Return the rate of the spring, that of the drive and that of the damping."""
    return [1.0, float(scene.frequency), 2.0 * float(scene.damping)]


def loses_energy(scene):
    """Return True if the scene or a soft wall is damped."""
    return any(bool(scene.parameter(name) > 0) for name in scene.names if name.endswith("damping"))


def areas_may_grow():
    """Return False: the determinant of a flight is at most 1."""
    return False


def has_unique_free_response():
    """Return True, because the equations of an orbit without impacts are linear."""
    return True


def require_reversible(scene):
    """Raise an error if the damping is too large for time reversal."""
    if not scene.damping < 1:
        raise check.ArgumentError("damping", "must be less than 1 for the inverse map", scene.damping)


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


def advance_motion(coeffs, motion, time, lookahead):
    """Return the motion after a step."""
    return propagate_motion(coeffs, motion, time)


def propagate_motion(coeffs, motion, time):
    """Return the `SlowMotion` after a time of at most one step."""
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
    slow_parts = call_without_inlining(_slow_parts_after_flight, coeffs, motion, propagator, extra_increments)
    return rotate_drive(slow_parts, motion, propagator)


def rotate_drive(slow_parts, motion, propagator):
    """Return the `SlowMotion` after a flight from its first four fields."""
    return SlowMotion(
        *slow_parts,
        *call_without_inlining(flow.rotate_phasor, *motion[4:], propagator.cos_less_1, propagator.sin_angle),
    )


def slow_force(coeffs, motion):
    """Return the parts (cosine, sine) of the force on the slow part of the motion."""
    gamma_omega = coeffs.damping * coeffs.frequency
    return (
        -2.0 * coeffs.in_phase_amplitude * (motion.cosine + gamma_omega * (motion.cosine - motion.sine)),
        -2.0 * coeffs.in_phase_amplitude * (motion.sine + gamma_omega * (motion.sine + motion.cosine)),
    )


def _slow_parts_after_flight(coeffs, motion, propagator, extra_increments):
    """Return the first four fields of the `SlowMotion` after a flight between the walls."""
    return slow_parts_after_flight(coeffs, motion, propagator, extra_increments, *slow_force(coeffs, motion))


def slow_parts_after_flight(coeffs, motion, propagator, extra_increments, force_cos, force_sin):
    """Return the first four fields of the `SlowMotion` after a flight.

    `extra_increments` are increments of x and v in addition to those due to the force on the slow part, see
    `slow_force`. None stands for zero.
    """
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
    drive_force_derivs = further_drive_terms.harmonic_derivatives(
        coeffs.amplitude * expansion_point.cosine,
        coeffs.amplitude * expansion_point.sine,
        coeffs.frequency,
        order - 1,
    )
    extra_derivs = further_drive_terms.add_term_derivatives(
        coeffs.drive_terms,
        coeffs.frequency,
        expansion_point.cosine,
        expansion_point.sine,
        [*frame_force, *[None] * order][:order],
    )
    return [
        add_coefficients(force_deriv, extra_deriv)
        for force_deriv, extra_deriv in zip(drive_force_derivs, extra_derivs, strict=True)
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
    """Return (bound on the time derivative of the contact force, damping, bound on the force gradient) for chatter.

    The bound on the force gradient is 1, because the derivative of the spring force with respect to x is -1.
    """
    return wall_motion.select_by_side(side, coeffs.walls, coeffs.force_rate_bounds), coeffs.damping, 1.0


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


def matrix_state(x, v):
    """Return the empty tuple, because the matrix of the linear flow does not depend on x and v."""
    return ()


def propagate_with_matrix(coeffs, state, cosine, sine, time):
    """Return (`matrix_state`, cosine, sine, matrix of the flow by rows) after a time."""
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
    damping, for which `make_coefficients` computes the bounds.
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

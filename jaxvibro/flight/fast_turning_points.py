"""Measure the clearance of fast steps at the turning points of x - x_b, where the mass misses a wall.

A measurement changes neither the steps of a lane nor its state, unless it gives up the lane. A sign change of the speed
of x - x_b within a step follows from this speed and its first two derivatives at both ends of the step. They determine
a quintic, which is written in Bernstein form and whose error is bounded. If the Bernstein coefficients change sign at
most once beyond the error, the speed also does. Otherwise the lane is in doubt and is given up. A step with a turning
point is recorded. Its clearance is measured when the lane passes the next turning point.

The code of a `recorded_turns.StepWithTurningPoint` is its signed span: the length of its step times the sign of the
wall. It is 0 without a turning point, and `DOUBTFUL` if the lane is in doubt.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import (
    call_without_inlining,
    choose,
    maximum,
    minimum,
    positive_part,
)
from . import event_certificates, fast_event, fast_motion, flow, recorded_turns
from .event_certificates import N_TERMS
from .fast_coefficients import GIVEN_UP
from .recorded_turns import ClosestApproaches
from .turning_points import halley_correction
from .wall_motion import select_lists_by_side, subtract_optional, wall_jet

DOUBTFUL = 2.0  # span that marks a lane in doubt; all other spans are at most one longest step
TIME_TOLERANCE = 2.0**-7  # in longest steps; accuracy of the turning time from the expansion at the start of a step
SPEED_TOLERANCE = 2.0**-40  # in largest lengths of a lane per longest step; far above the rounding of a speed
QUINTIC_ERROR = 7.0 / 20.0  # error of the quintic's middle coefficient, as a multiple of the remainder


class StepStart(NamedTuple):
    """Motion at the start of a step.

    Attributes
    ----------
    x : array
        Position.
    v : array
        Velocity.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.
    """

    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]


def empty_approaches(lanes_template):
    """Return `ClosestApproaches` without turning points, for lanes with the shape of a template."""
    zero = jnp.zeros_like(lanes_template)
    return recorded_turns.empty_approaches(zero, StepStart(*[zero] * 4))


def reject_doubtful_starts(coeffs, lanes):
    """Give up lanes whose speed relative to a moving wall is too close to zero to have a certain sign."""
    return (
        lanes
        if coeffs.has_fixed_walls
        else lanes._replace(time_remaining=call_without_inlining(_time_after_start_check, coeffs, lanes))
    )


def _time_after_start_check(coeffs, lanes):
    is_certain = lax.full_like(lanes.x, True, dtype=bool)
    for speed, _, _ in _relative_speed_jets(coeffs, lanes.x, lanes.v, lanes.cosine, lanes.sine):
        is_certain &= lax.abs(speed) > fast_event.DOUBT_MARGIN * lanes.largest_length
    return choose(is_certain | (lanes.time_remaining <= 0), lanes.time_remaining, GIVEN_UP)


def record_turning_point(
    coeffs, lanes_before, lanes_after, impact_velocity, step_time, delay, hit_side, remainder_bound, approaches
):
    """Return (approaches, remaining time) after a step; the remaining time is GIVEN_UP for a lane in doubt.

    `lanes_before` and `lanes_after` are the `LaneStates` around the step. `impact_velocity` is v before the impact.
    """
    new_signed_span = call_without_inlining(
        _turning_point_span,
        coeffs,
        lanes_before,
        lanes_after,
        impact_velocity,
        step_time,
        delay,
        hit_side,
        remainder_bound,
    )
    start = StepStart(lanes_before.x, lanes_before.v, lanes_before.cosine, lanes_before.sine)
    return recorded_turns.record_step(approaches, start, new_signed_span, DOUBTFUL), call_without_inlining(
        _time_unless_doubtful, new_signed_span, lanes_after.time_remaining
    )


def _time_unless_doubtful(new_signed_span, time_remaining):
    """Return the remaining time, GIVEN_UP for lanes whose turning point is in doubt."""
    return choose(new_signed_span == DOUBTFUL, GIVEN_UP, time_remaining)


def _relative_speed_jets(coeffs, x, v, cosine, sine):
    """Return speeds with two derivatives: the speed relative to each moving wall, or only x' if all walls are fixed."""
    acceleration = fast_motion.evaluate_acceleration(coeffs, x, v, (cosine, sine))
    jerk = fast_motion.evaluate_jerk(coeffs, v, acceleration, sine)
    if coeffs.has_fixed_walls:
        return [(v, acceleration, jerk)]
    wall_derivs = [wall_jet(wall, coeffs.frequency, cosine, sine, 3)[1:] for wall in coeffs.walls]
    return [
        tuple(
            wall.sign * subtract_optional(mass_deriv, wall_deriv)
            for mass_deriv, wall_deriv in zip((v, acceleration, jerk), derivs_of_wall, strict=True)
        )
        for wall, derivs_of_wall in zip(coeffs.walls, wall_derivs, strict=True)
    ]


def _turning_point_span(
    coeffs, lanes_before, lanes_after, impact_velocity, step_time, delay, hit_side, flight_remainder_bound
):
    """Return the signed span of a step's turning point, 0 if there is none, DOUBTFUL if this is uncertain.

    A step that hits a fixed wall has no turning point, because the mass certainly approaches the wall throughout.
    """
    start_jets = _relative_speed_jets(coeffs, lanes_before.x, lanes_before.v, lanes_before.cosine, lanes_before.sine)
    end_jets = _relative_speed_jets(coeffs, lanes_after.x, impact_velocity, lanes_after.cosine, lanes_after.sine)
    step_time = step_time + delay
    signed_span, is_certain = lax.full_like(step_time, 0.0), lax.full_like(step_time, True, dtype=bool)
    is_at_period_end = lanes_after.time_remaining == 0
    for wall_index, (start_jet, end_jet) in enumerate(zip(start_jets, end_jets, strict=True)):
        remainder_bound = (
            flight_remainder_bound
            if coeffs.has_fixed_walls
            else flight_remainder_bound + coeffs.wall_remainder_bounds[wall_index]
        )
        initial_speed_sign, changes_at_most_once = _sign_change_test(
            start_jet,
            end_jet,
            step_time,
            QUINTIC_ERROR * remainder_bound,
            SPEED_TOLERANCE * lanes_before.largest_length,
        )
        turns_back = initial_speed_sign * end_jet[0] <= 0
        is_certain &= changes_at_most_once & ~(
            is_at_period_end & (lax.abs(end_jet[0]) <= fast_event.DOUBT_MARGIN * lanes_before.largest_length)
        )
        if coeffs.has_fixed_walls and len(coeffs.walls) == 2:
            side = initial_speed_sign
        else:
            wall_sign = float(coeffs.walls[wall_index].sign)
            side, turns_back = (
                wall_sign,
                turns_back
                & ((initial_speed_sign == wall_sign) if coeffs.has_fixed_walls else (initial_speed_sign > 0)),
            )
        is_certain &= ~turns_back | (signed_span == 0)
        signed_span = choose(turns_back, side * step_time, signed_span)
    is_in_free_flight = lanes_before.time_remaining > 0
    if coeffs.has_fixed_walls:
        is_in_free_flight &= hit_side == 0
    return choose(is_in_free_flight, choose(is_certain, signed_span, DOUBTFUL), 0.0)


def _sign_change_test(start_jet, end_jet, step_time, quintic_error_bound, speed_tolerance):
    """Return (initial sign of a speed, True if it certainly changes sign at most once) over a step.

    The test uses the quintic with the speed and its two derivatives at both ends, in Bernstein form of degree 6. At the
    fraction t of the step the speed differs from the quintic by at most 20 e t^3 (1 - t)^3, where e is
    `quintic_error_bound` times the sixth power of the length of the step. This is an error e of the middle coefficient.
    The speed is multiplied by its initial sign, so that the first coefficient is not negative."""
    time_squared = step_time * step_time
    quintic_error_bound = quintic_error_bound * (time_squared * time_squared * time_squared)
    initial_speed_sign = lax.sign(choose(start_jet[0] == 0, start_jet[1], start_jet[0]))
    (v0, a0, j0), (v1, a1, j1) = (
        (
            initial_speed_sign * speed,
            (initial_speed_sign * step_time) * acceleration,
            (initial_speed_sign * time_squared) * jerk,
        )
        for speed, acceleration, jerk in (start_jet, end_jet)
    )
    bernstein_3 = 0.5 * (v0 + v1) + 0.2 * (a0 - a1) + (1 / 40) * (j0 + j1)
    bernstein_2, bernstein_4 = v0 + (1 / 3) * a0 + (1 / 30) * j0, v1 - (1 / 3) * a1 + (1 / 30) * j1
    bernstein_1, bernstein_5 = v0 + (1 / 6) * a0, v1 - (1 / 6) * a1
    certainty_margin = minimum(
        maximum(bernstein_1, -bernstein_2), maximum(bernstein_2, -(bernstein_3 + quintic_error_bound))
    )
    certainty_margin = minimum(
        certainty_margin,
        minimum(maximum(bernstein_3 - quintic_error_bound, -bernstein_4), maximum(bernstein_4, -bernstein_5)),
    )
    return initial_speed_sign, minimum(certainty_margin, maximum(bernstein_5, -v1)) > speed_tolerance


def measure_pending_turns(coeffs, time_remaining, approaches):
    """Measure pending turning points: return (approaches, remaining time); the latest turning points become pending.

    The Taylor polynomial at the start of the step gives the time of a turning point with an error below
    `TIME_TOLERANCE`. One Halley step and one Newton step, from the motion at that time, refine the time. The remaining
    time is GIVEN_UP for a lane in doubt.
    """
    turning_step, signed_span = approaches.pending_turn
    side, drive_forces = (
        call_without_inlining(_span_side, signed_span),
        call_without_inlining(fast_motion.drive_forces, coeffs, turning_step.cosine, turning_step.sine),
    )
    phasors = fast_event.compute_wall_phasors(coeffs, turning_step)
    speed_terms = [
        call_without_inlining(_approach_speed_term, coeffs, turning_step, drive_forces, phasors, side, k=k)
        for k in range(1, N_TERMS)
    ]
    turning_time = call_without_inlining(_quadratic_speed_zero, speed_terms, signed_span)
    for _ in range(2):
        turning_time = call_without_inlining(_halley_time_step, speed_terms, turning_time, signed_span)
    propagator = call_without_inlining(flow.step_propagator, coeffs.economised_series, coeffs.frequency, turning_time)
    x, v = call_without_inlining(
        fast_motion.propagate_free_flight, coeffs, turning_step.x, turning_step.v, drive_forces, propagator
    )
    phasor = call_without_inlining(
        flow.rotate_phasor, turning_step.cosine, turning_step.sine, propagator.cos_less_1, propagator.sin_angle
    )
    approach_derivs = [
        call_without_inlining(_approach_derivative, coeffs, x, v, phasor, side, order=k) for k in range(6)
    ]
    first_time_correction = call_without_inlining(halley_correction, *approach_derivs[1:4])
    clearance = call_without_inlining(
        _turning_clearance, approach_derivs, first_time_correction, turning_time, signed_span
    )
    least_clearance, time_remaining = (
        call_without_inlining(_update_least_clearance, approaches.least_clearance, signed_span, clearance),
        call_without_inlining(_time_unless_uncertain, time_remaining, signed_span, clearance),
    )
    latest_turn = approaches.latest_turn
    no_turn = latest_turn._replace(code=jnp.zeros_like(latest_turn.code))
    return ClosestApproaches(least_clearance, latest_turn, no_turn), time_remaining


def _span_side(signed_span):
    """Return the side of the wall of a turning point."""
    return choose(signed_span < 0, lax.full_like(signed_span, -1.0), 1.0)


def _approach_speed_term(coeffs, turning_step, drive_forces, phasors, side, k):
    """Return a Taylor coefficient of the speed towards the wall, from the coefficient of G (`fast_event`)."""
    return float(k) * fast_event.event_polynomial_term(coeffs, turning_step, drive_forces, phasors, side, k)


def _quadratic_speed_zero(speed_terms, signed_span):
    """Return the zero within the step of the quadratic with the speeds at both ends and the initial slope."""
    time = lax.abs(signed_span)
    end_speed, start_speed, slope = (
        event_certificates.horner_with_slope(speed_terms, time)[0],
        speed_terms[0],
        speed_terms[1] * time,
    )
    discriminant = slope * slope + 4.0 * start_speed * ((slope + start_speed) - end_speed)
    return 2.0 * time * (start_speed / (lax.sqrt(positive_part(discriminant)) - slope))


def _halley_time_step(speed_terms, turning_time, signed_span):
    """Improve the time of the turning point by one Halley step within the step."""
    speed_value, slope = event_certificates.horner_with_slope(speed_terms, turning_time)
    curvature = event_certificates.horner_with_slope(
        [float(k) * term for k, term in enumerate(speed_terms)][1:], turning_time
    )[1]
    return lax.clamp(
        lax.full_like(signed_span, 0.0),
        turning_time + halley_correction(speed_value, slope, curvature),
        lax.abs(signed_span),
    )


def _approach_derivative(coeffs, x, v, phasor, side, order):
    """Return a derivative of G, the negative clearance of the wall on a side."""
    force_derivs = [coeffs.amplitude * phasor[0], -(coeffs.frequency * coeffs.amplitude) * phasor[1]]
    derivs = [x, v]
    for lower_order in range(order - 1):
        if lower_order > 1:
            force_derivs.append(-(coeffs.frequency * coeffs.frequency) * force_derivs[lower_order - 2])
        derivs.append(
            force_derivs[lower_order] - coeffs.stiffness * derivs[lower_order] - coeffs.drag * derivs[lower_order + 1]
        )
    wall_derivs = [wall_jet(wall, coeffs.frequency, *phasor, max(order, 1)) for wall in coeffs.walls]
    return side * subtract_optional(derivs[order], select_lists_by_side(side, coeffs.walls, wall_derivs)[order])


def _turning_clearance(approach_derivs, first_time_correction, turning_time, signed_span):
    """Return the clearance at the turning point, -1 if it is uncertain."""
    relative_position, relative_speed, acceleration, jerk, fourth_deriv, fifth_deriv = approach_derivs
    accel_after_first = acceleration + first_time_correction * (
        jerk + first_time_correction * (0.5 * fourth_deriv + first_time_correction * (fifth_deriv / 6.0))
    )
    speed_after_first = relative_speed + first_time_correction * (
        acceleration
        + first_time_correction
        * (0.5 * jerk + first_time_correction * (fourth_deriv / 6.0 + first_time_correction * (fifth_deriv / 24.0)))
    )
    second_time_correction = -speed_after_first / accel_after_first
    time_correction = first_time_correction + second_time_correction
    half_accel_mean = acceleration / 2.0 + time_correction * (
        jerk / 6.0 + time_correction * (fourth_deriv / 24.0 + time_correction * (fifth_deriv / 120.0))
    )
    correction_size, step_end_tolerance = (
        lax.abs(first_time_correction),
        TIME_TOLERANCE * TIME_TOLERANCE * TIME_TOLERANCE,
    )
    is_certain = (
        (correction_size <= TIME_TOLERANCE)
        & (lax.abs(second_time_correction) <= TIME_TOLERANCE * (correction_size + step_end_tolerance))
        & (8.0 * correction_size * lax.abs(jerk) <= -acceleration)
    )
    is_certain &= (turning_time + time_correction >= -step_end_tolerance) & (
        turning_time + time_correction <= lax.abs(signed_span) + step_end_tolerance
    )
    return choose(
        is_certain, -(relative_position + time_correction * (relative_speed + time_correction * half_accel_mean)), -1.0
    )


def _update_least_clearance(least_clearance, signed_span, clearance):
    """Return the smallest clearance including a new one."""
    return choose((signed_span != 0) & (clearance >= 0), minimum(clearance, least_clearance), least_clearance)


def _time_unless_uncertain(time_remaining, signed_span, clearance):
    """Return the remaining time, GIVEN_UP for lanes whose clearance is uncertain."""
    return choose((signed_span == 0) | (clearance >= 0), time_remaining, GIVEN_UP)

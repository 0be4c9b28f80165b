"""Measure the clearance of fast steps at the turning points of x - x_b, where the mass misses a wall.

The clearances do not change the steps of a lane or any bit of its state. A sign change of the speed of x - x_b within a
step follows from this speed and its first two derivatives at both ends. The quintic with these values is written in
Bernstein form, and the error of the quintic is bounded. If its coefficients change sign at most once, so does the
speed. Otherwise the lane is in doubt and is given up. A step with a turning point is recorded, and measured when its
lane passes the next turning point.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import bit_mask, choose, maximum, merge_bits, minimum, positive_part, stage
from . import event, fast_event, fast_motion, flow
from .event import N_TERMS
from .fast_coefficients import GIVEN_UP
from .wall_motion import select_lists_by_side, subtract, wall_jet

DOUBTFUL = 2.0  # span that marks a lane in doubt; all other spans are at most one longest step
TIME_TOLERANCE = 2.0**-7  # in longest steps; accuracy of the turning time from the expansion at the start of a step
SPEED_TOLERANCE = 2.0**-40  # in largest lengths of a lane per longest step; far above the rounding of a speed
QUINTIC_ERROR = 7.0 / 20.0  # error of the quintic's middle coefficient, as a multiple of the remainder


class FastTurningPoint(NamedTuple):
    """Step with a turning point.

    `x`, `v`, `cosine` and `sine` are the state at its start. `signed_span` is its length times the sign of the wall,
    and 0 without a turning point.
    """

    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    signed_span: Float[jax.Array, "*lanes"]


class FastClosestApproaches(NamedTuple):
    """Smallest clearance, the turning point to be measured, and the one of the last step."""

    least_clearance: Float[jax.Array, "*lanes"]
    pending: FastTurningPoint
    latest: FastTurningPoint


def no_turning_points(template):
    """Return the record without turning points, for lanes with the shape of a template."""
    zero = jnp.zeros_like(template)
    turning_point = FastTurningPoint(*[zero] * 5)
    return FastClosestApproaches(jnp.full_like(template, jnp.inf), turning_point, turning_point)


def check_start(coeffs, lanes):
    """Give up lanes whose speed relative to a moving wall is too close to zero to have a certain sign."""
    return lanes if coeffs.has_fixed_walls else lanes._replace(time_remaining=stage(_check_start, coeffs, lanes))


def _check_start(coeffs, lanes):
    is_certain = lax.full_like(lanes.x, True, dtype=bool)
    for speed, _, _ in _approach_jets(coeffs, lanes.x, lanes.v, lanes.cosine, lanes.sine):
        is_certain &= lax.abs(speed) > fast_event.DOUBT_MARGIN * lanes.largest_length
    return choose(is_certain | (lanes.time_remaining <= 0), lanes.time_remaining, GIVEN_UP)


def record_turning_point(
    coeffs, lanes_before, lanes_after, impact_velocity, time, delay, hit_side, remainder, approaches
):
    """Return (approaches, remaining time) after a step; the remaining time is GIVEN_UP for a lane in doubt.

    `lanes_before` and `lanes_after` are the `LaneStates` around the step. `impact_velocity` is v before the impact.
    """
    new_span = stage(
        _turning_span, coeffs, lanes_before, lanes_after, impact_velocity, time, delay, hit_side, remainder
    )
    record_mask, latest_span = stage(_split_new, approaches.pending.signed_span, new_span)
    start_state = lanes_before.x, lanes_before.v, lanes_before.cosine, lanes_before.sine
    pending = FastTurningPoint(
        *(
            merge_bits(record_mask, new_span, old_value)
            for new_span, old_value in zip((*start_state, new_span), approaches.pending, strict=True)
        )
    )
    return FastClosestApproaches(
        approaches.least_clearance, pending, FastTurningPoint(*start_state, latest_span)
    ), stage(_give_up_doubtful, new_span, lanes_after.time_remaining)


def _split_new(pending_span, new_span):
    """Return the mask of lanes without a pending turning point, and the spans of the other lanes."""
    is_certain = lax.abs(new_span) < DOUBTFUL
    return bit_mask((pending_span == 0) & (new_span != 0) & is_certain, new_span), choose(
        (pending_span != 0) & is_certain, new_span, 0.0
    )


def _give_up_doubtful(new_span, time_remaining):
    """Return the remaining time, GIVEN_UP for lanes whose turning point is in doubt."""
    return choose(new_span == DOUBTFUL, GIVEN_UP, time_remaining)


def needs_measurement(approaches):
    """Return the lanes with a second turning point while one is pending, for which `measure_pending` is due."""
    return approaches.latest.signed_span != 0


def has_pending(approaches):
    """Return the lanes with a pending turning point."""
    return approaches.pending.signed_span != 0


def _approach_jets(coeffs, x, v, cosine, sine):
    """Return the monitored speeds with two derivatives: those relative to each moving wall, or x' for fixed walls."""
    acceleration = fast_motion.evaluate_acceleration(coeffs, x, v, (cosine, sine))
    jerk = fast_motion.evaluate_jerk(coeffs, v, acceleration, sine)
    if coeffs.has_fixed_walls:
        return [(v, acceleration, jerk)]
    wall_derivs = [wall_jet(wall, coeffs.frequency, cosine, sine, 3)[1:] for wall in coeffs.walls]
    return [
        tuple(
            wall.sign * subtract(mass_deriv, wall_deriv)
            for mass_deriv, wall_deriv in zip((v, acceleration, jerk), derivs, strict=True)
        )
        for wall, derivs in zip(coeffs.walls, wall_derivs, strict=True)
    ]


def _turning_span(coeffs, lanes_before, lanes_after, impact_velocity, step_time, delay, hit_side, remainder):
    """Return the span of a step's turning point, 0 if there is none, DOUBTFUL if this is uncertain.

    A step that hits a fixed wall has none, because x - x_b certainly rises throughout.
    """
    start_jets = _approach_jets(coeffs, lanes_before.x, lanes_before.v, lanes_before.cosine, lanes_before.sine)
    end_jets = _approach_jets(coeffs, lanes_after.x, impact_velocity, lanes_after.cosine, lanes_after.sine)
    step_time = step_time + delay
    signed_span, is_certain = lax.full_like(step_time, 0.0), lax.full_like(step_time, True, dtype=bool)
    at_period_end = lanes_after.time_remaining == 0
    for k, (start_jet, end_jet) in enumerate(zip(start_jets, end_jets, strict=True)):
        remainder_bound = remainder if coeffs.has_fixed_walls else remainder + coeffs.wall_remainders[k]
        initial_sign, changes_once = _changes_sign_once(
            start_jet,
            end_jet,
            step_time,
            QUINTIC_ERROR * remainder_bound,
            SPEED_TOLERANCE * lanes_before.largest_length,
        )
        turns_back = initial_sign * end_jet[0] <= 0
        is_certain &= changes_once & ~(
            at_period_end & (lax.abs(end_jet[0]) <= fast_event.DOUBT_MARGIN * lanes_before.largest_length)
        )
        if coeffs.has_fixed_walls and len(coeffs.walls) == 2:
            side = initial_sign
        else:
            wall_sign = float(coeffs.walls[k].sign)
            side, turns_back = (
                wall_sign,
                turns_back & ((initial_sign == wall_sign) if coeffs.has_fixed_walls else (initial_sign > 0)),
            )
        is_certain &= ~turns_back | (signed_span == 0)
        signed_span = choose(turns_back, side * step_time, signed_span)
    is_free = lanes_before.time_remaining > 0
    if coeffs.has_fixed_walls:
        is_free &= hit_side == 0
    return choose(is_free, choose(is_certain, signed_span, DOUBTFUL), 0.0)


def _changes_sign_once(start_jet, end_jet, step_time, error_bound, tolerance):
    """Return (initial sign of a speed, True if it certainly changes sign at most once) over a step.

    The test uses the quintic with the values and two derivatives at both ends, in Bernstein form of degree 6. The speed
    differs from the quintic by at most 20 error_bound t^3 (1 - t)^3, which is error_bound in the middle coefficient.
    The first coefficient is not negative.
    """
    time_squared = step_time * step_time
    error_bound = error_bound * (time_squared * time_squared * time_squared)
    initial_sign = lax.sign(choose(start_jet[0] == 0, start_jet[1], start_jet[0]))
    (v0, a0, j0), (v1, a1, j1) = (
        (initial_sign * speed, (initial_sign * step_time) * acceleration, (initial_sign * time_squared) * jerk)
        for speed, acceleration, jerk in (start_jet, end_jet)
    )
    coeff_3 = 0.5 * (v0 + v1) + 0.2 * (a0 - a1) + (1 / 40) * (j0 + j1)
    coeff_2, coeff_4 = v0 + (1 / 3) * a0 + (1 / 30) * j0, v1 - (1 / 3) * a1 + (1 / 30) * j1
    coeff_1, coeff_5 = v0 + (1 / 6) * a0, v1 - (1 / 6) * a1
    certainty = minimum(maximum(coeff_1, -coeff_2), maximum(coeff_2, -(coeff_3 + error_bound)))
    certainty = minimum(certainty, minimum(maximum(coeff_3 - error_bound, -coeff_4), maximum(coeff_4, -coeff_5)))
    return initial_sign, minimum(certainty, maximum(coeff_5, -v1)) > tolerance


def measure_pending(coeffs, time_remaining, approaches):
    """Measure pending turning points: return (approaches, remaining time); the latest turning points become pending.

    The time comes from the polynomial at the start of the step, with an error below `TIME_TOLERANCE`. One Halley step
    and one Newton step from the motion at that time refine it. The remaining time is GIVEN_UP for a lane in doubt.
    """
    turning_point = approaches.pending
    side, drive_forces = (
        stage(_span_side, turning_point.signed_span),
        stage(fast_motion.drive_forces, coeffs, turning_point.cosine, turning_point.sine),
    )
    phasors = fast_event.wall_phasors(coeffs, turning_point)
    speed_terms = [
        stage(_speed_term, coeffs, turning_point, drive_forces, phasors, side, k=k) for k in range(1, N_TERMS)
    ]
    time = stage(_quadratic_crossing, speed_terms, turning_point.signed_span)
    for _ in range(2):
        time = stage(_halley_update, speed_terms, time, turning_point.signed_span)
    propagator = stage(flow.step_propagator, coeffs.short_series, coeffs.frequency, time)
    x, v = stage(fast_motion.propagate, coeffs, turning_point.x, turning_point.v, drive_forces, propagator)
    phasor = stage(flow.rotate, turning_point.cosine, turning_point.sine, propagator.cos_less_1, propagator.sin_angle)
    progress_derivs = [stage(_progress_derivative, coeffs, x, v, phasor, side, k=k) for k in range(6)]
    first_correction = stage(_halley_correction, *progress_derivs[1:4])
    clearance = stage(_turning_clearance, progress_derivs, first_correction, time, turning_point.signed_span)
    least_clearance, time_remaining = (
        stage(_update_least, approaches.least_clearance, turning_point.signed_span, clearance),
        stage(_keep_certain, time_remaining, turning_point.signed_span, clearance),
    )
    latest = approaches.latest
    return FastClosestApproaches(
        least_clearance, latest, latest._replace(signed_span=jnp.zeros_like(latest.signed_span))
    ), time_remaining


def _span_side(signed_span):
    """Return the side of the wall of a turning point."""
    return choose(signed_span < 0, lax.full_like(signed_span, -1.0), 1.0)


def _speed_term(coeffs, turning_point, drive_forces, phasors, side, k):
    """Return a Taylor coefficient of the speed towards the wall, from that of the progress."""
    return float(k) * fast_event.progress_term(coeffs, turning_point, drive_forces, phasors, side, k)


def _quadratic_crossing(speed_terms, signed_span):
    """Return the zero within the step of the quadratic with the speeds at both ends and the initial slope."""
    time = lax.abs(signed_span)
    end_speed, start_speed, slope = event.horner_with_slope(speed_terms, time)[0], speed_terms[0], speed_terms[1] * time
    discriminant = slope * slope + 4.0 * start_speed * ((slope + start_speed) - end_speed)
    return 2.0 * time * (start_speed / (lax.sqrt(positive_part(discriminant)) - slope))


def _halley_update(speed_terms, time, signed_span):
    """Improve the time of the turning point by one Halley step within the step."""
    value, slope = event.horner_with_slope(speed_terms, time)
    curvature = event.horner_with_slope([float(k) * term for k, term in enumerate(speed_terms)][1:], time)[1]
    return lax.clamp(
        lax.full_like(signed_span, 0.0), time + _halley_correction(value, slope, curvature), lax.abs(signed_span)
    )


def _halley_correction(value, slope, curvature):
    """Return the correction of a Halley step."""
    return -2.0 * value * slope / (2.0 * slope * slope - value * curvature)


def _progress_derivative(coeffs, x, v, phasor, side, k):
    """Return the k-th derivative of the progress towards the wall on a side."""
    force_derivs = [coeffs.amplitude * phasor[0], -(coeffs.frequency * coeffs.amplitude) * phasor[1]]
    derivs = [x, v]
    for j in range(k - 1):
        if j > 1:
            force_derivs.append(-(coeffs.frequency * coeffs.frequency) * force_derivs[j - 2])
        derivs.append(force_derivs[j] - coeffs.stiffness * derivs[j] - coeffs.drag * derivs[j + 1])
    wall_derivs = [wall_jet(wall, coeffs.frequency, *phasor, max(k, 1)) for wall in coeffs.walls]
    return side * subtract(derivs[k], select_lists_by_side(side, coeffs.walls, wall_derivs)[k])


def _turning_clearance(progress_derivs, first_correction, time, signed_span):
    """Return the clearance at the turning point, -1 if it is uncertain."""
    position, speed, acceleration, jerk, fourth_deriv, fifth_deriv = progress_derivs
    accel_at_first = acceleration + first_correction * (
        jerk + first_correction * (0.5 * fourth_deriv + first_correction * (fifth_deriv / 6.0))
    )
    speed_at_first = speed + first_correction * (
        acceleration
        + first_correction
        * (0.5 * jerk + first_correction * (fourth_deriv / 6.0 + first_correction * (fifth_deriv / 24.0)))
    )
    second_correction = -speed_at_first / accel_at_first
    correction = first_correction + second_correction
    half_accel_mean = acceleration / 2.0 + correction * (
        jerk / 6.0 + correction * (fourth_deriv / 24.0 + correction * (fifth_deriv / 120.0))
    )
    correction_size, edge_tolerance = lax.abs(first_correction), TIME_TOLERANCE * TIME_TOLERANCE * TIME_TOLERANCE
    is_certain = (
        (correction_size <= TIME_TOLERANCE)
        & (lax.abs(second_correction) <= TIME_TOLERANCE * (correction_size + edge_tolerance))
        & (8.0 * correction_size * lax.abs(jerk) <= -acceleration)
    )
    is_certain &= (time + correction >= -edge_tolerance) & (time + correction <= lax.abs(signed_span) + edge_tolerance)
    return choose(is_certain, -(position + correction * (speed + correction * half_accel_mean)), -1.0)


def _update_least(least_clearance, signed_span, clearance):
    """Return the smallest clearance including a new one."""
    return choose((signed_span != 0) & (clearance >= 0), minimum(clearance, least_clearance), least_clearance)


def _keep_certain(time_remaining, signed_span, clearance):
    """Return the remaining time, GIVEN_UP for lanes whose clearance is uncertain."""
    return choose((signed_span == 0) | (clearance >= 0), time_remaining, GIVEN_UP)

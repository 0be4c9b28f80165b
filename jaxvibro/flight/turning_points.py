"""Measure the clearance of a flight at the turning points of x - x_b, where the mass misses a wall.

A step with a turning point is recorded. The clearance is measured only when the lane passes the next turning point,
because a block of lanes would otherwise require a measurement at almost every step.

The start of a `StepWithTurningPoint` is (motion, length of the step). Its code is the sign of the wall times (a guess
of the time since the start + the longest step). The magnitude is larger by `DOUBLE_TURN_CODE` longest steps if the
motion turns back from the other wall as well.
"""

import math

import jax
import jax.numpy as jnp
from jax import lax

from ..compiled.lane_arithmetic import call_without_inlining, choose, maximum, minimum
from ..scene.state import Contact
from . import event_certificates, recorded_turns
from .flight_state import SlowMotion, state_of_slow_motion
from .recorded_turns import ClosestApproaches, StepWithTurningPoint
from .wall_motion import subtract_optional, wall_jet, wall_jet_on_side

DOUBLE_TURN_CODE = 4.0  # added to the code of two turning points, in longest steps
N_TERMS = 9  # degree of the Taylor polynomial of x, an odd number
NEWTON_STEPS = 8  # Newton steps on this polynomial
ROOT_TOLERANCE = 1e-3  # tolerance of its root, in longest steps
MAX_FIRST_STEP = 1.8  # largest multiple of Newton's first step from an end; beyond it lies the other turning point
# slightly over 2; from a turning point this leads beyond the extremum of the speed and the other turning point
OTHER_TURN_FACTOR = 2.2
# error of a cubic through the speeds at the ends of a step, relative to the change of the acceleration
CUBIC_ERROR = 0.05


def empty_approaches(lanes_template):
    """Return `ClosestApproaches` without turning points, for lanes with the shape of a template."""
    zero = jnp.zeros_like(lanes_template)
    return recorded_turns.empty_approaches(zero, (SlowMotion(*[zero] * 6), zero))


def record_turning_point(coeffs, path, step_result, approaches):
    """Return the `ClosestApproaches` including the turning points of a step."""
    code = call_without_inlining(_turning_point_code, coeffs, path, step_result.pre_impact_path, step_result.time)
    return recorded_turns.record_step(approaches, (path.motion, step_result.time), code)


def measure_pending_turns(coeffs, approaches):
    """Measure pending turning points.

    If the step has a second turning point at the other wall, this point becomes pending. Otherwise the latest turning
    point becomes pending.

    The Taylor polynomial of the speed gives the time of the turning point with an error below 1e-3 of the longest step,
    by Newton's method, with bisection if the speed changes its sign between the ends of the step.
    One Halley step along the flow refines the time. The error of the clearance is of the order of the fourth power
    of the error of the first time.
    """
    (motion, step_time), time_guess_code = approaches.pending_turn
    side, flow_module = choose(time_guess_code < 0, lax.full_like(time_guess_code, -1.0), 1.0), coeffs.flow
    x, _, v = call_without_inlining(state_of_slow_motion, coeffs, motion)
    speed_terms = call_without_inlining(
        _speed_terms, coeffs, side, motion, flow_module.jet(coeffs, x, v, motion.cosine, motion.sine, N_TERMS)
    )
    has_second_turn, turning_time = call_without_inlining(_decode_guess, coeffs, time_guess_code)
    time_bracket = lax.full_like(step_time, 0.0), step_time
    is_bracketed = call_without_inlining(_changes_sign, side, speed_terms, step_time)
    for _ in range(NEWTON_STEPS):
        turning_time, time_bracket = call_without_inlining(
            _newton_step, coeffs.max_step, side, speed_terms, is_bracketed, turning_time, time_bracket
        )
    other_turn_code = call_without_inlining(_other_turn_code, coeffs, side, speed_terms, turning_time, step_time)
    relative_jet = call_without_inlining(
        _relative_jet, coeffs, side, flow_module.propagate_motion(coeffs, motion, turning_time)
    )
    time_correction = call_without_inlining(halley_correction, *relative_jet[1:])
    clearance = -side * (
        relative_jet[0]
        + time_correction
        * (relative_jet[1] + time_correction * (0.5 * relative_jet[2] + time_correction * (relative_jet[3] / 6.0)))
    )
    turning_time, step_end_tolerance = (
        turning_time + time_correction,
        coeffs.max_step * event_certificates.unit_roundoff(turning_time.dtype) ** 0.5,
    )
    # the correction is also small at zero acceleration, where the speed need not be; hence the test of the speed
    is_converged = lax.abs(time_correction) <= coeffs.max_step * ROOT_TOLERANCE
    is_valid_turn = (
        (time_guess_code != 0)
        & is_converged
        & (lax.abs(relative_jet[1]) <= 2.0 * coeffs.max_step * ROOT_TOLERANCE * lax.abs(relative_jet[2]))
    )
    is_valid_turn &= side * relative_jet[2] < 0
    is_valid_turn &= (turning_time >= -step_end_tolerance) & (turning_time <= step_time + step_end_tolerance)
    other_turn, latest_turn = StepWithTurningPoint((motion, step_time), other_turn_code), approaches.latest_turn
    pending_turn = jax.tree.map(
        lambda updated, current: choose(has_second_turn, updated, current), other_turn, latest_turn
    )
    latest_turn = latest_turn._replace(code=choose(has_second_turn, latest_turn.code, 0.0))
    least_clearance = choose(is_valid_turn, minimum(clearance, approaches.least_clearance), approaches.least_clearance)
    return ClosestApproaches(least_clearance, pending_turn, latest_turn)


def _decode_guess(coeffs, time_guess_code):
    """Return (True where the code stands for two turning points, guess of the turning time)."""
    magnitude = lax.abs(time_guess_code)
    has_second_turn = magnitude > (DOUBLE_TURN_CODE - 1.0) * coeffs.max_step
    return has_second_turn, magnitude - choose(
        has_second_turn, lax.full_like(magnitude, 1.0 + DOUBLE_TURN_CODE), 1.0
    ) * coeffs.max_step


def _other_turn_code(coeffs, side, speed_terms, turning_time, step_time):
    """Return the code of the turning point at the other wall.

    The guess of the time is the time of the first turning point, mirrored at the extremum of the speed and slightly
    beyond.
    """
    _, acceleration = event_certificates.horner_with_slope(speed_terms, turning_time)
    curvature = event_certificates.horner_with_slope(
        [k * term for k, term in enumerate(speed_terms)][1:], turning_time
    )[1]
    time_guess = lax.clamp(
        lax.full_like(turning_time, 0.0), turning_time - OTHER_TURN_FACTOR * acceleration / curvature, step_time
    )
    return -side * (time_guess + coeffs.max_step)


def _speed_terms(coeffs, side, motion, derivatives):
    """Return the Taylor coefficients of the speed of x - x_b."""
    wall_derivs = wall_jet_on_side(coeffs, side, motion.cosine, motion.sine, N_TERMS)
    return [
        subtract_optional(derivatives[k], wall_derivs[k]) * (1.0 / math.factorial(k - 1)) for k in range(1, N_TERMS + 1)
    ]


def _changes_sign(side, speed_terms, step_time):
    """Return the lanes in which the mass approaches the wall at the start of the step but not at its end."""
    end_speed, _ = event_certificates.horner_with_slope(speed_terms, step_time)
    return (side * speed_terms[0] > 0) & (side * end_speed <= 0)


def _newton_step(max_step, side, speed_terms, is_bracketed, turning_time, time_bracket):
    """Improve the time of a turning point by one Newton step, or by bisection where it leaves the bracket.

    The bracket has a margin: the root may be at its end, where rounding decides on which side a step ends.
    """
    speed, acceleration = event_certificates.horner_with_slope(speed_terms, turning_time)
    next_time, is_approaching = turning_time - speed / acceleration, side * speed > 0
    low = choose(is_approaching, turning_time, time_bracket[0])
    high = choose(is_approaching, time_bracket[1], turning_time)
    margin = max_step * ROOT_TOLERANCE
    is_outside = is_bracketed & ~((next_time >= low - margin) & (next_time <= high + margin))
    return choose(is_outside, 0.5 * (low + high), next_time), (low, high)


def _turning_point_code(coeffs, path, end_path, step_time):
    """Return the code of the turning point of a step.

    If the step has several turning points, the code is that of the point closest to its wall.

    The guess of the time is the root of the secant of the speed if the speed decreases throughout. If x - x_b turns
    twice within the step, the guess is a root of a parabola. Otherwise the guess is an end of the step from which
    Newton steps converge monotonically.
    """
    is_in_free_flight = lax.abs(path.contact) != Contact.STUCK
    is_inside_wall = coeffs.contact.inside_mask(path.contact)
    if is_inside_wall is not None:
        is_in_free_flight &= ~is_inside_wall
    time_guess_code, least_distance = (lax.full_like(step_time, value) for value in (0.0, jnp.inf))
    n_turns = lax.full_like(step_time, 0.0)
    are_walls_fixed = all(wall.amplitude is None for wall in coeffs.walls)
    # fixed walls share one relative speed
    for wall_group in [coeffs.walls] if are_walls_fixed else [(wall,) for wall in coeffs.walls]:
        relative_start_state, relative_end_state = (
            _relative_motion(coeffs, wall_group[0], path),
            _relative_motion(coeffs, wall_group[0], end_path),
        )
        initial_speed_sign = choose(relative_start_state[1] > 0, lax.full_like(step_time, 1.0), -1.0)
        (v0, a0), (v1, a1) = (
            (initial_speed_sign * speed, initial_speed_sign * acceleration)
            for _, speed, acceleration in (relative_start_state, relative_end_state)
        )
        mean_relative_position = 0.5 * (relative_start_state[0] + relative_end_state[0])
        nearer_wall_sign, nearer_wall_distance = _nearer_wall(wall_group, mean_relative_position)
        turns_once = (v0 > 0) & (v1 <= 0) & ((a0 < 0) | (a1 < 0))
        extremum_time = a0 / (a0 - a1)
        extremum_speed = _cubic_extremum(v0, a0 * step_time, v1, a1 * step_time, extremum_time)
        turns_twice = (v0 > 0) & (v1 > 0) & (a0 < 0) & (a1 > 0) & (extremum_speed < CUBIC_ERROR * (a1 - a0) * step_time)
        single_turn_guess = choose(a0 < 0, choose(a1 < 0, v0 / (v0 - v1), 0.0), 1.0)
        is_first_turn = nearer_wall_sign == initial_speed_sign
        extremum_half_width = lax.sqrt(lax.abs(extremum_speed / (extremum_speed - choose(is_first_turn, v0, v1))))
        first_turn_guess, second_turn_guess = (
            minimum(extremum_time - extremum_time * extremum_half_width, MAX_FIRST_STEP * v0 / (-a0 * step_time)),
            extremum_time + (1.0 - extremum_time) * extremum_half_width,
        )
        second_turn_guess = maximum(second_turn_guess, 1.0 - MAX_FIRST_STEP * v1 / (a1 * step_time))
        wall_sign = choose(turns_once, initial_speed_sign, nearer_wall_sign)
        has_turn = is_in_free_flight & (turns_once | turns_twice)
        if len(wall_group) == 1:
            has_turn &= wall_sign == float(wall_group[0].sign)
            n_turns = n_turns + choose(has_turn, 1.0, 0.0)
        else:
            n_turns = choose(has_turn & turns_twice, 2.0, n_turns)
        has_turn &= nearer_wall_distance < least_distance
        time_guess_code = choose(
            has_turn,
            wall_sign
            * (
                step_time
                * choose(turns_once, single_turn_guess, choose(is_first_turn, first_turn_guess, second_turn_guess))
                + coeffs.max_step
            ),
            time_guess_code,
        )
        least_distance = choose(has_turn, nearer_wall_distance, least_distance)
    return choose(
        n_turns > 1.5,
        time_guess_code + lax.sign(time_guess_code) * (DOUBLE_TURN_CODE * coeffs.max_step),
        time_guess_code,
    )


def _nearer_wall(walls, relative_position):
    """Return (sign of the nearer wall, clearance to it); `relative_position` is x relative to the first wall."""
    wall_sign = lax.full_like(relative_position, float(walls[0].sign))
    if len(walls) == 1:
        return wall_sign, -walls[0].sign * relative_position
    other_wall_distance = walls[1].position - walls[0].position - relative_position
    return choose(other_wall_distance < relative_position, 1.0, wall_sign), minimum(
        other_wall_distance, relative_position
    )


def _cubic_extremum(v0, a0, v1, a1, extremum_time):
    """Evaluate a cubic at `extremum_time`, from the values v0, v1 and slopes a0, a1 at 0 and 1."""
    return v0 + extremum_time * (
        a0 + extremum_time * (3.0 * (v1 - v0) - 2.0 * a0 - a1 + extremum_time * (2.0 * (v0 - v1) + a0 + a1))
    )


def _relative_motion(coeffs, wall, path):
    """Return x - x_b, its speed and its acceleration."""
    acceleration, _ = coeffs.flow.acceleration_and_jerk(coeffs, path.x, path.v, path.cosine, path.sine)
    wall_position, wall_velocity, wall_acceleration = wall_jet(wall, coeffs.frequency, path.cosine, path.sine, 2)
    return (
        (path.x - wall_position) + path.x_low_part,
        subtract_optional(path.v, wall_velocity),
        subtract_optional(acceleration, wall_acceleration),
    )


def halley_correction(speed, acceleration, jerk):
    """Return the correction of a Halley step towards the zero of a speed."""
    return -2.0 * speed * acceleration / (2.0 * acceleration * acceleration - speed * jerk)


def _relative_jet(coeffs, side, slow_motion):
    """Return x - x_b for the wall on a side and its first three derivatives."""
    x, x_low_part, v = state_of_slow_motion(coeffs, slow_motion)
    wall_derivs = wall_jet_on_side(coeffs, side, slow_motion.cosine, slow_motion.sine, 3)
    mass_derivs = x, v, *coeffs.flow.acceleration_and_jerk(coeffs, x, v, slow_motion.cosine, slow_motion.sine)
    relative_derivs = [
        subtract_optional(mass_deriv, wall_deriv)
        for mass_deriv, wall_deriv in zip(mass_derivs, wall_derivs, strict=True)
    ]
    return [relative_derivs[0] + x_low_part, *relative_derivs[1:]]

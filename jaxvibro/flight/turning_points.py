"""Measure the clearance of a flight at the turning points of x - x_b, where the mass misses a wall.

A step with a turning point is recorded, and measured only when its lane passes the next turning point. Otherwise a
block of lanes would measure at almost every step.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import bit_mask, choose, maximum, merge_bits, minimum, stage
from ..scene.codes import Contact
from . import event
from .flight_state import SlowMotion, motion_state
from .flows import flow_of
from .soft_wall_lanes import in_soft_wall
from .wall_motion import subtract, wall_jet, wall_jet_on_side

DOUBLE_TURN_CODE = 4.0  # added to the code of two turning points, in longest steps
N_TERMS = 9  # degree of the Taylor polynomial of x, an odd number
NEWTON_STEPS = 8  # Newton steps on this polynomial
ROOT_TOLERANCE = 1e-3  # tolerance of its root, in longest steps
MAX_FIRST_STEP = 1.8  # largest multiple of Newton's first step from an end; beyond it lies the other turning point
# slightly over 2; from a turning point this leads beyond the extremum of the speed and the other turning point
OTHER_TURN_FACTOR = 2.2
# error of a cubic through the speeds at the ends of a step, relative to the change of the acceleration
CUBIC_ERROR = 0.05


class TurningPoint(NamedTuple):
    """Step with a turning point.

    Attributes
    ----------
    motion : SlowMotion
        Motion at the start of the step.
    step_time : array
        Length of the step.
    guess_code : array
        Sign of the wall times (a guess of the time since the start + the longest step), 0 without a turning point. The
        magnitude is larger by `DOUBLE_TURN_CODE` longest steps if the motion turns back from the other wall as well.
    """

    motion: SlowMotion
    step_time: Float[jax.Array, "*lanes"]
    guess_code: Float[jax.Array, "*lanes"]


class ClosestApproaches(NamedTuple):
    """Smallest clearance and recorded turning points.

    Attributes
    ----------
    least_clearance : array
        Smallest clearance.
    pending : TurningPoint
        Turning points to be measured.
    latest : TurningPoint
        Turning points of the last step.
    """

    least_clearance: Float[jax.Array, "*lanes"]
    pending: TurningPoint
    latest: TurningPoint


def no_turning_points(template):
    """Return the record without turning points, for lanes with the shape of a template."""
    zero = jnp.zeros_like(template)
    turning_point = TurningPoint(SlowMotion(*[zero] * 6), zero, zero)
    return ClosestApproaches(jnp.full_like(template, jnp.inf), turning_point, turning_point)


def record_turning_point(coeffs, path, step, approaches):
    """Return the approaches with the turning points of a step, pending where no other turning point is."""
    new_code = stage(_turning_code, coeffs, path, step.pre_impact_path, step.time)
    record_mask, latest_code = stage(_split_new, approaches.pending.guess_code, new_code)
    pending = jax.tree.map(
        lambda updated, current: merge_bits(record_mask, updated, current),
        TurningPoint(path.motion, step.time, new_code),
        approaches.pending,
    )
    return ClosestApproaches(approaches.least_clearance, pending, TurningPoint(path.motion, step.time, latest_code))


def _split_new(pending_code, new_code):
    """Return the mask of lanes without a pending turning point, and the codes of the other lanes."""
    return bit_mask((pending_code == 0) & (new_code != 0), new_code), choose(pending_code == 0, 0.0, new_code)


def needs_measurement(approaches):
    """Return the lanes with a second turning point while one is pending, for which `measure_pending` is due."""
    return approaches.latest.guess_code != 0


def measure_pending(coeffs, approaches):
    """Measure pending turning points.

    The pending record becomes the turning point at the other wall if the step has one, and the latest one otherwise.
    The time comes from the Taylor polynomial of the speed, then from one Halley step along the flow. The polynomial has
    an error below 1e-3 of the longest step. The error of the clearance is of the fourth power of this.
    """
    motion, step_time, guess_code = approaches.pending
    side, flow = choose(guess_code < 0, lax.full_like(guess_code, -1.0), 1.0), flow_of(coeffs)
    x, _, v = stage(motion_state, coeffs, motion)
    speed_terms = stage(_speed_terms, coeffs, side, motion, flow.jet(coeffs, x, v, motion.cosine, motion.sine, N_TERMS))
    is_double, time = stage(_decode_guess, coeffs, guess_code)
    for _ in range(NEWTON_STEPS):
        time = stage(_newton_step, speed_terms, time)
    other_code = stage(_other_turn_code, coeffs, side, speed_terms, time, step_time)
    relative_jet = stage(_relative_jet, coeffs, side, flow.propagate(coeffs, motion, time))
    correction = stage(_halley_correction, *relative_jet[1:])
    clearance = -side * (
        relative_jet[0]
        + correction * (relative_jet[1] + correction * (0.5 * relative_jet[2] + correction * (relative_jet[3] / 6.0)))
    )
    time, edge_tolerance = time + correction, coeffs.max_step * event.unit_roundoff(time.dtype) ** 0.5
    # the correction is also small at zero acceleration, where the speed need not be; hence the test of the speed
    is_converged = lax.abs(correction) <= coeffs.max_step * ROOT_TOLERANCE
    is_real = (
        (guess_code != 0)
        & is_converged
        & (lax.abs(relative_jet[1]) <= 2.0 * coeffs.max_step * ROOT_TOLERANCE * lax.abs(relative_jet[2]))
    )
    is_real &= side * relative_jet[2] < 0
    is_real &= (time >= -edge_tolerance) & (time <= step_time + edge_tolerance)
    other_turn, latest = TurningPoint(motion, step_time, other_code), approaches.latest
    pending = jax.tree.map(lambda updated, current: choose(is_double, updated, current), other_turn, latest)
    latest = latest._replace(guess_code=choose(is_double, latest.guess_code, 0.0))
    return ClosestApproaches(
        choose(is_real, minimum(clearance, approaches.least_clearance), approaches.least_clearance), pending, latest
    )


def _decode_guess(coeffs, guess_code):
    """Return (True for a code of two turning points, guess of the time)."""
    magnitude = lax.abs(guess_code)
    is_double = magnitude > (DOUBLE_TURN_CODE - 1.0) * coeffs.max_step
    return is_double, magnitude - choose(
        is_double, lax.full_like(magnitude, 1.0 + DOUBLE_TURN_CODE), 1.0
    ) * coeffs.max_step


def _other_turn_code(coeffs, side, speed_terms, time, step_time):
    """Return the code of the turning point at the other wall, as far beyond the extremum of the speed."""
    _, acceleration = event.horner_with_slope(speed_terms, time)
    curvature = event.horner_with_slope([k * term for k, term in enumerate(speed_terms)][1:], time)[1]
    time_guess = lax.clamp(lax.full_like(time, 0.0), time - OTHER_TURN_FACTOR * acceleration / curvature, step_time)
    return -side * (time_guess + coeffs.max_step)


def _speed_terms(coeffs, side, motion, derivatives):
    """Return the Taylor coefficients of the speed of x - x_b."""
    wall_derivs = wall_jet_on_side(coeffs, side, motion.cosine, motion.sine, N_TERMS)
    return [subtract(derivatives[k], wall_derivs[k]) * (1.0 / math.factorial(k - 1)) for k in range(1, N_TERMS + 1)]


def _newton_step(speed_terms, time):
    """Improve the time of a turning point by one Newton step."""
    speed, acceleration = event.horner_with_slope(speed_terms, time)
    return time - speed / acceleration


def _turning_code(coeffs, path, end_path, step_time):
    """Return the code of the turning point of a step; of several, the one closest to its wall first.

    The guess is an end of the step from which Newton steps converge monotonically. It is that of the secant if the
    speed decreases throughout, and that of a parabola if x - x_b turns twice within the step.
    """
    is_free = lax.abs(path.contact) != Contact.STUCK
    is_inside_wall = in_soft_wall(coeffs, path.contact)
    if is_inside_wall is not None:
        is_free &= ~is_inside_wall
    guess_code, least_distance = (lax.full_like(step_time, value) for value in (0.0, jnp.inf))
    n_turns = lax.full_like(step_time, 0.0)
    walls_fixed = all(wall.amplitude is None for wall in coeffs.walls)
    # fixed walls share one relative speed
    for wall_group in [coeffs.walls] if walls_fixed else [(wall,) for wall in coeffs.walls]:
        start_motion, end_motion = (
            _relative_motion(coeffs, wall_group[0], path),
            _relative_motion(coeffs, wall_group[0], end_path),
        )
        initial_sign = choose(start_motion[1] > 0, lax.full_like(step_time, 1.0), -1.0)
        (v0, a0), (v1, a1) = (
            (initial_sign * speed, initial_sign * acceleration) for _, speed, acceleration in (start_motion, end_motion)
        )
        mean_offset = 0.5 * (start_motion[0] + end_motion[0])
        nearer_sign, distance = _nearer_wall(wall_group, mean_offset)
        turns_once = (v0 > 0) & (v1 <= 0) & ((a0 < 0) | (a1 < 0))
        crest_time = a0 / (a0 - a1)
        crest_speed = _cubic_extremum(v0, a0 * step_time, v1, a1 * step_time, crest_time)
        turns_twice = (v0 > 0) & (v1 > 0) & (a0 < 0) & (a1 > 0) & (crest_speed < CUBIC_ERROR * (a1 - a0) * step_time)
        single_guess = choose(a0 < 0, choose(a1 < 0, v0 / (v0 - v1), 0.0), 1.0)
        is_first_turn = nearer_sign == initial_sign
        crest_width = lax.sqrt(lax.abs(crest_speed / (crest_speed - choose(is_first_turn, v0, v1))))
        early_guess, late_guess = (
            minimum(crest_time - crest_time * crest_width, MAX_FIRST_STEP * v0 / (-a0 * step_time)),
            crest_time + (1.0 - crest_time) * crest_width,
        )
        late_guess = maximum(late_guess, 1.0 - MAX_FIRST_STEP * v1 / (a1 * step_time))
        wall_sign = choose(turns_once, initial_sign, nearer_sign)
        has_turn = is_free & (turns_once | turns_twice)
        if len(wall_group) == 1:
            has_turn &= wall_sign == float(wall_group[0].sign)
            n_turns = n_turns + choose(has_turn, 1.0, 0.0)
        else:
            n_turns = choose(has_turn & turns_twice, 2.0, n_turns)
        has_turn &= distance < least_distance
        guess_code = choose(
            has_turn,
            wall_sign
            * (
                step_time * choose(turns_once, single_guess, choose(is_first_turn, early_guess, late_guess))
                + coeffs.max_step
            ),
            guess_code,
        )
        least_distance = choose(has_turn, distance, least_distance)
    return choose(n_turns > 1.5, guess_code + lax.sign(guess_code) * (DOUBLE_TURN_CODE * coeffs.max_step), guess_code)


def _nearer_wall(walls, offset):
    """Return (sign of the nearer wall, clearance to it); `offset` is x relative to the first wall."""
    wall_sign = lax.full_like(offset, float(walls[0].sign))
    if len(walls) == 1:
        return wall_sign, -walls[0].sign * offset
    distance = walls[1].position - walls[0].position - offset
    return choose(distance < offset, 1.0, wall_sign), minimum(distance, offset)


def _cubic_extremum(v0, a0, v1, a1, crest_time):
    """Evaluate the cubic with given values and slopes at 0 and 1 where its slope, if linear, would vanish."""
    return v0 + crest_time * (
        a0 + crest_time * (3.0 * (v1 - v0) - 2.0 * a0 - a1 + crest_time * (2.0 * (v0 - v1) + a0 + a1))
    )


def _relative_motion(coeffs, wall, path):
    """Return x - x_b, its speed and its acceleration."""
    acceleration, _ = flow_of(coeffs).acceleration_and_jerk(coeffs, path.x, path.v, path.cosine, path.sine)
    wall_position, wall_velocity, wall_acceleration = wall_jet(wall, coeffs.frequency, path.cosine, path.sine, 2)
    return (
        (path.x - wall_position) + path.x_low,
        subtract(path.v, wall_velocity),
        subtract(acceleration, wall_acceleration),
    )


def _halley_correction(speed, acceleration, jerk):
    """Return the correction of a Halley step."""
    return -2.0 * speed * acceleration / (2.0 * acceleration * acceleration - speed * jerk)


def _relative_jet(coeffs, side, motion):
    """Return x - x_b for the wall on a side and its first three derivatives."""
    x, x_low, v = motion_state(coeffs, motion)
    wall_derivs = wall_jet_on_side(coeffs, side, motion.cosine, motion.sine, 3)
    mass_derivs = x, v, *flow_of(coeffs).acceleration_and_jerk(coeffs, x, v, motion.cosine, motion.sine)
    relative_derivs = [
        subtract(mass_deriv, wall_deriv) for mass_deriv, wall_deriv in zip(mass_derivs, wall_derivs, strict=True)
    ]
    return [relative_derivs[0] + x_low, *relative_derivs[1:]]

"""Locate the first exit of a mass from a soft wall, from the polynomial of its motion over successive steps.

In Bernstein form the number of sign changes of the coefficients is the number of roots within the step plus 0 or an
even number (Descartes). Without sign changes the mass remains inside over the whole step. With one sign change the mass
exits exactly once. With more sign changes the step is halved. A step is a few operations on arrays, so that the
equations of orbits are cheap to evaluate at each point of a branch.
"""

import math
from functools import partial

import jax.numpy as jnp
import numpy as np
from jax import lax

from ..compiled.lane_arithmetic import choose
from . import flow, motion_in_soft_wall, soft_wall_long_step, soft_wall_polynomial
from .flight_state import Path, SlowMotion, reduce_time_remaining
from .motion_in_soft_wall import is_inside_soft_wall
from .soft_wall_polynomial import DEGREE

MIN_STEP_FRACTION = 2.0**-26  # least step, in longest steps; signs below it are due to rounding
ROOT_TOLERANCE = 2.0**-50  # relative tolerance of the root
BERNSTEIN = np.array([[math.comb(j, k) / math.comb(DEGREE, k) for k in range(DEGREE + 1)] for j in range(DEGREE + 1)])
CUMULATIVE_SUM = np.tri(DEGREE + 1)


def first_exit_time(coeffs, contact, entry_velocity, cosine, sine, max_time, displacement=None):
    """Compute the time from the entry into a wall to the exit.

    The result is accurate to a few rounding errors of the motion. Derivatives are not supported.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    contact : array
        Contact code times the sign of the wall, 0 in lanes that enter no wall.
    entry_velocity : array
        Velocity of entry relative to the wall.
    cosine : array
        Cosine of the drive angle at the entry.
    sine : array
        Sine of the drive angle at the entry.
    max_time : array
        Largest time.
    displacement : array, optional
        Initial displacement past the wall. None stands for 0.

    Returns
    -------
    array
        Time to the exit. `max_time` if the mass does not exit up to this time, and in lanes that enter no wall.
    """
    zero = lax.full_like(entry_velocity, 0.0)
    time_remaining = choose(is_inside_soft_wall(contact), max_time, 0.0)
    displacement = zero if displacement is None else displacement
    path = Path(
        displacement,
        zero,
        entry_velocity,
        SlowMotion(displacement, zero, entry_velocity, zero, cosine, sine),
        time_remaining,
        zero,
        contact,
    )
    lane_coeffs = motion_in_soft_wall.coeffs_by_lane(coeffs, contact)
    basis = soft_wall_polynomial.polynomial_basis(lane_coeffs, contact)
    take_step, take_long_step = partial(_take_step, lane_coeffs, basis), partial(_take_long_step, coeffs, basis)

    def advance_iteration(carry):
        path, step_fraction, n_waiting_steps, has_exited = carry
        is_long_step_due = jnp.any(soft_wall_long_step.is_long_step_due(path, n_waiting_steps) & (has_exited == 0))
        path, n_waiting_steps = lax.cond(
            is_long_step_due, take_long_step, lambda *operands: operands, path, n_waiting_steps
        )
        path, step_fraction, has_exited = take_step(path, step_fraction, has_exited)
        return path, step_fraction, n_waiting_steps + 1.0, has_exited

    def is_unfinished(carry):
        path, _, _, has_exited = carry
        return jnp.any((path.time_remaining > 0) & (has_exited == 0))

    initial_carry = path, zero + 1.0, zero, zero
    path, step_fraction, _, has_exited = lax.while_loop(is_unfinished, advance_iteration, initial_carry)
    polynomial_terms = _depth_terms(lane_coeffs, basis, path, step_fraction)
    exit_time_in_step = (
        step_fraction * lane_coeffs.max_step * choose(has_exited != 0, _first_root(polynomial_terms, has_exited), 0.0)
    )
    return (max_time - path.time_remaining) - path.time_remaining_low_part + exit_time_in_step


def _depth_terms(lane_coeffs, basis, path, step_fraction):
    """Return the terms of the polynomial of the depth over a fraction of the longest step, at its end."""
    state = path.x, path.v, path.cosine, path.sine
    polynomial = soft_wall_polynomial.displacement_polynomial(lane_coeffs, path.contact, basis, *state)
    return lax.sign(path.contact) * polynomial * soft_wall_polynomial.scaled_time_powers(step_fraction)


def _take_long_step(coeffs, basis, path, n_waiting_steps):
    """Take a long step in the lanes that may take one."""

    def advance_lanes(lane_coeffs, path, time):
        contact_response = soft_wall_polynomial.contact_response(lane_coeffs, path.contact, basis, time)
        return motion_in_soft_wall.apply_response(
            lane_coeffs, path.contact, contact_response, (path.x, path.v), path.cosine, path.sine
        )

    return soft_wall_long_step.take_long_step(coeffs, path, n_waiting_steps, advance_lanes)


def _take_step(lane_coeffs, basis, path, step_fraction, has_exited):
    """Return (path, fraction of the longest step, 1 if the mass exits) after a step inside or an attempt at one.

    A lane that exits keeps its path, and the fraction of the step in which it exits.
    """
    trial_fraction = jnp.minimum(step_fraction, path.time_remaining / lane_coeffs.max_step)
    polynomial_terms = _depth_terms(lane_coeffs, basis, path, trial_fraction)
    is_active, is_step_minimal = (
        (path.time_remaining > 0) & (has_exited == 0),
        trial_fraction < MIN_STEP_FRACTION,
    )
    exits_in_step, takes_full_step = (is_active & mask for mask in _step_outcome(polynomial_terms, is_step_minimal))
    time = choose(takes_full_step, jnp.minimum(trial_fraction * lane_coeffs.max_step, path.time_remaining), 0.0)
    side = lax.sign(path.contact)
    next_x = side * soft_wall_polynomial.sum_along_axis(polynomial_terms)
    next_v = (
        side
        * soft_wall_polynomial.sum_along_axis(soft_wall_polynomial.differentiate_polynomial(polynomial_terms))
        / choose(takes_full_step, trial_fraction * lane_coeffs.max_step, 1.0)
    )
    phasor = flow.rotate_phasor_by_angle(path.cosine, path.sine, lane_coeffs.frequency * time)
    time_remaining, time_remaining_low_part = reduce_time_remaining(path, time)
    next_state = choose(takes_full_step, next_x, path.x), choose(takes_full_step, next_v, path.v)
    motion = path.motion._replace(slow_x=next_state[0], slow_v=next_state[1], cosine=phasor[0], sine=phasor[1])
    next_path = path._replace(
        x=next_state[0],
        v=next_state[1],
        motion=motion,
        time_remaining=time_remaining,
        time_remaining_low_part=time_remaining_low_part,
    )
    next_fraction = choose(
        takes_full_step,
        jnp.minimum(2.0 * trial_fraction, 1.0),
        choose(exits_in_step, trial_fraction, 0.5 * trial_fraction),
    )
    return next_path, choose(is_active, next_fraction, step_fraction), choose(exits_in_step, 1.0, has_exited)


def _step_outcome(polynomial_terms, is_step_minimal):
    """Return masks of (lanes that exit in the step, lanes that remain inside), from the terms of the depth.

    Both are False where the step must be halved.
    """
    bernstein_coefficients = _multiply_first_axis(BERNSTEIN, polynomial_terms)
    cumulative_negatives = _multiply_first_axis(
        CUMULATIVE_SUM, (bernstein_coefficients < 0).astype(polynomial_terms.dtype)
    )
    stays_inside, ends_outside = cumulative_negatives[-1] == 0, bernstein_coefficients[-1] < 0
    has_single_sign_change = ~jnp.any((cumulative_negatives > 0) & (bernstein_coefficients > 0), 0)
    return (
        ends_outside & (has_single_sign_change | is_step_minimal),
        stays_inside | (is_step_minimal & ~ends_outside),
    )


def _multiply_first_axis(constant_matrix, values):
    """Multiply a constant matrix by an array along the first axis of the array."""
    weights = jnp.asarray(constant_matrix, values.dtype).reshape(*constant_matrix.shape, *[1] * (values.ndim - 1))
    return soft_wall_polynomial.sum_along_axis(weights * values, 1)


def _first_root(polynomial_terms, has_exited):
    """Return the first root between 0 and 1 of polynomials that are positive at 0, by safeguarded Newton steps."""
    derivative, zero = soft_wall_polynomial.differentiate_polynomial(polynomial_terms), jnp.zeros_like(has_exited)

    def is_unfinished(carry):
        lower, upper, guess, step, n_iterations = carry
        return (n_iterations < 64) & jnp.any(
            (has_exited != 0) & (step > ROOT_TOLERANCE * guess) & (upper - lower > ROOT_TOLERANCE * upper)
        )

    def refine(carry):
        lower, upper, guess, _, n_iterations = carry
        guess_powers = soft_wall_polynomial.scaled_time_powers(guess)
        value, slope = (
            soft_wall_polynomial.evaluate_polynomial(polynomial, guess_powers)
            for polynomial in (polynomial_terms, derivative)
        )
        lower, upper = jnp.where(value > 0, guess, lower), jnp.where(value > 0, upper, guess)
        next_guess = guess - value / slope
        next_guess = jnp.where((next_guess > lower) & (next_guess < upper), next_guess, 0.5 * (lower + upper))
        return lower, upper, next_guess, abs(next_guess - guess), n_iterations + 1

    initial_carry = zero, zero + 1.0, zero + 1.0, zero + 1.0, 0
    return lax.while_loop(is_unfinished, refine, initial_carry)[2]

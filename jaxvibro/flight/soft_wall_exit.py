"""Locate the first exit of a mass from a soft wall, from the polynomial of its motion over successive steps.

In Bernstein form the number of sign changes of the coefficients is the number of roots plus 0 or an even number
(Descartes). Without sign change the mass stays inside over the whole step. With one sign change it leaves once. With
more the step is halved. A step is a few operations on arrays, so that the equations of orbits are cheap to evaluate at
each point of a branch.
"""

import math

import jax.numpy as jnp
import numpy as np
from jax import lax

from ..compiled.compiler_hints import choose
from . import flow, soft_contact, soft_long_step, soft_polynomial
from .flight_state import Path, SlowMotion, subtract_time
from .soft_contact import is_inside
from .soft_polynomial import DEGREE

MIN_STEP_FRACTION = 2.0**-26  # least step, in longest steps; signs below it are due to rounding
ROOT_TOLERANCE = 2.0**-50  # relative tolerance of the root
BERNSTEIN = np.array([[math.comb(j, k) / math.comb(DEGREE, k) for k in range(DEGREE + 1)] for j in range(DEGREE + 1)])
CUMULATIVE_SUM = np.tri(DEGREE + 1)


def first_exit_time(coeffs, contact, v, cosine, sine, max_time, y=None):
    """Compute the time from the entry into a wall to the exit.

    The result is correct up to some rounding errors of the motion and has no derivatives.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    contact : array
        Contact code times the sign of the wall, 0 in lanes that enter no wall.
    v : array
        Velocity of entry relative to the wall.
    cosine : array
        Cosine of the drive angle at the entry.
    sine : array
        Sine of the drive angle at the entry.
    max_time : array
        Largest time.
    y : array, optional
        Initial displacement past the wall. None stands for 0.

    Returns
    -------
    array
        Time to the exit, at most `max_time`.
    """
    zero = lax.full_like(v, 0.0)
    time_remaining = choose(is_inside(contact), max_time, 0.0)
    y = zero if y is None else y
    path = Path(y, zero, v, SlowMotion(y, zero, v, zero, cosine, sine), time_remaining, zero, contact)
    lane_coeffs = soft_contact.coeffs_by_lane(coeffs, contact)
    basis, side = soft_polynomial.polynomial_basis(lane_coeffs, contact), lax.sign(contact)

    def depth_polynomial(path):
        state = path.x, path.v, path.cosine, path.sine
        return side * soft_polynomial.coefficients(lane_coeffs, contact, basis, *state)

    def advance_lanes(lane_coeffs, path, time):
        response = soft_polynomial.contact_response(lane_coeffs, path.contact, basis, time)
        return soft_contact.apply_response(
            lane_coeffs, path.contact, response, (path.x, path.v), path.cosine, path.sine
        )

    def iterate(carry):
        path, step_fraction, wait_count, has_exited = carry
        due = jnp.any(soft_long_step.is_due(path, wait_count) & (has_exited == 0))
        path, wait_count = lax.cond(
            due,
            lambda path, wait_count: soft_long_step.take_long_step(coeffs, path, wait_count, advance_lanes),
            lambda *operands: operands,
            path,
            wait_count,
        )
        trial_fraction = jnp.minimum(step_fraction, path.time_remaining / lane_coeffs.max_step)
        coefficients = depth_polynomial(path) * soft_polynomial.powers(trial_fraction)
        bernstein = _multiply(BERNSTEIN, coefficients)
        n_negative = _multiply(CUMULATIVE_SUM, (bernstein < 0).astype(coefficients.dtype))
        stays_inside, ends_outside = n_negative[-1] == 0, bernstein[-1] < 0
        exits_once, is_minimal = ~jnp.any((n_negative > 0) & (bernstein > 0), 0), trial_fraction < MIN_STEP_FRACTION
        active = (path.time_remaining > 0) & (has_exited == 0)
        exits, full_step = (
            active & ends_outside & (exits_once | is_minimal),
            active & (stays_inside | (is_minimal & ~ends_outside)),
        )
        time = choose(full_step, jnp.minimum(trial_fraction * lane_coeffs.max_step, path.time_remaining), 0.0)
        next_x = side * soft_polynomial.sum_along_axis(coefficients)
        next_v = (
            side
            * soft_polynomial.sum_along_axis(soft_polynomial.differentiate(coefficients))
            / choose(full_step, trial_fraction * lane_coeffs.max_step, 1.0)
        )
        phasor = flow.rotate_by_angle(path.cosine, path.sine, coeffs.frequency * time)
        time_remaining, time_remaining_low = subtract_time(path, time)
        next_state = choose(full_step, next_x, path.x), choose(full_step, next_v, path.v)
        motion = path.motion._replace(slow_x=next_state[0], slow_v=next_state[1], cosine=phasor[0], sine=phasor[1])
        next_path = path._replace(
            x=next_state[0],
            v=next_state[1],
            motion=motion,
            time_remaining=time_remaining,
            time_remaining_low=time_remaining_low,
        )
        next_fraction = choose(
            full_step, jnp.minimum(2.0 * trial_fraction, 1.0), choose(exits, trial_fraction, 0.5 * trial_fraction)
        )
        return next_path, choose(active, next_fraction, step_fraction), wait_count + 1.0, choose(exits, 1.0, has_exited)

    def is_unfinished(carry):
        path, _, _, has_exited = carry
        return jnp.any((path.time_remaining > 0) & (has_exited == 0))

    start = path, zero + 1.0, zero, zero
    path, step_fraction, _, has_exited = lax.while_loop(is_unfinished, iterate, start)
    coefficients = depth_polynomial(path) * soft_polynomial.powers(step_fraction)
    delay = step_fraction * lane_coeffs.max_step * choose(has_exited != 0, _first_root(coefficients, has_exited), 0.0)
    return (max_time - path.time_remaining) - path.time_remaining_low + delay


def _multiply(matrix, values):
    """Multiply a constant matrix by the first axis of some values."""
    weights = jnp.asarray(matrix, values.dtype).reshape(*matrix.shape, *[1] * (values.ndim - 1))
    return soft_polynomial.sum_along_axis(weights * values, 1)


def _first_root(coefficients, has_exited):
    """Return the first sign change before 1 of polynomials that are positive at first, by safeguarded Newton steps."""
    derivative, zero = soft_polynomial.differentiate(coefficients), jnp.zeros_like(has_exited)

    def is_unfinished(carry):
        lower, upper, guess, step, n_iterations = carry
        return (n_iterations < 64) & jnp.any(
            (has_exited != 0) & (step > ROOT_TOLERANCE * guess) & (upper - lower > ROOT_TOLERANCE * upper)
        )

    def refine(carry):
        lower, upper, guess, _, n_iterations = carry
        powers = soft_polynomial.powers(guess)
        value, slope = (soft_polynomial.evaluate(polynomial, powers) for polynomial in (coefficients, derivative))
        lower, upper = jnp.where(value > 0, guess, lower), jnp.where(value > 0, upper, guess)
        next_guess = guess - value / slope
        next_guess = jnp.where((next_guess > lower) & (next_guess < upper), next_guess, 0.5 * (lower + upper))
        return lower, upper, next_guess, abs(next_guess - guess), n_iterations + 1

    start = zero, zero + 1.0, zero + 1.0, zero + 1.0, 0
    return lax.while_loop(is_unfinished, refine, start)[2]

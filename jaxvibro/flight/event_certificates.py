"""Certify the next event of a flight: a step that certainly reaches no wall, or the time of the contact.

Time is measured in units of the longest step. The progress towards a wall is G, the negative clearance. G is its Taylor
polynomial g0 + g1 t + ... + g6 t^6 plus a remainder of at most `remainder_bound` t^6 for 0 <= t <= 1. A cubic above G
yields a step without contact. If G provably rises up to the root of the polynomial, the root is the first contact.
After an impact G has the root t = 0, which is divided out. For a mass that sticks to a wall the event is the release,
and G is the negative contact force.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import call_without_inlining, choose, maximum, minimum, negative_part, positive_part

N_TERMS = 7  # terms of the polynomial
HORIZON_FACTOR = 0.99  # fraction of the horizon at which a quadratic still turns back despite rounding
ROUNDING_FACTOR = 16.0  # rounding error of the polynomial's value, in rounding errors of its first two terms
TINY_EXPONENT = 0.4  # see `min_squarable_length`
ROOT_MARGIN = 1.05  # up to this multiple of the root no other root and no contact with the other wall may occur


class EventPolynomial(NamedTuple):
    """Taylor polynomial of G, or of G / t after an impact, in the scaled time t, with a bound on its remainder for t in
    [0, 1].

    Attributes
    ----------
    terms : tuple of array
        `N_TERMS` Taylor coefficients, the constant first.
    remainder_bound : array
        Factor of t^6 in the bound on the remainder.
    """

    terms: tuple[Float[jax.Array, "*lanes"], ...]
    remainder_bound: Float[jax.Array, "*lanes"]


class UpperCubic(NamedTuple):
    """Cubic polynomial above G for 0 <= t <= 1.

    Attributes
    ----------
    clearance : array
        Clearance at t = 0, equal to -g0.
    slope : array
        Slope g1 of G at t = 0.
    curvature : array
        Coefficient g2 of t^2.
    cubic : array
        Coefficient of t^3, at least 0. It bounds all terms from the third order on.
    """

    clearance: Float[jax.Array, "*lanes"]
    slope: Float[jax.Array, "*lanes"]
    curvature: Float[jax.Array, "*lanes"]
    cubic: Float[jax.Array, "*lanes"]


def taylor_weights(max_step):
    """Return the weights max_step^k / k! of the derivatives in a Taylor polynomial of the scaled time."""
    return tuple(max_step**k / math.factorial(k) for k in range(N_TERMS + 1))


def landing_time_tolerance(dtype):
    """Return the largest delay between the end of a step and its event that a Halley step corrects to rounding.

    The unit of time is the longest step.
    """
    return float(jnp.finfo(dtype).eps) ** (1 / 3)


def unit_roundoff(dtype):
    """Return the unit roundoff: half a unit in the last place of 1.

    Parameters
    ----------
    dtype : dtype
        Floating-point type.

    Returns
    -------
    float
        Unit roundoff of the type.
    """
    return float(jnp.finfo(dtype).eps) / 2


def min_squarable_length(dtype):
    """Return the smallest length and speed of a motion: products of any two lengths remain normal numbers.

    The value is about 9e-124 in double precision and 7e-16 in single precision.
    """
    return float(jnp.finfo(dtype).tiny) ** TINY_EXPONENT


def make_event_polynomial(taylor_terms, remainder_bound, is_leaving):
    """Build the `EventPolynomial` from the Taylor terms of the negative clearance.

    In lanes with `is_leaving` the mass starts on the wall and moves away from it. There G / t replaces G.
    """
    polynomial_terms = [
        choose(is_leaving, next_term, taylor_term)
        for taylor_term, next_term in zip(taylor_terms, [*taylor_terms[1:], 0.0], strict=True)
    ]
    return EventPolynomial((negative_part(polynomial_terms[0]), *polynomial_terms[1:]), remainder_bound)


def cubic_coefficient_bound(event_polynomial, sign=1.0):
    """Return K >= 0 with s G <= s (g0 + g1 t + g2 t^2) + K t^3 for 0 <= t <= 1.

    s is `sign`, 1 or -1, and gk are the terms of the polynomial of G.
    """
    cubic_bound = event_polynomial.remainder_bound
    for term in event_polynomial.terms[:2:-1]:
        cubic_bound = positive_part(sign * term + cubic_bound)
    return cubic_bound


def make_upper_cubic(event_polynomial, cubic_coefficient):
    """Return the `UpperCubic` of an `EventPolynomial`, given the coefficient of t^3."""
    terms = event_polynomial.terms
    return UpperCubic(-terms[0], terms[1], terms[2], cubic_coefficient)


def safe_step_ratio(upper_cubic, max_time):
    """Return numerator and denominator of the length of a step without contact, which is at most `max_time`.

    The step follows from the quadratic bound on G that t^3 <= `max_time` t^2 yields, and from t^2 <= `max_time` t.
    """
    clearance, approach_slope = upper_cubic.clearance, upper_cubic.slope
    max_curvature = upper_cubic.curvature + upper_cubic.cubic * max_time
    positive_curvature, is_approaching = positive_part(max_curvature), approach_slope >= 0
    stays_clear = (clearance >= max_time * (approach_slope + positive_curvature * max_time)) | (
        (max_curvature < 0) & (approach_slope * approach_slope <= -4.0 * max_curvature * clearance)
    )
    numerator = choose(is_approaching, clearance, maximum(clearance, -approach_slope * max_time))
    denominator = choose(is_approaching, approach_slope, 0.0) + positive_curvature * max_time
    return choose(stays_clear, max_time, numerator), choose(stays_clear, 1.0, denominator)


def safe_step(upper_cubic):
    """Return a step without contact, computed with a single division."""
    numerator, denominator = safe_step_ratio(upper_cubic, 1.0)
    return minimum(numerator / denominator, 1.0)


def safe_step_by_root(upper_cubic):
    """Return a step without contact from the root of a quadratic.

    The step follows from the quadratic bound on G that t^3 <= t^2 yields. In a narrow gap between walls the step is
    much longer than the result of `safe_step`.
    """
    root = first_quadratic_root(upper_cubic.clearance, upper_cubic.slope, upper_cubic.curvature + upper_cubic.cubic)
    return choose(root >= 0, minimum(root, 1.0), 1.0)


def first_quadratic_root(clearance, approach_slope, approach_curvature):
    """Return the first positive root of `approach_slope` t + `approach_curvature` t^2 = `clearance` without
    cancellation, or -1 if there is no positive root."""
    has_root, root = quadratic_root(clearance, approach_slope, approach_curvature)
    return choose(has_root, root, -1.0)


def quadratic_root(clearance, approach_slope, approach_curvature):
    """Return (mask of the lanes with a `first_quadratic_root`, the root; elsewhere a time near the extremum)."""
    is_approaching = approach_slope > 0
    discriminant = approach_slope * approach_slope + 4.0 * approach_curvature * clearance
    slope_plus_root = lax.abs(approach_slope) + lax.sqrt(positive_part(discriminant))
    first_root = choose(is_approaching, 2.0 * clearance, slope_plus_root) / choose(
        is_approaching, slope_plus_root, 2.0 * approach_curvature
    )
    return (discriminant >= 0) & (is_approaching | (approach_curvature > 0)), first_root


def certificate_horizon(upper_cubic, root_guess):
    """Return the horizon of `safe_step_to_horizon`, at most 1.

    The horizon is twice the guessed root. If no root is guessed, the horizon follows from the terms of the cubic with
    slope g1, curvature g2 and cubic coefficient K. For g2 < 0 the horizon is `HORIZON_FACTOR` times the positive root
    of g1 t + g2 t^2, or of g2 t^2 + K t^3 if g1 <= 0. For g2 >= 0 the horizon is 0.
    """
    is_approaching = upper_cubic.slope > 0
    turning_time = choose(is_approaching, upper_cubic.slope, -upper_cubic.curvature) / choose(
        is_approaching, -upper_cubic.curvature, upper_cubic.cubic
    )
    return minimum(
        choose(
            root_guess >= 0, 2.0 * root_guess, choose(upper_cubic.curvature < 0, HORIZON_FACTOR * turning_time, 0.0)
        ),
        1.0,
    )


def safe_step_to_horizon(upper_cubic, horizon, min_time):
    """Return a step without contact: the root of a quadratic above G up to the horizon, or the horizon without a root.

    The result is at least `min_time`, which must be the length of a step without contact.
    """
    root = first_quadratic_root(
        upper_cubic.clearance, upper_cubic.slope, upper_cubic.curvature + upper_cubic.cubic * horizon
    )
    return maximum(choose(root >= 0, minimum(horizon, root), horizon), min_time)


def horner_with_slope(coefficients, time):
    """Return the value and the slope of a polynomial from its coefficients, the constant first."""
    value, slope = coefficients[-1], lax.full_like(time, 0.0)
    for coefficient in coefficients[-2::-1]:
        slope = slope * time + value
        value = value * time + coefficient
    return value, slope


def evaluate_second_deriv(event_polynomial, time):
    """Evaluate the second derivative of an `EventPolynomial`."""
    return horner_with_slope([k * coefficient for k, coefficient in enumerate(event_polynomial.terms)][1:], time)[1]


def halley_root_step(event_polynomial, root_guess):
    """Improve the root of the quadratic by one Halley step."""
    value, slope = horner_with_slope(event_polynomial.terms, root_guess)
    return root_guess - value * slope / (
        slope * slope - 0.5 * value * evaluate_second_deriv(event_polynomial, root_guess)
    )


def newton_root_step(event_polynomial, root_guess):
    """Improve a root by one Newton step."""
    value, slope = horner_with_slope(event_polynomial.terms, root_guess)
    return root_guess - value / slope


def slope_lower_bound(event_polynomial, max_time):
    """Return a lower bound on the slope of G for times up to `max_time`."""
    terms = event_polynomial.terms
    slope_bound = negative_part(6.0 * terms[6]) - 7.0 * event_polynomial.remainder_bound
    for k in (5, 4, 3, 2):
        slope_bound = slope_bound * max_time + negative_part(float(k) * terms[k])
    return slope_bound * max_time + terms[1]


def certify_root(event_polynomial, root_guess, root, time_beyond=0.0):
    """Certify that a root is the first contact.

    Parameters
    ----------
    event_polynomial : EventPolynomial
        Polynomial of G.
    root_guess : array
        Guess of the root. Negative without a root.
    root : array
        Root of the polynomial.
    time_beyond : float, optional
        Time after the root, beyond its margin, up to which no other root may occur.

    Returns
    -------
    is_certain : array of bool
        True if up to `ROOT_MARGIN` times the root and `time_beyond`, at most 1, the slope of G is more than a fifth of
        its initial value. Then no earlier root exists.
    residual_bound : array
        Bound on G at the root: the sum of the remainder and of the residual of the polynomial, less its rounding error.
    slope_bound : array
        Lower bound on the slope of G. The distance to the true root is at most `residual_bound` / `slope_bound`.
    """
    terms, remainder_bound = event_polynomial.terms, event_polynomial.remainder_bound
    margin_end_time = root * ROOT_MARGIN + time_beyond
    slope_bound = slope_lower_bound(event_polynomial, margin_end_time)
    root_cubed, (residual, _) = root * root * root, horner_with_slope(terms, root)
    residual_rounding = ROUNDING_FACTOR * unit_roundoff(remainder_bound.dtype) * (terms[1] * root - terms[0])
    residual_bound = remainder_bound * (root_cubed * root_cubed) + positive_part(lax.abs(residual) - residual_rounding)
    is_certain = (
        (root_guess >= 0) & (terms[1] > 0) & (margin_end_time <= 1.0) & (slope_bound > 0.2 * terms[1]) & (root >= 0)
    )
    return is_certain, residual_bound, slope_bound


def root_error_bound(event_polynomial, root_guess, root):
    """Return a bound on the error of a root, or -1 if the root is not certainly the first contact."""
    is_certain, residual_bound, slope_bound = certify_root(event_polynomial, root_guess, root)
    return choose(is_certain, residual_bound / lax.abs(slope_bound), -1.0)


def certify_event(event_polynomial):
    """Certify the next event; each stage is a call that is not inlined.

    Parameters
    ----------
    event_polynomial : EventPolynomial
        Polynomial of G.

    Returns
    -------
    safe_time : array
        Length of a step without contact.
    root : array
        Time of the contact, arbitrary if there is none.
    root_error : array
        Result of `root_error_bound`.
    """
    upper_cubic = make_upper_cubic(event_polynomial, call_without_inlining(cubic_coefficient_bound, event_polynomial))
    root_guess = call_without_inlining(first_quadratic_root, *upper_cubic[:3])
    horizon = call_without_inlining(certificate_horizon, upper_cubic, root_guess)
    min_time = call_without_inlining(safe_step, upper_cubic)
    safe_time = call_without_inlining(safe_step_to_horizon, upper_cubic, horizon, min_time)
    root = call_without_inlining(halley_root_step, event_polynomial, root_guess)
    root = call_without_inlining(newton_root_step, event_polynomial, root)
    return safe_time, root, call_without_inlining(root_error_bound, event_polynomial, root_guess, root)

"""Certify the next event of a flight: a step that cannot pass a wall, or the time of the contact.

Time is measured in units of the longest step. The progress towards a wall is G, the negative clearance. G is its Taylor
polynomial g0 + g1 t + ... + g6 t^6 plus a remainder of at most `remainder` t^6 for 0 <= t <= 1. A cubic above G yields
a step without contact. If G provably rises up to the root of the polynomial, the root is the first contact. After an
impact G has the root t = 0, which is divided out. For a mass that sticks to a wall the event is the end of the contact
force, and G is the negative contact force.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, maximum, minimum, negative_part, positive_part

N_TERMS = 7  # terms of the polynomial
HORIZON_FACTOR = 0.99  # fraction of the horizon at which a quadratic still turns back despite rounding
ROUNDING_FACTOR = 16.0  # rounding error of the polynomial's value, in rounding errors of its first two terms
TINY_EXPONENT = 0.4  # see `smallest_length`
ROOT_MARGIN = 1.05  # up to this multiple of the root no other root and no contact with the other wall may occur


class Progress(NamedTuple):
    """Taylor coefficients of G from the constant on, and the bound on the remainder."""

    terms: tuple[Float[jax.Array, "*lanes"], ...]
    remainder: Float[jax.Array, "*lanes"]


class ProgressBound(NamedTuple):
    """Bound G <= -clearance + slope t + curvature t^2 + cubic t^3 with cubic >= 0."""

    clearance: Float[jax.Array, "*lanes"]
    slope: Float[jax.Array, "*lanes"]
    curvature: Float[jax.Array, "*lanes"]
    cubic: Float[jax.Array, "*lanes"]


def taylor_weights(max_step):
    """Return the weights max_step^k / k! of the derivatives in a Taylor polynomial of the scaled time."""
    return tuple(max_step**k / math.factorial(k) for k in range(N_TERMS + 1))


def landing_tolerance(dtype):
    """Return how close to an event a step must end, in time units of the flight, for its correction to be exact."""
    return float(jnp.finfo(dtype).eps) ** (1 / 3)


def unit_roundoff(dtype):
    """Return half a unit in the last place of 1.

    Parameters
    ----------
    dtype : dtype
        Floating-point type.

    Returns
    -------
    float
        Unit roundoff.
    """
    return float(jnp.finfo(dtype).eps) / 2


def smallest_length(dtype):
    """Return the smallest length and speed of a motion: squares and products of any two stay normal numbers.

    The value is about 5e-124 in double precision and 7e-16 in single precision.
    """
    return float(jnp.finfo(dtype).tiny) ** TINY_EXPONENT


def make_progress(terms, remainder, is_leaving):
    """Build the `Progress` from the Taylor terms of the negative clearance.

    Lanes with `is_leaving` leave this wall, so that G / t replaces G.
    """
    coefficients = [
        choose(is_leaving, shifted_term, term) for term, shifted_term in zip(terms, [*terms[1:], 0.0], strict=True)
    ]
    return Progress((negative_part(coefficients[0]), *coefficients[1:]), remainder)


def cubic_bound(progress):
    """Return K >= 0 with G <= g0 + g1 t + g2 t^2 + K t^3."""
    terms = progress.terms
    return positive_part(
        terms[3] + positive_part(terms[4] + positive_part(terms[5] + positive_part(terms[6] + progress.remainder)))
    )


def bound_progress(progress, cubic):
    """Return the `ProgressBound` of a progress."""
    terms = progress.terms
    return ProgressBound(-terms[0], terms[1], terms[2], cubic)


def safe_step(bound):
    """Return a step without contact, with one division.

    It uses G <= -clearance + slope t + (curvature + cubic) t^2 and t^2 <= t.
    """
    clearance, slope, curvature = bound.clearance, bound.slope, bound.curvature + bound.cubic
    max_curvature = positive_part(curvature)
    max_slope = slope + max_curvature
    approaches = slope >= 0
    stays_clear = (clearance >= max_slope) | ((curvature < 0) & (slope * slope <= -4.0 * curvature * clearance))
    time = choose(approaches, clearance, maximum(clearance, -slope)) / choose(approaches, max_slope, max_curvature)
    return choose(stays_clear, 1.0, minimum(time, 1.0))


def safe_root_step(bound):
    """Return a step without contact from the root of a quadratic.

    It uses G <= -clearance + slope t + (curvature + cubic) t^2, as t^3 <= t^2. In a narrow gap it is much longer than
    `safe_step`.
    """
    root = first_quadratic_root(bound.clearance, bound.slope, bound.curvature + bound.cubic)
    return choose(root >= 0, minimum(root, 1.0), 1.0)


def first_quadratic_root(clearance, slope, curvature):
    """Return the first positive root of slope t + curvature t^2 = clearance without cancellation, or -1."""
    approaches = slope > 0
    discriminant = slope * slope + 4.0 * curvature * clearance
    root_sum = lax.abs(slope) + lax.sqrt(positive_part(discriminant))
    time = choose(approaches, 2.0 * clearance, root_sum) / choose(approaches, root_sum, 2.0 * curvature)
    return choose((discriminant >= 0) & (approaches | (curvature > 0)), time, -1.0)


def bounding_horizon(bound, root_guess):
    """Return the time up to which a quadratic bounds G usefully: beyond the guess, or before G can turn back."""
    approaches = bound.slope > 0
    turning_time = choose(approaches, bound.slope, -bound.curvature) / choose(approaches, -bound.curvature, bound.cubic)
    return minimum(
        choose(root_guess >= 0, 2.0 * root_guess, choose(bound.curvature < 0, HORIZON_FACTOR * turning_time, 0.0)), 1.0
    )


def safe_horizon_step(bound, horizon, min_time):
    """Return a step without contact of at least `min_time`: the root of a quadratic above G up to the horizon."""
    root = first_quadratic_root(bound.clearance, bound.slope, bound.curvature + bound.cubic * horizon)
    return maximum(choose(root >= 0, minimum(horizon, root), horizon), min_time)


def horner_with_slope(coefficients, time):
    """Evaluate a polynomial, given by its coefficients from the constant on, and its slope."""
    value, slope = coefficients[-1], lax.full_like(time, 0.0)
    for coefficient in coefficients[-2::-1]:
        slope = slope * time + value
        value = value * time + coefficient
    return value, slope


def second_derivative(progress, time):
    """Evaluate the second derivative of the polynomial."""
    return horner_with_slope([k * coefficient for k, coefficient in enumerate(progress.terms)][1:], time)[1]


def halley_step(progress, root_guess):
    """Improve the root of the quadratic by one Halley step."""
    value, slope = horner_with_slope(progress.terms, root_guess)
    return root_guess - value * slope / (slope * slope - 0.5 * value * second_derivative(progress, root_guess))


def newton_step(progress, root_guess):
    """Improve a root by one Newton step."""
    value, slope = horner_with_slope(progress.terms, root_guess)
    return root_guess - value / slope


def slope_lower_bound(progress, max_time):
    """Return a lower bound on the slope of G for times up to `max_time`."""
    terms = progress.terms
    slope_bound = negative_part(6.0 * terms[6]) - 7.0 * progress.remainder
    for k in (5, 4, 3, 2):
        slope_bound = slope_bound * max_time + negative_part(float(k) * terms[k])
    return slope_bound * max_time + terms[1]


def root_error_bound(progress, root_guess, root):
    """Return a bound on the error of a root that is the first contact, or -1 if this is uncertain.

    A root is certain if G rises with at least a fifth of its slope up to `ROOT_MARGIN` times the root. Then no earlier
    root exists. The residual of the polynomial, less its rounding error, bounds the distance to the true root.
    """
    terms, remainder = progress.terms, progress.remainder
    horizon = root * ROOT_MARGIN
    slope_bound = slope_lower_bound(progress, horizon)
    root_cubed, (residual, _) = root * root * root, horner_with_slope(terms, root)
    rounding_noise = ROUNDING_FACTOR * unit_roundoff(remainder.dtype) * (terms[1] * root - terms[0])
    root_error = (remainder * (root_cubed * root_cubed) + positive_part(lax.abs(residual) - rounding_noise)) / lax.abs(
        slope_bound
    )
    return choose(
        (root_guess >= 0) & (terms[1] > 0) & (horizon <= 1.0) & (slope_bound > 0.2 * terms[1]) & (root >= 0),
        root_error,
        -1.0,
    )

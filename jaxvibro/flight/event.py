"""The next event of a flight, certified: a step that cannot pass a wall, or the time at which it is met.

Time is counted in the longest step here. The progress towards a wall, G = minus the clearance, is its Taylor polynomial
g0 + g1 t + ... + g6 t^6 and a remainder of at most `remainder` t^6 for 0 <= t <= 1. A cubic above G gives a step with
no contact; where G provably rises up to the root of the polynomial, the root is the first contact. After an impact G
has the root t = 0: it is divided out. A mass that rests on a wall waits for the press on it to end: then G is minus the
press.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, maximum, minimum, negative_part, positive_part

N_TERMS = 7  # of the polynomial
HORIZON_FACTOR = 0.99  # a horizon at which a quadratic still bends away in spite of rounding
ROUNDING_FACTOR = 16.0  # of the polynomial's value, in roundings of its first two terms
TINY_EXPONENT = 0.4  # exponent, see `smallest_length`
ROOT_MARGIN = 1.05  # the root must be the only one, and the other wall out of reach, this much further


class Progress(NamedTuple):
    """The polynomial of G, from the constant on, and its remainder."""

    terms: tuple[Float[jax.Array, "*lanes"], ...]
    remainder: Float[jax.Array, "*lanes"]


class ProgressBound(NamedTuple):
    """G <= -clear + slope t + bend t^2 + cubic t^3, cubic >= 0."""

    clearance: Float[jax.Array, "*lanes"]
    slope: Float[jax.Array, "*lanes"]
    curvature: Float[jax.Array, "*lanes"]
    cubic: Float[jax.Array, "*lanes"]


def taylor_weights(max_step):
    """What a derivative is multiplied by in a Taylor polynomial of the time over the longest step: reach^k / k!."""
    return tuple(max_step**k / math.factorial(k) for k in range(N_TERMS + 1))


def landing_tolerance(dtype):
    """How near its event, in units of the flight's own time, a step must end for the event's correction to be exact."""
    return float(jnp.finfo(dtype).eps) ** (1 / 3)


def unit_roundoff(dtype):
    """Half a unit in the last place of 1."""
    return float(jnp.finfo(dtype).eps) / 2


def smallest_length(dtype):
    """The smallest length and speed of a motion: squares and products of any two stay normal numbers.

    About 5e-124 in double precision and 7e-16 in single precision.
    """
    return float(jnp.finfo(dtype).tiny) ** TINY_EXPONENT


def make_progress(terms, remainder, is_leaving):
    """The `Progress` from minus the clearance's Taylor terms; is_leaving: the lane leaves this wall, so G / t
    counts."""
    coefficients = [
        choose(is_leaving, shifted_term, term) for term, shifted_term in zip(terms, [*terms[1:], 0.0], strict=True)
    ]
    return Progress((negative_part(coefficients[0]), *coefficients[1:]), remainder)


def cubic_bound(progress):
    """K >= 0 with G <= g0 + g1 t + g2 t^2 + K t^3."""
    terms = progress.terms
    return positive_part(
        terms[3] + positive_part(terms[4] + positive_part(terms[5] + positive_part(terms[6] + progress.remainder)))
    )


def bound_progress(progress, cubic):
    """The `ProgressBound` of a progress."""
    terms = progress.terms
    return ProgressBound(-terms[0], terms[1], terms[2], cubic)


def safe_step(bound):
    """A step without contact, from one division: G <= -clear + slope t + (bend + cubic) t^2, and t^2 <= t."""
    clearance, slope, curvature = bound.clearance, bound.slope, bound.curvature + bound.cubic
    max_curvature = positive_part(curvature)
    max_slope = slope + max_curvature
    approaches = slope >= 0
    stays_clear = (clearance >= max_slope) | ((curvature < 0) & (slope * slope <= -4.0 * curvature * clearance))
    time = choose(approaches, clearance, maximum(clearance, -slope)) / choose(approaches, max_slope, max_curvature)
    return choose(stays_clear, 1.0, minimum(time, 1.0))


def safe_root_step(bound):
    """A step without contact, from a root: G <= -clear + slope t + (bend + cubic) t^2, as t^3 <= t^2. In a narrow gap
    it is longer than the free one by far."""
    root = first_quadratic_root(bound.clearance, bound.slope, bound.curvature + bound.cubic)
    return choose(root >= 0, minimum(root, 1.0), 1.0)


def first_quadratic_root(clearance, slope, curvature):
    """The first positive root of slope t + bend t^2 = clear, without cancellation; -1 where there is none."""
    approaches = slope > 0
    discriminant = slope * slope + 4.0 * curvature * clearance
    root_sum = lax.abs(slope) + lax.sqrt(positive_part(discriminant))
    time = choose(approaches, 2.0 * clearance, root_sum) / choose(approaches, root_sum, 2.0 * curvature)
    return choose((discriminant >= 0) & (approaches | (curvature > 0)), time, -1.0)


def bounding_horizon(bound, root_guess):
    """Up to where it pays to bound G by a quadratic: a little beyond the guess, or before G can turn back."""
    approaches = bound.slope > 0
    turning_time = choose(approaches, bound.slope, -bound.curvature) / choose(approaches, -bound.curvature, bound.cubic)
    return minimum(
        choose(root_guess >= 0, 2.0 * root_guess, choose(bound.curvature < 0, HORIZON_FACTOR * turning_time, 0.0)), 1.0
    )


def safe_horizon_step(bound, horizon, min_time):
    """A step without contact, at least the min_time: the root of a quadratic above G up to the horizon."""
    root = first_quadratic_root(bound.clearance, bound.slope, bound.curvature + bound.cubic * horizon)
    return maximum(choose(root >= 0, minimum(horizon, root), horizon), min_time)


def horner_with_slope(coefficients, time):
    """The polynomial with these coefficients, from the constant on, and its slope at a time."""
    value, slope = coefficients[-1], lax.full_like(time, 0.0)
    for coefficient in coefficients[-2::-1]:
        slope = slope * time + value
        value = value * time + coefficient
    return value, slope


def second_derivative(progress, time):
    """The second derivative of the polynomial."""
    return horner_with_slope([k * coefficient for k, coefficient in enumerate(progress.terms)][1:], time)[1]


def halley_step(progress, root_guess):
    """A root from the quadratic's, by one of Halley's steps."""
    value, slope = horner_with_slope(progress.terms, root_guess)
    return root_guess - value * slope / (slope * slope - 0.5 * value * second_derivative(progress, root_guess))


def newton_step(progress, root_guess):
    """A root from one that is near, by one of Newton's steps."""
    value, slope = horner_with_slope(progress.terms, root_guess)
    return root_guess - value / slope


def slope_lower_bound(progress, max_time):
    """A lower bound on the slope of G for times up to far."""
    terms = progress.terms
    slope_bound = negative_part(6.0 * terms[6]) - 7.0 * progress.remainder
    for k in (5, 4, 3, 2):
        slope_bound = slope_bound * max_time + negative_part(float(k) * terms[k])
    return slope_bound * max_time + terms[1]


def root_error_bound(progress, root_guess, root):
    """A bound on the error of a root that is the first contact, -1 where that is not certain.

    Certain: G rises at a fifth of its slope at least up to MARGIN times the root, so that there is no other before, and
    the true one is as near as what is left of the polynomial there says, but for rounding.
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

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

from ..compiled.compiler_hints import choose, least, most, negative, positive

TERMS = 7  # of the polynomial
SHORTER = 0.99  # a horizon at which a quadratic still bends away in spite of rounding
NOISE = 16.0  # of the polynomial's value, in roundings of its first two terms
NORMAL = 0.4  # exponent, see `smallest`
MARGIN = 1.05  # the root must be the only one, and the other wall out of reach, this much further


class Progress(NamedTuple):
    """The polynomial of G, from the constant on, and its remainder."""

    terms: tuple[Float[jax.Array, "*lanes"], ...]
    remainder: Float[jax.Array, "*lanes"]


class Bound(NamedTuple):
    """G <= -clear + slope t + bend t^2 + cubic t^3, cubic >= 0."""

    clear: Float[jax.Array, "*lanes"]
    slope: Float[jax.Array, "*lanes"]
    bend: Float[jax.Array, "*lanes"]
    cubic: Float[jax.Array, "*lanes"]


def weights(reach):
    """What a derivative is multiplied by in a Taylor polynomial of the time over the longest step: reach^k / k!."""
    return tuple(reach**k / math.factorial(k) for k in range(TERMS + 1))


def landing(dtype):
    """How near its event, in units of the flight's own time, a step must end for the event's correction to be exact."""
    return float(jnp.finfo(dtype).eps) ** (1 / 3)


def rounding(dtype):
    """Half a unit in the last place of 1."""
    return float(jnp.finfo(dtype).eps) / 2


def smallest(dtype):
    """The smallest length and speed of a motion: squares and products of any two stay normal numbers.

    About 5e-124 in double precision and 7e-16 in single precision.
    """
    return float(jnp.finfo(dtype).tiny) ** NORMAL


def progress(terms, remainder, on):
    """The `Progress` from minus the clearance's Taylor terms; on: the lane leaves this wall, so G / t counts."""
    g = [choose(on, after, before) for before, after in zip(terms, [*terms[1:], 0.0], strict=True)]
    return Progress((negative(g[0]), *g[1:]), remainder)


def cubic(progress):
    """K >= 0 with G <= g0 + g1 t + g2 t^2 + K t^3."""
    g = progress.terms
    return positive(g[3] + positive(g[4] + positive(g[5] + positive(g[6] + progress.remainder))))


def bound(progress, cubic):
    """The `Bound` of a progress."""
    g = progress.terms
    return Bound(-g[0], g[1], g[2], cubic)


def free_step(bound):
    """A step without contact, from one division: G <= -clear + slope t + (bend + cubic) t^2, and t^2 <= t."""
    clear, slope, steep = bound.clear, bound.slope, bound.bend + bound.cubic
    most_steep = positive(steep)
    rise = slope + most_steep
    ahead = slope >= 0
    never = (clear >= rise) | ((steep < 0) & (slope * slope <= -4.0 * steep * clear))
    time = choose(ahead, clear, most(clear, -slope)) / choose(ahead, rise, most_steep)
    return choose(never, 1.0, least(time, 1.0))


def long_step(bound):
    """A step without contact, from a root: G <= -clear + slope t + (bend + cubic) t^2, as t^3 <= t^2. In a narrow gap
    it is longer than the free one by far."""
    root = quadratic(bound.clear, bound.slope, bound.bend + bound.cubic)
    return choose(root >= 0, least(root, 1.0), 1.0)


def quadratic(clear, slope, bend):
    """The first positive root of slope t + bend t^2 = clear, without cancellation; -1 where there is none."""
    ahead = slope > 0
    inside = slope * slope + 4.0 * bend * clear
    sum_ = lax.abs(slope) + lax.sqrt(positive(inside))
    time = choose(ahead, 2.0 * clear, sum_) / choose(ahead, sum_, 2.0 * bend)
    return choose((inside >= 0) & (ahead | (bend > 0)), time, -1.0)


def horizon(bound, guess):
    """Up to where it pays to bound G by a quadratic: a little beyond the guess, or before G can turn back."""
    ahead = bound.slope > 0
    turn = choose(ahead, bound.slope, -bound.bend) / choose(ahead, -bound.bend, bound.cubic)
    return least(choose(guess >= 0, 2.0 * guess, choose(bound.bend < 0, SHORTER * turn, 0.0)), 1.0)


def sure_step(bound, horizon, floor):
    """A step without contact, at least the floor: the root of a quadratic above G up to the horizon."""
    root = quadratic(bound.clear, bound.slope, bound.bend + bound.cubic * horizon)
    return most(choose(root >= 0, least(horizon, root), horizon), floor)


def horner(g, time):
    """The polynomial with these coefficients, from the constant on, and its slope at a time."""
    value, slope = g[-1], lax.full_like(time, 0.0)
    for coefficient in g[-2::-1]:
        slope = slope * time + value
        value = value * time + coefficient
    return value, slope


def bend(progress, time):
    """The second derivative of the polynomial."""
    return horner([k * g for k, g in enumerate(progress.terms)][1:], time)[1]


def halley(progress, guess):
    """A root from the quadratic's, by one of Halley's steps."""
    value, slope = horner(progress.terms, guess)
    return guess - value * slope / (slope * slope - 0.5 * value * bend(progress, guess))


def newton(progress, time):
    """A root from one that is near, by one of Newton's steps."""
    value, slope = horner(progress.terms, time)
    return time - value / slope


def rising(progress, far):
    """A lower bound on the slope of G for times up to far."""
    g = progress.terms
    rise = negative(6.0 * g[6]) - 7.0 * progress.remainder
    for k in (5, 4, 3, 2):
        rise = rise * far + negative(float(k) * g[k])
    return rise * far + g[1]


def slack(progress, guess, root):
    """A bound on the error of a root that is the first contact, -1 where that is not certain.

    Certain: G rises at a fifth of its slope at least up to MARGIN times the root, so that there is no other before, and
    the true one is as near as what is left of the polynomial there says, but for rounding.
    """
    g, remainder = progress.terms, progress.remainder
    far = root * MARGIN
    rise = rising(progress, far)
    cube, (left, _) = root * root * root, horner(g, root)
    noise = NOISE * rounding(remainder.dtype) * (g[1] * root - g[0])
    error = (remainder * (cube * cube) + positive(lax.abs(left) - noise)) / lax.abs(rise)
    return choose((guess >= 0) & (g[1] > 0) & (far <= 1.0) & (rise > 0.2 * g[1]) & (root >= 0), error, -1.0)

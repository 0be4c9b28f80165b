"""When a mass within a soft wall first comes back to it, from the motion's polynomial over one step after another.

In Bernstein's form of a polynomial the changes of sign are no fewer than its roots, and but for an even number as many
(Descartes): with none the mass stays within over the whole step, with one it leaves once; with more the step is halved.
A step is a few operations on arrays, so that the equations of orbits, asked for a branch point by point, are cheap.
"""

import math

import jax.numpy as jnp
import numpy as np
from jax import lax

from ..compiled.compiler_hints import choose
from . import flow, soft_contact, soft_long_step, soft_polynomial
from .flight_state import Path, SlowMotion, remaining
from .soft_contact import is_inside
from .soft_polynomial import DEGREE

FINE = 2.0**-26  # of the longest step: there what is left of a sign is rounding
CLOSE = 2.0**-50  # of itself: the root
BERNSTEIN = np.array([[math.comb(j, k) / math.comb(DEGREE, k) for k in range(DEGREE + 1)] for j in range(DEGREE + 1)])
SO_FAR = np.tri(DEGREE + 1)


def first_return(frame, touch, v, cosine, sine, longest, y=None):
    """The time until lanes that enter a wall with the velocity v leave it, at most the longest; touch: their contact,
    0 of lanes that enter none; y: how far past the wall they are, None at it. No derivatives; right to some roundings
    of the motion."""
    none = lax.full_like(v, 0.0)
    to_go = choose(is_inside(touch), longest, 0.0)
    y = none if y is None else y
    path = Path(y, none, v, SlowMotion(y, none, v, none, cosine, sine), to_go, none, touch)
    here = soft_contact.feeling(frame, touch)
    rows, side = soft_polynomial.table(here, touch), lax.sign(touch)

    def depth(path):
        given = path.x, path.v, path.cosine, path.sine
        return side * soft_polynomial.coefficients(here, touch, rows, *given)

    def flown(here, path, time):
        response = soft_polynomial.response(here, path.contact, rows, time)
        return soft_contact.flown(here, path.contact, response, (path.x, path.v), path.cosine, path.sine)

    def turn(carry):
        path, share, wait, leaves = carry
        due = jnp.any(soft_long_step.is_due(path, wait) & (leaves == 0))
        path, wait = lax.cond(
            due, lambda path, wait: soft_long_step.leap(frame, path, wait, flown), lambda *same: same, path, wait
        )
        tried = jnp.minimum(share, path.to_go / here.reach)
        scaled = depth(path) * soft_polynomial.powers(tried)
        signs = _times(BERNSTEIN, scaled)
        below = _times(SO_FAR, (signs < 0).astype(scaled.dtype))
        never, last = below[-1] == 0, signs[-1] < 0
        once, fine = ~jnp.any((below > 0) & (signs > 0), 0), tried < FINE
        on = (path.to_go > 0) & (leaves == 0)
        out, whole = on & last & (once | fine), on & (never | (fine & ~last))
        time = choose(whole, jnp.minimum(tried * here.reach, path.to_go), 0.0)
        x = side * soft_polynomial.total(scaled)
        pace = side * soft_polynomial.total(soft_polynomial.slope(scaled)) / choose(whole, tried * here.reach, 1.0)
        turned = flow.rotated(path.cosine, path.sine, frame.frequency * time)
        to_go, low = remaining(path, time)
        new = choose(whole, x, path.x), choose(whole, pace, path.v)
        motion = path.motion._replace(slow_x=new[0], slow_v=new[1], cosine=turned[0], sine=turned[1])
        after = path._replace(x=new[0], v=new[1], motion=motion, to_go=to_go, to_go_low=low)
        next_share = choose(whole, jnp.minimum(2.0 * tried, 1.0), choose(out, tried, 0.5 * tried))
        return after, choose(on, next_share, share), wait + 1.0, choose(out, 1.0, leaves)

    def going(carry):
        path, _, _, leaves = carry
        return jnp.any((path.to_go > 0) & (leaves == 0))

    start = path, none + 1.0, none, none
    path, share, _, leaves = lax.while_loop(going, turn, start)
    scaled = depth(path) * soft_polynomial.powers(share)
    late = share * here.reach * choose(leaves != 0, _root(scaled, leaves), 0.0)
    return (longest - path.to_go) - path.to_go_low + late


def _times(matrix, values):
    """A constant matrix times the first axis of some values."""
    wide = jnp.asarray(matrix, values.dtype).reshape(*matrix.shape, *[1] * (values.ndim - 1))
    return soft_polynomial.total(wide * values, 1)


def _root(path, leaves):
    """Where polynomials that are positive at first are so no more, before 1: by Newton's method, kept between."""
    slopes, none = soft_polynomial.slope(path), jnp.zeros_like(leaves)

    def going(carry):
        low, high, place, step, count = carry
        return (count < 64) & jnp.any((leaves != 0) & (step > CLOSE * place) & (high - low > CLOSE * high))

    def nearer(carry):
        low, high, place, _, count = carry
        powers = soft_polynomial.powers(place)
        value, slope = (soft_polynomial.value(each, powers) for each in (path, slopes))
        low, high = jnp.where(value > 0, place, low), jnp.where(value > 0, high, place)
        new = place - value / slope
        new = jnp.where((new > low) & (new < high), new, 0.5 * (low + high))
        return low, high, new, abs(new - place), count + 1

    start = none, none + 1.0, none + 1.0, none + 1.0, 0
    return lax.while_loop(going, nearer, start)[2]

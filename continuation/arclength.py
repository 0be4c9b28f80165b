"""Pseudo-arclength continuation: many steps along a branch of F(z) = 0 in one compiled call.

z = (u, p): n unknowns and the parameter, n equations. A step goes along the tangent and comes back to the branch within
the plane across it. Lengths are weighted: the length of dz is that of scale * dz.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import ArrayLike, Bool, Float, Int

from .arrays import Array
from .linear import solve as dense

ON, OUT, UNDERFLOW, NONFINITE = range(4)
STATUS = ("on", "out of bounds", "step underflow", "not finite")
ROUNDS = 8  # of Newton's method in a step
TURN, LARGEST_TURN = 0.12, 0.3  # angle between tangents that steps aim at; beyond which a step is refused
GROW, SHRINK = 2.0, 0.25  # the most that one step is longer or shorter than the last
EXACT = 16.0  # roundings of 1 + the largest unknown: F as small is zero, and Newton's last change is a rounding's
LOOSE = 5e-10  # largest change accepted where F is zero to rounding: ill-conditioned systems amplify rounding errors
STRAY = 0.15  # of a step: so far may the branch lie from its tangent
FAR, NEAR = 2.0, 1e-6  # of a step, and a length: Newton's method ends where it is farther than both from its guess


class Control(NamedTuple):
    """scale: (n + 1,), weights of a length; smallest, largest: step; tolerance: of Newton's method, as a length;
    low, high: where the parameter ends the branch."""

    scale: Float[Array, "*lanes unknowns"]
    smallest: Float[ArrayLike, "*lanes"]
    largest: Float[ArrayLike, "*lanes"]
    tolerance: Float[ArrayLike, "*lanes"]
    low: Float[ArrayLike, "*lanes"]
    high: Float[ArrayLike, "*lanes"]


class Place(NamedTuple):
    """A point of a branch, its unit tangent, the step to try next, and a status: on from here, or why not."""

    z: Float[Array, "*lanes unknowns"]
    tangent: Float[Array, "*lanes unknowns"]
    step: Float[ArrayLike, "*lanes"]
    status: Int[ArrayLike, "*lanes"]


class Point(NamedTuple):
    """A point met. z, tangent: (n + 1,); step: from the last one; residual: the largest entry of F before Newton's last
    step; determinant: of the system with the last tangent as its last row; met: whether Newton's method came there;
    kept: whether the step was taken, not too far round a bend."""

    z: Float[Array, "*points unknowns"]
    tangent: Float[Array, "*points unknowns"]
    step: Float[Array, "*points"]
    residual: Float[Array, "*points"]
    determinant: Float[Array, "*points"]
    met: Bool[ArrayLike, "*points"]
    kept: Bool[ArrayLike, "*points"]


def bordered(slopes, row, right):
    """The system whose rows are an n by n + 1 matrix and one row more, solved: `linear.Eliminated`."""
    return dense(jnp.concatenate([slopes, row[None]]), right)


def unit(tangent, scale):
    """The tangent with length 1."""
    return tangent / jnp.linalg.norm(scale * tangent)


def corrected(function, solve, place, step, control, args, strays=False):
    """The branch's point a step away along the tangent: (`Point`, cosine of the angle that the tangent has turned by,
    length of Newton's changes).

    function: (z, args) -> (F, slopes); solve: (slopes, row, right) -> x, worst, determinant, as `bordered`.
    """
    row = control.scale * control.scale * place.tangent
    guess = place.z + step * place.tangent
    along = jnp.zeros_like(guess).at[-1].set(1.0)

    # Beyond `far` a step would be refused, and an evaluation there may take very long: flights of any length.
    far = jnp.where(strays | (step == 0), jnp.inf, FAR * abs(step) + NEAR)

    def going(carry):
        _, _, change, _, _, count = carry
        return (change > control.tolerance) & (count < ROUNDS)

    def advance(carry):
        z, _, _, _, _, count = carry
        value, slopes = function(z, args)
        miss = jnp.concatenate([value, jnp.sum(row * (z - guess))[None]])
        found = solve(slopes, row, jnp.stack([miss, along], 1))
        change, tangent = found.x[:, 0], found.x[:, 1]
        length = jnp.linalg.norm(control.scale * change)
        z = z - change
        near = jnp.isfinite(length) & (jnp.linalg.norm(control.scale * (z - guess)) <= far)
        length, count = jnp.where(near, length, jnp.inf), jnp.where(near, count + 1, ROUNDS)
        return z, tangent, length, jnp.max(abs(value)), found.determinant, count

    zero = jnp.zeros_like(step)
    start = (guess, place.tangent, zero + jnp.inf, zero, zero, 0)
    z, tangent, change, residual, determinant, _ = lax.while_loop(going, advance, start)
    exact = residual <= EXACT * jnp.finfo(z.dtype).eps * (1.0 + jnp.max(abs(z)))
    met = (change <= control.tolerance) | (exact & (change <= LOOSE))
    point = Point(z, unit(tangent, control.scale), step, residual, determinant, met, met)
    return point, jnp.sum(row * point.tangent), jnp.linalg.norm(control.scale * (z - guess))


def track(function, solve, place, control, args, count, most=None):
    """(the `Place` reached, the `Point` of each of so many attempted steps); after its end nothing is attempted, and
    the rest is blank. most: the number of steps to attempt, where that is less than the count."""
    most = count if most is None else most

    def attempt(place):
        on = place.status == ON  # of lanes under vmap, one may have ended before the others
        step = jnp.where(on, place.step, 0.0)
        point, cosine, stray = corrected(function, solve, place, step, control, args, strays=jnp.equal(most, 1))
        turn = jnp.sqrt(jnp.maximum(2.0 * (1.0 - cosine), 0.0))  # nan where the tangent is not finite
        good = point.met & (turn < LARGEST_TURN) & (stray < STRAY * abs(step))
        kept = on & good
        factor = jnp.where(good, jnp.minimum(jnp.maximum(TURN / turn, SHRINK), GROW), SHRINK)
        wanted = jnp.minimum(place.step * factor, control.largest)
        outside = (point.z[-1] < control.low) | (point.z[-1] > control.high)
        short = jnp.where(jnp.isfinite(point.residual), UNDERFLOW, NONFINITE)
        status = jnp.where(kept & outside, OUT, jnp.where(wanted < control.smallest, short, ON))
        status = jnp.where(on, status, place.status)
        new = Place(
            jnp.where(kept, point.z, place.z),
            jnp.where(kept, point.tangent, place.tangent),
            jnp.where(on, wanted, place.step),
            status,
        )
        return new, point._replace(kept=kept)

    def advance(carry):
        k, place, points = carry
        place, point = attempt(place)
        kept = [lax.dynamic_update_index_in_dim(*each, k, 0) for each in zip(points, point, strict=True)]
        return k + 1, place, Point(*kept)

    def going(carry):
        k, place, _ = carry
        return (k < most) & (place.status == ON)

    wide, one = (jnp.zeros((count, *shape), place.z.dtype) for shape in (place.z.shape, ()))
    blank = Point(wide, wide, one, one, one, one > 0, one > 0)
    return lax.while_loop(going, advance, (0, place, blank))[1:]

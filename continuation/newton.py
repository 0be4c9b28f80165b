"""Newton's method with a status in place of an exception: under jit and vmap."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import ArrayLike, Float, Int

from .arrays import Array
from .linear import solve

OK, SLOW, SINGULAR, NONFINITE = range(4)
STATUS = ("ok", "not converged", "singular", "not finite")
ADVICE = (
    "",
    "Newton's steps did not become small: start nearer",
    "the Jacobian is singular: a bifurcation is near",
    "a number is not finite: the start is too far from any solution",
)
DONE = -1
SINGULAR_BELOW = 64.0  # times the rounding, least over largest pivot


class Solved(NamedTuple):
    """unknowns; residual: the largest entry of F there; step: the last one's largest entry; worst: the least pivot over
    the largest; status: 0 OK, 1 SLOW, 2 SINGULAR, 3 NONFINITE."""

    unknowns: Float[Array, " unknowns"]
    residual: Float[ArrayLike, ""]
    step: Float[ArrayLike, ""]
    worst: Float[ArrayLike, ""]
    status: Int[ArrayLike, ""]


def newton(function, start, longest=jnp.inf, most=30, solve=solve):
    """The solution of F(u) = 0 near a start: `Solved`.

    function: u -> (F, dF/du), shapes (n,) and (n, n), or whatever `solve` takes for a matrix. longest: a step is cut
    where an entry would be larger, a number or one for each. It ends one step after the first that is below eps^0.7
    of u, which leaves rounding alone, or after `most` steps; the residual is that before the last step.
    """
    eps, zero = jnp.finfo(start.dtype).eps, jnp.zeros((), start.dtype)

    def advance(carry):
        unknowns, _, step, _, count = carry
        value, slope = function(unknowns)
        change, worst = solve(slope, value)[:2]
        cut = jnp.minimum(1.0, jnp.min(longest / abs(change), where=change != 0, initial=1.0))
        near = step <= eps**0.7 * (1.0 + jnp.max(abs(unknowns)))
        return (
            unknowns - cut * change,
            jnp.max(abs(value)),
            jnp.max(abs(change)),
            worst,
            jnp.where(near, DONE, count + 1),
        )

    def going(carry):
        _, _, step, _, count = carry
        return (count != DONE) & (count < most) & jnp.isfinite(step)

    carry = (start, zero, zero + jnp.finfo(start.dtype).max, zero + 1.0, 0)
    unknowns, residual, step, worst, _ = lax.while_loop(going, advance, carry)
    small = step <= eps**0.5 * (1.0 + jnp.max(abs(unknowns)))
    stalled = jnp.where(worst < eps**0.25, SINGULAR, SLOW)  # at a double root the steps shrink by a factor alone
    status = jnp.where(worst < SINGULAR_BELOW * eps, SINGULAR, jnp.where(small, OK, stalled))
    status = jnp.where(jnp.isfinite(residual), status, jnp.asarray(NONFINITE, int))
    return Solved(unknowns, residual, step, worst, status)

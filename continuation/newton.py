"""Newton's method with a status in place of an exception: under jit and vmap."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import ArrayLike, Float, Int

from .array_type import Array
from .linear_solver import solve

OK, NOT_CONVERGED, SINGULAR, NONFINITE = range(4)
STATUS_TEXTS = ("ok", "not converged", "singular", "not finite")
ADVICE = (
    "",
    "Newton's steps did not become small: start nearer",
    "the Jacobian is singular: a bifurcation is near",
    "a number is not finite: the start is too far from any solution",
)
FINISHED = -1
SINGULAR_PIVOT_RATIO = 64.0  # times the rounding, least over largest pivot


class NewtonSolution(NamedTuple):
    """unknowns; residual: the largest entry of F there; step: the last one's largest entry; pivot_ratio: the least
    pivot over the largest; status: 0 OK, 1 SLOW, 2 SINGULAR, 3 NONFINITE."""

    unknowns: Float[Array, " unknowns"]
    residual: Float[ArrayLike, ""]
    step: Float[ArrayLike, ""]
    pivot_ratio: Float[ArrayLike, ""]
    status: Int[ArrayLike, ""]


def newton(function, start, max_change=jnp.inf, max_steps=30, solve=solve):
    """The solution of F(u) = 0 near a start: `NewtonSolution`.

    function: u -> (F, dF/du), shapes (n,) and (n, n), or whatever `solve` takes for a matrix. max_change: a step is cut
    where an entry would be larger, a number or one for each. It ends one step after the first that is below eps^0.7
    of u, which leaves rounding alone, or after `max_steps` steps; the residual is that before the last step.
    """
    eps, zero = jnp.finfo(start.dtype).eps, jnp.zeros((), start.dtype)

    def newton_step(carry):
        unknowns, _, step, _, n_steps = carry
        residual_vector, jacobian = function(unknowns)
        change, pivot_ratio = solve(jacobian, residual_vector)[:2]
        damping = jnp.minimum(1.0, jnp.min(max_change / abs(change), where=change != 0, initial=1.0))
        is_last = step <= eps**0.7 * (1.0 + jnp.max(abs(unknowns)))
        return (
            unknowns - damping * change,
            jnp.max(abs(residual_vector)),
            jnp.max(abs(change)),
            pivot_ratio,
            jnp.where(is_last, FINISHED, n_steps + 1),
        )

    def is_unfinished(carry):
        _, _, step, _, n_steps = carry
        return (n_steps != FINISHED) & (n_steps < max_steps) & jnp.isfinite(step)

    carry = (start, zero, zero + jnp.finfo(start.dtype).max, zero + 1.0, 0)
    unknowns, residual, step, pivot_ratio, _ = lax.while_loop(is_unfinished, newton_step, carry)
    converged = step <= eps**0.5 * (1.0 + jnp.max(abs(unknowns)))
    failure_status = jnp.where(
        pivot_ratio < eps**0.25, SINGULAR, NOT_CONVERGED
    )  # at a double root the steps shrink by a factor alone
    status = jnp.where(pivot_ratio < SINGULAR_PIVOT_RATIO * eps, SINGULAR, jnp.where(converged, OK, failure_status))
    status = jnp.where(jnp.isfinite(residual), status, jnp.asarray(NONFINITE, int))
    return NewtonSolution(unknowns, residual, step, pivot_ratio, status)

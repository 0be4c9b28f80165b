"""Solve equations by Newton's method under jit and vmap, and return a status instead of raising an error."""

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
    "Newton's method did not converge: start closer to a solution",
    "the Jacobian is singular: a bifurcation is near",
    "a number is not finite: the start is too far from any solution",
)
FINISHED = -1
SINGULAR_PIVOT_RATIO = 64.0  # multiple of eps below which the pivot ratio counts as zero


class NewtonSolution(NamedTuple):
    """Result of Newton's method.

    Attributes
    ----------
    unknowns : Array
        Solution of shape (n,).
    residual : Array
        Largest magnitude of the entries of F before the last step.
    step : Array
        Largest magnitude of the entries of the last Newton step.
    pivot_ratio : Array
        Smallest over largest pivot of the last linear system.
    status : Array
        0 OK, 1 NOT_CONVERGED, 2 SINGULAR, 3 NONFINITE.
    """

    unknowns: Float[Array, " unknowns"]
    residual: Float[ArrayLike, ""]
    step: Float[ArrayLike, ""]
    pivot_ratio: Float[ArrayLike, ""]
    status: Int[ArrayLike, ""]


def newton(residual_and_jacobian, start, max_change=jnp.inf, max_steps=30, solve=solve):
    """Solve F(u) = 0 by Newton's method.

    Parameters
    ----------
    residual_and_jacobian : callable
        Function of u that returns F and dF/du, of shapes (n,) and (n, n), or a derivative in a form that `solve` takes.
    start : Array
        Initial guess of shape (n,).
    max_change : float or Array, optional
        Largest change of an entry in one step: one number, or one number per entry. Longer steps are scaled down.
    max_steps : int, optional
        Largest number of steps.
    solve : callable, optional
        Linear solver, as `linear_solver.solve`.

    Returns
    -------
    NewtonSolution
        Solution and status.

    Notes
    -----
    The iteration ends one step after the first step that is below eps^0.7, relative to 1 + the largest unknown. The
    remaining error of u is then a rounding error.
    """
    eps, zero = jnp.finfo(start.dtype).eps, jnp.zeros((), start.dtype)

    def newton_step(carry):
        unknowns, _, step, _, n_steps = carry
        residual_vector, jacobian = residual_and_jacobian(unknowns)
        minus_change, pivot_ratio = solve(jacobian, residual_vector)[:2]
        damping_factor = jnp.minimum(1.0, jnp.min(max_change / abs(minus_change), where=minus_change != 0, initial=1.0))
        is_last_step = step <= eps**0.7 * (1.0 + jnp.max(abs(unknowns)))
        return (
            unknowns - damping_factor * minus_change,
            jnp.max(abs(residual_vector)),
            jnp.max(abs(minus_change)),
            pivot_ratio,
            jnp.where(is_last_step, FINISHED, n_steps + 1),
        )

    def is_unfinished(carry):
        _, _, step, _, n_steps = carry
        return (n_steps != FINISHED) & (n_steps < max_steps) & jnp.isfinite(step)

    initial_carry = (start, zero, zero + jnp.finfo(start.dtype).max, zero + 1.0, 0)
    unknowns, residual, step, pivot_ratio, _ = lax.while_loop(is_unfinished, newton_step, initial_carry)
    converged = step <= eps**0.5 * (1.0 + jnp.max(abs(unknowns)))
    # At a double root the steps shrink only linearly.
    failure_status = jnp.where(pivot_ratio < eps**0.25, SINGULAR, NOT_CONVERGED)
    status = jnp.where(pivot_ratio < SINGULAR_PIVOT_RATIO * eps, SINGULAR, jnp.where(converged, OK, failure_status))
    status = jnp.where(jnp.isfinite(residual), status, jnp.asarray(NONFINITE, int))
    return NewtonSolution(unknowns, residual, step, pivot_ratio, status)

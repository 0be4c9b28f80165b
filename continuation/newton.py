"""Solve equations by Newton's method, and small dense linear systems, under jit and vmap."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import ArrayLike, Float, Int

from .array_type import Array


class LinearSolution(NamedTuple):
    """Solution of a linear system.

    Attributes
    ----------
    x : Array
        Solution of shape (n,) or (n, k); not finite if the matrix is singular.
    pivot_ratio : Array
        Smallest over largest pivot; 0 if the matrix is singular.
    determinant : Array
        Determinant of the matrix.
    """

    x: Float[Array, " unknowns *sides"]
    pivot_ratio: Float[ArrayLike, ""]
    determinant: Float[ArrayLike, ""]


def solve(matrix, rhs):
    """Solve ``matrix @ x = rhs`` by Gauss-Jordan elimination with row pivoting.

    Parameters
    ----------
    matrix : array_like
        Matrix of shape (n, n), n small.
    rhs : array_like
        Right-hand sides of shape (n,) or (n, k).

    Returns
    -------
    LinearSolution
        Solution, pivot ratio and determinant.
    """
    size = len(rhs)
    row_indices = jnp.arange(size)

    def eliminate_column(column_index, carry):
        augmented_matrix, min_pivot, max_pivot, determinant = carry
        pivot_column = lax.dynamic_index_in_dim(augmented_matrix, column_index, 1, keepdims=False)
        pivot_index = jnp.argmax(jnp.where(row_indices >= column_index, abs(pivot_column), -1.0))
        pivot_row = lax.dynamic_index_in_dim(augmented_matrix, pivot_index, 0, keepdims=False)
        swapped_row = lax.dynamic_index_in_dim(augmented_matrix, column_index, 0, keepdims=False)
        augmented_matrix = jnp.where((row_indices == pivot_index)[:, None], swapped_row, augmented_matrix)
        pivot = lax.dynamic_index_in_dim(pivot_row, column_index, keepdims=False)
        pivot_row = pivot_row / pivot
        pivot_column = jnp.where(
            row_indices == pivot_index,
            lax.dynamic_index_in_dim(swapped_row, column_index, keepdims=False),
            pivot_column,
        )
        augmented_matrix = jnp.where(
            (row_indices == column_index)[:, None], pivot_row, augmented_matrix - pivot_column[:, None] * pivot_row
        )
        determinant = determinant * jnp.where(pivot_index == column_index, pivot, -pivot)
        return augmented_matrix, jnp.minimum(min_pivot, abs(pivot)), jnp.maximum(max_pivot, abs(pivot)), determinant

    rhs_columns = rhs[:, None] if rhs.ndim == 1 else rhs
    augmented_matrix = jnp.concatenate([matrix, rhs_columns], 1)
    zero = jnp.zeros((), augmented_matrix.dtype)
    initial_carry = (augmented_matrix, zero + jnp.inf, zero, zero + 1.0)
    augmented_matrix, min_pivot, max_pivot, determinant = lax.fori_loop(0, size, eliminate_column, initial_carry)
    pivot_ratio = min_pivot / max_pivot
    x = augmented_matrix[:, size:].reshape(rhs.shape)
    return LinearSolution(x, jnp.where(jnp.isnan(pivot_ratio), 0.0, pivot_ratio), determinant)


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
        Linear solver, as `solve`.

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

"""Solve small dense linear systems, single or under vmap, without the overhead of library calls."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import ArrayLike, Float

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

    def eliminate_column(k, carry):
        augmented, min_pivot, max_pivot, determinant = carry
        column = lax.dynamic_index_in_dim(augmented, k, 1, keepdims=False)
        pivot_index = jnp.argmax(jnp.where(row_indices >= k, abs(column), -1.0))
        pivot_row = lax.dynamic_index_in_dim(augmented, pivot_index, 0, keepdims=False)
        swapped_row = lax.dynamic_index_in_dim(augmented, k, 0, keepdims=False)
        augmented = jnp.where((row_indices == pivot_index)[:, None], swapped_row, augmented)
        pivot = lax.dynamic_index_in_dim(pivot_row, k, keepdims=False)
        pivot_row = pivot_row / pivot
        column = jnp.where(row_indices == pivot_index, lax.dynamic_index_in_dim(swapped_row, k, keepdims=False), column)
        augmented = jnp.where((row_indices == k)[:, None], pivot_row, augmented - column[:, None] * pivot_row)
        determinant = determinant * jnp.where(pivot_index == k, pivot, -pivot)
        return augmented, jnp.minimum(min_pivot, abs(pivot)), jnp.maximum(max_pivot, abs(pivot)), determinant

    rhs_columns = rhs[:, None] if rhs.ndim == 1 else rhs
    augmented = jnp.concatenate([matrix, rhs_columns], 1)
    zero = jnp.zeros((), augmented.dtype)
    initial = (augmented, zero + jnp.inf, zero, zero + 1.0)
    augmented, min_pivot, max_pivot, determinant = lax.fori_loop(0, size, eliminate_column, initial)
    pivot_ratio = min_pivot / max_pivot
    x = augmented[:, size:].reshape(rhs.shape)
    return LinearSolution(x, jnp.where(jnp.isnan(pivot_ratio), 0.0, pivot_ratio), determinant)

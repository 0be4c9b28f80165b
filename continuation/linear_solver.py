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

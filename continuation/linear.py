"""Small dense linear systems, one or many under vmap: no call of a library, whose overhead is more than the work."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import ArrayLike, Float

from .arrays import Array


class Eliminated(NamedTuple):
    """x; worst: the least pivot over the largest, 0 where the matrix is singular, and x is not finite; determinant."""

    x: Float[Array, " unknowns *sides"]
    worst: Float[ArrayLike, ""]
    determinant: Float[ArrayLike, ""]


def solve(matrix, right):
    """matrix x = right by Gauss and Jordan with row pivoting: `Eliminated`.

    matrix: (n, n), n small; right: (n,), or (n, k) for k right sides.
    """
    size = len(right)
    rows = jnp.arange(size)

    def eliminate(k, carry):
        system, least, most, determinant = carry
        column = lax.dynamic_index_in_dim(system, k, 1, keepdims=False)
        chosen = jnp.argmax(jnp.where(rows >= k, abs(column), -1.0))
        pivot_row = lax.dynamic_index_in_dim(system, chosen, 0, keepdims=False)
        moved = lax.dynamic_index_in_dim(system, k, 0, keepdims=False)
        system = jnp.where((rows == chosen)[:, None], moved, system)
        pivot = lax.dynamic_index_in_dim(pivot_row, k, keepdims=False)
        pivot_row = pivot_row / pivot
        column = jnp.where(rows == chosen, lax.dynamic_index_in_dim(moved, k, keepdims=False), column)
        system = jnp.where((rows == k)[:, None], pivot_row, system - column[:, None] * pivot_row)
        determinant = determinant * jnp.where(chosen == k, pivot, -pivot)
        return system, jnp.minimum(least, abs(pivot)), jnp.maximum(most, abs(pivot)), determinant

    wide = right[:, None] if right.ndim == 1 else right
    system = jnp.concatenate([matrix, wide], 1)
    zero = jnp.zeros((), system.dtype)
    start = (system, zero + jnp.inf, zero, zero + 1.0)
    system, least, most, determinant = lax.fori_loop(0, size, eliminate, start)
    worst = least / most
    x = system[:, size:].reshape(right.shape)
    return Eliminated(x, jnp.where(jnp.isnan(worst), 0.0, worst), determinant)

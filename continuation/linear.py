"""Small dense linear systems, one or many under vmap: no call of a library, whose overhead is more than the work."""

import jax.numpy as jnp
from jax import lax


def solve(matrix, right):
    """(x, worst): matrix x = right by Gauss and Jordan with row pivoting; worst: the least pivot over the largest.

    matrix: (n, n), n small; right: (n,). Where worst is 0 the matrix is singular, and x is not finite.
    """
    size = len(right)
    rows = jnp.arange(size)

    def eliminate(k, carry):
        system, least, most = carry
        column = lax.dynamic_index_in_dim(system, k, 1, keepdims=False)
        chosen = jnp.argmax(jnp.where(rows >= k, abs(column), -1.0))
        pivot_row = lax.dynamic_index_in_dim(system, chosen, 0, keepdims=False)
        moved = lax.dynamic_index_in_dim(system, k, 0, keepdims=False)
        system = jnp.where((rows == chosen)[:, None], moved, system)
        pivot = lax.dynamic_index_in_dim(pivot_row, k, keepdims=False)
        pivot_row = pivot_row / pivot
        column = jnp.where(rows == chosen, lax.dynamic_index_in_dim(moved, k, keepdims=False), column)
        system = jnp.where((rows == k)[:, None], pivot_row, system - column[:, None] * pivot_row)
        return system, jnp.minimum(least, abs(pivot)), jnp.maximum(most, abs(pivot))

    system = jnp.concatenate([matrix, right[:, None]], 1)
    zero = jnp.zeros((), system.dtype)
    system, least, most = lax.fori_loop(0, size, eliminate, (system, zero + jnp.inf, zero))
    worst = least / most
    return system[:, -1], jnp.where(jnp.isnan(worst), 0.0, worst)

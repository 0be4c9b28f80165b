"""Derivatives as whole arrays, an axis for each time a number was chosen, last: what moves, sums with tangents."""

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero


def active_argnums(tangents):
    """The places of the numbers that have tangents; the contact, the last, is a constant."""
    return tuple(k for k, tangent in enumerate(tangents[:-1]) if not isinstance(tangent, SymbolicZero))


def contract_tangents(tensors, primals, tangents):
    """Each array's last axis, one entry for each number that moves, summed with the tangents."""
    rank = max(map(jnp.ndim, primals))

    def contract(tensor):
        total = 0.0
        for k, argnum in enumerate(active_argnums(tangents)):
            tangent = jnp.asarray(tangents[argnum])
            shape = (*[1] * (rank - tangent.ndim), *tangent.shape, *[1] * (tensor.ndim - 1 - rank))
            total = total + tensor[..., k] * tangent.reshape(shape)
        return total

    return jax.tree.map(contract, tensors)


def select_argnums(tensors, request, axes_argnums):
    """The arrays with the last axes, one for each entry of `axes_argnums`, narrowed from the task's chosen numbers to
    those."""

    def narrow(tensor):
        for axis, argnums in enumerate(reversed(axes_argnums), 1):
            if argnums != request.argnums:
                tensor = jnp.take(
                    tensor, jnp.array([request.argnums.index(argnum) for argnum in argnums]), tensor.ndim - axis
                )
        return tensor

    return jax.tree.map(narrow, tensors)

"""Derivatives as arrays with one last axis for each differentiation: selection and contraction with tangents."""

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero


def active_argnums(tangents):
    """Return the indices of the arguments that have tangents; the contact, the last argument, is a constant."""
    return tuple(k for k, tangent in enumerate(tangents[:-1]) if not isinstance(tangent, SymbolicZero))


def contract_tangents(tensors, primals, tangents):
    """Contract the last axis of each array, which runs over the active arguments, with the tangents."""
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
    """Narrow the last axes, one for each entry of `axes_argnums`, from the arguments of the request to these."""

    def narrow(tensor):
        for axis, argnums in enumerate(reversed(axes_argnums), 1):
            if argnums != request.argnums:
                tensor = jnp.take(
                    tensor, jnp.array([request.argnums.index(argnum) for argnum in argnums]), tensor.ndim - axis
                )
        return tensor

    return jax.tree.map(narrow, tensors)

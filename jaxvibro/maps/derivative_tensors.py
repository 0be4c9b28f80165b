"""Selection and contraction of derivative tensors: arrays with one trailing axis for each differentiation."""

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero


def active_argnums(tangents):
    """Return the indices of the arguments that have tangents; the contact, the last argument, is a constant."""
    return tuple(argnum for argnum, tangent in enumerate(tangents[:-1]) if not isinstance(tangent, SymbolicZero))


def contract_tangents(tensors, primals, tangents):
    """Contract the last axis of each array with the tangents; this axis runs over the arguments with tangents."""
    max_primal_ndim = max(map(jnp.ndim, primals))

    def contract_last_axis(tensor):
        contraction = 0.0
        for active_index, argnum in enumerate(active_argnums(tangents)):
            tangent = jnp.asarray(tangents[argnum])
            broadcast_tangent_shape = (
                *[1] * (max_primal_ndim - tangent.ndim),
                *tangent.shape,
                *[1] * (tensor.ndim - 1 - max_primal_ndim),
            )
            contraction = contraction + tensor[..., active_index] * tangent.reshape(broadcast_tangent_shape)
        return contraction

    return jax.tree.map(contract_last_axis, tensors)


def select_argnums(tensors, request, argnums_by_axis):
    """Select arguments of differentiation along trailing axes.

    The trailing axes run over the arguments of the request. `argnums_by_axis` lists the arguments to keep along each
    trailing axis, in order of the axes.
    """

    def select_in_tensor(tensor):
        for axis_from_end, axis_argnums in enumerate(reversed(argnums_by_axis), 1):
            if axis_argnums != request.argnums:
                tensor = jnp.take(
                    tensor,
                    jnp.array([request.argnums.index(argnum) for argnum in axis_argnums]),
                    tensor.ndim - axis_from_end,
                )
        return tensor

    return jax.tree.map(select_in_tensor, tensors)

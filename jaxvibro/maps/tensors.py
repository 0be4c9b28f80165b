"""Derivatives as whole arrays, an axis for each time a number was chosen, last: what moves, sums with tangents."""

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero


def moving_places(tangents):
    """The places of the numbers that have tangents; the contact, the last, is a constant."""
    return tuple(k for k, each in enumerate(tangents[:-1]) if not isinstance(each, SymbolicZero))


def contracted(tensors, primals, tangents):
    """Each array's last axis, one entry for each number that moves, summed with the tangents."""
    rank = max(map(jnp.ndim, primals))

    def along(tensor):
        total = 0.0
        for k, place in enumerate(moving_places(tangents)):
            tangent = jnp.asarray(tangents[place])
            shape = (*[1] * (rank - tangent.ndim), *tangent.shape, *[1] * (tensor.ndim - 1 - rank))
            total = total + tensor[..., k] * tangent.reshape(shape)
        return total

    return jax.tree.map(along, tensors)


def some(tensors, task, kept):
    """The arrays with the last axes, one for each entry of `kept`, narrowed from the task's chosen numbers to those."""

    def narrow(tensor):
        for axis, places in enumerate(reversed(kept), 1):
            if places != task.chosen:
                tensor = jnp.take(tensor, jnp.array([task.chosen.index(place) for place in places]), tensor.ndim - axis)
        return tensor

    return jax.tree.map(narrow, tensors)

"""Provide arithmetic on lanes and hints for the compiler.

Hints affect speed only. Results do not depend on whether the compiler follows them.

Operands are lanes of one shape, or scalars that all lanes share. `jnp.where` and similar functions are jitted and
would each become a separate loop inside a call that is not inlined. Hence code for lanes uses `choose` and `jax.lax`.
"""

import jax
import jax.numpy as jnp
from jax import lax
from jax.experimental.xla_metadata import set_xla_metadata

from .kernels import on_cpu, trace_once

COMPILER_OPTIONS = {"xla_cpu_prefer_vector_width": 512}


def choose(condition, if_true, if_false):
    """Select values by a condition, with Python numbers and broadcasting.

    Parameters
    ----------
    condition : array of bool
        Condition for each lane.
    if_true : array or float
        Value where the condition holds.
    if_false : array or float
        Value where it does not hold.

    Returns
    -------
    array
        Selected values, of the broadcast shape and of the type of the first array among the values.
    """
    arrays = [operand for operand in (if_true, if_false) if isinstance(operand, jax.Array)]
    dtype = arrays[0].dtype if arrays else jnp.result_type(float)
    shape = jnp.broadcast_shapes(condition.shape, *(operand.shape for operand in arrays))
    return lax.select(
        *(_broadcast(*operand, shape) for operand in ((condition, bool), (if_true, dtype), (if_false, dtype)))
    )


def _broadcast(value, dtype, shape):
    """Convert a value to an array of a given type and shape."""
    if isinstance(value, jax.Array) and value.shape == shape:
        return value
    return jnp.broadcast_to(lax.convert_element_type(value, dtype), shape)


def bit_mask(condition, like):
    """Build the mask of `merge_bits` from a condition.

    Parameters
    ----------
    condition : array of bool
        Condition for each lane.
    like : array
        Array with the floating-point type of the values that are merged later.

    Returns
    -------
    array of int
        All bits set where the condition holds, no bit set elsewhere. As wide as the numbers of `like`.
    """
    int_dtype = jnp.int64 if like.dtype == jnp.float64 else jnp.int32
    return lax.neg(lax.convert_element_type(condition, int_dtype))


def merge_bits(mask, if_set, if_clear):
    """Merge two arrays bit by bit.

    Use this for values that a loop carries. There `choose` compiles to a masked store, which is ten times slower on
    some machines.

    Parameters
    ----------
    mask : array of int
        Mask from `bit_mask`. It must be the result of a `stage`.
    if_set : array
        Value where the bits of the mask are set.
    if_clear : array
        Value where they are clear.

    Returns
    -------
    array
        Merged values.
    """
    bits = [lax.bitcast_convert_type(operand, mask.dtype) for operand in (if_set, if_clear)]
    return lax.bitcast_convert_type((bits[0] & mask) | (bits[1] & ~mask), if_clear.dtype)


def positive_part(a):
    """Return `a` where it is positive, and 0 elsewhere."""
    return choose(a > 0, a, 0.0)


def negative_part(a):
    """Return `a` where it is negative, and 0 elsewhere."""
    return choose(a < 0, a, 0.0)


def minimum(a, b):
    """Return the smaller of two values in one instruction; the result for nan is unspecified."""
    return choose(a < b, a, b)


def maximum(a, b):
    """Return the larger of two values in one instruction; the result for nan is unspecified."""
    return choose(a > b, a, b)


def two_sum(a, b):
    """Add two numbers without loss (Knuth).

    The rounding error of a path then grows with its length and not with its number of steps.

    Parameters
    ----------
    a : array
        First summand.
    b : array
        Second summand.

    Returns
    -------
    rounded_sum : array
        Rounded sum.
    error : array
        Rounding error: the exact sum less the rounded one.
    """
    rounded_sum = a + b
    virtual_b = rounded_sum - a
    return rounded_sum, (a - (rounded_sum - virtual_b)) + (b - virtual_b)


def stage(function, *lanes, **static):
    """Call a function without inlining it, so that its results are stored.

    Without this XLA recomputes a result at each of its uses. XLA computes each result of a call in a separate loop,
    with everything that it depends on inside the call. Hence a stage should be short or have few results. Only operands
    that the results depend on are passed on, because the emitter of a whole loop as one kernel aborts on any other.

    Parameters
    ----------
    function : callable
        Function at the top level of a module. It is traced once for lanes of given shapes and types.
    *lanes : pytree of array
        Positional arguments.
    **static : hashable
        Static keyword arguments.

    Returns
    -------
    pytree of array
        Results of ``function(*lanes, **static)``.
    """
    traced_function, operands = trace_once(function, lanes, static)
    flat_function = traced_function.call_with_used
    if on_cpu():
        with set_xla_metadata(inlineable="false"):
            results = jax.jit(flat_function)(*traced_function.select_used(operands))
    else:
        results = flat_function(*traced_function.select_used(operands))
    return jax.tree.unflatten(traced_function.tree, results)

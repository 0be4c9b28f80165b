"""Arithmetic on lanes, and hints for the compiler.

Hints affect speed only. The results do not depend on them.

Operands are arrays of lanes of one shape, or scalars for all lanes. Inside a call that is not inlined, `jnp.where` and
other jitted functions would each become a separate loop. Code for lanes therefore uses `choose` and `jax.lax`.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.experimental.xla_metadata import set_xla_metadata

from . import kernel_calls
from .kernel_calls import is_traced_for_cpu, trace_with_cache

COMPILER_OPTIONS = {"xla_cpu_prefer_vector_width": 512}


def choose(condition, if_true, if_false):
    """Select values by a condition; values may be Python numbers and broadcast.

    Parameters
    ----------
    condition : array of bool
        Condition for each lane.
    if_true : array or float
        Value where the condition holds.
    if_false : array or float
        Value where the condition does not hold.

    Returns
    -------
    array
        Selected values, of the broadcast shape and of the type of the first array among the values.
    """
    array_operands = [operand for operand in (if_true, if_false) if isinstance(operand, jax.Array)]
    dtype = array_operands[0].dtype if array_operands else jnp.result_type(float)
    shape = jnp.broadcast_shapes(condition.shape, *(operand.shape for operand in array_operands))
    return lax.select(
        *(
            _convert_and_broadcast(*operand, shape)
            for operand in ((condition, bool), (if_true, dtype), (if_false, dtype))
        )
    )


def _convert_and_broadcast(value, dtype, shape):
    """Convert a value to an array of a given type and shape."""
    if isinstance(value, jax.Array) and value.shape == shape:
        return value
    return jnp.broadcast_to(lax.convert_element_type(value, dtype), shape)


def bit_mask(condition, dtype_like):
    """Build the mask of `merge_bits` from a condition.

    Parameters
    ----------
    condition : array of bool
        Condition for each lane.
    dtype_like : array
        Array with the floating-point type of the values that are merged later.

    Returns
    -------
    array of int
        All bits set where the condition holds, no bit set elsewhere. The integers are as wide as the numbers of
        `dtype_like`.
    """
    int_dtype = jnp.int64 if dtype_like.dtype == jnp.float64 else jnp.int32
    return lax.neg(lax.convert_element_type(condition, int_dtype))


def merge_bits(mask, if_set, if_clear):
    """Merge two arrays bit by bit.

    Use this function for values that a loop carries. For a carried value, `choose` compiles to a masked store, which
    is ten times slower on some machines.

    Parameters
    ----------
    mask : array of int
        Mask from `bit_mask`. It must be the result of a `call_without_inlining`.
    if_set : array
        Value where the bits of the mask are set.
    if_clear : array
        Value where the bits of the mask are clear.

    Returns
    -------
    array
        Merged values.
    """
    operand_bits = [lax.bitcast_convert_type(operand, mask.dtype) for operand in (if_set, if_clear)]
    return lax.bitcast_convert_type((operand_bits[0] & mask) | (operand_bits[1] & ~mask), if_clear.dtype)


def positive_part(value):
    """Return `value` where it is positive, and 0 elsewhere."""
    return choose(value > 0, value, 0.0)


def negative_part(value):
    """Return `value` where it is negative, and 0 elsewhere."""
    return choose(value < 0, value, 0.0)


def minimum(first_value, second_value):
    """Return the smaller of two values in one instruction; the result for nan is unspecified."""
    return choose(first_value < second_value, first_value, second_value)


def maximum(first_value, second_value):
    """Return the larger of two values in one instruction; the result for nan is unspecified."""
    return choose(first_value > second_value, first_value, second_value)


def two_sum(first_summand, second_summand):
    """Add two numbers without loss (Knuth).

    With this sum the rounding error of a path grows with the length of the path, not with the number of steps.

    Parameters
    ----------
    first_summand : array
        First summand.
    second_summand : array
        Second summand.

    Returns
    -------
    rounded_sum : array
        Rounded sum.
    error : array
        Rounding error: the exact sum less the rounded one.
    """
    rounded_sum = first_summand + second_summand
    virtual_summand = rounded_sum - first_summand
    return rounded_sum, (first_summand - (rounded_sum - virtual_summand)) + (second_summand - virtual_summand)


def value_and_gradient(function, arguments, axis=0):
    """Compute a function of lanes and its derivatives with respect to each argument.

    Parameters
    ----------
    function : callable
        Function of arrays of lanes whose results belong to the same lanes.
    arguments : sequence of array
        Arguments of the function.
    axis : int, optional
        New axis of the derivatives, which numbers the arguments.

    Returns
    -------
    value : pytree of array
        Result of the function.
    gradient : pytree of array
        Derivatives of each result.
    """

    def derivative_along(direction):
        tangents = [
            jnp.broadcast_to(component, jnp.shape(argument))
            for component, argument in zip(direction, arguments, strict=True)
        ]
        return jax.jvp(function, tuple(arguments), tuple(tangents))

    directions = jnp.eye(len(arguments), dtype=jnp.result_type(arguments[0]))
    return jax.vmap(derivative_along, out_axes=(None, axis))(directions)


def call_without_inlining(function, *lanes, **static):
    """Call a function without inlining it, so that its results are stored.

    XLA recomputes a result of an inlined function at each use. XLA computes each result of a call in a separate loop,
    together with all operations on which the result depends. The function should therefore be short or have few
    results. Unused operands are not passed, because XLA cannot emit a kernel with an unused parameter.

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
    traced_function, operands = trace_with_cache(function, lanes, static)
    flat_function = traced_function.call_with_used_operands
    if is_traced_for_cpu():
        with set_xla_metadata(inlineable="false"):
            results = jax.jit(flat_function)(*traced_function.select_used_operands(operands))
    else:
        results = flat_function(*traced_function.select_used_operands(operands))
    return jax.tree.unflatten(traced_function.tree, results)


def describe_hints() -> dict[str, Any]:
    """Describe the compiler hints in use: options, attributes of calls, and block widths.

    Returns
    -------
    dict
        ``applied``: True if code is compiled for a CPU; code for other devices gets no hints. ``options``: compiler
        options. ``marks``: attributes of each kind of call. ``block_width``, ``narrow_block_width``: number of lanes in
        a block of the fast path and of the reference path.
    """
    is_for_cpu = kernel_calls.is_traced_for_cpu()
    no_inlining_attribute = {"inlineable": "false"}
    call_attributes = {
        "stage": no_inlining_attribute,
        "one_kernel": {**no_inlining_attribute, "xla_cpu_small_call": "true"},
    }
    return {
        "applied": is_for_cpu,
        "options": dict(COMPILER_OPTIONS),
        "marks": call_attributes if is_for_cpu else {},
        "block_width": kernel_calls.block_width(),
        "narrow_block_width": kernel_calls.reference_block_width(),
    }

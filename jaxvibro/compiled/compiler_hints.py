"""How the compiler is asked to treat a block of lanes: hints that cost speed, never correctness, where it ignores them.

Arithmetic here works on lanes of one shape and on scalars, the numbers that all lanes share. `jnp.where` and its kin
are jitted functions of their own and would each become a loop of their own below an un-inlined call, so the lanes use
`choose` and lax alone.
"""

import jax
import jax.numpy as jnp
from jax import lax
from jax.experimental.xla_metadata import set_xla_metadata

from .kernels import on_cpu, trace_once

COMPILER_OPTIONS = {"xla_cpu_prefer_vector_width": 512}


def choose(condition, if_true, if_false):
    """lax.select that takes Python numbers and broadcasts: yes where the condition holds, no elsewhere."""
    arrays = [operand for operand in (if_true, if_false) if isinstance(operand, jax.Array)]
    dtype = arrays[0].dtype if arrays else jnp.result_type(float)
    shape = jnp.broadcast_shapes(condition.shape, *(operand.shape for operand in arrays))
    return lax.select(
        *(_broadcast(*operand, shape) for operand in ((condition, bool), (if_true, dtype), (if_false, dtype)))
    )


def _broadcast(value, dtype, shape):
    if isinstance(value, jax.Array) and value.shape == shape:
        return value
    return jnp.broadcast_to(lax.convert_element_type(value, dtype), shape)


def bit_mask(condition, like):
    """The lanes where a condition holds, for `merge_bits`: all bits set or none, as wide as the numbers of `like`."""
    int_dtype = jnp.int64 if like.dtype == jnp.float64 else jnp.int32
    return lax.neg(lax.convert_element_type(condition, int_dtype))


def merge_bits(mask, if_set, if_clear):
    """new where the mask's bits are set, else if_clear: for what a loop carries, as `choose` in place is a masked
    store, ten times as slow on some machines. The mask is to be the result of a `stage`."""
    bits = [lax.bitcast_convert_type(operand, mask.dtype) for operand in (if_set, if_clear)]
    return lax.bitcast_convert_type((bits[0] & mask) | (bits[1] & ~mask), if_clear.dtype)


def positive_part(a):
    """a where it is positive, else 0."""
    return choose(a > 0, a, 0.0)


def negative_part(a):
    """a where it is negative, else 0."""
    return choose(a < 0, a, 0.0)


def minimum(a, b):
    """The smaller of two; one instruction, as it promises nothing for nan."""
    return choose(a < b, a, b)


def maximum(a, b):
    """The larger of two."""
    return choose(a > b, a, b)


def two_sum(a, b):
    """The rounded sum and its error (Knuth): a path's rounding errors then grow with its length, not its steps."""
    rounded_sum = a + b
    virtual_b = rounded_sum - a
    return rounded_sum, (a - (rounded_sum - virtual_b)) + (b - virtual_b)


def stage(function, *lanes, **static):
    """function(*lanes) as an un-inlined call, whose results are stored: XLA would compute them anew for each use.

    XLA computes each result of a call in a loop of its own, with all that it depends on within the call: a stage is to
    be short, or to have few results. Only operands that the results depend on are handed over; the emitter of a whole
    loop as one kernel aborts on any other. The function is one of a module, traced once for lanes of a kind.
    """
    traced_function, operands = trace_once(function, lanes, static)
    flat_function = traced_function.call_with_used
    if on_cpu():
        with set_xla_metadata(inlineable="false"):
            results = jax.jit(flat_function)(*traced_function.select_used(operands))
    else:
        results = flat_function(*traced_function.select_used(operands))
    return jax.tree.unflatten(traced_function.tree, results)

"""Run functions of lanes block by block, and turn a vmap of a function of lanes into a call with more lanes."""

import math
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
from jax import lax
from jax.core import ShapedArray
from jax.extend import core
from jax.interpreters import batching, mlir

from .kernel_calls import (
    BLOCK_SIZES,
    KernelTooCostly,
    block_width,
    compute_abstract_results,
    is_traced_for_cpu,
    is_within_run_in_blocks,
    reference_block_width,
    use_block_sizes,
)

MIN_LANES = 16  # least lanes of a block; XLA compiles fewer differently, and results differ by a rounding error


def run_in_blocks(
    block_function,
    arguments,
    make_initial_results,
    min_lanes=MIN_LANES,
    trailing_axis_arguments=(),
    n_lanes_due=None,
    max_blocks_per_call=1,
):
    """Run a function of lanes on blocks of lanes.

    If XLA would split an operation of a kernel over threads, narrower blocks are used.

    Parameters
    ----------
    block_function : callable
        Function of `arguments` and of each of `trailing_axis_arguments`, reduced to the lanes of one block. Returns a
        pytree of arrays, lanes first.
    arguments : pytree of array
        Arguments of any shapes that broadcast against each other. Scalars are passed on as scalars.
    make_initial_results : callable
        Function from a number of lanes to the initial content of the results, lanes first.
    min_lanes : int, optional
        Smallest number of lanes in a block.
    trailing_axis_arguments : sequence of array, optional
        Further arguments with all lanes and one additional axis, the last.
    n_lanes_due : int or array, optional
        Number of lanes to compute, counted from the first. Blocks without such lanes keep the initial results. None
        computes all lanes.
    max_blocks_per_call : int, optional
        Largest number of blocks that one call of `block_function` receives. If a call receives several blocks, all
        of these blocks are full.

    Returns
    -------
    pytree of array
        Results of `block_function` for all lanes, in the broadcast shape of `arguments`.
    """
    if is_within_run_in_blocks():
        return _run_with_current_sizes(
            block_function,
            arguments,
            make_initial_results,
            min_lanes,
            trailing_axis_arguments,
            n_lanes_due,
            max_blocks_per_call,
        )
    for block_sizes in BLOCK_SIZES:
        try:
            with use_block_sizes(block_sizes):
                return _run_with_current_sizes(
                    block_function,
                    arguments,
                    make_initial_results,
                    min_lanes,
                    trailing_axis_arguments,
                    n_lanes_due,
                    min(max_blocks_per_call, block_sizes.max_blocks_per_kernel),
                )
        except KernelTooCostly:
            continue
    return _run_with_current_sizes(
        block_function,
        arguments,
        make_initial_results,
        min_lanes,
        trailing_axis_arguments,
        n_lanes_due,
        max_blocks_per_call,
    )


def _run_with_current_sizes(
    block_function,
    arguments,
    make_initial_results,
    min_lanes,
    trailing_axis_arguments,
    n_lanes_due,
    max_blocks_per_call,
):
    """Run a function of lanes with the current block sizes."""
    leaves, treedef = jax.tree.flatten(arguments)
    shape = jnp.broadcast_shapes(*map(jnp.shape, leaves))
    if not shape:
        return block_function(arguments, *trailing_axis_arguments)
    n_lanes = math.prod(shape)
    full_block_width = block_width()
    lanes_per_call = min(
        full_block_width if n_lanes_due is None else reference_block_width(),
        max(min_lanes, 1 << (n_lanes - 1).bit_length()),
    )
    if n_lanes > full_block_width:
        n_blocks = -(-n_lanes // full_block_width)
        # the same number in each strip, so that few are computed twice
        lanes_per_call *= -(-n_blocks // -(-n_blocks // max_blocks_per_call))
    n_padded_lanes = max(n_lanes, lanes_per_call)

    def pad_lanes(leaf, *trailing_sizes):
        flat_lanes = jnp.broadcast_to(leaf, (*shape, *trailing_sizes)).reshape(n_lanes, *trailing_sizes)
        padding = [(0, n_padded_lanes - n_lanes), *[(0, 0)] * len(trailing_sizes)]
        return jnp.pad(flat_lanes, padding, mode="edge" if n_lanes else "constant")

    # a scalar for all lanes remains a scalar
    leaves = [pad_lanes(leaf) if jnp.shape(leaf) else leaf for leaf in leaves]
    trailing_axis_arguments = [pad_lanes(row, row.shape[-1]) for row in trailing_axis_arguments]

    def update_block_results(block_index, results):
        first_lane = jnp.minimum(
            block_index * lanes_per_call, n_padded_lanes - lanes_per_call
        )  # the last block may repeat lanes of the previous one
        block_leaves = [
            lax.dynamic_slice_in_dim(leaf, first_lane, lanes_per_call) if jnp.shape(leaf) else leaf for leaf in leaves
        ]
        block_results = block_function(
            treedef.unflatten(block_leaves),
            *(lax.dynamic_slice_in_dim(row, first_lane, lanes_per_call) for row in trailing_axis_arguments),
        )
        return jax.tree.map(
            lambda array, part: lax.dynamic_update_slice_in_dim(array, part, first_lane, 0), results, block_results
        )

    results = lax.fori_loop(
        0,
        -(-(n_padded_lanes if n_lanes_due is None else n_lanes_due) // lanes_per_call),
        update_block_results,
        make_initial_results(n_padded_lanes),
    )
    return jax.tree.map(lambda array: array[:n_lanes].reshape(*shape, *array.shape[1:]), results)


def vmap_as_lanes(function, n_trailing_axis_args=0):
    """Wrap a function of lanes as one operation whose vmap is one call with more lanes.

    The function is traced separately for the shapes and types of its arguments. The surrounding program therefore does
    not affect how the function is compiled. The operation has no derivative rule.

    Parameters
    ----------
    function : callable
        Function of arrays that broadcast. Returns a pytree of arrays.
    n_trailing_axis_args : int, optional
        Number of trailing arguments that have one axis more than the lanes.

    Returns
    -------
    callable
        Function with the arguments and results of `function`.
    """

    def call_as_operation(*operands):
        results, treedef = _call_as_operation(function, n_trailing_axis_args, operands)
        return jax.tree.unflatten(treedef, results)

    return call_as_operation


def _call_as_operation(function, n_trailing_axis_args, operands):
    """Apply a function as one operation and return (results, pytree structure of the results)."""
    signature = tuple((jnp.shape(operand), jnp.result_type(operand)) for operand in operands)
    closed_jaxpr, treedef = _trace_lane_function(function, signature, (jax.config.jax_enable_x64, is_traced_for_cpu()))
    return lanes_p.bind(*operands, closed=closed_jaxpr, function=function, rows=n_trailing_axis_args), treedef


@lru_cache(512)
def _trace_lane_function(function, signature, trace_settings):
    """Return (closed jaxpr, pytree structure of the results) for arrays of given shapes and types."""
    abstract_operands = [jax.ShapeDtypeStruct(*shape_dtype) for shape_dtype in signature]
    closed_jaxpr, result_shapes = jax.make_jaxpr(function, return_shape=True)(*abstract_operands)
    return closed_jaxpr, jax.tree.structure(result_shapes)


def _add_lane_axis(axis_size, vmap_axes, operands, n_trailing_axis_args):
    """Move the axis of a vmap to the front of the operands and align their lane axes."""
    trailing_axis_counts = [0] * (len(operands) - n_trailing_axis_args) + [1] * n_trailing_axis_args
    operands = [
        operand if axis is None else jnp.moveaxis(operand, axis, 0)
        for operand, axis in zip(operands, vmap_axes, strict=True)
    ]
    lane_axis_counts = [
        jnp.ndim(operand) - n_trailing_axes - (axis is not None)
        for operand, n_trailing_axes, axis in zip(operands, trailing_axis_counts, vmap_axes, strict=True)
    ]
    max_lane_axes = max(lane_axis_counts)

    def align_lane_axes(operand, vmap_axis, n_lane_axes):
        return (
            operand
            if vmap_axis is None
            else operand.reshape(axis_size, *[1] * (max_lane_axes - n_lane_axes), *operand.shape[1:])
        )

    return [*map(align_lane_axes, operands, vmap_axes, lane_axis_counts)]


def _batching_rule(operands, vmap_axes, *, closed, function, rows):
    axis_size = next(operand.shape[axis] for operand, axis in zip(operands, vmap_axes, strict=True) if axis is not None)
    results, _ = _call_as_operation(function, rows, _add_lane_axis(axis_size, vmap_axes, operands, rows))
    return results, [0] * len(results)


def _lowering_rule(context, *operands, closed, **static):
    avals = [ShapedArray(aval.shape, aval.dtype) for aval in context.avals_in]
    evaluate = partial(jax.core.eval_jaxpr, closed.jaxpr, closed.consts)
    return mlir.lower_fun(evaluate)(context.replace(avals_in=avals), *operands)


lanes_p = core.Primitive("lanes")
lanes_p.multiple_results = True
lanes_p.def_impl(lambda *operands, function, **static: jax.tree.leaves(function(*operands)))
lanes_p.def_abstract_eval(lambda *avals, closed, **static: compute_abstract_results(*avals, call_jaxpr=closed))
batching.primitive_batchers[lanes_p] = _batching_rule
mlir.register_lowering(lanes_p, _lowering_rule)

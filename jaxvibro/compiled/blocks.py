"""Run functions of lanes block by block, and turn a vmap of such a function into more lanes."""

import math
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
from jax import lax
from jax.core import ShapedArray
from jax.extend import core
from jax.interpreters import batching, mlir

from .kernels import (
    BLOCK_SIZES,
    TooCostly,
    abstract_results,
    block_width,
    is_within_blocks,
    narrow_block_width,
    on_cpu,
    use_block_sizes,
)

MIN_LANES = 16  # least lanes of a block; XLA compiles fewer differently, and results differ by a rounding error


def run_in_blocks(run, tree, initial_results, min_lanes=MIN_LANES, rows=(), n_due=None, max_blocks=1):
    """Run a function of lanes on blocks of lanes.

    Blocks are narrower where XLA would split an operation of a kernel of full blocks over threads.

    Parameters
    ----------
    run : callable
        Function ``run(tree, *rows)`` of scalars and of the lanes of one block. Returns a pytree of arrays, lanes first.
    tree : pytree of array
        Arguments of any shapes that broadcast against each other. Scalars are passed on as scalars.
    initial_results : callable
        Function from a number of lanes to the initial content of the results, lanes first.
    min_lanes : int, optional
        Smallest number of lanes in a block.
    rows : sequence of array, optional
        Further arguments with all lanes and one additional axis, the last.
    n_due : int or array, optional
        Number of lanes to compute, counted from the first. None computes all lanes.
    max_blocks : int, optional
        Largest number of blocks that one call of `run` receives. If there is more than one block, they are full.

    Returns
    -------
    pytree of array
        Results of `run` for all lanes, in the broadcast shape of `tree`.
    """
    if is_within_blocks():
        return _run_in_blocks(run, tree, initial_results, min_lanes, rows, n_due, max_blocks)
    for sizes in BLOCK_SIZES:
        try:
            with use_block_sizes(sizes):
                return _run_in_blocks(
                    run, tree, initial_results, min_lanes, rows, n_due, min(max_blocks, sizes.max_blocks)
                )
        except TooCostly:
            continue
    return _run_in_blocks(run, tree, initial_results, min_lanes, rows, n_due, max_blocks)


def _run_in_blocks(run, tree, initial_results, min_lanes, rows, n_due, max_blocks):
    """Run a function of lanes with the current block sizes."""
    leaves, treedef = jax.tree.flatten(tree)
    shape = jnp.broadcast_shapes(*map(jnp.shape, leaves))
    if not shape:
        return run(tree, *rows)
    n_lanes = math.prod(shape)
    full_width = block_width()
    width = min(full_width if n_due is None else narrow_block_width(), max(min_lanes, 1 << (n_lanes - 1).bit_length()))
    if n_lanes > full_width:
        n_blocks = -(-n_lanes // full_width)
        # the same number in each strip, so that few are computed twice
        width *= -(-n_blocks // -(-n_blocks // max_blocks))
    n_padded = max(n_lanes, width)

    def pad_lanes(leaf, *row_sizes):
        flat = jnp.broadcast_to(leaf, (*shape, *row_sizes)).reshape(n_lanes, *row_sizes)
        padding = [(0, n_padded - n_lanes), *[(0, 0)] * len(row_sizes)]
        return jnp.pad(flat, padding, mode="edge" if n_lanes else "constant")

    # a scalar for all lanes remains a scalar
    leaves = [pad_lanes(leaf) if jnp.shape(leaf) else leaf for leaf in leaves]
    rows = [pad_lanes(row, row.shape[-1]) for row in rows]

    def run_block(block, results):
        start = jnp.minimum(block * width, n_padded - width)  # the last block may repeat lanes of the previous one
        block_leaves = [lax.dynamic_slice_in_dim(leaf, start, width) if jnp.shape(leaf) else leaf for leaf in leaves]
        block_results = run(
            treedef.unflatten(block_leaves), *(lax.dynamic_slice_in_dim(row, start, width) for row in rows)
        )
        return jax.tree.map(
            lambda array, part: lax.dynamic_update_slice_in_dim(array, part, start, 0), results, block_results
        )

    results = lax.fori_loop(
        0, -(-(n_padded if n_due is None else n_due) // width), run_block, initial_results(n_padded)
    )
    return jax.tree.map(lambda array: array[:n_lanes].reshape(*shape, *array.shape[1:]), results)


def vmap_as_lanes(function, n_rows=0):
    """Wrap a function of lanes as one operation, so that a vmap of it is one call with more lanes.

    The function is traced by itself, for arrays of given shapes and types. Hence the surrounding program does not
    change it. The operation has no derivative rule.

    Parameters
    ----------
    function : callable
        Function of arrays that broadcast. Returns a pytree of arrays.
    n_rows : int, optional
        Number of the last arguments that have one axis more than the lanes.

    Returns
    -------
    callable
        Function with the arguments and results of `function`.
    """

    def run(*operands):
        results, treedef = _bind_lanes(function, n_rows, operands)
        return jax.tree.unflatten(treedef, results)

    return run


def _bind_lanes(function, n_rows, operands):
    """Return (results, their pytree structure) of a function applied as one operation."""
    signature = tuple((jnp.shape(operand), jnp.result_type(operand)) for operand in operands)
    closed_jaxpr, treedef = _trace(function, signature, (jax.config.jax_enable_x64, on_cpu()))
    return lanes_p.bind(*operands, closed=closed_jaxpr, function=function, rows=n_rows), treedef


@lru_cache(512)
def _trace(function, signature, settings):
    """Return (closed jaxpr, pytree structure of the results) for arrays of given shapes and types."""
    abstract_operands = [jax.ShapeDtypeStruct(*shape_dtype) for shape_dtype in signature]
    closed_jaxpr, result_shapes = jax.make_jaxpr(function, return_shape=True)(*abstract_operands)
    return closed_jaxpr, jax.tree.structure(result_shapes)


def _add_lane_axis(axis_size, axes, operands, n_rows):
    """Give all operands the additional lane axis of a vmap, as their first axis."""
    row_axes = [0] * (len(operands) - n_rows) + [1] * n_rows
    operands = [
        operand if axis is None else jnp.moveaxis(operand, axis, 0)
        for operand, axis in zip(operands, axes, strict=True)
    ]
    lane_ranks = [
        jnp.ndim(operand) - n_row_axes - (axis is not None)
        for operand, n_row_axes, axis in zip(operands, row_axes, axes, strict=True)
    ]
    rank = max(lane_ranks)

    def align(operand, axis, lane_rank):
        return operand if axis is None else operand.reshape(axis_size, *[1] * (rank - lane_rank), *operand.shape[1:])

    return [*map(align, operands, axes, lane_ranks)]


def _batching_rule(operands, axes, *, closed, function, rows):
    axis_size = next(operand.shape[axis] for operand, axis in zip(operands, axes, strict=True) if axis is not None)
    results, _ = _bind_lanes(function, rows, _add_lane_axis(axis_size, axes, operands, rows))
    return results, [0] * len(results)


def _lowering_rule(context, *operands, closed, **static):
    avals = [ShapedArray(aval.shape, aval.dtype) for aval in context.avals_in]
    run = partial(jax.core.eval_jaxpr, closed.jaxpr, closed.consts)
    return mlir.lower_fun(run)(context.replace(avals_in=avals), *operands)


lanes_p = core.Primitive("lanes")
lanes_p.multiple_results = True
lanes_p.def_impl(lambda *operands, function, **static: jax.tree.leaves(function(*operands)))
lanes_p.def_abstract_eval(lambda *avals, closed, **static: abstract_results(*avals, call_jaxpr=closed))
batching.primitive_batchers[lanes_p] = _batching_rule
mlir.register_lowering(lanes_p, _lowering_rule)

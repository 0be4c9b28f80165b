"""Run a function of lanes block by block; a caller's own vmap of it becomes more lanes."""

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

MIN_LANES = 16  # lanes of a block: fewer are compiled in another way, and differ by a rounding


def run_in_blocks(run, tree, initial_results, min_lanes=MIN_LANES, rows=(), n_due=None, max_blocks=1):
    """run(tree, *rows) for numbers of any shapes that broadcast; run takes scalars and lanes of one block.

    initial_results: from a number of lanes to the results' first content, lanes first. min_lanes: lanes that a block
    has at least. rows: arrays of all lanes with an axis more, the last. n_due: of so many lanes alone, the first ones,
    None: of all. max_blocks: run takes the lanes of so many blocks at most, in full ones where there is more than one
    block. Blocks are shorter where XLA would split an operation of a kernel of full ones over threads."""
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
    leaves, treedef = jax.tree.flatten(tree)
    shape = jnp.broadcast_shapes(*map(jnp.shape, leaves))
    if not shape:
        return run(tree, *rows)
    n_lanes = math.prod(shape)
    full_width = block_width()
    width = min(full_width if n_due is None else narrow_block_width(), max(min_lanes, 1 << (n_lanes - 1).bit_length()))
    if n_lanes > full_width:
        n_blocks = -(-n_lanes // full_width)
        width *= -(-n_blocks // -(-n_blocks // max_blocks))  # as many in each strip, so that few are done twice
    n_padded = max(n_lanes, width)

    def pad_lanes(leaf, *row_sizes):
        flat = jnp.broadcast_to(leaf, (*shape, *row_sizes)).reshape(n_lanes, *row_sizes)
        padding = [(0, n_padded - n_lanes), *[(0, 0)] * len(row_sizes)]
        return jnp.pad(flat, padding, mode="edge" if n_lanes else "constant")

    leaves = [pad_lanes(leaf) if jnp.shape(leaf) else leaf for leaf in leaves]  # one number for all lanes stays one
    rows = [pad_lanes(row, row.shape[-1]) for row in rows]

    def run_block(block, results):
        start = jnp.minimum(block * width, n_padded - width)  # the last block may repeat lanes of the one before
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
    """function(*numbers) -> a tree of arrays, as one operation of which a vmap is one call with more lanes.

    What surrounds the call changes nothing within it: the function is traced by itself, for arrays of given shapes and
    types. It has no derivatives of its own. n_rows: so many of the last arguments have an axis more than the lanes'.
    """

    def run(*operands):
        results, treedef = _bind_lanes(function, n_rows, operands)
        return jax.tree.unflatten(treedef, results)

    return run


def _bind_lanes(function, n_rows, operands):
    """(results, their tree) of a function as one operation."""
    signature = tuple((jnp.shape(operand), jnp.result_type(operand)) for operand in operands)
    closed_jaxpr, treedef = _trace(function, signature, (jax.config.jax_enable_x64, on_cpu()))
    return lanes_p.bind(*operands, closed=closed_jaxpr, function=function, rows=n_rows), treedef


@lru_cache(512)
def _trace(function, signature, settings):
    """(closed jaxpr, tree of the results) for arrays of such shapes and types."""
    abstract_operands = [jax.ShapeDtypeStruct(*shape_dtype) for shape_dtype in signature]
    closed_jaxpr, result_shapes = jax.make_jaxpr(function, return_shape=True)(*abstract_operands)
    return closed_jaxpr, jax.tree.structure(result_shapes)


def _add_lane_axis(axis_size, axes, operands, n_rows):
    """Numbers whose lanes have one axis more, the first."""
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

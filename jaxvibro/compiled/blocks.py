"""Run a function of lanes block by block; a caller's own vmap of it becomes more lanes."""

import math
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
from jax import lax
from jax.core import ShapedArray
from jax.extend import core
from jax.interpreters import batching, mlir

from .kernels import SIZES, TooCostly, block_width, is_within_blocks, narrow_width, of_sizes, on_processor, shapes_of

LEAST = 16  # lanes of a block: fewer are compiled in another way, and differ by a rounding


def in_blocks(run, tree, blank, least=LEAST, rows=(), due=None, strip=1):
    """run(tree, *rows) for numbers of any shapes that broadcast; run takes scalars and lanes of one block.

    blank: from a number of lanes to the results' first content, lanes first. least: lanes that a block has at least.
    rows: arrays of all lanes with an axis more, the last. due: of so many lanes alone, the first ones, None: of all.
    strip: run takes the lanes of so many blocks at most, in full ones where there is more than one block. Blocks are
    shorter where XLA would split an operation of a kernel of full ones over threads.
    """
    if is_within_blocks():
        return _in_blocks(run, tree, blank, least, rows, due, strip)
    for sizes in SIZES:
        try:
            with of_sizes(sizes):
                return _in_blocks(run, tree, blank, least, rows, due, min(strip, sizes.strip))
        except TooCostly:
            continue
    return _in_blocks(run, tree, blank, least, rows, due, strip)


def _in_blocks(run, tree, blank, least, rows, due, strip):
    leaves, form = jax.tree.flatten(tree)
    shape = jnp.broadcast_shapes(*map(jnp.shape, leaves))
    if not shape:
        return run(tree, *rows)
    count = math.prod(shape)
    whole = block_width()
    width = min(whole if due is None else narrow_width(), max(least, 1 << (count - 1).bit_length()))
    if count > whole:
        blocks = -(-count // whole)
        width *= -(-blocks // -(-blocks // strip))  # as many in each strip, so that few are done twice
    total = max(count, width)

    def spread(leaf, *more):
        flat = jnp.broadcast_to(leaf, (*shape, *more)).reshape(count, *more)
        filler = [(0, total - count), *[(0, 0)] * len(more)]
        return jnp.pad(flat, filler, mode="edge" if count else "constant")

    leaves = [spread(leaf) if jnp.shape(leaf) else leaf for leaf in leaves]  # one number for all lanes stays one
    rows = [spread(row, row.shape[-1]) for row in rows]

    def put(block, out):
        start = jnp.minimum(block * width, total - width)  # the last block may repeat lanes of the one before
        some = [lax.dynamic_slice_in_dim(leaf, start, width) if jnp.shape(leaf) else leaf for leaf in leaves]
        done = run(form.unflatten(some), *(lax.dynamic_slice_in_dim(row, start, width) for row in rows))
        return jax.tree.map(lambda whole, part: lax.dynamic_update_slice_in_dim(whole, part, start, 0), out, done)

    out = lax.fori_loop(0, -(-(total if due is None else due) // width), put, blank(total))
    return jax.tree.map(lambda part: part[:count].reshape(*shape, *part.shape[1:]), out)


def batched(function, rows=0):
    """function(*numbers) -> a tree of arrays, as one operation of which a vmap is one call with more lanes.

    What surrounds the call changes nothing within it: the function is traced by itself, for arrays of given shapes and
    types. It has no derivatives of its own. rows: so many of the last arguments have an axis more than the lanes'.
    """

    def run(*numbers):
        results, tree = _called(function, rows, numbers)
        return jax.tree.unflatten(tree, results)

    return run


def _called(function, rows, numbers):
    """(results, their tree) of a function as one operation."""
    kinds = tuple((jnp.shape(number), jnp.result_type(number)) for number in numbers)
    closed, tree = _traced(function, kinds, (jax.config.jax_enable_x64, on_processor()))
    return lanes_p.bind(*numbers, closed=closed, function=function, rows=rows), tree


@lru_cache(512)
def _traced(function, kinds, settings):
    """(closed jaxpr, tree of the results) for arrays of such shapes and types."""
    blank = [jax.ShapeDtypeStruct(*kind) for kind in kinds]
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*blank)
    return closed, jax.tree.structure(shape)


def _more_lanes(size, axes, numbers, rows):
    """Numbers whose lanes have one axis more, the first."""
    own = [0] * (len(numbers) - rows) + [1] * rows
    numbers = [n if axis is None else jnp.moveaxis(n, axis, 0) for n, axis in zip(numbers, axes, strict=True)]
    lanes = [jnp.ndim(n) - k - (axis is not None) for n, k, axis in zip(numbers, own, axes, strict=True)]
    rank = max(lanes)

    def aligned(number, axis, own):
        return number if axis is None else number.reshape(size, *[1] * (rank - own), *number.shape[1:])

    return [*map(aligned, numbers, axes, lanes)]


def _vmapped(numbers, axes, *, closed, function, rows):
    size = next(n.shape[axis] for n, axis in zip(numbers, axes, strict=True) if axis is not None)
    results, _ = _called(function, rows, _more_lanes(size, axes, numbers, rows))
    return results, [0] * len(results)


def _lowered(context, *numbers, closed, **static):
    blank = [ShapedArray(aval.shape, aval.dtype) for aval in context.avals_in]
    run = partial(jax.core.eval_jaxpr, closed.jaxpr, closed.consts)
    return mlir.lower_fun(run)(context.replace(avals_in=blank), *numbers)


lanes_p = core.Primitive("lanes")
lanes_p.multiple_results = True
lanes_p.def_impl(lambda *numbers, function, **static: jax.tree.leaves(function(*numbers)))
lanes_p.def_abstract_eval(lambda *avals, closed, **static: shapes_of(*avals, call_jaxpr=closed))
batching.primitive_batchers[lanes_p] = _vmapped
mlir.register_lowering(lanes_p, _lowered)

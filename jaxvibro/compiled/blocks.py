"""Lanes in blocks: a function of lanes is run block by block, and a caller's own vmap of it becomes more lanes."""

import math

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap

from .compiler_hints import block_width, narrow_width

LEAST = 16  # lanes of a block: fewer are compiled in another way, and differ by a rounding


def in_blocks(run, tree, blank, least=LEAST, rows=(), due=None, strip=1):
    """run(tree, *rows) for numbers of any shapes that broadcast; run takes scalars and lanes of one block.

    blank: from a number of lanes to the results' first content, lanes first. least: lanes that a block has at least.
    rows: arrays of all lanes with an axis more, the last. due: of so many lanes alone, the first ones, None: of all.
    strip: run takes the lanes of so many blocks at most, in full ones where there is more than one block.
    """
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
    """function(*numbers) -> a tree of real numbers, such that a vmap of it is one call with more lanes.

    Real numbers only, and no None among them: custom_vmap passes on nothing else. rows: so many of the last arguments
    have an axis more than the lanes'.
    """
    run = custom_vmap(function)

    @run.def_vmap
    def _(size, batched, *numbers):
        more = [0] * (len(numbers) - rows) + [1] * rows
        lanes = [jnp.ndim(n) - own - axis for n, own, axis in zip(numbers, more, batched, strict=True)]
        rank = max(lanes)

        def aligned(number, axis, own):
            return number.reshape(size, *[1] * (rank - own), *number.shape[1:]) if axis else number

        out = function(*map(aligned, numbers, batched, lanes))
        return out, jax.tree.map(lambda _: any(batched), out)

    return run

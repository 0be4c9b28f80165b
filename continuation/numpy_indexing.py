"""gather and scatter, jax's indexing with arrays, in NumPy."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jax import lax

LANE_MODES = (lax.GatherScatterMode.FILL_OR_DROP, lax.GatherScatterMode.CLIP, lax.GatherScatterMode.PROMISE_IN_BOUNDS)


class Unknown(Exception):
    """A primitive, or a use of one, that has no rule."""


def _places(index, shape, sizes, kept, mapped, lanes):
    """(for each axis of an operand the indices of some windows, shaped (windows, *sizes of those kept); which windows
    are within it, (windows,)).

    index: (windows, mapped); sizes: of a window along each axis; mapped: the axes that its numbers are of; lanes: pairs
    (axis, axis of the windows) that go together.
    """
    batch = index.shape[:-1]
    starts, inside = [np.zeros(batch, int)] * len(shape), np.ones(batch, bool)
    for k, axis in enumerate(mapped):
        first, last = index[..., k].astype(int), shape[axis] - sizes[axis]
        inside = inside & (first >= 0) & (first <= last)
        starts[axis] = np.clip(first, 0, last)
    for axis, along in lanes:
        thin = [-1 if place == along else 1 for place in range(len(batch))]
        starts[axis] = np.broadcast_to(np.arange(shape[axis]).reshape(thin), batch)
    whole, found = (*batch, *(sizes[axis] for axis in kept)), []
    for axis, start in enumerate(starts):
        place = start.reshape((*batch, *[1] * len(kept)))
        if axis in kept:
            place = place + np.arange(sizes[axis]).reshape([-1 if other == axis else 1 for other in kept])
        found.append(np.broadcast_to(place, whole))
    return tuple(found), inside


def gather(dimension_numbers: Any, slice_sizes: Any, mode: Any, fill_value: Any, **_: Any) -> Callable[..., Any]:
    """Windows of an operand at some indices: a function of (operand, indices)."""
    how = dimension_numbers
    if mode not in LANE_MODES:
        raise Unknown(mode)

    def run(x, index):
        dropped = (*how.collapsed_slice_dims, *how.operand_batching_dims)
        kept = [axis for axis in range(x.ndim) if axis not in dropped]
        lanes = list(zip(how.operand_batching_dims, how.start_indices_batching_dims, strict=True))
        places, inside = _places(index, x.shape, slice_sizes, kept, how.start_index_map, lanes)
        found, batch = x[places], index.ndim - 1
        if mode == lax.GatherScatterMode.FILL_OR_DROP and not inside.all():
            empty = fill_value
            if empty is None:
                empty = np.nan if x.dtype.kind == "f" else np.iinfo(x.dtype).min if x.dtype.kind == "i" else True
            inside = inside.reshape((*inside.shape, *[1] * len(kept)))
            found = np.where(inside, found, np.asarray(empty, x.dtype))
        order, rest = [0] * found.ndim, iter(range(batch))
        for place in range(found.ndim):
            within = place in how.offset_dims
            order[place] = batch + how.offset_dims.index(place) if within else next(rest)
        return np.transpose(found, order)[()]

    return run


def scatter(put: Callable[..., Any], dimension_numbers: Any, mode: Any, **_: Any) -> Callable[..., Any]:
    """An operand with windows put, or added, at some indices: a function of (operand, indices, windows).

    put: of (array, places, windows), in place.
    """
    how = dimension_numbers
    if mode not in LANE_MODES:
        raise Unknown(mode)

    def run(x, index, new):
        dropped = (*how.inserted_window_dims, *how.operand_batching_dims)
        kept = [axis for axis in range(x.ndim) if axis not in dropped]
        sizes = [1] * x.ndim
        for axis, place in zip(kept, how.update_window_dims, strict=True):
            sizes[axis] = new.shape[place]
        rest = [place for place in range(new.ndim) if place not in how.update_window_dims]
        lanes = list(zip(how.operand_batching_dims, how.scatter_indices_batching_dims, strict=True))
        mapped = how.scatter_dims_to_operand_dims
        places, inside = _places(index, x.shape, sizes, kept, mapped, lanes)
        if mode == lax.GatherScatterMode.CLIP:
            inside = np.ones_like(inside)
        found = np.array(x)
        put(found, tuple(each[inside] for each in places), np.transpose(new, [*rest, *how.update_window_dims])[inside])
        return found[()]

    return run

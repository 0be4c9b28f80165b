"""Implement JAX's gather and scatter in NumPy."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jax import lax

GATHER_MODES = (lax.GatherScatterMode.FILL_OR_DROP, lax.GatherScatterMode.CLIP, lax.GatherScatterMode.PROMISE_IN_BOUNDS)


class NoRuleError(Exception):
    """Error for a primitive, or a use of one, without a rule."""


def _window_indices(index, shape, window_sizes, window_axes, indexed_axes, batch_axes):
    """Return the indices of windows for each axis of an operand, and which windows lie inside it.

    `index` has shape (windows, indexed axes). The indices have shape (windows, sizes of the window axes), the mask
    (windows,). `window_sizes` contains the size along each axis, `batch_axes` pairs (axis, axis of the windows).
    """
    batch_shape = index.shape[:-1]
    starts, is_inside = [np.zeros(batch_shape, int)] * len(shape), np.ones(batch_shape, bool)
    for k, axis in enumerate(indexed_axes):
        window_start, max_start = index[..., k].astype(int), shape[axis] - window_sizes[axis]
        is_inside = is_inside & (window_start >= 0) & (window_start <= max_start)
        starts[axis] = np.clip(window_start, 0, max_start)
    for axis, batch_axis in batch_axes:
        broadcast_shape = [-1 if axis_indices == batch_axis else 1 for axis_indices in range(len(batch_shape))]
        starts[axis] = np.broadcast_to(np.arange(shape[axis]).reshape(broadcast_shape), batch_shape)
    index_shape, indices = (*batch_shape, *(window_sizes[axis] for axis in window_axes)), []
    for axis, start in enumerate(starts):
        axis_indices = start.reshape((*batch_shape, *[1] * len(window_axes)))
        if axis in window_axes:
            axis_indices = axis_indices + np.arange(window_sizes[axis]).reshape(
                [-1 if window_axis == axis else 1 for window_axis in window_axes]
            )
        indices.append(np.broadcast_to(axis_indices, index_shape))
    return tuple(indices), is_inside


def gather(dimension_numbers: Any, slice_sizes: Any, mode: Any, fill_value: Any, **_: Any) -> Callable[..., Any]:
    """Make the rule of gather, a function of (operand, indices)."""
    dimensions = dimension_numbers
    if mode not in GATHER_MODES:
        raise NoRuleError(mode)

    def run(x, index):
        dropped_axes = (*dimensions.collapsed_slice_dims, *dimensions.operand_batching_dims)
        window_axes = [x_axis for x_axis in range(x.ndim) if x_axis not in dropped_axes]
        batch_axes = list(zip(dimensions.operand_batching_dims, dimensions.start_indices_batching_dims, strict=True))
        indices, is_inside = _window_indices(
            index, x.shape, slice_sizes, window_axes, dimensions.start_index_map, batch_axes
        )
        windows, n_batch_axes = x[indices], index.ndim - 1
        if mode == lax.GatherScatterMode.FILL_OR_DROP and not is_inside.all():
            fill = fill_value
            if fill is None:
                fill = np.nan if x.dtype.kind == "f" else np.iinfo(x.dtype).min if x.dtype.kind == "i" else True
            is_inside = is_inside.reshape((*is_inside.shape, *[1] * len(window_axes)))
            windows = np.where(is_inside, windows, np.asarray(fill, x.dtype))
        order, batch_iterator = [0] * windows.ndim, iter(range(n_batch_axes))
        for axis in range(windows.ndim):
            is_window_axis = axis in dimensions.offset_dims
            order[axis] = n_batch_axes + dimensions.offset_dims.index(axis) if is_window_axis else next(batch_iterator)
        return np.transpose(windows, order)[()]

    return run


def scatter(write_windows: Callable[..., Any], dimension_numbers: Any, mode: Any, **_: Any) -> Callable[..., Any]:
    """Make the rule of scatter, a function of (operand, indices, windows).

    `write_windows` writes in place: (array, indices, windows).
    """
    dimensions = dimension_numbers
    if mode not in GATHER_MODES:
        raise NoRuleError(mode)

    def run(x, index, windows):
        dropped_axes = (*dimensions.inserted_window_dims, *dimensions.operand_batching_dims)
        window_axes = [axis for axis in range(x.ndim) if axis not in dropped_axes]
        window_sizes = [1] * x.ndim
        for axis, update_axis in zip(window_axes, dimensions.update_window_dims, strict=True):
            window_sizes[axis] = windows.shape[update_axis]
        batch_order = [
            update_axis for update_axis in range(windows.ndim) if update_axis not in dimensions.update_window_dims
        ]
        batch_axes = list(zip(dimensions.operand_batching_dims, dimensions.scatter_indices_batching_dims, strict=True))
        indexed_axes = dimensions.scatter_dims_to_operand_dims
        indices, is_inside = _window_indices(index, x.shape, window_sizes, window_axes, indexed_axes, batch_axes)
        if mode == lax.GatherScatterMode.CLIP:
            is_inside = np.ones_like(is_inside)
        result = np.array(x)
        write_windows(
            result,
            tuple(axis_indices[is_inside] for axis_indices in indices),
            np.transpose(windows, [*batch_order, *dimensions.update_window_dims])[is_inside],
        )
        return result[()]

    return run

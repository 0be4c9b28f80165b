"""Implement JAX's gather and scatter in NumPy."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jax import lax

GATHER_MODES = (lax.GatherScatterMode.FILL_OR_DROP, lax.GatherScatterMode.CLIP, lax.GatherScatterMode.PROMISE_IN_BOUNDS)


class NoRuleError(Exception):
    """Error for a primitive without a rule, or for parameters or types that the rule does not support."""


def _window_indices(start_indices, operand_shape, window_sizes, window_axes, indexed_axes, batch_axis_pairs):
    """Return the indices of windows along each axis of an operand, and a mask of the windows inside the operand.

    `start_indices` has shape (windows, indexed axes). The indices have shape (windows, sizes of the window axes), the
    mask (windows,). `window_sizes` contains the size of a window along each axis. `batch_axis_pairs` contains pairs
    (axis of the operand, axis of the windows).
    """
    batch_shape = start_indices.shape[:-1]
    starts_by_axis, is_window_inside = [np.zeros(batch_shape, int)] * len(operand_shape), np.ones(batch_shape, bool)
    for k, axis in enumerate(indexed_axes):
        axis_starts, max_start = start_indices[..., k].astype(int), operand_shape[axis] - window_sizes[axis]
        is_window_inside = is_window_inside & (axis_starts >= 0) & (axis_starts <= max_start)
        starts_by_axis[axis] = np.clip(axis_starts, 0, max_start)
    for axis, batch_axis in batch_axis_pairs:
        broadcast_shape = [-1 if other_batch_axis == batch_axis else 1 for other_batch_axis in range(len(batch_shape))]
        starts_by_axis[axis] = np.broadcast_to(np.arange(operand_shape[axis]).reshape(broadcast_shape), batch_shape)
    operand_index_shape, operand_indices = (*batch_shape, *(window_sizes[axis] for axis in window_axes)), []
    for axis, start in enumerate(starts_by_axis):
        axis_indices = start.reshape((*batch_shape, *[1] * len(window_axes)))
        if axis in window_axes:
            axis_indices = axis_indices + np.arange(window_sizes[axis]).reshape(
                [-1 if other_window_axis == axis else 1 for other_window_axis in window_axes]
            )
        operand_indices.append(np.broadcast_to(axis_indices, operand_index_shape))
    return tuple(operand_indices), is_window_inside


def gather(dimension_numbers: Any, slice_sizes: Any, mode: Any, fill_value: Any, **_: Any) -> Callable[..., Any]:
    """Make the rule of gather, a function of (operand, indices)."""
    dimensions = dimension_numbers
    if mode not in GATHER_MODES:
        raise NoRuleError(mode)

    def run(operand, start_indices):
        dropped_axes = (*dimensions.collapsed_slice_dims, *dimensions.operand_batching_dims)
        window_axes = [operand_axis for operand_axis in range(operand.ndim) if operand_axis not in dropped_axes]
        batch_axis_pairs = list(
            zip(dimensions.operand_batching_dims, dimensions.start_indices_batching_dims, strict=True)
        )
        operand_indices, is_window_inside = _window_indices(
            start_indices, operand.shape, slice_sizes, window_axes, dimensions.start_index_map, batch_axis_pairs
        )
        windows, n_batch_axes = operand[operand_indices], start_indices.ndim - 1
        if mode == lax.GatherScatterMode.FILL_OR_DROP and not is_window_inside.all():
            fill_entry = fill_value
            if fill_entry is None:
                fill_entry = (
                    np.nan
                    if operand.dtype.kind == "f"
                    else np.iinfo(operand.dtype).min
                    if operand.dtype.kind == "i"
                    else True
                )
            is_window_inside = is_window_inside.reshape((*is_window_inside.shape, *[1] * len(window_axes)))
            windows = np.where(is_window_inside, windows, np.asarray(fill_entry, operand.dtype))
        axis_order, batch_axis_iterator = [0] * windows.ndim, iter(range(n_batch_axes))
        for axis in range(windows.ndim):
            is_window_axis = axis in dimensions.offset_dims
            axis_order[axis] = (
                n_batch_axes + dimensions.offset_dims.index(axis) if is_window_axis else next(batch_axis_iterator)
            )
        return np.transpose(windows, axis_order)[()]

    return run


def scatter(write_windows: Callable[..., Any], dimension_numbers: Any, mode: Any, **_: Any) -> Callable[..., Any]:
    """Make the rule of scatter, a function of (operand, indices, windows).

    `write_windows` takes (array, indices, windows) and writes the windows into the array.
    """
    dimensions = dimension_numbers
    if mode not in GATHER_MODES:
        raise NoRuleError(mode)

    def run(operand, start_indices, update_windows):
        dropped_axes = (*dimensions.inserted_window_dims, *dimensions.operand_batching_dims)
        window_axes = [axis for axis in range(operand.ndim) if axis not in dropped_axes]
        window_sizes = [1] * operand.ndim
        for axis, update_axis in zip(window_axes, dimensions.update_window_dims, strict=True):
            window_sizes[axis] = update_windows.shape[update_axis]
        batch_update_axes = [
            update_axis
            for update_axis in range(update_windows.ndim)
            if update_axis not in dimensions.update_window_dims
        ]
        batch_axis_pairs = list(
            zip(dimensions.operand_batching_dims, dimensions.scatter_indices_batching_dims, strict=True)
        )
        indexed_axes = dimensions.scatter_dims_to_operand_dims
        operand_indices, is_window_inside = _window_indices(
            start_indices, operand.shape, window_sizes, window_axes, indexed_axes, batch_axis_pairs
        )
        if mode == lax.GatherScatterMode.CLIP:
            is_window_inside = np.ones_like(is_window_inside)
        result = np.array(operand)
        write_windows(
            result,
            tuple(axis_indices[is_window_inside] for axis_indices in operand_indices),
            np.transpose(update_windows, [*batch_update_axes, *dimensions.update_window_dims])[is_window_inside],
        )
        return result[()]

    return run

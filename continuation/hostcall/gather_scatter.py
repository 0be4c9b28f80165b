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
        starts_by_axis[axis] = np.indices(batch_shape)[batch_axis]
    offsets = np.indices([window_sizes[axis] for axis in window_axes])
    new_axes = tuple(range(-len(window_axes), 0))
    operand_indices = [np.expand_dims(starts, new_axes) for starts in starts_by_axis]
    for axis, offset in zip(window_axes, offsets, strict=True):
        operand_indices[axis] = operand_indices[axis] + offset
    return np.broadcast_arrays(*operand_indices), is_window_inside


def _window_axes(operand, dropped_axes, batching_axes):
    return [axis for axis in range(operand.ndim) if axis not in dropped_axes and axis not in batching_axes]


def gather(dimension_numbers: Any, slice_sizes: Any, mode: Any, fill_value: Any = None) -> Callable[..., Any]:
    """Make the rule of gather, a function of (operand, indices)."""
    dimensions = dimension_numbers
    if mode not in GATHER_MODES:
        raise NoRuleError(f"gather in the mode {mode}")
    batch_axis_pairs = list(zip(dimensions.operand_batching_dims, dimensions.start_indices_batching_dims, strict=True))

    def run(operand, start_indices):
        window_axes = _window_axes(operand, dimensions.collapsed_slice_dims, dimensions.operand_batching_dims)
        operand_indices, is_inside = _window_indices(
            start_indices, operand.shape, slice_sizes, window_axes, dimensions.start_index_map, batch_axis_pairs
        )
        windows, n_batch_axes = operand[tuple(operand_indices)], start_indices.ndim - 1
        if mode == lax.GatherScatterMode.FILL_OR_DROP and not is_inside.all():
            kind = operand.dtype.kind
            default = np.nan if kind == "f" else np.iinfo(operand.dtype).min if kind == "i" else True
            is_inside = is_inside.reshape((*is_inside.shape, *[1] * len(window_axes)))
            fill = np.asarray(default if fill_value is None else fill_value, operand.dtype)
            windows = np.where(is_inside, windows, fill)
        return np.moveaxis(windows, range(n_batch_axes, windows.ndim), dimensions.offset_dims)[()]

    return run


def scatter(write_windows: Callable[..., Any], dimension_numbers: Any, mode: Any) -> Callable[..., Any]:
    """Make the rule of scatter, a function of (operand, indices, windows).

    `write_windows` takes (array, indices, windows) and writes the windows into the array.
    """
    dimensions = dimension_numbers
    if mode not in GATHER_MODES:
        raise NoRuleError(f"scatter in the mode {mode}")
    batch_axis_pairs = list(
        zip(dimensions.operand_batching_dims, dimensions.scatter_indices_batching_dims, strict=True)
    )

    def run(operand, start_indices, update_windows):
        window_axes = _window_axes(operand, dimensions.inserted_window_dims, dimensions.operand_batching_dims)
        window_sizes = np.ones(operand.ndim, int)
        window_sizes[window_axes] = [update_windows.shape[axis] for axis in dimensions.update_window_dims]
        operand_indices, is_inside = _window_indices(
            start_indices,
            operand.shape,
            window_sizes,
            window_axes,
            dimensions.scatter_dims_to_operand_dims,
            batch_axis_pairs,
        )
        is_written = is_inside | (mode == lax.GatherScatterMode.CLIP)
        window_first = range(-len(window_axes), 0)
        updates = np.moveaxis(update_windows, dimensions.update_window_dims, window_first)
        result = np.array(operand)
        write_windows(result, tuple(indices[is_written] for indices in operand_indices), updates[is_written])
        return result[()]

    return run

"""Implement JAX's primitives in NumPy: `RULES` maps a primitive's parameters to a function of its operands.

Operands and results are NumPy arrays and scalars of the types that JAX gives them.
"""

import operator
from collections.abc import Callable
from functools import partial, reduce
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


RULES_VERSION = 1  # version of this table; a change of a rule that changes results increases it
# Parameters that do not change the result. Any other parameter that a rule does not take refuses the equation.
IGNORED_PARAMETERS = {
    "indices_are_sorted",
    "is_stable",
    "out_sharding",
    "precision",
    "preferred_element_type",
    "sharding",
    "unique_indices",
    "update_consts",
    "update_jaxpr",
    "weak_type",
}
UNSUPPORTED = {"atan2": "c", "clamp": "c"}  # kinds of operands for which NumPy's function is missing or differs


def rule_arguments(params: dict[str, Any]) -> dict[str, Any]:
    """Return the parameters of an equation that its rule takes; None is the default of each."""
    return {key: value for key, value in params.items() if key not in IGNORED_PARAMETERS and value is not None}


def make_rule(name: str, params: dict[str, Any]) -> Any:
    """Make the function of the operands of an equation. Raises NoRuleError for an unknown primitive or parameter."""
    try:
        return RULES[name](**rule_arguments(params))
    except (KeyError, TypeError) as error:
        raise NoRuleError(f"{name}: {error}") from None


def _divide(x, y):
    """Divide; integer quotients are truncated, and integer division by zero sets all bits, as in XLA."""
    if y.dtype.kind not in "iu":
        return x / y
    floor_quotient = np.floor_divide(x, y)
    needs_increment = (np.multiply(floor_quotient, y) != x) & ((x < 0) != (y < 0))
    quotient = np.where(y == 0, ~np.zeros_like(y), floor_quotient + needs_increment.astype(y.dtype))
    return quotient.astype(y.dtype)[()]


def _remainder(x, y):
    """Return the remainder with the sign of x; for integers and y = 0 return x, as in XLA."""
    remainder = np.fmod(x, y)
    return remainder if y.dtype.kind == "f" else np.where(y == 0, x, remainder).astype(y.dtype)[()]


def _round_away(x):
    integer_part = np.trunc(x)
    return integer_part + np.copysign(np.asarray(abs(x - integer_part) >= 0.5).astype(x.dtype), x)


def _round(rounding_method):
    return np.round if rounding_method == lax.RoundingMethod.TO_NEAREST_EVEN else _round_away


def _integer_power(y):
    def power(x):
        product = reduce(operator.mul, [x] * abs(y))
        return product if y > 0 else 1 / product

    return power if y else np.ones_like


def _convert(new_dtype):
    dtype = np.dtype(new_dtype)

    def run(x):
        x_real = x.real if x.dtype.kind == "c" and dtype.kind != "c" else x
        is_truncated = x_real.dtype.kind == "f" and dtype.kind in "iu"
        return _truncate_to_integers(x_real, dtype) if is_truncated else x_real.astype(dtype)

    return run


def _truncate_to_integers(x, dtype):
    """Convert floats to integers; values out of range are clipped, nan becomes 0."""
    limits = np.iinfo(dtype)
    is_below_range, is_above_range = x <= float(limits.min), x >= float(limits.max)
    truncated = np.where(is_below_range | is_above_range | np.isnan(x), 0.0, x).astype(dtype)
    extremes = [dtype.type(limits.max), dtype.type(limits.min)]
    return np.select([is_above_range, is_below_range], extremes, truncated)[()]


def _bitcast(new_dtype):
    dtype = np.dtype(new_dtype)

    def run(x):
        if x.dtype.itemsize != dtype.itemsize:  # the parts of a number would form a further axis
            raise NoRuleError("bitcast_convert_type between widths")
        return np.asarray(x).view(dtype)[()]

    return run


def _select(case_index, *cases):
    if case_index.ndim == 0:
        return cases[int(case_index)]
    return np.where(case_index, cases[1], cases[0]) if case_index.dtype == bool else np.choose(case_index, cases)


def _broadcast(shape, broadcast_dimensions):
    new_axes = tuple(axis for axis in range(len(shape)) if axis not in broadcast_dimensions)
    return lambda x: np.array(np.broadcast_to(np.expand_dims(x, new_axes), shape))


def _reshape(new_sizes):
    return lambda x: x.reshape(new_sizes)[()]


def _squeeze(dimensions):
    return lambda x: np.squeeze(x, tuple(dimensions))[()]


def _expand_dims(dimensions):
    return lambda x: np.expand_dims(x, tuple(dimensions))


def _slice(start_indices, limit_indices, strides=None):
    slices = tuple(map(slice, start_indices, limit_indices, strides or [1] * len(start_indices)))
    return lambda x: x[slices]


def _clipped_window(starts, shape, sizes):
    """Return the slices of a window that is moved into an array."""
    origins = [min(max(int(start), 0), length - size) for start, length, size in zip(starts, shape, sizes, strict=True)]
    return tuple(slice(origin, origin + size) for origin, size in zip(origins, sizes, strict=True))


def _dynamic_slice(slice_sizes):
    return lambda x, *starts: x[_clipped_window(starts, x.shape, slice_sizes)]


def _update_window(x, window, *starts):
    result = x.copy()
    result[_clipped_window(starts, x.shape, window.shape)] = window
    return result


def _concatenate(dimension):
    return lambda *parts: np.concatenate(parts, dimension)


def _stack(axis):
    return lambda *parts: np.stack(parts, axis)


def _unstack(axis):
    return lambda x: list(np.moveaxis(x, axis, 0))


def _split(sizes, axis):
    return lambda x: np.split(x, np.cumsum(sizes)[:-1], axis)


def _tile(reps):
    return lambda x: np.tile(x, reps)


def _iota(dtype, shape, dimension):
    shape_with_ones = [-1 if axis == dimension else 1 for axis in range(len(shape))]
    result = np.broadcast_to(np.arange(shape[dimension], dtype=dtype).reshape(shape_with_ones), shape)
    return lambda: result


def _transpose(permutation):
    return lambda x: np.transpose(x, permutation)


def _reverse(dimensions):
    return lambda x: np.flip(x, tuple(dimensions))


def _pad(padding_config):
    if any(low_padding < 0 or high_padding < 0 for low_padding, high_padding, _ in padding_config):
        raise NoRuleError("padding by less than nothing")

    def run(x, value):
        axis_spans = [
            (low_padding, low_padding + max(size - 1, 0) * (spacing + 1) + min(size, 1), high_padding, spacing + 1)
            for size, (low_padding, high_padding, spacing) in zip(x.shape, padding_config, strict=True)
        ]
        padded = np.full([stop + high_padding for _, stop, high_padding, _ in axis_spans], value, x.dtype)
        padded[tuple(slice(low_padding, stop, spacing) for low_padding, stop, _, spacing in axis_spans)] = x
        return padded

    return run


def _dot_general(dimension_numbers):
    (x_summed_axes, y_summed_axes), (x_batch_axes, y_batch_axes) = dimension_numbers

    def run(x, y):
        x_labels, y_labels = list(range(x.ndim)), list(range(x.ndim, x.ndim + y.ndim))
        for x_axis, y_axis in zip((*x_summed_axes, *x_batch_axes), (*y_summed_axes, *y_batch_axes), strict=True):
            y_labels[y_axis] = x_axis
        labels = dict.fromkeys((*x_batch_axes, *x_labels, *y_labels))  # in order, once each
        return np.einsum(x, x_labels, y, y_labels, [label for label in labels if label not in x_summed_axes])

    return run


def _sort(dimension, num_keys):
    def run(*operands):
        order = np.lexsort(operands[:num_keys][::-1], axis=dimension)
        return [np.take_along_axis(operand, order, dimension) for operand in operands]

    return run


def _without_parameters(function):
    """Return the function itself; an equation with parameters is refused."""
    return function


def _reduction(ufunc, axes):
    if not axes:
        return lambda x: x
    return lambda x: ufunc.reduce(x, axis=tuple(axes), dtype=x.dtype)


def _extremum(function, axes, index_dtype):
    return lambda x: np.asarray(function(x, axis=axes[0])).astype(index_dtype)[()]


def _cumulative(function, axis, reverse):
    def run(x):
        cumulative = function(np.flip(x, axis) if reverse else x, axis, dtype=x.dtype)
        return np.flip(cumulative, axis) if reverse else cumulative

    return run


ELEMENTWISE = {
    "abs": operator.abs,
    "add": operator.add,
    "add_any": operator.add,
    "and": operator.and_,
    "atan2": np.arctan2,
    "ceil": np.ceil,
    "clamp": lambda lower, x, upper: np.minimum(np.maximum(x, lower), upper),
    "copy": lambda x: x,
    "copy_p": lambda x: x,
    "cos": np.cos,
    "cosh": np.cosh,
    "div": _divide,
    "dynamic_update_slice": _update_window,
    "eq": operator.eq,
    "exp": np.exp,
    "exp2": np.exp2,
    "expm1": np.expm1,
    "floor": np.floor,
    "ge": operator.ge,
    "gt": operator.gt,
    "is_finite": np.isfinite,
    "le": operator.le,
    "log": np.log,
    "log1p": np.log1p,
    "lt": operator.lt,
    "max": np.maximum,
    "min": np.minimum,
    "mul": operator.mul,
    "ne": operator.ne,
    "neg": operator.neg,
    "nextafter": np.nextafter,
    "not": np.invert,
    "optimization_barrier": lambda *x: x,
    "or": operator.or_,
    "pow": np.power,
    "rem": _remainder,
    "rsqrt": lambda x: 1.0 / np.sqrt(x),
    "select_n": _select,
    "sign": np.sign,
    "sin": np.sin,
    "sinh": np.sinh,
    "sqrt": np.sqrt,
    "square": np.square,
    "stop_gradient": lambda x: x,
    "sub": operator.sub,
    "tan": np.tan,
    "tanh": np.tanh,
    "xor": operator.xor,
}
REDUCTIONS = {
    "reduce_and": np.bitwise_and,
    "reduce_max": np.maximum,
    "reduce_min": np.minimum,
    "reduce_or": np.bitwise_or,
    "reduce_prod": np.multiply,
    "reduce_sum": np.add,
}
RULES: dict[str, Callable[..., Any]] = {}
RULES |= {name: partial(_without_parameters, function) for name, function in ELEMENTWISE.items()}
RULES |= {name: partial(_reduction, ufunc) for name, ufunc in REDUCTIONS.items()}
RULES |= {
    "argmax": partial(_extremum, np.argmax),
    "argmin": partial(_extremum, np.argmin),
    "cumsum": partial(_cumulative, np.cumsum),
    "cumprod": partial(_cumulative, np.cumprod),
    "integer_pow": _integer_power,
    "round": _round,
    "convert_element_type": _convert,
    "bitcast_convert_type": _bitcast,
    "broadcast_in_dim": _broadcast,
    "reshape": _reshape,
    "squeeze": _squeeze,
    "expand_dims": _expand_dims,
    "slice": _slice,
    "dynamic_slice": _dynamic_slice,
    "concatenate": _concatenate,
    "stack": _stack,
    "unstack": _unstack,
    "split": _split,
    "tile": _tile,
    "iota": _iota,
    "transpose": _transpose,
    "rev": _reverse,
    "pad": _pad,
    "dot_general": _dot_general,
    "sort": _sort,
    "gather": gather,
    "scatter": partial(scatter, operator.setitem),
}
RULES |= {f"scatter{separator}add": partial(scatter, np.add.at) for separator in "-_"}
RULES |= {f"scatter{separator}mul": partial(scatter, np.multiply.at) for separator in "-_"}

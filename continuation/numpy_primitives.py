"""Implement JAX's primitives in NumPy: rules map the parameters of a primitive to a function of its operands.

Operands and results are NumPy arrays and scalars of the types that JAX gives them.
"""

import operator
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from jax import lax

from .numpy_gather_scatter import NoRuleError, gather, scatter

Rule = Callable[..., Any]
UNSUPPORTED = {"atan2": "c", "clamp": "c"}  # kinds of operands for which NumPy's function is missing or differs
rules: dict[str, Callable[..., Rule]] = {}


def register_rule(*names):
    """Make a decorator that registers a function of a primitive's parameters as the rule of this primitive."""

    def register(rule_factory):
        rules.update(dict.fromkeys(names, rule_factory))
        return rule_factory

    return register


def _elementwise_rule(function, **_):
    return function


def _reduction_rule(function, axes, **_):
    return partial(_reduce, function.reduce, tuple(axes))


def _reduce(reduce_ufunc, axes, x):
    return reduce_ufunc(x, axis=axes, dtype=x.dtype) if axes else x


def _arg_extremum_rule(function, axes, index_dtype, **_):
    return lambda x: np.asarray(function(x, axis=axes[0])).astype(index_dtype)[()]


def _cumulative_rule(function, axis, reverse, **_):
    def run(x):
        oriented_array = np.flip(x, axis) if reverse else x
        cumulative = function(oriented_array, axis, dtype=x.dtype)
        return np.flip(cumulative, axis) if reverse else cumulative

    return run


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


def _bitwise_not(x):
    return np.logical_not(x) if x.dtype == bool else ~x


def _identity(x, *_):
    return x


ELEMENTWISE = {
    "abs": operator.abs,
    "add": operator.add,
    "add_any": operator.add,
    "and": operator.and_,
    "atan2": np.arctan2,
    "ceil": np.ceil,
    "clamp": lambda lower, x, upper: np.minimum(np.maximum(x, lower), upper),
    "copy": _identity,
    "copy_p": _identity,
    "cos": np.cos,
    "cosh": np.cosh,
    "div": _divide,
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
    "not": _bitwise_not,
    "optimization_barrier": lambda *x: x,
    "or": operator.or_,
    "pow": np.power,
    "rem": _remainder,
    "rsqrt": lambda x: 1.0 / np.sqrt(x),
    "sign": np.sign,
    "sin": np.sin,
    "sinh": np.sinh,
    "sqrt": np.sqrt,
    "square": np.square,
    "stop_gradient": _identity,
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
rules |= {name: partial(_elementwise_rule, function) for name, function in ELEMENTWISE.items()}
rules |= {name: partial(_reduction_rule, function) for name, function in REDUCTIONS.items()}
rules |= {"argmax": partial(_arg_extremum_rule, np.argmax), "argmin": partial(_arg_extremum_rule, np.argmin)}
rules |= {"cumsum": partial(_cumulative_rule, np.cumsum), "cumprod": partial(_cumulative_rule, np.cumprod)}


@register_rule("integer_pow")
def _integer_pow(y, **_):
    def power(x):
        repeated_product = x
        for _ in range(abs(y) - 1):
            repeated_product = repeated_product * x
        return repeated_product if y > 0 else 1 / repeated_product

    if y == 0:
        return np.ones_like
    return power


@register_rule("round")
def _round(rounding_method, **_):
    def round_away(x):
        integer_part = np.trunc(x)
        return integer_part + np.copysign(np.asarray(abs(x - integer_part) >= 0.5).astype(x.dtype), x)

    return np.round if rounding_method == lax.RoundingMethod.TO_NEAREST_EVEN else round_away


@register_rule("convert_element_type")
def _convert_element_type(new_dtype, **_):
    dtype = np.dtype(new_dtype)

    def run(x):
        x_real = x.real if x.dtype.kind == "c" and dtype.kind != "c" else x
        return (
            _truncate_to_integers(x_real, dtype)
            if x_real.dtype.kind == "f" and dtype.kind in "iu"
            else x_real.astype(dtype)
        )

    return run


def _truncate_to_integers(x, dtype):
    """Convert floats to integers; values out of range are clipped, nan becomes 0."""
    limits = np.iinfo(dtype)
    is_below_range, is_above_range = x <= float(limits.min), x >= float(limits.max)
    truncated = np.where(is_below_range | is_above_range | np.isnan(x), 0.0, x).astype(dtype)
    return np.where(
        is_above_range, dtype.type(limits.max), np.where(is_below_range, dtype.type(limits.min), truncated)
    )[()]


@register_rule("bitcast_convert_type")
def _bitcast_convert_type(new_dtype, **_):
    dtype = np.dtype(new_dtype)

    def run(x):
        if x.dtype.itemsize != dtype.itemsize:  # the parts of a number would form a further axis
            raise NoRuleError("bitcast_convert_type")
        return np.asarray(x).view(dtype)[()]

    return run


@register_rule("select_n")
def _select_n(**_):
    def select(case_index, *cases):
        if case_index.ndim == 0:
            return cases[int(case_index)]
        return np.where(case_index, cases[1], cases[0]) if case_index.dtype == bool else np.choose(case_index, cases)

    return select


@register_rule("broadcast_in_dim")
def _broadcast_in_dim(shape, broadcast_dimensions, **_):
    def run(x):
        shape_with_ones = [1] * len(shape)
        for axis, size in zip(broadcast_dimensions, x.shape, strict=True):
            shape_with_ones[axis] = size
        result = np.empty(shape, x.dtype)
        result[...] = x.reshape(shape_with_ones)
        return result

    return run


@register_rule("reshape")
def _reshape(new_sizes, dimensions=None, **_):
    if dimensions is not None:
        raise NoRuleError("dimensions of reshape")
    return lambda x: x.reshape(new_sizes)[()]


@register_rule("squeeze")
def _squeeze(dimensions, **_):
    return lambda x: np.squeeze(x, tuple(dimensions))[()]


@register_rule("expand_dims")
def _expand_dims(dimensions, **_):
    return lambda x: np.expand_dims(x, tuple(dimensions))


@register_rule("slice")
def _slice(start_indices, limit_indices, strides, **_):
    slices = tuple(map(slice, start_indices, limit_indices, strides or [1] * len(start_indices)))
    return lambda x: x[slices]


def _slices_of_clipped_window(starts, shape, sizes):
    window_origins = (
        min(max(int(start), 0), length - size) for start, length, size in zip(starts, shape, sizes, strict=True)
    )
    return tuple(slice(origin, origin + size) for origin, size in zip(window_origins, sizes, strict=True))


@register_rule("dynamic_slice")
def _dynamic_slice(slice_sizes, **_):
    return lambda x, *starts: x[_slices_of_clipped_window(starts, x.shape, slice_sizes)]


@register_rule("dynamic_update_slice")
def _dynamic_update_slice(**_):
    def run(x, window, *starts):
        result = x.copy()
        result[_slices_of_clipped_window(starts, x.shape, window.shape)] = window
        return result

    return run


@register_rule("concatenate")
def _concatenate(dimension, **_):
    return lambda *parts: np.concatenate(parts, dimension)


@register_rule("stack")
def _stack(axis, **_):
    return lambda *parts: np.stack(parts, axis)


@register_rule("unstack")
def _unstack(axis, **_):
    return lambda x: list(np.moveaxis(x, axis, 0))


@register_rule("split")
def _split(sizes, axis, **_):
    return lambda x: np.split(x, np.cumsum(sizes)[:-1], axis)


@register_rule("tile")
def _tile(reps, **_):
    return lambda x: np.tile(x, reps)


@register_rule("iota")
def _iota(dtype, shape, dimension, **_):
    shape_with_ones = [-1 if axis == dimension else 1 for axis in range(len(shape))]
    result = np.broadcast_to(np.arange(shape[dimension], dtype=dtype).reshape(shape_with_ones), shape)
    return lambda: result


@register_rule("transpose")
def _transpose(permutation, **_):
    return lambda x: np.transpose(x, permutation)


@register_rule("rev")
def _rev(dimensions, **_):
    return lambda x: np.flip(x, tuple(dimensions))


@register_rule("pad")
def _pad(padding_config, **_):
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


@register_rule("dot_general")
def _dot_general(dimension_numbers, **_):
    (x_summed_axes, y_summed_axes), (x_batch_axes, y_batch_axes) = dimension_numbers

    def run(x, y):
        x_labels = list(range(x.ndim))
        y_labels = [x.ndim + axis for axis in range(y.ndim)]
        for x_axis, y_axis in zip((*x_summed_axes, *x_batch_axes), (*y_summed_axes, *y_batch_axes), strict=True):
            y_labels[y_axis] = x_labels[x_axis]
        summed_labels = {x_labels[axis] for axis in x_summed_axes}
        batch_labels = [x_labels[axis] for axis in x_batch_axes]
        free_labels = [
            label for label in (*x_labels, *y_labels) if label not in summed_labels and label not in batch_labels
        ]
        return np.einsum(x, x_labels, y, y_labels, batch_labels + list(dict.fromkeys(free_labels)))

    return run


@register_rule("sort")
def _sort(dimension, num_keys, **_):
    def run(*operands):
        order = np.lexsort(operands[:num_keys][::-1], axis=dimension)
        return [np.take_along_axis(operand, order, dimension) for operand in operands]

    return run


rules["gather"] = gather
rules["scatter"] = partial(scatter, operator.setitem)
rules |= {f"scatter{separator}add": partial(scatter, np.add.at) for separator in "-_"}
rules |= {f"scatter{separator}mul": partial(scatter, np.multiply.at) for separator in "-_"}

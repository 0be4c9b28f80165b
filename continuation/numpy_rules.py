"""What jax's primitives do, in NumPy: of a primitive's parameters, the function of its operands' values.

Operands and results are NumPy's arrays and scalars, of the types that jax gives them.
"""

import operator
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from jax import lax

from .numpy_indexing import Unknown, gather, scatter

Rule = Callable[..., Any]
COMPILED = {"atan2": "c", "clamp": "c"}  # kinds of operands of which NumPy has no such function, or another one
rules: dict[str, Callable[..., Rule]] = {}


def rule(*names):
    """Keeps a function of a primitive's parameters as its rule."""

    def keep(make):
        rules.update(dict.fromkeys(names, make))
        return make

    return keep


def _always(function, **_):
    return function


def _over(function, axes, **_):
    return partial(_reduced, function.reduce, tuple(axes))


def _reduced(reduce, axes, x):
    return reduce(x, axis=axes, dtype=x.dtype) if axes else x


def _place_of(function, axes, index_dtype, **_):
    return lambda x: np.asarray(function(x, axis=axes[0])).astype(index_dtype)[()]


def _along(function, axis, reverse, **_):
    def run(x):
        turned = np.flip(x, axis) if reverse else x
        found = function(turned, axis, dtype=x.dtype)
        return np.flip(found, axis) if reverse else found

    return run


def _divided(x, y):
    """The quotient, of whole numbers truncated; of these by zero -1, all bits set, as XLA has it."""
    if y.dtype.kind not in "iu":
        return x / y
    below = np.floor_divide(x, y)
    inexact = (np.multiply(below, y) != x) & ((x < 0) != (y < 0))
    found = np.where(y == 0, ~np.zeros_like(y), below + inexact.astype(y.dtype))
    return found.astype(y.dtype)[()]


def _remainder(x, y):
    """The remainder of division, with the sign of x; of whole numbers by zero x itself, as XLA has it."""
    found = np.fmod(x, y)
    return found if y.dtype.kind == "f" else np.where(y == 0, x, found).astype(y.dtype)[()]


def _negated(x):
    return np.logical_not(x) if x.dtype == bool else ~x


def _same(x, *_):
    return x


ELEMENTWISE = {
    "abs": operator.abs,
    "add": operator.add,
    "add_any": operator.add,
    "and": operator.and_,
    "atan2": np.arctan2,
    "ceil": np.ceil,
    "clamp": lambda low, x, high: np.minimum(np.maximum(x, low), high),
    "copy": _same,
    "copy_p": _same,
    "cos": np.cos,
    "cosh": np.cosh,
    "div": _divided,
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
    "not": _negated,
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
    "stop_gradient": _same,
    "sub": operator.sub,
    "tan": np.tan,
    "tanh": np.tanh,
    "xor": operator.xor,
}
REDUCED = {
    "reduce_and": np.bitwise_and,
    "reduce_max": np.maximum,
    "reduce_min": np.minimum,
    "reduce_or": np.bitwise_or,
    "reduce_prod": np.multiply,
    "reduce_sum": np.add,
}
rules |= {name: partial(_always, each) for name, each in ELEMENTWISE.items()}
rules |= {name: partial(_over, each) for name, each in REDUCED.items()}
rules |= {"argmax": partial(_place_of, np.argmax), "argmin": partial(_place_of, np.argmin)}
rules |= {"cumsum": partial(_along, np.cumsum), "cumprod": partial(_along, np.cumprod)}


@rule("integer_pow")
def _integer_pow(y, **_):
    def power(x):
        found = x
        for _ in range(abs(y) - 1):
            found = found * x
        return found if y > 0 else 1 / found

    if y == 0:
        return np.ones_like
    return power


@rule("round")
def _round(rounding_method, **_):
    def away(x):
        whole = np.trunc(x)
        return whole + np.copysign(np.asarray(abs(x - whole) >= 0.5).astype(x.dtype), x)

    return np.round if rounding_method == lax.RoundingMethod.TO_NEAREST_EVEN else away


@rule("convert_element_type")
def _convert_element_type(new_dtype, **_):
    kind = np.dtype(new_dtype)

    def run(x):
        part = x.real if x.dtype.kind == "c" and kind.kind != "c" else x
        return _truncated(part, kind) if part.dtype.kind == "f" and kind.kind in "iu" else part.astype(kind)

    return run


def _truncated(x, kind):
    """Real numbers as whole ones: those beyond the least and the largest as these, what is no number as 0."""
    ends = np.iinfo(kind)
    low, high = x <= float(ends.min), x >= float(ends.max)
    found = np.where(low | high | np.isnan(x), 0.0, x).astype(kind)
    return np.where(high, kind.type(ends.max), np.where(low, kind.type(ends.min), found))[()]


@rule("bitcast_convert_type")
def _bitcast_convert_type(new_dtype, **_):
    kind = np.dtype(new_dtype)

    def run(x):
        if x.dtype.itemsize != kind.itemsize:  # parts of numbers would be an axis of their own
            raise Unknown("bitcast_convert_type")
        return np.asarray(x).view(kind)[()]

    return run


@rule("select_n")
def _select_n(**_):
    def select(which, *cases):
        if which.ndim == 0:
            return cases[int(which)]
        return np.where(which, cases[1], cases[0]) if which.dtype == bool else np.choose(which, cases)

    return select


@rule("broadcast_in_dim")
def _broadcast_in_dim(shape, broadcast_dimensions, **_):
    def run(x):
        thin = [1] * len(shape)
        for place, size in zip(broadcast_dimensions, x.shape, strict=True):
            thin[place] = size
        found = np.empty(shape, x.dtype)
        found[...] = x.reshape(thin)
        return found

    return run


@rule("reshape")
def _reshape(new_sizes, dimensions=None, **_):
    if dimensions is not None:
        raise Unknown("dimensions of reshape")
    return lambda x: x.reshape(new_sizes)[()]


@rule("squeeze")
def _squeeze(dimensions, **_):
    return lambda x: np.squeeze(x, tuple(dimensions))[()]


@rule("expand_dims")
def _expand_dims(dimensions, **_):
    return lambda x: np.expand_dims(x, tuple(dimensions))


@rule("slice")
def _slice(start_indices, limit_indices, strides, **_):
    cut = tuple(map(slice, start_indices, limit_indices, strides or [1] * len(start_indices)))
    return lambda x: x[cut]


def _window(starts, shape, sizes):
    firsts = (min(max(int(start), 0), whole - size) for start, whole, size in zip(starts, shape, sizes, strict=True))
    return tuple(slice(first, first + size) for first, size in zip(firsts, sizes, strict=True))


@rule("dynamic_slice")
def _dynamic_slice(slice_sizes, **_):
    return lambda x, *starts: x[_window(starts, x.shape, slice_sizes)]


@rule("dynamic_update_slice")
def _dynamic_update_slice(**_):
    def run(x, part, *starts):
        found = x.copy()
        found[_window(starts, x.shape, part.shape)] = part
        return found

    return run


@rule("concatenate")
def _concatenate(dimension, **_):
    return lambda *parts: np.concatenate(parts, dimension)


@rule("stack")
def _stack(axis, **_):
    return lambda *parts: np.stack(parts, axis)


@rule("unstack")
def _unstack(axis, **_):
    return lambda x: list(np.moveaxis(x, axis, 0))


@rule("split")
def _split(sizes, axis, **_):
    return lambda x: np.split(x, np.cumsum(sizes)[:-1], axis)


@rule("tile")
def _tile(reps, **_):
    return lambda x: np.tile(x, reps)


@rule("iota")
def _iota(dtype, shape, dimension, **_):
    thin = [-1 if place == dimension else 1 for place in range(len(shape))]
    found = np.broadcast_to(np.arange(shape[dimension], dtype=dtype).reshape(thin), shape)
    return lambda: found


@rule("transpose")
def _transpose(permutation, **_):
    return lambda x: np.transpose(x, permutation)


@rule("rev")
def _rev(dimensions, **_):
    return lambda x: np.flip(x, tuple(dimensions))


@rule("pad")
def _pad(padding_config, **_):
    if any(low < 0 or high < 0 for low, high, _ in padding_config):
        raise Unknown("padding by less than nothing")

    def run(x, value):
        spans = [
            (low, low + max(size - 1, 0) * (gap + 1) + min(size, 1), high, gap + 1)
            for size, (low, high, gap) in zip(x.shape, padding_config, strict=True)
        ]
        found = np.full([last + high for _, last, high, _ in spans], value, x.dtype)
        found[tuple(slice(low, last, gap) for low, last, _, gap in spans)] = x
        return found

    return run


@rule("dot_general")
def _dot_general(dimension_numbers, **_):
    (left, right), (left_lanes, right_lanes) = dimension_numbers

    def run(x, y):
        names = list(range(x.ndim))
        others = [x.ndim + place for place in range(y.ndim)]
        for one, other in zip((*left, *left_lanes), (*right, *right_lanes), strict=True):
            others[other] = names[one]
        summed = {names[place] for place in left}
        lanes = [names[place] for place in left_lanes]
        rest = [name for name in (*names, *others) if name not in summed and name not in lanes]
        return np.einsum(x, names, y, others, lanes + list(dict.fromkeys(rest)))

    return run


@rule("sort")
def _sort(dimension, num_keys, **_):
    def run(*columns):
        order = np.lexsort(columns[:num_keys][::-1], axis=dimension)
        return [np.take_along_axis(each, order, dimension) for each in columns]

    return run


rules["gather"] = gather
rules["scatter"] = partial(scatter, operator.setitem)
rules |= {f"scatter{mark}add": partial(scatter, np.add.at) for mark in "-_"}
rules |= {f"scatter{mark}mul": partial(scatter, np.multiply.at) for mark in "-_"}

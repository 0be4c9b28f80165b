"""Write primitives on small arrays entry by entry."""

from functools import reduce

import numpy as np
from jax import lax

from .rules import make_rule

LIST_PRIMITIVES = {"optimization_barrier", "sort", "split", "unstack"}  # primitives whose rules return lists
# Primitives that only move entries: {name: indices of the operands that must be constant}
MOVES = {
    "broadcast_in_dim": (),
    "concatenate": (),
    "copy": (),
    "copy_p": (),
    "dynamic_slice": (1, 2, 3, 4),
    "dynamic_update_slice": (2, 3, 4, 5),
    "expand_dims": (),
    "gather": (1,),
    "optimization_barrier": (),
    "pad": (),
    "reshape": (),
    "rev": (),
    "scatter": (1,),
    "slice": (),
    "split": (),
    "squeeze": (),
    "stack": (),
    "stop_gradient": (),
    "tile": (),
    "transpose": (),
    "unstack": (),
}
OUT_OF_RANGE = -1  # stands for an entry outside the operand
MAXIMUM_TEXT = "{0} if {0} >= {1} or {0} != {0} else {1}"
MINIMUM_TEXT = "{0} if {0} <= {1} or {0} != {0} else {1}"
UFUNC_NAMES = ("cosh", "exp", "exp2", "expm1", "log", "log1p", "sinh", "tan", "tanh")
EXPRESSIONS = {
    "abs": "abs({0})",
    "add": "{0} + {1}",
    "add_any": "{0} + {1}",
    "and": "{0} & {1}",
    "cos": "math.cos({0}) if math.isfinite({0}) else nan",
    "div": "{0} / {1} if {1} else divide_ieee({0}, {1})",
    "eq": "{0} == {1}",
    "ge": "{0} >= {1}",
    "gt": "{0} > {1}",
    "is_finite": "math.isfinite({0})",
    "le": "{0} <= {1}",
    "lt": "{0} < {1}",
    "max": MAXIMUM_TEXT,
    "min": MINIMUM_TEXT,
    "mul": "{0} * {1}",
    "ne": "{0} != {1}",
    "neg": "-{0}",
    "or": "{0} | {1}",
    "rsqrt": "1.0 / math.sqrt({0}) if {0} > 0.0 else divide_ieee(1.0, np.sqrt({0}))",
    "sin": "math.sin({0}) if math.isfinite({0}) else nan",
    "sqrt": "math.sqrt({0}) if {0} >= 0.0 else nan",
    "square": "{0} * {0}",
    "sub": "{0} - {1}",
    "xor": "{0} ^ {1}",
} | {name: f"np.{name}({{0}}).item()" for name in UFUNC_NAMES}
OVERFLOW_PRIMITIVES = {"abs", "add", "mul", "neg", "square", "sub"}  # primitives that may overflow for integers
REDUCTION_OPERATIONS = {"reduce_sum": "add", "reduce_prod": "mul", "reduce_max": "max", "reduce_min": "min"}
REDUCTION_OPERATIONS |= {"reduce_and": "and", "reduce_or": "or"}


def write_small_primitive(writer, name, params, operands, constants, avals):
    """Write a primitive on small arrays and return the values of its results; None for an unsupported primitive."""
    dtype = np.dtype(avals[0].dtype) if avals else None
    indices = [index for index in MOVES.get(name, ()) if index < len(operands)]
    if name in MOVES and all(constants[index] is not None for index in indices):
        arguments = [constants[k] if k in indices else value for k, value in enumerate(operands)]
        return _move_entries(name, params, arguments)
    if name in SPECIAL_WRITERS:
        result = SPECIAL_WRITERS[name](writer, params, dtype, *operands)
    elif name in REDUCTION_OPERATIONS:
        result = _write_reduction(writer, expression_text(REDUCTION_OPERATIONS[name], dtype), *operands, params["axes"])
    elif name in EXPRESSIONS and not (name == "div" and dtype.kind != "f"):
        result = write_elementwise(writer, expression_text(name, dtype), *operands)
    else:
        return None
    return None if result is None else [result]


def expression_text(name, dtype):
    """Return the text of a primitive; for integers that may overflow the result is wrapped to their number of bits."""
    text = EXPRESSIONS[name]
    return f"wrap_integer({8 * dtype.itemsize}, {text})" if dtype.kind == "i" and name in OVERFLOW_PRIMITIVES else text


def map_entries(function, *operands):
    """Return the values of a function of entries, for the entries of the broadcast operands."""
    return np.asarray(np.frompyfunc(function, len(operands), 1)(*operands), int)


def write_elementwise(writer, text, *operands):
    """Write a line with the text for each entry of the broadcast operands."""
    return map_entries(lambda *entries: writer.emit_line(text, entries), *operands)


def _move_entries(name, params, arguments):
    """Apply a primitive that only moves entries; return None if an index is out of range."""
    results = make_rule(name, params | ({"fill_value": OUT_OF_RANGE} if name == "gather" else {}))(*arguments)
    results = [np.asarray(value) for value in (results if name in LIST_PRIMITIVES else [results])]
    return None if any((value == OUT_OF_RANGE).any() for value in results) else results


def _write_gather(writer, params, dtype, operand, start_indices):
    """Write a gather with variable indices as a selection among all possible entries.

    Returns None if indices have several coordinates or may lie outside the array.
    """
    dimensions = params["dimension_numbers"]
    if len(dimensions.start_index_map) != 1 or params["mode"] == lax.GatherScatterMode.FILL_OR_DROP:
        return None
    (axis,) = dimensions.start_index_map
    max_start, gather_rule = operand.shape[axis] - params["slice_sizes"][axis], make_rule("gather", params)
    starts = (np.full(start_indices.shape, start) for start in range(max_start + 1))
    index_text = "{0} > 0" if max_start == 1 else f"min(max({{0}}, 0), {max_start})"
    index = np.expand_dims(write_elementwise(writer, index_text, start_indices[..., 0]), dimensions.offset_dims)
    return _write_select(writer, params, dtype, index, *(np.asarray(gather_rule(operand, start)) for start in starts))


def _write_select(writer, params, dtype, case_index, *cases):
    """Write a selection among cases, entry by entry."""
    texts = ", ".join(f"{{{k}}}" for k in range(1, len(cases) + 1))
    text = "{2} if {0} else {1}" if len(cases) == 2 else f"({texts})[{{0}}]"

    def select(index, *entries):
        if index in writer.values:
            return entries[int(writer.values[index])]
        return entries[0] if len(set(entries)) == 1 else writer.emit_line(text, (index, *entries))

    return map_entries(select, case_index, *cases)


def _write_conversion(writer, params, dtype, value):
    """Write a conversion between types; None for floats to integers."""
    new_dtype = np.dtype(params["new_dtype"])
    if dtype == new_dtype or (dtype.kind == new_dtype.kind == "i" and dtype.itemsize <= new_dtype.itemsize):
        return value
    if new_dtype.kind == "i" and dtype.kind == "f":
        return None
    wrapped = f"wrap_integer({8 * new_dtype.itemsize}, int({{0}}))"
    return write_elementwise(writer, {"f": "float({0})", "b": "{0} != 0", "i": wrapped}[new_dtype.kind], value)


def _write_integer_power(writer, params, dtype, value):
    """Write an integer power as repeated products."""
    exponent, constant_one = params["y"], np.array(writer.constant_number(dtype.type(1).item()))
    factors = [value] * abs(exponent) or [np.broadcast_to(constant_one, value.shape)]
    product = reduce(lambda x, y: write_elementwise(writer, expression_text("mul", dtype), x, y), factors)
    return product if exponent >= 0 else write_elementwise(writer, EXPRESSIONS["div"], constant_one, product)


def _write_reduction(writer, operation_text, value, axes):
    """Write a reduction along axes as a sequence of operations; None for an empty reduction."""
    rows = np.moveaxis(value, axes, range(len(axes)))
    rows = rows.reshape(-1, *rows.shape[len(axes) :])
    return np.asarray(reduce(lambda x, y: write_elementwise(writer, operation_text, x, y), rows)) if len(rows) else None


def _write_dot_general(writer, params, dtype, x, y):
    """Write dot_general as sums of products; None for empty sums."""
    (x_summed, y_summed), (x_batch, y_batch) = params["dimension_numbers"]
    n_batch, n_summed = len(x_batch), len(x_summed)
    positions = (*range(n_batch), *range(-n_summed, 0))
    x, y = np.moveaxis(x, (*x_batch, *x_summed), positions), np.moveaxis(y, (*y_batch, *y_summed), positions)
    n_x, n_y = x.ndim - n_summed, y.ndim - n_summed - n_batch  # x: batch, free of x, 1..., summed; y: batch, 1..., ...
    x, y = np.expand_dims(x, tuple(range(n_x, n_x + n_y))), np.expand_dims(y, tuple(range(n_batch, n_x)))
    products = write_elementwise(writer, expression_text("mul", dtype), x, y)
    return _write_reduction(writer, expression_text("add", dtype), products, tuple(range(n_x + n_y, products.ndim)))


def _write_clamp(writer, params, dtype, lower, x, upper):
    return write_elementwise(writer, MINIMUM_TEXT, write_elementwise(writer, MAXIMUM_TEXT, x, lower), upper)


def _write_not(writer, params, dtype, value):
    return write_elementwise(writer, "not {0}" if dtype.kind == "b" else "~{0}", value)


SPECIAL_WRITERS = {
    "clamp": _write_clamp,
    "convert_element_type": _write_conversion,
    "dot_general": _write_dot_general,
    "gather": _write_gather,
    "integer_pow": _write_integer_power,
    "not": _write_not,
    "select_n": _write_select,
}

"""Write primitives on small arrays entry by entry."""

import math
from functools import reduce

import numpy as np
from jax import lax

from .numpy_primitives import rules

LIST_PRIMITIVES = {"optimization_barrier", "sort", "split", "unstack"}  # primitives whose rules return lists
MOVE_PRIMITIVES = {
    "broadcast_in_dim",
    "concatenate",
    "copy",
    "copy_p",
    "expand_dims",
    "optimization_barrier",
    "pad",
    "reshape",
    "rev",
    "slice",
    "split",
    "squeeze",
    "stack",
    "stop_gradient",
    "tile",
    "transpose",
    "unstack",
}
CONSTANT_OPERANDS = {
    "dynamic_slice": (1, 2, 3, 4),
    "dynamic_update_slice": (2, 3, 4, 5),
    "gather": (1,),
    "scatter": (1,),
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


def write_small_primitive(writer, name, params, operands, constants, avals, result_avals):
    """Write a primitive on small arrays and return the values of its results; None for an unsupported primitive."""
    dtype = np.dtype(avals[0].dtype) if avals else None
    if name in MOVE_PRIMITIVES:
        return move_entries(name, params, operands, len(result_avals))
    if name in CONSTANT_OPERANDS and all(
        constants[k] is not None for k in CONSTANT_OPERANDS[name] if k < len(operands)
    ):
        return move_at_constant_indices(name, params, operands, constants)
    if name == "gather":
        return write_gather(writer, params, *operands)
    if name == "select_n":
        return [write_select(writer, *operands)]
    if name == "convert_element_type":
        return write_conversion(writer, operands[0], dtype, np.dtype(params["new_dtype"]))
    if name == "not":
        return [write_elementwise(writer, "not {0}" if dtype.kind == "b" else "~{0}", operands)]
    if name == "integer_pow":
        return [write_integer_power(writer, operands[0], dtype, params["y"])]
    if name == "clamp":
        lower, x, upper = operands
        return [write_elementwise(writer, MINIMUM_TEXT, [write_elementwise(writer, MAXIMUM_TEXT, [x, lower]), upper])]
    if name in REDUCTION_OPERATIONS:
        return write_reduction(writer, expression_text(REDUCTION_OPERATIONS[name], dtype), operands[0], params["axes"])
    if name == "dot_general":
        return write_dot_general(writer, params["dimension_numbers"], *operands, dtype)
    if name in EXPRESSIONS and not (name == "div" and dtype.kind != "f"):
        return [write_elementwise(writer, expression_text(name, dtype), operands)]
    return None


def expression_text(name, dtype):
    """Return the text of a primitive; for integers that may overflow the result is wrapped to their number of bits."""
    text = EXPRESSIONS[name]
    return f"wrap_integer({8 * dtype.itemsize}, {text})" if dtype.kind == "i" and name in OVERFLOW_PRIMITIVES else text


def write_elementwise(writer, text, operands):
    """Write a line with the text for each entry of the broadcast operands."""
    rows, shape = broadcast_entries(operands)
    return np.array([writer.emit_line(text, row) for row in rows], int).reshape(shape)


def broadcast_entries(operands):
    """Return rows of corresponding entries of broadcast values, and the broadcast shape."""
    shape = operands[0].shape
    if any(value.shape != shape for value in operands):
        shape = np.broadcast_shapes(*(value.shape for value in operands))
        operands = [np.broadcast_to(value, shape) for value in operands]
    return list(zip(*(value.ravel().tolist() for value in operands), strict=True)), shape


def move_entries(name, params, operands, n_results):
    """Apply a primitive that only moves entries."""
    results = rules[name](**params)(*operands)
    return [np.asarray(value) for value in (results if name in LIST_PRIMITIVES else [results])]


def move_at_constant_indices(name, params, operands, constants):
    """Apply a primitive that moves entries from or to constant indices; None if an index is out of range."""
    if name == "gather":
        params = params | {"fill_value": OUT_OF_RANGE}
    result = np.asarray(
        rules[name](**params)(
            *(constants[k] if k in CONSTANT_OPERANDS[name] else operand for k, operand in enumerate(operands))
        )
    )
    return None if (result == OUT_OF_RANGE).any() else [result]


def write_gather(writer, params, operand, start_indices):
    """Write a gather with variable indices as a selection among all possible entries.

    Returns None if indices have several coordinates or may lie outside the array.
    """
    dimensions, slice_sizes = params["dimension_numbers"], params["slice_sizes"]
    if len(dimensions.start_index_map) != 1 or params["mode"] == lax.GatherScatterMode.FILL_OR_DROP:
        return None
    (axis,) = dimensions.start_index_map
    max_start, gather_rule = operand.shape[axis] - slice_sizes[axis], rules["gather"](**params)
    entries_by_start = [
        np.asarray(gather_rule(operand, np.full(start_indices.shape, start))) for start in range(max_start + 1)
    ]
    index_text = "{0} > 0" if max_start == 1 else f"min(max({{0}}, 0), {max_start})"
    return [
        write_select(
            writer,
            np.expand_dims(write_elementwise(writer, index_text, [start_indices[..., 0]]), dimensions.offset_dims),
            *entries_by_start,
        )
    ]


def write_select(writer, case_index, *cases):
    """Write a selection among cases, entry by entry."""
    rows, shape = broadcast_entries([case_index, *cases])
    text = (
        "{2} if {0} else {1}"
        if len(cases) == 2
        else f"({', '.join(f'{{{k}}}' for k in range(1, len(cases) + 1))})[{{0}}]"
    )
    results = []
    for row in rows:
        if row[0] in writer.values:
            results.append(row[1 + int(writer.values[row[0]])])
        else:
            results.append(row[1] if len(set(row[1:])) == 1 else writer.emit_line(text, row))
    return np.array(results, int).reshape(shape)


def write_conversion(writer, value, old_dtype, new_dtype):
    """Write a conversion between types; None for floats to integers."""
    if old_dtype == new_dtype or (old_dtype.kind == new_dtype.kind == "i" and old_dtype.itemsize <= new_dtype.itemsize):
        return [value]
    if new_dtype.kind == "i" and old_dtype.kind == "f":
        return None
    text = {"f": "float({0})", "b": "{0} != 0", "i": f"wrap_integer({8 * new_dtype.itemsize}, int({{0}}))"}[
        new_dtype.kind
    ]
    return [write_elementwise(writer, text, [value])]


def write_integer_power(writer, value, dtype, exponent):
    """Write an integer power as repeated products."""
    constant_one = np.array(writer.constant_number(dtype.type(1).item()))
    product = np.broadcast_to(constant_one, value.shape) if exponent == 0 else value
    for _ in range(abs(exponent) - 1):
        product = write_elementwise(writer, expression_text("mul", dtype), [product, value])
    return product if exponent >= 0 else write_elementwise(writer, EXPRESSIONS["div"], [constant_one, product])


def write_reduction(writer, operation_text, value, axes):
    """Write a reduction along axes as a sequence of operations; None for an empty reduction."""
    remaining_axes = [axis for axis in range(value.ndim) if axis not in axes]
    rows = value.transpose([*axes, *remaining_axes]).reshape(-1, *(value.shape[axis] for axis in remaining_axes))
    if not len(rows):
        return None
    return [
        np.asarray(
            reduce(
                lambda accumulated, row: write_elementwise(writer, operation_text, [accumulated, np.asarray(row)]), rows
            )
        )
    ]


def write_dot_general(writer, dimension_numbers, x, y, dtype):
    """Write dot_general as sums of products; None for empty sums."""
    (x_summed_axes, y_summed_axes), (x_batch_axes, y_batch_axes) = dimension_numbers
    grouped_operands = []
    for value, summed_axes, batch_axes in ((x, x_summed_axes, x_batch_axes), (y, y_summed_axes, y_batch_axes)):
        free_axes = [axis for axis in range(value.ndim) if axis not in summed_axes and axis not in batch_axes]
        shape_groups = ([value.shape[axis] for axis in axes] for axes in (batch_axes, free_axes, summed_axes))
        sizes_by_axis_group = list(shape_groups)
        grouped_operands.append(
            (
                value.transpose([*batch_axes, *free_axes, *summed_axes]).reshape(
                    [math.prod(group_sizes) for group_sizes in sizes_by_axis_group]
                ),
                sizes_by_axis_group,
            )
        )
    (x, (batch_sizes, x_free_sizes, summed_sizes)), (y, (_, y_free_sizes, _)) = grouped_operands
    if math.prod(summed_sizes) == 0:
        return None
    products = write_elementwise(writer, expression_text("mul", dtype), [x[:, :, None], y[:, None]])
    (summed_products,) = write_reduction(writer, expression_text("add", dtype), products, (3,))
    return [summed_products.reshape((*batch_sizes, *x_free_sizes, *y_free_sizes))]

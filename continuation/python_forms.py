"""How a primitive on small arrays is written number by number."""

import math
from functools import reduce

import numpy as np
from jax import lax

from .numpy_rules import rules

SEVERAL = {"optimization_barrier", "sort", "split", "unstack"}  # their rules give lists
MOVES = {
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
PLACED = {"dynamic_slice": (1, 2, 3, 4), "dynamic_update_slice": (2, 3, 4, 5), "gather": (1,), "scatter": (1,)}
BEYOND = -1  # for an entry that is not of the operand
LARGER = "{0} if {0} >= {1} or {0} != {0} else {1}"
SMALLER = "{0} if {0} <= {1} or {0} != {0} else {1}"
UFUNCS = ("cosh", "exp", "exp2", "expm1", "log", "log1p", "sinh", "tan", "tanh")
FORMS = {
    "abs": "abs({0})",
    "add": "{0} + {1}",
    "add_any": "{0} + {1}",
    "and": "{0} & {1}",
    "cos": "math.cos({0}) if math.isfinite({0}) else nan",
    "div": "{0} / {1} if {1} else divided({0}, {1})",
    "eq": "{0} == {1}",
    "ge": "{0} >= {1}",
    "gt": "{0} > {1}",
    "is_finite": "math.isfinite({0})",
    "le": "{0} <= {1}",
    "lt": "{0} < {1}",
    "max": LARGER,
    "min": SMALLER,
    "mul": "{0} * {1}",
    "ne": "{0} != {1}",
    "neg": "-{0}",
    "or": "{0} | {1}",
    "rsqrt": "1.0 / math.sqrt({0}) if {0} > 0.0 else divided(1.0, np.sqrt({0}))",
    "sin": "math.sin({0}) if math.isfinite({0}) else nan",
    "sqrt": "math.sqrt({0}) if {0} >= 0.0 else nan",
    "square": "{0} * {0}",
    "sub": "{0} - {1}",
    "xor": "{0} ^ {1}",
} | {name: f"np.{name}({{0}}).item()" for name in UFUNCS}
GROWING = {"abs", "add", "mul", "neg", "square", "sub"}  # of whole numbers they may go beyond their bits
FOLDED = {"reduce_sum": "add", "reduce_prod": "mul", "reduce_max": "max", "reduce_min": "min"}
FOLDED |= {"reduce_and": "and", "reduce_or": "or"}


def small(program, name, params, given, fixed, kinds, outs):
    """The values of the results of a primitive on small arrays; None where it is not written so."""
    kind = np.dtype(kinds[0].dtype) if kinds else None
    if name in MOVES:
        return moved(name, params, given, len(outs))
    if name in PLACED and all(fixed[k] is not None for k in PLACED[name] if k < len(given)):
        return placed(name, params, given, fixed)
    if name == "gather":
        return gathered(program, params, *given)
    if name == "select_n":
        return [selected(program, *given)]
    if name == "convert_element_type":
        return converted(program, given[0], kind, np.dtype(params["new_dtype"]))
    if name == "not":
        return [each(program, "not {0}" if kind.kind == "b" else "~{0}", given)]
    if name == "integer_pow":
        return [powers(program, given[0], kind, params["y"])]
    if name == "clamp":
        low, x, high = given
        return [each(program, SMALLER, [each(program, LARGER, [x, low]), high])]
    if name in FOLDED:
        return folded(program, form(FOLDED[name], kind), given[0], params["axes"])
    if name == "dot_general":
        return contracted(program, params["dimension_numbers"], *given, kind)
    if name in FORMS and not (name == "div" and kind.kind != "f"):
        return [each(program, form(name, kind), given)]
    return None


def form(name, kind):
    text = FORMS[name]
    return f"wrapped({8 * kind.itemsize}, {text})" if kind.kind == "i" and name in GROWING else text


def each(program, text, given):
    """A text of the entries, one after another; numbers go with all."""
    rows, shape = entries(given)
    return np.array([program.line(text, row) for row in rows], int).reshape(shape)


def entries(given):
    """(the entries of values that go together, in rows, their shape)."""
    shape = given[0].shape
    if any(value.shape != shape for value in given):
        shape = np.broadcast_shapes(*(value.shape for value in given))
        given = [np.broadcast_to(value, shape) for value in given]
    return list(zip(*(value.ravel().tolist() for value in given), strict=True)), shape


def moved(name, params, given, count):
    found = rules[name](**params)(*given)
    return [np.asarray(value) for value in (found if name in SEVERAL else [found])]


def placed(name, params, given, fixed):
    """Entries moved to where constants say."""
    if name == "gather":
        params = params | {"fill_value": BEYOND}
    found = np.asarray(rules[name](**params)(*(fixed[k] if k in PLACED[name] else one for k, one in enumerate(given))))
    return None if (found == BEYOND).any() else [found]


def gathered(program, params, x, index):
    """Entries of an array at places that are known later: each is one of those that it may be. None where the places
    have several coordinates, or may lie beyond the array."""
    how, sizes = params["dimension_numbers"], params["slice_sizes"]
    if len(how.start_index_map) != 1 or params["mode"] == lax.GatherScatterMode.FILL_OR_DROP:
        return None
    (axis,) = how.start_index_map
    last, rule = x.shape[axis] - sizes[axis], rules["gather"](**params)
    cases = [np.asarray(rule(x, np.full(index.shape, place))) for place in range(last + 1)]
    text = "{0} > 0" if last == 1 else f"min(max({{0}}, 0), {last})"
    return [selected(program, np.expand_dims(each(program, text, [index[..., 0]]), how.offset_dims), *cases)]


def selected(program, which, *cases):
    """Entries of the cases, each as its entry of which says."""
    rows, shape = entries([which, *cases])
    text = (
        "{2} if {0} else {1}"
        if len(cases) == 2
        else f"({', '.join(f'{{{k}}}' for k in range(1, len(cases) + 1))})[{{0}}]"
    )
    found = []
    for row in rows:
        if row[0] in program.values:
            found.append(row[1 + int(program.values[row[0]])])
        else:
            found.append(row[1] if len(set(row[1:])) == 1 else program.line(text, row))
    return np.array(found, int).reshape(shape)


def converted(program, value, old, new):
    if old == new or (old.kind == new.kind == "i" and old.itemsize <= new.itemsize):
        return [value]
    if new.kind == "i" and old.kind == "f":
        return None
    text = {"f": "float({0})", "b": "{0} != 0", "i": f"wrapped({8 * new.itemsize}, int({{0}}))"}[new.kind]
    return [each(program, text, [value])]


def powers(program, value, kind, exponent):
    one = np.array(program.constant(kind.type(1).item()))
    found = np.broadcast_to(one, value.shape) if exponent == 0 else value
    for _ in range(abs(exponent) - 1):
        found = each(program, form("mul", kind), [found, value])
    return found if exponent >= 0 else each(program, FORMS["div"], [one, found])


def folded(program, text, value, axes):
    """An operation on the entries along some axes, one after another; None where there is none."""
    rest = [axis for axis in range(value.ndim) if axis not in axes]
    rows = value.transpose([*axes, *rest]).reshape(-1, *(value.shape[axis] for axis in rest))
    if not len(rows):
        return None
    return [np.asarray(reduce(lambda one, row: each(program, text, [one, np.asarray(row)]), rows))]


def contracted(program, dimensions, x, y, kind):
    """Sums of products (dot_general); None of none."""
    (left, right), (left_lanes, right_lanes) = dimensions
    parts = []
    for value, summed, lanes in ((x, left, left_lanes), (y, right, right_lanes)):
        free = [axis for axis in range(value.ndim) if axis not in summed and axis not in lanes]
        groups = ([value.shape[axis] for axis in axes] for axes in (lanes, free, summed))
        shapes = list(groups)
        parts.append((value.transpose([*lanes, *free, *summed]).reshape([math.prod(each) for each in shapes]), shapes))
    (x, (lanes, own, summed)), (y, (_, others, _)) = parts
    if math.prod(summed) == 0:
        return None
    products = each(program, form("mul", kind), [x[:, :, None], y[:, None]])
    (found,) = folded(program, form("add", kind), products, (3,))
    return [found.reshape((*lanes, *own, *others))]

"""Prove by interval arithmetic that phase-space areas never grow.

In flight an area changes at the rate d force / d v, for any drive. At an impact with a rigid wall, moving or not, it
changes by the factor R^2, and at entry into a soft wall not at all. It is therefore sufficient that the damping is not
negative, R is at most 1, and d force / d v is not positive at any t and v and any x that the walls allow. For the last
condition `intervals` evaluates the traced derivative over cells of x and v, and halves the cells that are undecided.
The force must be continuous in v, because an area may grow where it jumps in v; a jump in t or x does not change areas.
"""

from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

from . import check
from .force import flat_function
from .force_trace import cached_jaxpr, find_inner_jaxpr
from .intervals import (
    BOOLEAN,
    DISCONTINUOUS,
    ENTIRE,
    OPERATION_RULES,
    Interval,
    add,
    multiply,
    point_interval,
    subtract,
)

MAX_CELLS = 4096  # lanes or cells in one evaluation
MAX_HALVINGS = 40
UNIT = point_interval(1.0)
SUM_RULES = {"add": add, "add_any": add, "sub": subtract}


def areas_never_grow(*scenes):
    """Return True if phase-space areas provably never grow, for all scenes between the given ones.

    Parameters
    ----------
    *scenes : Scene
        Scenes of equal structure. The proof holds for all scenes with numbers between theirs; each lane may differ in
        one number at most.

    Returns
    -------
    bool or None
        True with a proof, in flight and at impacts; None without one, and for traced numbers.
    """
    if check.is_traced(*jax.tree.leaves(scenes)):
        return None
    is_passive = all(bool(np.all(np.abs(scene.bounce(side)) <= 1.0)) for scene in scenes for side in scene.walls)
    if not is_passive:
        return None
    if scenes[0].force is None:
        damping_names = [name for name in scenes[0].names if name.endswith("damping")]
        return all(bool(np.all(scene.parameter(name) >= 0.0)) for scene in scenes for name in damping_names) or None
    if scenes[0].soft_sides:
        return None
    return _force_never_expands(scenes) or None


def _force_never_expands(scenes):
    """Return True if d force / d v is provably not positive, for all lanes at once or for each."""
    names, dtype = tuple(scenes[0].force.numbers), np.dtype(scenes[0].dtype)
    derivative = _velocity_derivative(scenes[0].force.function, names, dtype)
    intervals = [_hull_of_arrays([scene.force.numbers[name] for scene in scenes]) for name in names]
    intervals.append(_hull_of_arrays([bound for scene in scenes for bound in _position_range(scene)]))
    shape = np.broadcast_shapes(*(np.shape(interval.lower) for interval in intervals))
    intervals = [Interval(*(np.broadcast_to(bound, shape).reshape(-1) for bound in interval)) for interval in intervals]
    if derivative is None:
        return False
    hull = [Interval(interval.lower.min()[None], interval.upper.max()[None]) for interval in intervals]
    n_lanes = len(intervals[-1].lower)
    batches = (
        [Interval(*(bound[start : start + MAX_CELLS] for bound in interval)) for interval in intervals]
        for start in range(0, n_lanes, MAX_CELLS)
    )
    return _is_proved(derivative, hull) or (
        n_lanes > 1 and all(_is_proved(derivative, interval) for interval in batches)
    )


def _hull_of_arrays(values):
    """Return the interval from the smallest to the largest of some arrays, lane by lane."""
    values = np.stack(np.broadcast_arrays(*(np.asarray(array, float) for array in values)))
    return Interval(values.min(axis=0), values.max(axis=0))


def _position_range(scene):
    """Return the smallest and the largest x that the walls of a scene allow."""
    bounds = {"left": -np.inf, "right": np.inf}
    for side, wall in scene.walls.items():
        wall_amplitude = 0.0 if wall.motion is None else np.abs(np.asarray(wall.motion.amplitude, float))
        position = np.asarray(wall.position, float)
        bounds[side] = (
            position
            if wall.motion is None
            else np.nextafter(position + np.copysign(wall_amplitude, bounds[side]), bounds[side])
        )
    return bounds["left"], bounds["right"]


def _is_proved(derivative, intervals):
    """Return True if d force / d v is nowhere positive, for intervals of the force's parameters and, last, of x."""
    zeros = np.zeros(len(intervals[-1].lower))
    cells = [Interval(*(np.tile(bound, 2) for bound in interval)) for interval in intervals]
    cells.append(Interval(np.append(zeros - np.inf, zeros), np.append(zeros, zeros + np.inf)))
    for _ in range(MAX_HALVINGS):
        unproved = ~(_evaluate_cells(derivative, cells).upper <= 0.0)
        if not unproved.any():
            return True
        cells = [Interval(lower[unproved], upper[unproved]) for lower, upper in cells]
        *params, x, v = cells
        midpoints = [*params, *(point_interval(_midpoint(interval)) for interval in (x, v))]
        if 4 * len(x.lower) > MAX_CELLS + 4 * len(zeros) or (_evaluate_cells(derivative, midpoints).lower > 0.0).any():
            return False
        cells = _halve_cells(_halve_cells(cells, -1), -2)
    return False


def _halve_cells(cells, index):
    """Return the cells, halved along one of their intervals."""
    lower, upper = cells[index]
    midpoint = _midpoint(cells[index])
    halves = [Interval(*(np.tile(bound, 2) for bound in interval)) for interval in cells]
    halves[index] = Interval(np.append(lower, midpoint), np.append(midpoint, upper))
    return halves


def _midpoint(interval):
    """Return a number within an interval, which may be unbounded."""
    lower, upper = interval
    with np.errstate(invalid="ignore", over="ignore"):
        half_line_point = np.where(
            lower >= 0.0, np.maximum(2.0 * lower, 1.0), np.where(upper <= 0.0, np.minimum(2.0 * upper, -1.0), 0.0)
        )
        return np.where(np.isfinite(lower) & np.isfinite(upper), 0.5 * lower + 0.5 * upper, half_line_point)


@lru_cache(256)
def _velocity_derivative(function, names, dtype):
    """Return the jaxpr of d force / d v, or None if the force may jump in v."""
    if not _trace_continuity(cached_jaxpr(function, names, dtype).jaxpr, [False, False, True, *[False] * len(names)])[
        0
    ]:
        return None
    force = flat_function(function, names)

    def derivative(t, x, v, *params):
        return jax.jvp(lambda v: force(t, x, v, *params), (v,), (jnp.ones_like(v),))[1]

    return jax.make_jaxpr(derivative)(*[jax.ShapeDtypeStruct((), dtype)] * (3 + len(names)))


def _trace_continuity(jaxpr, depends_on_v):
    """Return whether all operations on values that depend on v are continuous, and which results depend on v."""
    dependence = dict(zip(jaxpr.invars, depends_on_v, strict=True))
    is_continuous = True
    for eqn in jaxpr.eqns:
        input_dependence = [
            not isinstance(variable, core.Literal) and dependence.get(variable, False) for variable in eqn.invars
        ]
        inner_jaxpr, output_dependence = find_inner_jaxpr(eqn), [any(input_dependence)] * len(eqn.outvars)
        if inner_jaxpr is not None:
            is_smooth, output_dependence = _trace_continuity(inner_jaxpr.jaxpr, input_dependence)
        else:
            name = eqn.primitive.name
            is_selection = name == "select_n" and not input_dependence[0]
            is_smooth = (
                not any(input_dependence)
                or is_selection
                or _keeps_type(eqn)
                or (name in OPERATION_RULES and name not in DISCONTINUOUS)
            )
        is_continuous = is_continuous and is_smooth
        dependence.update(zip(eqn.outvars, output_dependence, strict=True))
    return is_continuous, [
        not isinstance(variable, core.Literal) and dependence.get(variable, False) for variable in jaxpr.outvars
    ]


def _keeps_type(eqn):
    """Return True if an operation converts a number to its own type."""
    return eqn.primitive.name == "convert_element_type" and eqn.invars[0].aval.dtype == eqn.outvars[0].aval.dtype


def _evaluate_cells(derivative, cells):
    """Return the interval of d force / d v in each cell."""
    *params, x, v = cells
    (interval,) = _evaluate_jaxpr(derivative, [ENTIRE, x, v, *params])
    return Interval(*(np.broadcast_to(np.asarray(bound, float), np.shape(x.lower)) for bound in interval))


def _evaluate_jaxpr(closed_jaxpr, inputs):
    """Return the intervals of the results of a jaxpr."""
    environment = dict(zip(closed_jaxpr.jaxpr.invars, inputs, strict=True))
    environment |= {
        name: _constant_interval(value)
        for name, value in zip(closed_jaxpr.jaxpr.constvars, closed_jaxpr.consts, strict=True)
    }
    producers: dict[Any, Any] = {}

    def read_interval(variable):
        return _constant_interval(variable.val) if isinstance(variable, core.Literal) else environment[variable]

    for eqn in closed_jaxpr.jaxpr.eqns:
        inner_jaxpr = find_inner_jaxpr(eqn)
        if inner_jaxpr is not None:
            results = _evaluate_jaxpr(inner_jaxpr, [read_interval(variable) for variable in eqn.invars])
        else:
            results = (
                [_evaluate_operation(eqn, producers, read_interval)]
                if len(eqn.outvars) == 1
                else [ENTIRE] * len(eqn.outvars)
            )
        environment.update(zip(eqn.outvars, results, strict=True))
        producers.update(dict.fromkeys(eqn.outvars, eqn))
    return [read_interval(variable) for variable in closed_jaxpr.jaxpr.outvars]


def _constant_interval(value):
    """Return the interval of a constant, unbounded for an array."""
    return point_interval(float(value)) if np.ndim(value) == 0 and np.isfinite(value) else ENTIRE


def _evaluate_operation(eqn, producers, read_interval):
    """Return the interval of the result of one operation, unbounded without a rule."""
    name, (output,) = eqn.primitive.name, eqn.outvars
    unbounded = BOOLEAN if output.aval.dtype == bool else ENTIRE
    has_rule = name in OPERATION_RULES and (
        name != "convert_element_type" or _keeps_type(eqn) or eqn.invars[0].aval.dtype == bool
    )
    is_real_scalar = not any(variable.aval.shape for variable in (*eqn.invars, output)) and not np.issubdtype(
        output.aval.dtype, np.integer
    )
    if not has_rule or not is_real_scalar:
        return unbounded
    return _repeated_operand(eqn, producers, read_interval) or OPERATION_RULES[name](
        *map(read_interval, eqn.invars), **eqn.params
    )


def _repeated_operand(eqn, producers, read_interval):
    """Return the tighter interval of an expression in which one operand occurs twice, or None for other operations.

    These are a square, and a + a b and a - a b, which are evaluated as a (1 + b) and a (1 - b).
    """
    name = eqn.primitive.name
    if name not in ("mul", *SUM_RULES) or any(isinstance(variable, core.Literal) for variable in eqn.invars):
        return None
    left_operand, right_operand = eqn.invars
    if name == "mul":
        return OPERATION_RULES["square"](read_interval(left_operand)) if left_operand is right_operand else None
    for single_operand, product_operand in ((left_operand, right_operand), (right_operand, left_operand))[
        : 1 if name == "sub" else 2
    ]:
        product = producers.get(product_operand)
        if (
            product is not None
            and product.primitive.name == "mul"
            and any(variable is single_operand for variable in product.invars)
        ):
            factor = product.invars[0 if product.invars[1] is single_operand else 1]
            return multiply(read_interval(single_operand), SUM_RULES[name](UNIT, read_interval(factor)))
    return None

"""Trace a force with JAX, find its operations without a Taylor series, and prove that areas never grow.

Prove by interval arithmetic that phase-space areas never grow. In flight the relative rate of change of an area is d
force / d v, for any drive. An impact on a rigid wall, moving or not, multiplies the area by R^2. Entry into a soft wall
does not change the area. Three conditions are therefore sufficient: the damping is not negative, R is at most 1, and d
force / d v is not positive at any t and v and any x that the walls allow.

For the last condition the traced derivative is evaluated with `interval_arithmetic` over cells of x and v. Undecided
cells are halved. The force must be continuous in v, because a jump of the force in v may increase areas. A jump in t or
x does not change areas.
"""

from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

from . import check
from .force import trace_jaxpr, with_positional_params
from .interval_arithmetic import (
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

SERIES_OPS = """add add_any sub mul div neg square integer_pow pow sqrt rsqrt cbrt exp exp2 expm1 log log1p sin cos sinh
cosh tan tanh logistic erf erfc asin acos atan asinh acosh atanh atan2 copy"""  # with rules in `flight.series`
SERIES_OPS_SET = frozenset(SERIES_OPS.split())
INNER_KEYS = ("jaxpr", "call_jaxpr")  # parameters that hold the jaxpr of an inner function
LOOP_OPERATIONS = ("while", "scan", "cond")  # operations with inner functions that do not simply run once
CONST_OPS = """abs sign max min floor ceil round select_n clamp is_finite not and or eq ne lt le gt ge rem stop_gradient
convert_element_type"""  # further operations that are allowed on constants
CONST_OPS_SET = frozenset(CONST_OPS.split())

cached_jaxpr = lru_cache(256)(trace_jaxpr)


@lru_cache(256)
def ops_without_series(function, parameter_names, dtype, n_leading_arguments=3):
    """Return the names of the operations of a force without a known Taylor series.

    Parameters
    ----------
    function : callable
        The force.
    parameter_names : tuple of str
        Names of its parameters.
    dtype : dtype
        Floating-point type.
    n_leading_arguments : int, optional
        Number of arguments before the parameters.

    Returns
    -------
    tuple of str
        Names, sorted; "... of arrays" if the series is known for scalars only.
    """
    closed_jaxpr = cached_jaxpr(function, parameter_names, dtype, n_leading_arguments)
    return tuple(
        sorted(_scan_operations(closed_jaxpr.jaxpr, [False] * n_leading_arguments + [True] * len(parameter_names))[0])
    )


@lru_cache(256)
def depends_on_time(function, parameter_names, dtype):
    """Return True if the time t enters the value of a force."""
    jaxpr = cached_jaxpr(function, parameter_names, dtype).jaxpr
    return not all(_scan_operations(jaxpr, [False] + [True] * (len(jaxpr.invars) - 1))[1])


def _scan_operations(jaxpr, is_input_constant):
    """Return (names of operations without a series, True per result that is constant in time).

    is_input_constant: True for each input that is constant in time.
    """
    is_variable_constant = dict(zip(jaxpr.invars, is_input_constant, strict=True)) | dict.fromkeys(
        jaxpr.constvars, True
    )
    ops_lacking_series = set()
    for eqn in jaxpr.eqns:
        are_inputs_constant = [is_literal(variable) or is_variable_constant[variable] for variable in eqn.invars]
        inner_jaxpr = find_inner_jaxpr(eqn)
        if inner_jaxpr is not None:
            inner_ops_lacking_series, are_outputs_constant = _scan_operations(inner_jaxpr.jaxpr, are_inputs_constant)
            ops_lacking_series |= inner_ops_lacking_series
        else:
            are_outputs_constant = [all(are_inputs_constant)] * len(eqn.outvars)
            has_array_operands = any(variable.aval.shape for variable in (*eqn.invars, *eqn.outvars))
            if has_array_operands or not _has_series_rule(eqn, all(are_inputs_constant)):
                ops_lacking_series.add(f"{eqn.primitive.name} of arrays" if has_array_operands else eqn.primitive.name)
        is_variable_constant.update(zip(eqn.outvars, are_outputs_constant, strict=True))
    return ops_lacking_series, [is_literal(variable) or is_variable_constant[variable] for variable in jaxpr.outvars]


def _has_series_rule(eqn, are_inputs_constant):
    """Return True if the Taylor series of an operation is known; more operations are known for constant inputs."""
    operation_name = eqn.primitive.name
    if operation_name == "convert_element_type":
        return are_inputs_constant or keeps_dtype(eqn)
    return operation_name in SERIES_OPS_SET or (are_inputs_constant and operation_name in CONST_OPS_SET)


def keeps_dtype(eqn):
    """Return True if an operation is a type conversion that does not change the type."""
    return eqn.primitive.name == "convert_element_type" and eqn.invars[0].aval.dtype == eqn.outvars[0].aval.dtype


def is_literal(variable):
    """Return True for a literal of a jaxpr."""
    return isinstance(variable, core.Literal)


def find_inner_jaxpr(eqn):
    """Return the inner function of an operation that runs it once.

    Parameters
    ----------
    eqn : JaxprEqn
        Operation of a jaxpr.

    Returns
    -------
    ClosedJaxpr or None
        The inner function. None if the operation has none or does not simply run it once.
    """
    if eqn.primitive.name in LOOP_OPERATIONS:
        return None
    for parameter_key in INNER_KEYS:
        inner_jaxpr = eqn.params.get(parameter_key)
        if inner_jaxpr is not None:
            return inner_jaxpr if isinstance(inner_jaxpr, core.ClosedJaxpr) else core.ClosedJaxpr(inner_jaxpr, ())
    return None


MAX_CELLS = 4096  # lanes or cells in one evaluation
MAX_HALVINGS = 40
UNIT = point_interval(1.0)
SUM_RULES = {"add": add, "add_any": add, "sub": subtract}


def areas_never_grow(*scenes):
    """Return True if phase-space areas provably never grow, for given scenes and all scenes between them.

    Parameters
    ----------
    *scenes : Scene
        Scenes of equal structure. The proof holds for all scenes with parameter values between those of the given
        scenes. In each lane the scenes may differ in one parameter at most.

    Returns
    -------
    bool or None
        True if the proof for flight and impacts succeeds. None if the proof fails or numbers are traced.
    """
    if check.is_traced(*jax.tree.leaves(scenes)):
        return None
    has_passive_impacts = all(
        bool(np.all(np.abs(scene.bounce(side)) <= 1.0)) for scene in scenes for side in scene.walls
    )
    if not has_passive_impacts:
        return None
    return scenes[0].flow_kind.never_expands(scenes) or None


def has_no_negative_damping(scenes):
    """Return True if no damping is negative in scenes of equal structure."""
    damping_names = [name for name in scenes[0].names if name.endswith("damping")]
    return all(bool(np.all(scene.parameter(name) >= 0.0)) for scene in scenes for name in damping_names)


def proves_no_expansion(scenes):
    """Return True if d force / d v is provably nowhere positive, for all lanes together or lane by lane."""
    force_parameter_names, dtype = tuple(scenes[0].force.numbers), np.dtype(scenes[0].dtype)
    v_derivative_jaxpr = _velocity_derivative(scenes[0].force.function, force_parameter_names, dtype)
    parameter_intervals = [
        _hull_of_arrays([scene.force.numbers[force_parameter_name] for scene in scenes])
        for force_parameter_name in force_parameter_names
    ]
    parameter_intervals.append(
        _hull_of_arrays([bound_array for scene in scenes for bound_array in _position_range(scene)])
    )
    shape = np.broadcast_shapes(*(np.shape(parameter_interval.lower) for parameter_interval in parameter_intervals))
    parameter_intervals = [
        Interval(*(np.broadcast_to(bound_array, shape).reshape(-1) for bound_array in parameter_interval))
        for parameter_interval in parameter_intervals
    ]
    if v_derivative_jaxpr is None:
        return False
    lane_hull_intervals = [
        Interval(parameter_interval.lower.min()[None], parameter_interval.upper.max()[None])
        for parameter_interval in parameter_intervals
    ]
    n_lanes = len(parameter_intervals[-1].lower)
    interval_batches = (
        [
            Interval(*(bound_array[first_lane : first_lane + MAX_CELLS] for bound_array in parameter_interval))
            for parameter_interval in parameter_intervals
        ]
        for first_lane in range(0, n_lanes, MAX_CELLS)
    )
    return _is_never_positive(v_derivative_jaxpr, lane_hull_intervals) or (
        n_lanes > 1
        and all(_is_never_positive(v_derivative_jaxpr, interval_batch) for interval_batch in interval_batches)
    )


def _hull_of_arrays(arrays):
    """Return the interval from the smallest to the largest value of some arrays, lane by lane."""
    arrays = np.stack(np.broadcast_arrays(*(np.asarray(array, float) for array in arrays)))
    return Interval(arrays.min(axis=0), arrays.max(axis=0))


def _position_range(scene):
    """Return the smallest and the largest x that the walls of a scene allow, -inf and inf without walls."""
    position_bounds = {"left": -np.inf, "right": np.inf}
    for side, wall in scene.walls.items():
        position = np.asarray(wall.position, float)
        if wall.motion is not None:
            wall_amplitude = np.copysign(np.asarray(wall.motion.amplitude, float), position_bounds[side])
            position = np.nextafter(position + wall_amplitude, position_bounds[side])
        position_bounds[side] = position
    return position_bounds["left"], position_bounds["right"]


def _is_never_positive(v_derivative_jaxpr, parameter_intervals):
    """Return True if d force / d v is nowhere positive, for intervals of the force's parameters and, last, of x."""
    lane_zeros = np.zeros(len(parameter_intervals[-1].lower))
    cells = [Interval(*(np.tile(bound, 2) for bound in cell_interval)) for cell_interval in parameter_intervals]
    cells.append(Interval(np.append(lane_zeros - np.inf, lane_zeros), np.append(lane_zeros, lane_zeros + np.inf)))
    for _ in range(MAX_HALVINGS):
        is_unproved = ~(_bound_derivative(v_derivative_jaxpr, cells).upper <= 0.0)
        if not is_unproved.any():
            return True
        cells = [Interval(lower[is_unproved], upper[is_unproved]) for lower, upper in cells]
        *param_intervals, x_interval, v_interval = cells
        cell_midpoints = [
            *param_intervals,
            *(point_interval(_interior_point(cell_interval)) for cell_interval in (x_interval, v_interval)),
        ]
        if (
            4 * len(x_interval.lower) > MAX_CELLS + 4 * len(lane_zeros)
            or (_bound_derivative(v_derivative_jaxpr, cell_midpoints).lower > 0.0).any()
        ):
            return False
        cells = _halve_cells(_halve_cells(cells, -1), -2)
    return False


def _halve_cells(cells, interval_index):
    """Return both halves of all cells, divided along the interval of index `interval_index`."""
    lower, upper = cells[interval_index]
    midpoint = _interior_point(cells[interval_index])
    half_cells = [Interval(*(np.tile(bound, 2) for bound in interval)) for interval in cells]
    half_cells[interval_index] = Interval(np.append(lower, midpoint), np.append(midpoint, upper))
    return half_cells


def _interior_point(interval):
    """Return a number within an interval, which may be unbounded."""
    lower, upper = interval
    with np.errstate(invalid="ignore", over="ignore"):
        unbounded_case_point = np.where(
            lower >= 0.0, np.maximum(2.0 * lower, 1.0), np.where(upper <= 0.0, np.minimum(2.0 * upper, -1.0), 0.0)
        )
        return np.where(np.isfinite(lower) & np.isfinite(upper), 0.5 * lower + 0.5 * upper, unbounded_case_point)


@lru_cache(256)
def _velocity_derivative(function, parameter_names, dtype):
    """Return the jaxpr of d force / d v, or None if the force may jump in v."""
    if not _analyse_v_dependence(
        cached_jaxpr(function, parameter_names, dtype).jaxpr, [False, False, True, *[False] * len(parameter_names)]
    )[0]:
        return None
    positional_force = with_positional_params(function, parameter_names)

    def evaluate_derivative(t, x, v, *params):
        return jax.jvp(lambda v: positional_force(t, x, v, *params), (v,), (jnp.ones_like(v),))[1]

    return jax.make_jaxpr(evaluate_derivative)(*[jax.ShapeDtypeStruct((), dtype)] * (3 + len(parameter_names)))


def _analyse_v_dependence(jaxpr, is_input_dependent):
    """Return (True if all operations on values that depend on v are continuous, True for results that depend on v)."""
    depends_on_v = dict(zip(jaxpr.invars, is_input_dependent, strict=True))
    is_continuous = True
    for eqn in jaxpr.eqns:
        eqn_input_dependence = [
            not is_literal(variable) and depends_on_v.get(variable, False) for variable in eqn.invars
        ]
        inner_jaxpr, eqn_output_dependence = find_inner_jaxpr(eqn), [any(eqn_input_dependence)] * len(eqn.outvars)
        if inner_jaxpr is not None:
            is_eqn_continuous, eqn_output_dependence = _analyse_v_dependence(inner_jaxpr.jaxpr, eqn_input_dependence)
        else:
            name = eqn.primitive.name
            is_selection = name == "select_n" and not eqn_input_dependence[0]
            is_eqn_continuous = (
                not any(eqn_input_dependence)
                or is_selection
                or keeps_dtype(eqn)
                or (name in OPERATION_RULES and name not in DISCONTINUOUS)
            )
        is_continuous = is_continuous and is_eqn_continuous
        depends_on_v.update(zip(eqn.outvars, eqn_output_dependence, strict=True))
    return is_continuous, [not is_literal(variable) and depends_on_v.get(variable, False) for variable in jaxpr.outvars]


def _bound_derivative(v_derivative_jaxpr, cells):
    """Return the interval of d force / d v in each cell."""
    *param_intervals, x_interval, v_interval = cells
    (derivative_interval,) = _evaluate_on_intervals(
        v_derivative_jaxpr, [ENTIRE, x_interval, v_interval, *param_intervals]
    )
    return Interval(
        *(np.broadcast_to(np.asarray(bound, float), np.shape(x_interval.lower)) for bound in derivative_interval)
    )


def _evaluate_on_intervals(closed_jaxpr, input_intervals):
    """Return the intervals of the results of a jaxpr."""
    variable_intervals = dict(zip(closed_jaxpr.jaxpr.invars, input_intervals, strict=True))
    variable_intervals |= {
        constant_variable: _constant_interval(value)
        for constant_variable, value in zip(closed_jaxpr.jaxpr.constvars, closed_jaxpr.consts, strict=True)
    }
    producing_eqns: dict[Any, Any] = {}

    def read_interval(variable):
        return _constant_interval(variable.val) if is_literal(variable) else variable_intervals[variable]

    for eqn in closed_jaxpr.jaxpr.eqns:
        inner_jaxpr = find_inner_jaxpr(eqn)
        if inner_jaxpr is not None:
            output_intervals = _evaluate_on_intervals(inner_jaxpr, [read_interval(variable) for variable in eqn.invars])
        else:
            output_intervals = (
                [_operation_interval(eqn, producing_eqns, read_interval)]
                if len(eqn.outvars) == 1
                else [ENTIRE] * len(eqn.outvars)
            )
        variable_intervals.update(zip(eqn.outvars, output_intervals, strict=True))
        producing_eqns.update(dict.fromkeys(eqn.outvars, eqn))
    return [read_interval(variable) for variable in closed_jaxpr.jaxpr.outvars]


def _constant_interval(value):
    """Return the interval of a constant; the interval of an array is unbounded."""
    return point_interval(float(value)) if np.ndim(value) == 0 and np.isfinite(value) else ENTIRE


def _operation_interval(eqn, producing_eqns, read_interval):
    """Return the interval of the result of one operation; the widest interval if no rule is known."""
    operation_name, (output_variable,) = eqn.primitive.name, eqn.outvars
    widest_interval = BOOLEAN if output_variable.aval.dtype == bool else ENTIRE
    has_interval_rule = operation_name in OPERATION_RULES and (
        operation_name != "convert_element_type" or keeps_dtype(eqn) or eqn.invars[0].aval.dtype == bool
    )
    is_real_scalar = not any(variable.aval.shape for variable in (*eqn.invars, output_variable)) and not np.issubdtype(
        output_variable.aval.dtype, np.integer
    )
    if not has_interval_rule or not is_real_scalar:
        return widest_interval
    return _repeated_operand_result(eqn, producing_eqns, read_interval) or OPERATION_RULES[operation_name](
        *map(read_interval, eqn.invars), **eqn.params
    )


def _repeated_operand_result(eqn, producing_eqns, read_interval):
    """Return the tighter interval of an expression in which one operand occurs twice, or None for other operations.

    The expressions are a square, a + a b and a - a b. The last two are evaluated as a (1 + b) and a (1 - b).
    """
    operation_name = eqn.primitive.name
    if operation_name not in ("mul", *SUM_RULES) or any(is_literal(variable) for variable in eqn.invars):
        return None
    left_operand, right_operand = eqn.invars
    if operation_name == "mul":
        return OPERATION_RULES["square"](read_interval(left_operand)) if left_operand is right_operand else None
    for single_operand, product_operand in ((left_operand, right_operand), (right_operand, left_operand))[
        : 1 if operation_name == "sub" else 2
    ]:
        product_eqn = producing_eqns.get(product_operand)
        if (
            product_eqn is not None
            and product_eqn.primitive.name == "mul"
            and any(variable is single_operand for variable in product_eqn.invars)
        ):
            other_factor = product_eqn.invars[0 if product_eqn.invars[1] is single_operand else 1]
            return multiply(read_interval(single_operand), SUM_RULES[operation_name](UNIT, read_interval(other_factor)))
    return None

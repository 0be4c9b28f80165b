"""Compute the Taylor series of a motion under a user-defined force, operation by operation of its jaxpr."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np

from ..compiled.lane_arithmetic import call_without_inlining
from ..scene.force_operations import cached_jaxpr, find_inner_jaxpr, is_literal
from .power_series import RULES, Series, Square, add_coefficients, scale_coefficient


@lru_cache(256)
def is_series_of_root(function, param_names, dtype):
    """Return True if the law of a wall is a power series in the square root of the depth, also at depth 0.

    The first four coefficients must be finite, for one rate of the depth and one value of all parameters.
    """
    closed_jaxpr, ones = cached_jaxpr(function, param_names, dtype, 2), np.ones((), dtype)
    with jax.ensure_compile_time_eval():
        depth_series = Square(Series(lambda series, k: None, 0.0 * ones, ones))
        depth_rate_series = Series(lambda series, k: None, 0.3 * ones, ones)
        (wall_force,) = _evaluate_jaxpr(
            closed_jaxpr, [depth_series, depth_rate_series, *(Series(None, 0.7 * ones) for _ in param_names)]
        )
        return all(wall_force[k] is None or bool(jnp.isfinite(wall_force[k])) for k in range(4))


def force_series(user_force, time_series, x_series, v_series):
    """Return the `Series` of a user-defined force from those of t, x and v."""
    return _function_series(
        user_force,
        np.dtype(jnp.result_type(*jax.tree.leaves((x_series[0], v_series[0])))),
        [time_series, x_series, v_series],
    )


def wall_force_series(wall_law, depth_series, depth_rate_series):
    """Return the `Series` of the force of a wall from those of the depth and of its rate.

    The depth may be a `Square`.
    """
    return _function_series(
        wall_law,
        np.dtype(jnp.result_type(*jax.tree.leaves((depth_series[0], depth_rate_series[0])))),
        [depth_series, depth_rate_series],
    )


def _function_series(force_function, dtype, argument_series):
    """Return the `Series` of a user-defined function of series and of constant parameters."""
    closed_jaxpr = cached_jaxpr(force_function.function, tuple(force_function.numbers), dtype, len(argument_series))
    (result_series,) = _evaluate_jaxpr(
        closed_jaxpr, [*argument_series, *(Series(None, param) for param in force_function.numbers.values())]
    )
    return result_series


def _evaluate_jaxpr(closed_jaxpr, argument_series):
    """Return the `Series` of the results of a jaxpr."""
    series_by_variable = dict(zip(closed_jaxpr.jaxpr.invars, argument_series, strict=True))
    series_by_variable |= {
        constant_variable: Series(None, value)
        for constant_variable, value in zip(closed_jaxpr.jaxpr.constvars, closed_jaxpr.consts, strict=True)
    }

    def read_series(variable):
        return Series(None, variable.val) if is_literal(variable) else series_by_variable[variable]

    for equation in closed_jaxpr.jaxpr.eqns:
        input_series = [read_series(item) for item in equation.invars]
        inner_jaxpr = find_inner_jaxpr(equation)
        if inner_jaxpr is not None:
            output_series = _evaluate_jaxpr(inner_jaxpr, input_series)
        elif all(item.is_constant for item in input_series):
            output_series = [Series(None, _evaluate_on_constants(equation, [item[0] for item in input_series]))]
        elif equation.primitive.name == "convert_element_type":
            output_series = input_series
        else:
            output_series = [RULES[equation.primitive.name](input_series, **equation.params)]
        series_by_variable.update(zip(equation.outvars, output_series, strict=True))
    return [read_series(item) for item in closed_jaxpr.jaxpr.outvars]


def _evaluate_on_constants(equation, operands):
    """Return the result of an operation of a jaxpr on operands that do not depend on time."""
    shape = jnp.broadcast_shapes(*map(jnp.shape, operands))
    return equation.primitive.bind(
        *(jnp.broadcast_to(jnp.asarray(operand), shape) for operand in operands), **equation.params
    )


def motion_coefficients(user_force, time, x, v, drive_force_terms, order):
    """Return the Taylor coefficients of x up to an order, for the motion that passes x, v at a time.

    `drive_force_terms` are the first order - 1 Taylor coefficients of an additional force.
    """
    x_series = Series(lambda series, k: _next_position_coeff(acceleration[k - 2], drive_force_terms[k - 2], k), x, v)
    v_series = Series(lambda series, k: scale_coefficient(k + 1.0, x_series[k + 1]), v)
    acceleration = force_series(user_force, Series(lambda series, k: None, time, 1.0), x_series, v_series)
    return [x_series[k] for k in range(order + 1)]


def _next_position_coeff(force_term, drive_term, k):
    """Return the k-th coefficient of x from the coefficients of the two forces."""
    return call_without_inlining(_scale_sum, force_term, drive_term, factor=1.0 / (k * (k - 1)))


def _scale_sum(force_term, drive_term, factor):
    return factor * add_coefficients(force_term, drive_term)


def drive_coefficients(force_amplitude, frequency, cosine, sine, n_terms):
    """Return the first `n_terms` Taylor coefficients in time of force_amplitude cos(omega t).

    `cosine` and `sine` belong to the phase at which the force is expanded.
    """
    return call_without_inlining(_drive_coefficients, force_amplitude, frequency, cosine, sine, n_terms=n_terms)


def _drive_coefficients(force_amplitude, frequency, cosine, sine, n_terms):
    force_terms = [force_amplitude * cosine, -(force_amplitude * sine) * frequency]
    frequency_squared = frequency * frequency
    for k in range(2, n_terms):
        force_terms.append(force_terms[k - 2] * (frequency_squared * (-1.0 / (k * (k - 1)))))
    return force_terms[:n_terms]

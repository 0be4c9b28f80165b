"""Compute the Taylor series of a motion under a user-defined force, operation by operation of its jaxpr."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np

from ..compiled.compiler_hints import stage
from ..scene.force_trace import cached_jaxpr, find_inner_jaxpr, is_literal
from .series import RULES, Series, Square, add_coefficients, scale_coefficient


@lru_cache(256)
def is_series_of_root(function, names, dtype):
    """Return True if the force of a wall is a power series in the root of the depth, also at the depth 0."""
    closed_jaxpr, ones = cached_jaxpr(function, names, dtype, 2), np.ones((), dtype)
    with jax.ensure_compile_time_eval():
        depth = Square(Series(lambda series, k: None, 0.0 * ones, ones))
        rate = Series(lambda series, k: None, 0.3 * ones, ones)
        (push,) = _evaluate_jaxpr(closed_jaxpr, [depth, rate, *(Series(None, 0.7 * ones) for _ in names)])
        return all(push[k] is None or bool(jnp.isfinite(push[k])) for k in range(4))


def force_series(force, time, x, v):
    """Return the `Series` of a force, given those of t, x and v."""
    return _function_series(force, np.dtype(jnp.result_type(*jax.tree.leaves((x[0], v[0])))), [time, x, v])


def wall_push_series(law, depth, depth_rate):
    """Return the `Series` of a wall's force, given a depth that is the `Square` of its root."""
    return _function_series(
        law, np.dtype(jnp.result_type(*jax.tree.leaves((depth[0], depth_rate[0])))), [depth, depth_rate]
    )


def _function_series(force, dtype, variables):
    """Return the `Series` of a function of some series and of its parameters."""
    closed_jaxpr = cached_jaxpr(force.function, tuple(force.numbers), dtype, len(variables))
    (result,) = _evaluate_jaxpr(closed_jaxpr, [*variables, *(Series(None, param) for param in force.numbers.values())])
    return result


def _evaluate_jaxpr(closed_jaxpr, arguments):
    """Return the `Series` of the results of a jaxpr."""
    env = dict(zip(closed_jaxpr.jaxpr.invars, arguments, strict=True))
    env |= {
        name: Series(None, value) for name, value in zip(closed_jaxpr.jaxpr.constvars, closed_jaxpr.consts, strict=True)
    }

    def read(variable):
        return Series(None, variable.val) if is_literal(variable) else env[variable]

    for eqn in closed_jaxpr.jaxpr.eqns:
        inputs = [read(item) for item in eqn.invars]
        inner_jaxpr = find_inner_jaxpr(eqn)
        if inner_jaxpr is not None:
            outputs = _evaluate_jaxpr(inner_jaxpr, inputs)
        elif all(item.is_constant for item in inputs):
            outputs = [Series(None, _bind_constants(eqn, [item[0] for item in inputs]))]
        elif eqn.primitive.name == "convert_element_type":
            outputs = inputs
        else:
            outputs = [RULES[eqn.primitive.name](inputs, **eqn.params)]
        env.update(zip(eqn.outvars, outputs, strict=True))
    return [read(item) for item in closed_jaxpr.jaxpr.outvars]


def _bind_constants(eqn, operands):
    """Return the result of an operation on numbers that do not depend on time."""
    shape = jnp.broadcast_shapes(*map(jnp.shape, operands))
    return eqn.primitive.bind(*(jnp.broadcast_to(jnp.asarray(operand), shape) for operand in operands), **eqn.params)


def motion_coefficients(force, time, x, v, drive_terms, order):
    """Return the coefficients of x up to an order, of the motion through x, v at a time.

    `drive_terms` are order - 1 coefficients of another force.
    """
    x_series = Series(lambda series, k: _next_coefficient(acceleration[k - 2], drive_terms[k - 2], k), x, v)
    v_series = Series(lambda series, k: scale_coefficient(k + 1.0, x_series[k + 1]), v)
    acceleration = force_series(force, Series(lambda series, k: None, time, 1.0), x_series, v_series)
    return [x_series[k] for k in range(order + 1)]


def _next_coefficient(force_term, drive_term, k):
    """Return the k-th coefficient of x from those of the forces."""
    return stage(_scaled_sum, force_term, drive_term, factor=1.0 / (k * (k - 1)))


def _scaled_sum(force_term, drive_term, factor):
    return factor * add_coefficients(force_term, drive_term)


def drive_coefficients(force, frequency, cosine, sine, n_terms):
    """Return the first coefficients of force cos(omega t), at a phasor of the drive."""
    return stage(_drive_coefficients, force, frequency, cosine, sine, n_terms=n_terms)


def _drive_coefficients(force, frequency, cosine, sine, n_terms):
    terms = [force * cosine, -(force * sine) * frequency]
    frequency_squared = frequency * frequency
    for k in range(2, n_terms):
        terms.append(terms[k - 2] * (frequency_squared * (-1.0 / (k * (k - 1)))))
    return terms[:n_terms]

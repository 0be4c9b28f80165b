"""Expand the motion inside a soft wall under a user-defined force, in a time variable that scales with the depth.

The depth y = e^2 and the time dt = 2 e ds turn y' = w, w' = a into

    de/ds = w,   dw/ds = 2 e a,   dt/ds = 2 e.

A force proportional to y^1.5 becomes e^3, which is analytic at entry and exit as well. The contact phase goes from
e = 0 to e = 0. The scaled variables e = scale f and w = scale g, with the speed of entry as the scale, are smooth where
this speed is zero.
"""

import math
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, maximum, stage
from . import traced_force
from .drive import harmonic_phasor
from .series import (
    Series,
    Square,
    add_constant,
    add_series,
    integrate_rate,
    multiply_series,
    scale_coefficient,
    scale_series,
    subtract_series,
)
from .wall_motion import select_by_side

TINY_MULTIPLE = 1e10  # terms below this multiple of the smallest normal number count as zero


class ContactState(NamedTuple):
    """State of a lane inside a wall: depth y = (scale scaled_root)^2 and rate w = scale scaled_rate.

    Attributes
    ----------
    scaled_root : array
        Square root of the depth over the scale.
    scaled_rate : array
        Rate of the depth over the scale.
    scale : array
        Scale, for example the speed of entry.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.
    """

    scaled_root: Float[jax.Array, "*lanes"]
    scaled_rate: Float[jax.Array, "*lanes"]
    scale: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]


class ContactSeries(NamedTuple):
    """Taylor coefficients in s, from the constant on, of the scaled root, the scaled rate and the elapsed time."""

    scaled_root: list[Float[jax.Array, "*lanes"]]
    scaled_rate: list[Float[jax.Array, "*lanes"]]
    time: list[Float[jax.Array, "*lanes"]]


def contact_series(coeffs, side, state, order):
    """Return the `ContactSeries` up to an order, for lanes inside the wall on a side."""
    root_series = Series(lambda series, k: scale_coefficient(1.0 / k, rate_series[k - 1]), state.scaled_root)
    rate_series = Series(lambda series, k: scale_coefficient(2.0 / k, root_times_accel[k - 1]), state.scaled_rate)
    time_series = Series(
        lambda series, k: scale_coefficient(2.0 / k, depth_root[k - 1]), jnp.zeros_like(state.scaled_root)
    )
    depth_root, depth_rate = scale_series(state.scale, root_series), scale_series(state.scale, rate_series)
    acceleration, wall_push = _acceleration_series(coeffs, side, state, Square(depth_root), depth_rate, time_series)
    root_times_accel = multiply_series(root_series, subtract_series(scale_series(side, acceleration), wall_push))
    return ContactSeries(*([series[k] for k in range(order + 1)] for series in (root_series, rate_series, time_series)))


def depth_jets(coeffs, side, state, depth, depth_rate, order):
    """Return (time derivatives of the depth, time derivatives of its rate) up to an order; the last is a constant.

    Unlike `contact_series` they hold where the depth is 0 or a rounding error, where time scales with the square of s.
    For orders above 1 they are nan at the depth 0 if the law has no such derivative, for example y^1.5.
    """
    ones = jnp.ones_like(depth)
    depth_series = Series(lambda series, k: scale_coefficient(1.0 / k, rate_series[k - 1]), depth)
    rate_series = Series(lambda series, k: scale_coefficient(1.0 / k, inward_accel[k - 1]), depth_rate)
    time_series = Series(lambda series, k: None, jnp.zeros_like(depth), ones)
    acceleration, wall_push = _acceleration_series(coeffs, side, state, depth_series, rate_series, time_series)
    inward_accel = subtract_series(scale_series(side, acceleration), wall_push)
    jets = []
    for series in (depth_series, rate_series):
        derivatives = [series[k] * float(math.factorial(k)) for k in range(order + 1)]
        jets.append([*derivatives[:-1], lax.stop_gradient(derivatives[-1])])
    return jets


def _acceleration_series(coeffs, side, state, depth, depth_rate, time):
    """Return the `Series` of (acceleration along x relative to the wall without its force, force of the wall)."""
    angle = scale_series(coeffs.frequency, time)
    cosine, _ = _rotate_phasor(angle, state.cosine, state.sine)
    wall_position, wall_velocity, wall_acceleration = _wall_motion(coeffs, side, state, angle)
    x, v = add_series(wall_position, scale_series(side, depth)), scale_series(side, depth_rate)
    v = v if wall_velocity is None else add_series(wall_velocity, v)
    absolute_time = add_constant(stage(_drive_time, coeffs.frequency, state.cosine, state.sine), time)
    acceleration = add_series(
        traced_force.force_series(coeffs.force_law, absolute_time, x, v), scale_series(coeffs.amplitude, cosine)
    )
    for term in coeffs.drive_terms:
        term_cosine, _ = _rotate_phasor(
            scale_series(float(term.harmonic), angle), *harmonic_phasor(term, state.cosine, state.sine)
        )
        acceleration = add_series(acceleration, scale_series(term.amplitude, term_cosine))
    return acceleration if wall_acceleration is None else subtract_series(acceleration, wall_acceleration), _wall_push(
        coeffs, side, depth, depth_rate, v
    )


def _drive_time(frequency, cosine, sine):
    """Return the time at which the drive has a phasor."""
    return lax.atan2(sine, cosine) / frequency


def _rotate_phasor(angle, cosine, sine):
    """Return the `Series` (cosine, sine) of an angle that starts at a phasor and grows by `angle`."""
    phasor: list[Series] = []
    phasor.append(integrate_rate(angle, cosine, lambda series: scale_series(-1.0, phasor[1])))
    phasor.append(integrate_rate(angle, sine, lambda series: phasor[0]))
    return phasor


def _wall_motion(coeffs, side, state, angle):
    """Return the `Series` of position, velocity and acceleration of the wall on a side; None for zero."""
    walls = coeffs.walls
    zero = jnp.zeros_like(state.scaled_root)
    mean_position = select_by_side(side, walls, [wall.position + zero for wall in walls])
    if all(wall.amplitude is None for wall in walls):
        return Series(None, mean_position), None, None
    wall_amplitude, harmonic, cosine, sine = (
        select_by_side(side, walls, values)
        for values in zip(*(_wall_oscillation(wall, state, zero) for wall in walls), strict=True)
    )
    cosine, sine = _rotate_phasor(scale_series(harmonic, angle), cosine, sine)
    wall_frequency = coeffs.frequency * harmonic
    return (
        add_constant(mean_position, scale_series(wall_amplitude, cosine)),
        scale_series(-wall_amplitude * wall_frequency, sine),
        scale_series(-wall_amplitude * wall_frequency * wall_frequency, cosine),
    )


def _wall_oscillation(wall, state, zero):
    """Return (amplitude, harmonic, cosine, sine) of the motion of a wall."""
    if wall.amplitude is None:
        return zero, zero + 1.0, zero + 1.0, zero
    return wall.amplitude + zero, zero + float(wall.harmonic), *harmonic_phasor(wall, state.cosine, state.sine)


def _wall_push(coeffs, side, depth, depth_rate, v):
    """Return the force of the wall on a side: its law, or k2 y + 2 gamma2 v, where v is the absolute velocity."""
    soft_walls = [wall for wall in coeffs.walls if wall.restitution is None]
    law_keys = [wall.law and (wall.law.function, tuple(wall.law.numbers)) for wall in soft_walls]
    if len(soft_walls) == 2 and law_keys[0] == law_keys[1]:
        wall_params = [(wall.law, wall.stiffness, wall.damping) for wall in soft_walls]
        law, stiffness, damping = jax.tree.map(partial(choose, side < 0), *wall_params)
        soft_walls = [replace(soft_walls[0], law=law, stiffness=stiffness, damping=damping)]
    pushes = [_push_of_wall(wall, side, depth, depth_rate, v) for wall in soft_walls]
    if len(pushes) == 1:
        return pushes[0]
    left_push, right_push = pushes
    return Series(
        lambda series, k: _select_coefficient(side < 0, left_push[k], right_push[k]),
        _select_coefficient(side < 0, left_push[0], right_push[0]),
    )


def _select_coefficient(on_left, left_value, right_value):
    """Select a coefficient by side; None stands for zero."""
    return (
        None
        if left_value is None and right_value is None
        else choose(on_left, 0.0 if left_value is None else left_value, 0.0 if right_value is None else right_value)
    )


def _push_of_wall(wall, side, depth, depth_rate, v):
    """Return the force of one wall."""
    if wall.law is not None:
        return traced_force.wall_push_series(wall.law, depth, depth_rate)
    return add_series(scale_series(wall.stiffness, depth), scale_series(2.0 * wall.damping * side, v))


def max_step(coeffs, terms, scale):
    """Return a step in s for which the last terms stay below the tolerance and no angle exceeds 1.

    The last terms are relative to the largest of the first terms.
    """
    return stage(_max_step, terms, scale, coeffs.max_step, tolerance=coeffs.force_law.tolerance)


def _max_step(terms, scale, max_time_step, tolerance):
    """Return the step of `max_step`."""
    tiny = TINY_MULTIPLE * float(jnp.finfo(scale.dtype).tiny)
    degree = len(terms.scaled_root) - 1
    time_slope, time_curvature = (
        2.0 * lax.abs(scale * series) + tiny for series in (terms.scaled_root[0], terms.scaled_rate[0])
    )
    step = lax.min(0.5 * max_time_step / time_slope, lax.sqrt(max_time_step / time_curvature))
    for series in (terms.scaled_root, terms.scaled_rate):
        for k in (degree - 1, degree):
            magnitude = lax.abs(series[k]) + tiny
            log_ratios = [lax.log((tolerance * lax.abs(series[j]) + tiny) / magnitude) / float(k - j) for j in range(3)]
            step = lax.min(step, lax.exp(maximum(maximum(log_ratios[0], log_ratios[1]), log_ratios[2])))
    return step


def evaluate_terms(terms, s_step):
    """Evaluate (root, rate, time) after a span of s."""
    values = []
    for series in terms:
        value = series[-1]
        for term in series[-2::-1]:
            value = value * s_step + term
        values.append(value)
    return values


def rotate_drive(coeffs, state, time):
    """Return (cosine, sine) of the drive angle after a time of any sign."""
    angle = coeffs.frequency * time
    half_sine = lax.sin(0.5 * angle)
    cos_less_1, sin_angle = -2.0 * half_sine * half_sine, lax.sin(angle)
    return state.cosine + (state.cosine * cos_less_1 - state.sine * sin_angle), state.sine + (
        state.sine * cos_less_1 + state.cosine * sin_angle
    )


def select_lanes(mask, if_true, if_false):
    """Select between two pytrees lane by lane.

    Parameters
    ----------
    mask : array of bool
        Lanes that take the first value.
    if_true : pytree of array
        Values where the mask holds.
    if_false : pytree of array
        Values elsewhere.

    Returns
    -------
    pytree of array
        Selected values.
    """
    return jax.tree.map(lambda if_true, if_false: choose(mask, if_true, if_false), if_true, if_false)

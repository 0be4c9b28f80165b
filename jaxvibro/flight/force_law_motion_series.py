"""Expand the motion inside a soft wall under a user-defined force in a scaled time s.

Let a be the acceleration into the wall. The substitutions y = e^2 for the depth and dt = 2 e ds for the time transform
the equations y' = w, w' = a into

    de/ds = w,   dw/ds = 2 e a,   dt/ds = 2 e.

A force proportional to y^1.5 becomes e^3, which is analytic at entry and exit as well. The contact phase goes from
e = 0 to e = 0. The scaled variables f and g, with e = scale f, w = scale g and the speed of entry as the scale, are
smooth where this speed is zero.
"""

import math
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import call_without_inlining, choose, maximum
from . import flow, jaxpr_series
from .further_drive_terms import harmonic_phasor
from .power_series import (
    Series,
    Square,
    add_constant,
    add_series,
    multiply_series,
    scale_coefficient,
    scale_series,
    series_from_rate,
    subtract_series,
)
from .wall_motion import select_by_side

TINY_MULTIPLE = 1e10  # terms below this multiple of the smallest normal number count as zero


class ContactState(NamedTuple):
    """State of a lane inside a wall: depth y = (scale f)^2 and rate w = scale g of the depth.

    Attributes
    ----------
    scaled_depth_root : array
        Square root f of the depth over the scale.
    scaled_depth_rate : array
        Rate g of the depth over the scale.
    scale : array
        Scale, for example the speed of entry.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.
    """

    scaled_depth_root: Float[jax.Array, "*lanes"]
    scaled_depth_rate: Float[jax.Array, "*lanes"]
    scale: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]


class ContactSeries(NamedTuple):
    """Taylor coefficients in s, the constant first.

    Attributes
    ----------
    scaled_depth_root : list of array
        Coefficients of the scaled square root of the depth.
    scaled_depth_rate : list of array
        Coefficients of the scaled rate of the depth.
    time : list of array
        Coefficients of the elapsed time.
    """

    scaled_depth_root: list[Float[jax.Array, "*lanes"]]
    scaled_depth_rate: list[Float[jax.Array, "*lanes"]]
    time: list[Float[jax.Array, "*lanes"]]


def contact_series(coeffs, side, state, order):
    """Return the `ContactSeries` up to an order, for lanes inside the wall on a side."""
    scaled_root_series = Series(
        lambda series, k: scale_coefficient(1.0 / k, scaled_rate_series[k - 1]), state.scaled_depth_root
    )
    scaled_rate_series = Series(
        lambda series, k: scale_coefficient(2.0 / k, root_times_inward_accel[k - 1]), state.scaled_depth_rate
    )
    time_series = Series(
        lambda series, k: scale_coefficient(2.0 / k, depth_root[k - 1]), jnp.zeros_like(state.scaled_depth_root)
    )
    depth_root, depth_rate = (
        scale_series(state.scale, scaled_root_series),
        scale_series(state.scale, scaled_rate_series),
    )
    relative_accel_series, wall_force_series = _accel_and_wall_force(
        coeffs, side, state, Square(depth_root), depth_rate, time_series
    )
    root_times_inward_accel = multiply_series(
        scaled_root_series, subtract_series(scale_series(side, relative_accel_series), wall_force_series)
    )
    return ContactSeries(
        *([series[k] for k in range(order + 1)] for series in (scaled_root_series, scaled_rate_series, time_series))
    )


def depth_jets(coeffs, side, state, depth, depth_rate, order):
    """Return (time derivatives of the depth, time derivatives of its rate) up to an order.

    The last entry of each list is a constant under differentiation. The derivatives are also correct if the depth is 0
    or a rounding error. The series in s cannot be used there, because the time grows like s^2. Derivatives of an order
    above 1 are nan at depth 0 if the contact law is not smooth enough, for example y^1.5.
    """
    ones = jnp.ones_like(depth)
    depth_series = Series(lambda series, k: scale_coefficient(1.0 / k, depth_rate_series[k - 1]), depth)
    depth_rate_series = Series(lambda series, k: scale_coefficient(1.0 / k, inward_accel[k - 1]), depth_rate)
    time_series = Series(lambda series, k: None, jnp.zeros_like(depth), ones)
    relative_accel_series, wall_force_series = _accel_and_wall_force(
        coeffs, side, state, depth_series, depth_rate_series, time_series
    )
    inward_accel = subtract_series(scale_series(side, relative_accel_series), wall_force_series)
    depth_and_rate_jets = []
    for series in (depth_series, depth_rate_series):
        derivatives = [series[k] * float(math.factorial(k)) for k in range(order + 1)]
        depth_and_rate_jets.append([*derivatives[:-1], lax.stop_gradient(derivatives[-1])])
    return depth_and_rate_jets


def _accel_and_wall_force(coeffs, side, state, depth_series, depth_rate_series, elapsed_time):
    """Return two `Series`: acceleration along x relative to the wall without the contact force, and this force."""
    angle_series = scale_series(coeffs.frequency, elapsed_time)
    cosine, _ = _phasor_series(angle_series, state.cosine, state.sine)
    wall_position, wall_velocity, wall_acceleration = _wall_motion_series(coeffs, side, state, angle_series)
    x_series, v_series = (
        add_series(wall_position, scale_series(side, depth_series)),
        scale_series(side, depth_rate_series),
    )
    v_series = v_series if wall_velocity is None else add_series(wall_velocity, v_series)
    absolute_time = add_constant(
        call_without_inlining(flow.time_at_phasor, coeffs.frequency, state.cosine, state.sine), elapsed_time
    )
    relative_accel_series = add_series(
        jaxpr_series.force_series(coeffs.user_force, absolute_time, x_series, v_series),
        scale_series(coeffs.amplitude, cosine),
    )
    for term in coeffs.drive_terms:
        term_cosine, _ = _phasor_series(
            scale_series(float(term.harmonic), angle_series), *harmonic_phasor(term, state.cosine, state.sine)
        )
        relative_accel_series = add_series(relative_accel_series, scale_series(term.amplitude, term_cosine))
    return relative_accel_series if wall_acceleration is None else subtract_series(
        relative_accel_series, wall_acceleration
    ), _wall_force_series(coeffs, side, depth_series, depth_rate_series, v_series)


def _phasor_series(angle_series, cosine, sine):
    """Return the `Series` (cosine, sine) of an angle that starts at a phasor and grows by `angle_series`."""
    phasor_series: list[Series] = []
    phasor_series.append(series_from_rate(angle_series, cosine, lambda series: scale_series(-1.0, phasor_series[1])))
    phasor_series.append(series_from_rate(angle_series, sine, lambda series: phasor_series[0]))
    return phasor_series


def _wall_motion_series(coeffs, side, state, angle_series):
    """Return the `Series` of position, velocity and acceleration of the wall on a side; None for zero."""
    walls = coeffs.walls
    zero = jnp.zeros_like(state.scaled_depth_root)
    mean_position = select_by_side(side, walls, [wall.position + zero for wall in walls])
    if all(wall.amplitude is None for wall in walls):
        return Series(None, mean_position), None, None
    wall_amplitude, harmonic, cosine, sine = (
        select_by_side(side, walls, values)
        for values in zip(*(_wall_oscillation(wall, state, zero) for wall in walls), strict=True)
    )
    cosine, sine = _phasor_series(scale_series(harmonic, angle_series), cosine, sine)
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


def _wall_force_series(coeffs, side, depth_series, depth_rate_series, velocity_series):
    """Return the `Series` of the force of the wall on a side: its law, or k2 y + 2 gamma2 s v.

    y is the depth, s is the side (-1 or 1), and v is the absolute velocity of the mass.
    """
    walls_and_contacts = zip(coeffs.walls, coeffs.kinds.wall_contacts, strict=True)
    soft_walls, contacts = zip(*(pair for pair in walls_and_contacts if pair[0].restitution is None), strict=True)
    law_identities = [wall.law and (wall.law.function, tuple(wall.law.numbers)) for wall in soft_walls]
    if len(soft_walls) == 2 and law_identities[0] == law_identities[1]:
        wall_law_params = [(wall.law, wall.stiffness, wall.damping) for wall in soft_walls]
        wall_law, stiffness, damping = jax.tree.map(partial(choose, side < 0), *wall_law_params)
        soft_walls = [replace(soft_walls[0], law=wall_law, stiffness=stiffness, damping=damping)]
    wall_forces = [
        contact.force_series(wall, side, depth_series, depth_rate_series, velocity_series)
        for wall, contact in zip(soft_walls, contacts, strict=False)
    ]
    if len(wall_forces) == 1:
        return wall_forces[0]
    left_force, right_force = wall_forces
    return Series(
        lambda series, k: _select_coeff_by_side(side < 0, left_force[k], right_force[k]),
        _select_coeff_by_side(side < 0, left_force[0], right_force[0]),
    )


def _select_coeff_by_side(is_on_left, left_value, right_value):
    """Select a coefficient by side; None stands for zero in all lanes."""
    return (
        None
        if left_value is None and right_value is None
        else choose(is_on_left, 0.0 if left_value is None else left_value, 0.0 if right_value is None else right_value)
    )


def max_scaled_step(coeffs, contact_series, state_scale):
    """Return a step in s for which the last terms remain below the tolerance.

    The angles of the drive and of the walls change by at most 1 within the step. The tolerance is relative to the
    largest of the first terms.
    """
    return call_without_inlining(
        _max_scaled_step, contact_series, state_scale, coeffs.max_step, tolerance=coeffs.user_force.tolerance
    )


def _max_scaled_step(contact_series, state_scale, max_time_step, tolerance):
    """Return the result of `max_scaled_step`."""
    tiny_magnitude = TINY_MULTIPLE * float(jnp.finfo(state_scale.dtype).tiny)
    degree = len(contact_series.scaled_depth_root) - 1
    time_slope, time_curvature = (
        2.0 * lax.abs(state_scale * series) + tiny_magnitude
        for series in (contact_series.scaled_depth_root[0], contact_series.scaled_depth_rate[0])
    )
    scaled_step = lax.min(0.5 * max_time_step / time_slope, lax.sqrt(max_time_step / time_curvature))
    for series in (contact_series.scaled_depth_root, contact_series.scaled_depth_rate):
        for k in (degree - 1, degree):
            magnitude = lax.abs(series[k]) + tiny_magnitude
            log_step_ratios = [
                lax.log((tolerance * lax.abs(series[j]) + tiny_magnitude) / magnitude) / float(k - j) for j in range(3)
            ]
            scaled_step = lax.min(
                scaled_step, lax.exp(maximum(maximum(log_step_ratios[0], log_step_ratios[1]), log_step_ratios[2]))
            )
    return scaled_step


def evaluate_series(series_list, scaled_step):
    """Evaluate Taylor series in s, such as the fields of a `ContactSeries`, after a span of s."""
    return [flow.horner(series, scaled_step) for series in series_list]


def rotate_drive_phasor(coeffs, state, time):
    """Return (cosine, sine) of the drive angle after a time of any sign."""
    return flow.rotate_phasor(state.cosine, state.sine, *flow.rotation_by_angle(coeffs.frequency * time))


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

"""Compute directional derivatives of x and v along fast steps, at fixed time, in directions of the parameters.

The rate of a quantity is its derivative in such a direction, not a derivative with respect to time. A flight of a given
duration is linear in x and v. Let dx and dv be the perturbations of x and v before an impact with restitution R at the
velocity v-, on a wall with position x_b and velocity v_b. The impact is delayed by

    d = (dx_b - dx) / u,    u = v- - v_b,

and the perturbation after it, referred to the time of the unperturbed impact, is (saltation matrix; paper, (36))

    dx+ = (1 + R) dx_b - R dx,    dv+ = (1 + R) dv_b - R dv - R' u + d ((1 + R) a_b - R a- - a+),

where R' is the rate of R, a- and a+ are the accelerations before and after the impact, and a_b is that of the wall. The
remaining terms are derivatives of `fast_motion` with respect to the parameters that vary.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..compiled.lane_arithmetic import call_without_inlining, choose
from . import fast_motion, flow
from .fast_coefficients import FastCoefficients
from .wall_motion import WallCoefficients, select_by_side, select_lists_by_side, subtract_optional, wall_jet


class ParameterDirection(NamedTuple):
    """Derivatives of the parameters of lanes in a direction; None stands for zero.

    Attributes
    ----------
    coeff_rates : FastCoefficients
        Derivatives of the coefficients.
    initial_phase_rate : array or None
        Derivative of the drive phase at the start.
    duration_rate : array or None
        Derivative of the duration.
    """

    coeff_rates: FastCoefficients
    initial_phase_rate: Float[jax.Array, "..."] | None
    duration_rate: Float[jax.Array, "..."] | None


class Tangent(NamedTuple):
    """Directional derivative of the state.

    Attributes
    ----------
    x : array
        Derivative of the position.
    v : array
        Derivative of the velocity, in lengths per longest step within the fast path.
    """

    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]


def parameter_direction(coeffs, scene, scene_rates, initial_phase_rate):
    """Build a direction from the derivatives of the parameters of a scene and of the initial phase.

    Parameters
    ----------
    coeffs : FastCoefficients
        Coefficients of the scene.
    scene : Scene
        Scene.
    scene_rates : Scene
        Derivatives of the parameters of the scene; None stands for zero.
    initial_phase_rate : array or None
        Derivative of the phase of the state.

    Returns
    -------
    ParameterDirection
        Derivatives of the coefficients, of the phase and of the duration.
    """
    amplitude_rate, frequency_rate, drag_rate = scene_rates.amplitude, scene_rates.frequency, scene_rates.damping
    if amplitude_rate is not None:
        amplitude_rate = amplitude_rate * coeffs.stiffness
    if frequency_rate is not None:
        frequency_rate = frequency_rate * coeffs.max_step
    if drag_rate is not None:
        drag_rate = 2.0 * drag_rate * coeffs.max_step
    signed_walls = zip((-1, 1), (scene.left, scene.right), (scene_rates.left, scene_rates.right), strict=True)
    zero_rates = FastCoefficients(*[None] * len(FastCoefficients._fields))
    coeff_rates = zero_rates._replace(
        amplitude=amplitude_rate,
        frequency=frequency_rate,
        drag=drag_rate,
        economised_series=_series_rates(coeffs, frequency_rate, drag_rate),
        walls=tuple(
            _wall_rates(side, wall, wall_rates, scene_rates.restitution)
            for side, wall, wall_rates in signed_walls
            if wall is not None
        ),
    )
    duration_rate = None if frequency_rate is None else -(coeffs.period / coeffs.frequency) * frequency_rate
    return ParameterDirection(coeff_rates, initial_phase_rate, duration_rate)


def _series_rates(coeffs, frequency_rate, drag_rate):
    """Return the directional derivatives of the flow series; None stands for zero."""
    if frequency_rate is None and drag_rate is None:
        return None
    damping_rate = None if drag_rate is None else 0.5 * drag_rate
    values = coeffs.frequency, 0.5 * coeffs.drag, coeffs.stiffness
    series_rates = flow.economise_series(
        jvp_of_varying_inputs(flow.flow_series, values, (frequency_rate, damping_rate, None))
    )
    return series_rates if drag_rate is not None else series_rates._replace(p00_minus_1=None, p01=None)


def _wall_rates(wall_sign, wall, wall_rates, scene_restitution_rate):
    """Return the directional derivatives of the coefficients of a wall."""
    restitution_rate = wall_rates.restitution if wall.restitution is not None else scene_restitution_rate
    wall_motion_rates = {"amplitude": None, "cosine": None, "sine": None}
    harmonic = 1
    if wall.motion is not None:
        harmonic, phase_rate = wall.motion.harmonic, wall_rates.motion.phase
        wall_motion_rates["amplitude"] = wall_rates.motion.amplitude
        if phase_rate is not None:
            phase = jnp.asarray(wall.motion.phase)
            wall_motion_rates["cosine"], wall_motion_rates["sine"] = (
                -jnp.sin(phase) * phase_rate,
                jnp.cos(phase) * phase_rate,
            )
    return WallCoefficients(
        wall_rates.position, restitution_rate, sign=wall_sign, harmonic=harmonic, **wall_motion_rates
    )


def jvp_of_varying_inputs(function, arguments, argument_rates):
    """Return the derivative of ``function(*arguments)`` for given derivatives of the arguments; None stands for zero.

    `argument_rates` is a prefix of the pytree `arguments`. A None applies to all leaves below it.
    """
    leaves, treedef = jax.tree.flatten(arguments)
    leaf_rates = []

    def append_leaf_rates(rate, subtree):
        leaf_rates.extend([None] * len(jax.tree.leaves(subtree)) if rate is None else [rate])

    jax.tree.map(append_leaf_rates, argument_rates, arguments, is_leaf=lambda rate: rate is None)
    varying_indices = [leaf_index for leaf_index, leaf_rate in enumerate(leaf_rates) if leaf_rate is not None]

    def function_of_varying(*varying_leaves):
        all_leaves = list(leaves)
        for leaf_index, varying_leaf in zip(varying_indices, varying_leaves, strict=True):
            all_leaves[leaf_index] = varying_leaf
        return function(*treedef.unflatten(all_leaves))

    varying_rates = [
        jnp.broadcast_to(leaf_rates[leaf_index], jnp.shape(leaves[leaf_index])) for leaf_index in varying_indices
    ]
    return jax.jvp(function_of_varying, [leaves[leaf_index] for leaf_index in varying_indices], varying_rates)[1]


def propagate_tangents(coeffs, directions, tangents, lanes_before, initial_drive_forces, propagator, step_time):
    """Return the tangents after the flight of a step, given the lanes and forces at its start."""
    time_in_period = call_without_inlining(_time_in_period, coeffs, lanes_before.time_remaining)
    flight_arguments = (
        lanes_before.x,
        lanes_before.v,
        lanes_before.cosine,
        lanes_before.sine,
        initial_drive_forces,
        propagator,
        step_time,
        time_in_period,
    )
    return tuple(
        call_without_inlining(_propagate_tangent, coeffs, direction, tangent, *flight_arguments)
        for direction, tangent in zip(directions, tangents, strict=True)
    )


def _time_in_period(coeffs, time_remaining):
    """Return the time since the start of the period."""
    return coeffs.period - time_remaining


def _drive_angle_rate(direction, time_in_period):
    """Return the directional derivative of the drive angle at a time after the start."""
    if direction.coeff_rates.frequency is None:
        return direction.initial_phase_rate
    angle_rate = direction.coeff_rates.frequency * time_in_period
    return angle_rate if direction.initial_phase_rate is None else angle_rate + direction.initial_phase_rate


def _phasor_rates(cosine, sine, angle_rate):
    """Return the directional derivatives of the phasor of the drive."""
    return (None, None) if angle_rate is None else (-sine * angle_rate, cosine * angle_rate)


def _propagate_tangent(
    coeffs, direction, tangent, x, v, cosine, sine, initial_drive_forces, propagator, step_time, time_in_period
):
    """Return one tangent after the flight of a step."""
    coeff_rates, phasor_rates = (
        direction.coeff_rates,
        _phasor_rates(cosine, sine, _drive_angle_rate(direction, time_in_period)),
    )
    force_rates = None, None
    if coeff_rates.amplitude is not None or phasor_rates[0] is not None:
        force_rates = jvp_of_varying_inputs(
            fast_motion.drive_forces, (coeffs, cosine, sine), (coeff_rates, *phasor_rates)
        )
    propagator_rates = _propagator_rates(coeff_rates.economised_series, step_time)
    return Tangent(
        *jvp_of_varying_inputs(
            fast_motion.propagate_free_flight,
            (coeffs, x, v, initial_drive_forces, propagator),
            (coeff_rates, tangent.x, tangent.v, force_rates, propagator_rates),
        )
    )


def _propagator_rates(series_rates, step_time):
    """Return the directional derivatives of the `flow.Propagator` of a flight; None stands for zero.

    Those of the drive rotation are also None, because `_phasor_rates` returns the derivatives of the phasor directly.
    """
    propagator_rates = flow.Propagator(*[None] * 6)
    if series_rates is None:
        return propagator_rates
    time_squared = step_time * step_time
    cos_response_rate, sin_response_rate = flow.drive_responses(series_rates, step_time)
    propagator_rates = propagator_rates._replace(cos_response=cos_response_rate, sin_response=sin_response_rate)
    if series_rates.p00_minus_1 is None:
        return propagator_rates
    return propagator_rates._replace(
        p00_minus_1=flow.horner(series_rates.p00_minus_1, step_time) * time_squared,
        p01=flow.horner(series_rates.p01, step_time) * step_time,
    )


def apply_saltation(coeffs, directions, tangents, lanes, flight_end_state, hit_side, impact_velocity):
    """Return the tangents after the event of a step; without an event they do not change.

    `flight_end_state` holds x, v and the phasor at the end of the flight, and the delay of the event. `lanes` are the
    states after the event. `impact_velocity` is the velocity before impact."""
    time_in_period = call_without_inlining(_time_in_period, coeffs, lanes.time_remaining)
    saltation_terms = call_without_inlining(
        _saltation_terms, coeffs, lanes.v, lanes.cosine, lanes.sine, hit_side, impact_velocity
    )
    impact_arguments = flight_end_state, hit_side, lanes.cosine, lanes.sine, time_in_period, saltation_terms
    return tuple(
        call_without_inlining(_saltate_tangent, coeffs, direction, tangent, *impact_arguments)
        for direction, tangent in zip(directions, tangents, strict=True)
    )


def _saltation_terms(coeffs, velocity_after_impact, cosine, sine, hit_side, velocity_before_impact):
    """Return (u, 1 / u, (1 + R) a_b - R a- - a+) of an impact."""
    wall_derivs = [wall_jet(wall, coeffs.frequency, cosine, sine, 2) for wall in coeffs.walls]
    wall_position, wall_velocity, wall_acceleration = select_lists_by_side(hit_side, coeffs.walls, wall_derivs)
    restitution = fast_motion.restitution_of(coeffs, hit_side)
    accel_before, accel_after = (
        fast_motion.evaluate_acceleration(coeffs, wall_position, velocity, (cosine, sine))
        for velocity in (velocity_before_impact, velocity_after_impact)
    )
    relative_velocity, acceleration_jump = (
        subtract_optional(velocity_before_impact, wall_velocity),
        -restitution * accel_before - accel_after,
    )
    return (
        relative_velocity,
        1.0 / relative_velocity,
        acceleration_jump if wall_acceleration is None else acceleration_jump + (1.0 + restitution) * wall_acceleration,
    )


def _saltate_tangent(
    coeffs, direction, tangent, flight_end_state, hit_side, cosine, sine, time_in_period, saltation_terms
):
    """Return one tangent after the event of a step."""
    coeff_rates, (*end_state_and_phasor, event_delay), (relative_velocity, inverse_velocity, acceleration_jump) = (
        direction.coeff_rates,
        flight_end_state,
        saltation_terms,
    )
    angle_rate = _drive_angle_rate(direction, time_in_period)
    angle_rate_before = (
        angle_rate if coeff_rates.frequency is None else angle_rate - coeff_rates.frequency * event_delay
    )
    argument_rates = (
        coeff_rates,
        tangent.x,
        tangent.v,
        _phasor_rates(end_state_and_phasor[2], end_state_and_phasor[3], angle_rate_before),
        None,
    )
    x, v = jvp_of_varying_inputs(
        _state_at_event,
        (coeffs, *end_state_and_phasor[:2], tuple(end_state_and_phasor[2:]), event_delay),
        argument_rates,
    )
    is_hit, restitution = hit_side != 0, fast_motion.restitution_of(coeffs, hit_side)
    restitution_rate = _restitution_rate(coeffs, coeff_rates, hit_side)
    wall_position_rate, wall_velocity_rate = _wall_state_rates(
        coeffs, coeff_rates, (cosine, sine), _phasor_rates(cosine, sine, angle_rate), hit_side
    )
    wall_minus_mass_rate = subtract_optional(-x, None if wall_position_rate is None else -wall_position_rate)
    v = -restitution * v + (wall_minus_mass_rate * inverse_velocity) * acceleration_jump
    x = -restitution * x
    if restitution_rate is not None:
        v = v - restitution_rate * relative_velocity
    if wall_position_rate is not None:
        x = x + (1.0 + restitution) * wall_position_rate
    if wall_velocity_rate is not None:
        v = v + (1.0 + restitution) * wall_velocity_rate
    return Tangent(choose(is_hit, x, tangent.x), choose(is_hit, v, tangent.v))


def _state_at_event(coeffs, x, v, flight_end_phasor, delay):
    """Return (x, v) before impact at an event that follows the end of a step after a delay."""
    flight_end_accel = fast_motion.evaluate_acceleration(coeffs, x, v, flight_end_phasor)
    return x + delay * (v + 0.5 * delay * flight_end_accel), fast_motion.impact_velocity(
        coeffs, x, v, flight_end_phasor, delay
    )


def _restitution_rate(coeffs, coeff_rates, side):
    """Return the derivative of the restitution of the wall on a side, in the direction of `coeff_rates`."""
    return select_by_side(side, coeffs.walls, [wall.restitution for wall in coeff_rates.walls])


def _wall_state_rates(coeffs, coeff_rates, phasor, phasor_rates, side):
    """Return the directional derivatives of position and velocity of the wall on a side."""

    def wall_motion_rates(wall, wall_rates):
        if wall.amplitude is None:
            return wall_rates.position, None
        input_rates = (
            wall_rates.position,
            wall_rates.amplitude,
            wall_rates.cosine,
            wall_rates.sine,
            coeff_rates.frequency,
            phasor_rates[0],
        )
        if all(input_rate is None for input_rate in input_rates):
            return None, None

        def wall_position_velocity(wall, frequency, cosine, sine):
            return wall_jet(wall, frequency, cosine, sine, 1)

        return tuple(
            jvp_of_varying_inputs(
                wall_position_velocity,
                (wall, coeffs.frequency, *phasor),
                (wall_rates, coeff_rates.frequency, *phasor_rates),
            )
        )

    return select_lists_by_side(
        side,
        coeffs.walls,
        [wall_motion_rates(*wall_and_rates) for wall_and_rates in zip(coeffs.walls, coeff_rates.walls, strict=True)],
    )


def add_period_derivative(coeffs, directions, tangents, lanes):
    """Return the tangents at the end of a period whose duration depends on the frequency."""
    return tuple(
        _add_period_derivative(coeffs, *direction_and_tangent, lanes)
        for direction_and_tangent in zip(directions, tangents, strict=True)
    )


def _add_period_derivative(coeffs, direction, tangent, lanes):
    if direction.duration_rate is None:
        return tangent
    acceleration = fast_motion.evaluate_acceleration(coeffs, lanes.x, lanes.v, (lanes.cosine, lanes.sine))
    return Tangent(tangent.x + direction.duration_rate * lanes.v, tangent.v + direction.duration_rate * acceleration)

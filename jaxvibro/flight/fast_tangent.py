"""Compute directional derivatives of x and v along fast steps, at fixed time, in directions of the parameters.

A flight of a given duration is linear in x and v. An impact on a wall with position x_b and velocity v_b is delayed by

    d = (dx_b - dx) / u,    u = v- - v_b,

and the perturbation after it, referred to the time of the unperturbed impact, is (saltation matrix; paper, (36))

    dx+ = (1 + R) dx_b - R dx,    dv+ = (1 + R) dv_b - R dv - R' u + d ((1 + R) a_b - R a- - a+),

where a- and a+ are the accelerations before and after, and a_b is that of the wall. The remaining terms are derivatives
of `fast_motion` with respect to the parameters that vary.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..compiled.compiler_hints import choose, stage
from . import fast_motion, flow
from .fast_coefficients import FastCoefficients
from .wall_motion import WallCoefficients, select_by_side, select_lists_by_side, subtract, wall_jet


class ParameterDirection(NamedTuple):
    """Rates of the parameters of lanes along a direction; None stands for a rate of zero.

    Attributes
    ----------
    coeff_rates : FastCoefficients
        Rates of the coefficients.
    phase_rate : array or None
        Rate of the drive phase at the start.
    period_rate : array or None
        Rate of the duration.
    """

    coeff_rates: FastCoefficients
    phase_rate: Float[jax.Array, "..."] | None
    period_rate: Float[jax.Array, "..."] | None


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


def parameter_direction(coeffs, scene, scene_rates, phase_rate):
    """Build the direction of a derivative from the rates of a scene and of the phase.

    Parameters
    ----------
    coeffs : FastCoefficients
        Coefficients of the scene.
    scene : Scene
        Scene.
    scene_rates : Scene
        Rates of the parameters of the scene; None stands for a rate of zero.
    phase_rate : array or None
        Rate of the phase of the state.

    Returns
    -------
    ParameterDirection
        Rates of the coefficients, of the phase and of the duration.
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
        short_series=_series_rates(coeffs, frequency_rate, drag_rate),
        walls=tuple(
            _wall_rates(side, wall, wall_rates, scene_rates.restitution)
            for side, wall, wall_rates in signed_walls
            if wall is not None
        ),
    )
    period_rate = None if frequency_rate is None else -(coeffs.period / coeffs.frequency) * frequency_rate
    return ParameterDirection(coeff_rates, phase_rate, period_rate)


def _series_rates(coeffs, frequency_rate, drag_rate):
    """Return the rates of the flow series; the free flow does not depend on the drive."""
    if frequency_rate is None and drag_rate is None:
        return None
    damping_rate = None if drag_rate is None else 0.5 * drag_rate
    values = coeffs.frequency, 0.5 * coeffs.drag, coeffs.stiffness
    series_rates = flow.economise_series(partial_jvp(flow.flow_series, values, (frequency_rate, damping_rate, None)))
    return series_rates if drag_rate is not None else series_rates._replace(p00_minus_1=None, p01=None)


def _wall_rates(side, wall, wall_rates, shared_rate):
    """Return the rates of the coefficients of a wall."""
    restitution_rate = wall_rates.restitution if wall.restitution is not None else shared_rate
    motion_rates = {"amplitude": None, "cosine": None, "sine": None}
    harmonic = 1
    if wall.motion is not None:
        harmonic, phase_rate = wall.motion.harmonic, wall_rates.motion.phase
        motion_rates["amplitude"] = wall_rates.motion.amplitude
        if phase_rate is not None:
            phase = jnp.asarray(wall.motion.phase)
            motion_rates["cosine"], motion_rates["sine"] = -jnp.sin(phase) * phase_rate, jnp.cos(phase) * phase_rate
    return WallCoefficients(wall_rates.position, restitution_rate, sign=side, harmonic=harmonic, **motion_rates)


def partial_jvp(function, values, rates):
    """Return the derivative of ``function(*values)`` for given rates of parts of the values; None stands for zero."""
    leaves, treedef = jax.tree.flatten(values)
    leaf_rates = []

    def spread_rate(rate, subtree):
        leaf_rates.extend([None] * len(jax.tree.leaves(subtree)) if rate is None else [rate])

    jax.tree.map(spread_rate, rates, values, is_leaf=lambda rate: rate is None)
    moving_indices = [k for k, rate in enumerate(leaf_rates) if rate is not None]

    def restricted_function(*moving_leaves):
        all_leaves = list(leaves)
        for k, value in zip(moving_indices, moving_leaves, strict=True):
            all_leaves[k] = value
        return function(*treedef.unflatten(all_leaves))

    moving_rates = [jnp.broadcast_to(leaf_rates[k], jnp.shape(leaves[k])) for k in moving_indices]
    return jax.jvp(restricted_function, [leaves[k] for k in moving_indices], moving_rates)[1]


def propagate_tangents(coeffs, directions, tangents, lanes_before, drive_forces, propagator, time):
    """Return the tangents after the flight of a step, given the lanes and forces at its start."""
    elapsed_time = stage(_elapsed_time, coeffs, lanes_before.time_remaining)
    flight_arguments = (
        lanes_before.x,
        lanes_before.v,
        lanes_before.cosine,
        lanes_before.sine,
        drive_forces,
        propagator,
        time,
        elapsed_time,
    )
    return tuple(
        stage(_propagate_tangent, coeffs, direction, tangent, *flight_arguments)
        for direction, tangent in zip(directions, tangents, strict=True)
    )


def _elapsed_time(coeffs, time_remaining):
    """Return the time since the start of the period."""
    return coeffs.period - time_remaining


def _angle_rate(direction, elapsed_time):
    """Return the rate of the drive angle at a time after the start."""
    if direction.coeff_rates.frequency is None:
        return direction.phase_rate
    angle_rate = direction.coeff_rates.frequency * elapsed_time
    return angle_rate if direction.phase_rate is None else angle_rate + direction.phase_rate


def _phasor_rates(cosine, sine, angle_rate):
    """Return the rates of the phasor of the drive."""
    return (None, None) if angle_rate is None else (-sine * angle_rate, cosine * angle_rate)


def _propagate_tangent(coeffs, direction, tangent, x, v, cosine, sine, drive_forces, propagator, time, elapsed_time):
    """Return one tangent after the flight of a step."""
    coeff_rates, phasor_rates = direction.coeff_rates, _phasor_rates(cosine, sine, _angle_rate(direction, elapsed_time))
    force_rates = None, None
    if coeff_rates.amplitude is not None or phasor_rates[0] is not None:
        force_rates = partial_jvp(fast_motion.drive_forces, (coeffs, cosine, sine), (coeff_rates, *phasor_rates))
    propagator_rates = _propagator_rates(coeff_rates.short_series, time)
    return Tangent(
        *partial_jvp(
            fast_motion.propagate,
            (coeffs, x, v, drive_forces, propagator),
            (coeff_rates, tangent.x, tangent.v, force_rates, propagator_rates),
        )
    )


def _propagator_rates(series, time):
    """Return the rates of the `flow.Propagator` of a flight."""
    propagator_rates = flow.Propagator(*[None] * 6)
    if series is None:
        return propagator_rates
    time_squared = time * time
    cos_response, sin_response = flow.drive_responses(series, time)
    propagator_rates = propagator_rates._replace(cos_response=cos_response, sin_response=sin_response)
    if series.p00_minus_1 is None:
        return propagator_rates
    return propagator_rates._replace(
        p00_minus_1=flow.horner(series.p00_minus_1, time) * time_squared, p01=flow.horner(series.p01, time) * time
    )


def apply_saltation(coeffs, directions, tangents, lanes, flight_end, side, impact_velocity):
    """Return the tangents after the event of a step, if it has one.

    `flight_end` holds x, v and the phasor at the end of the flight, and the delay of the event. `lanes` are the states
    after the event. `impact_velocity` is the velocity before impact.
    """
    elapsed_time = stage(_elapsed_time, coeffs, lanes.time_remaining)
    saltation_terms = stage(_saltation_terms, coeffs, lanes.v, lanes.cosine, lanes.sine, side, impact_velocity)
    impact_arguments = flight_end, side, lanes.cosine, lanes.sine, elapsed_time, saltation_terms
    return tuple(
        stage(_saltate_tangent, coeffs, direction, tangent, *impact_arguments)
        for direction, tangent in zip(directions, tangents, strict=True)
    )


def _saltation_terms(coeffs, new_velocity, cosine, sine, side, impact_velocity):
    """Return (u, 1 / u, (1 + R) a_b - R a- - a+) of an impact."""
    wall_derivs = [wall_jet(wall, coeffs.frequency, cosine, sine, 2) for wall in coeffs.walls]
    wall_position, wall_velocity, wall_acceleration = select_lists_by_side(side, coeffs.walls, wall_derivs)
    restitution = fast_motion.restitution_of(coeffs, side)
    accel_before, accel_after = (
        fast_motion.evaluate_acceleration(coeffs, wall_position, velocity, (cosine, sine))
        for velocity in (impact_velocity, new_velocity)
    )
    relative_velocity, acceleration_jump = (
        subtract(impact_velocity, wall_velocity),
        -restitution * accel_before - accel_after,
    )
    return (
        relative_velocity,
        1.0 / relative_velocity,
        acceleration_jump if wall_acceleration is None else acceleration_jump + (1.0 + restitution) * wall_acceleration,
    )


def _saltate_tangent(coeffs, direction, tangent, flight_end, side, cosine, sine, elapsed_time, saltation_terms):
    """Return one tangent after the event of a step."""
    coeff_rates, (*end_state, delay), (relative_velocity, inverse_velocity, acceleration_jump) = (
        direction.coeff_rates,
        flight_end,
        saltation_terms,
    )
    angle_rate = _angle_rate(direction, elapsed_time)
    angle_rate_before = angle_rate if coeff_rates.frequency is None else angle_rate - coeff_rates.frequency * delay
    argument_rates = (
        coeff_rates,
        tangent.x,
        tangent.v,
        _phasor_rates(end_state[2], end_state[3], angle_rate_before),
        None,
    )
    x, v = partial_jvp(_event_state, (coeffs, *end_state[:2], tuple(end_state[2:]), delay), argument_rates)
    is_hit, restitution = side != 0, fast_motion.restitution_of(coeffs, side)
    restitution_rate = _restitution_rate(coeffs, coeff_rates, side)
    wall_position_rate, wall_velocity_rate = _wall_state_rates(
        coeffs, coeff_rates, (cosine, sine), _phasor_rates(cosine, sine, angle_rate), side
    )
    relative_rate = subtract(-x, None if wall_position_rate is None else -wall_position_rate)
    v = -restitution * v + (relative_rate * inverse_velocity) * acceleration_jump
    x = -restitution * x
    if restitution_rate is not None:
        v = v - restitution_rate * relative_velocity
    if wall_position_rate is not None:
        x = x + (1.0 + restitution) * wall_position_rate
    if wall_velocity_rate is not None:
        v = v + (1.0 + restitution) * wall_velocity_rate
    return Tangent(choose(is_hit, x, tangent.x), choose(is_hit, v, tangent.v))


def _event_state(coeffs, x, v, phasor, delay):
    """Return (x, v) at an event a delay after the end of a step."""
    acceleration = fast_motion.evaluate_acceleration(coeffs, x, v, phasor)
    return x + delay * (v + 0.5 * delay * acceleration), fast_motion.impact_velocity(coeffs, x, v, phasor, delay)


def _restitution_rate(coeffs, coeff_rates, side):
    """Return the rate of the restitution of the wall on a side."""
    return select_by_side(side, coeffs.walls, [wall.restitution for wall in coeff_rates.walls])


def _wall_state_rates(coeffs, coeff_rates, phasor, phasor_rates, side):
    """Return the rates of position and velocity of the wall on a side."""

    def rates_of_wall(wall, wall_rates):
        if wall.amplitude is None:
            return wall_rates.position, None
        known_rates = (
            wall_rates.position,
            wall_rates.amplitude,
            wall_rates.cosine,
            wall_rates.sine,
            coeff_rates.frequency,
            phasor_rates[0],
        )
        if all(known_rate is None for known_rate in known_rates):
            return None, None

        def position_and_velocity(wall, frequency, cosine, sine):
            return wall_jet(wall, frequency, cosine, sine, 1)

        return tuple(
            partial_jvp(
                position_and_velocity,
                (wall, coeffs.frequency, *phasor),
                (wall_rates, coeff_rates.frequency, *phasor_rates),
            )
        )

    return select_lists_by_side(
        side,
        coeffs.walls,
        [rates_of_wall(*wall_and_rates) for wall_and_rates in zip(coeffs.walls, coeff_rates.walls, strict=True)],
    )


def add_period_change(coeffs, directions, tangents, lanes):
    """Return the tangents at the end of a period whose duration depends on the frequency."""
    return tuple(
        _add_period_change(coeffs, *direction_and_tangent, lanes)
        for direction_and_tangent in zip(directions, tangents, strict=True)
    )


def _add_period_change(coeffs, direction, tangent, lanes):
    if direction.period_rate is None:
        return tangent
    acceleration = fast_motion.evaluate_acceleration(coeffs, lanes.x, lanes.v, (lanes.cosine, lanes.sine))
    return Tangent(tangent.x + direction.period_rate * lanes.v, tangent.v + direction.period_rate * acceleration)

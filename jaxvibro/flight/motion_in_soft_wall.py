"""Model the motion inside a soft wall with spring and damper (paper, (39)).

The mass is then another oscillator in y = x - x_b, the displacement past the wall:

    y'' + 2 gamma2 y' + (1 + k2) y = A cos(theta) - x_b - 2 gamma2 x_b' - x_b''

The right-hand side is the contact force on a mass that sticks to the wall. The displacement y is accurate at any
stiffness, because x is measured from the wall. A lane is inside a wall from the step that ends at the entry to the step
that ends at the exit.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import choose
from ..scene.codes import Contact
from . import flow, further_drive_terms
from .soft_wall_first_step import FirstStepInWall, make_first_step_in_wall
from .wall_motion import select_by_side, subtract_optional, wall_jet


class SoftWallFlow(NamedTuple):
    """Flow of the oscillator inside a soft wall.

    Attributes
    ----------
    stiffness : array
        Stiffness 1 + k2.
    root_stiffness : array
        Square root of the stiffness.
    damping : array
        Damping gamma2.
    series : FlowSeries
        Series of the flow under the first drive term.
    wall_motion_series : FlowSeries or None
        Series of the flow under the motion of the wall. None for a fixed wall.
    first_step : FirstStepInWall
        First step after an entry.
    max_step : array
        Longest of the steps after the first.
    jet_bound : array
        Constant part of the bound on ``|y^(8)|``, as in `flight_coefficients.FlowCoefficients`.
    jet_bound_slope : array
        Factor of ``|y^(6)|`` and ``|y^(7)|`` in this bound, as in `flight_coefficients.FlowCoefficients`.
    drive_term_series : tuple of FlowSeries
        Series of the flow under each further drive term.
    """

    stiffness: Float[jax.Array, "..."]
    root_stiffness: Float[jax.Array, "..."]
    damping: Float[jax.Array, "..."]
    series: flow.FlowSeries
    wall_motion_series: flow.FlowSeries | None
    first_step: FirstStepInWall
    max_step: Float[jax.Array, "..."]
    jet_bound: Float[jax.Array, "..."]
    jet_bound_slope: Float[jax.Array, "..."]
    drive_term_series: tuple[flow.FlowSeries, ...] = ()


class LaneCoefficients(NamedTuple):
    """Coefficients of `flight_coefficients.FlowCoefficients` that differ between lanes inside and outside walls.

    Attributes
    ----------
    damping : array
        Damping ratio gamma outside walls, damping gamma2 inside a wall.
    in_phase_amplitude : array
        Amplitude of the in-phase part of the motion, 0 inside a wall.
    stiffness : array
        Stiffness, 1 outside walls.
    root_stiffness : array
        Square root of the stiffness.
    max_step : array
        Longest step.
    inverse_max_step : array
        Reciprocal of `max_step`.
    jet_bound : array
        Constant part of the bound on the eighth derivative.
    jet_bound_slope : array
        Factor of the sixth and seventh derivative in this bound.
    """

    damping: Float[jax.Array, "..."]
    in_phase_amplitude: Float[jax.Array, "..."]
    stiffness: Float[jax.Array, "..."]
    root_stiffness: Float[jax.Array, "..."]
    max_step: Float[jax.Array, "..."]
    inverse_max_step: Float[jax.Array, "..."]
    jet_bound: Float[jax.Array, "..."]
    jet_bound_slope: Float[jax.Array, "..."]


def soft_wall_flow(wall, amplitude, frequency, drive_terms=()):
    """Return the `SoftWallFlow` of a wall, None for a rigid wall and for a wall with a user-defined law."""
    if wall.stiffness is None:
        return None
    stiffness, damping = 1.0 + wall.stiffness, wall.damping
    root_stiffness = jnp.sqrt(stiffness)
    max_angular_rate, wall_motion_series = flow.max_angular_rate(frequency, damping, stiffness), None
    force_deriv_bound = further_drive_terms.drive_derivative_bound(drive_terms, amplitude, frequency, 6)
    if drive_terms:
        max_angular_rate = jnp.maximum(
            max_angular_rate, frequency * float(further_drive_terms.highest_harmonic(drive_terms))
        )
    if wall.amplitude is not None:
        wall_frequency = frequency * float(wall.harmonic)
        max_angular_rate = jnp.maximum(max_angular_rate, wall_frequency)
        wall_motion_series = flow.flow_series(wall_frequency, damping, stiffness)
        force_deriv_bound = force_deriv_bound + abs(wall.amplitude) * wall_frequency**6 * (
            1.0 + 2.0 * damping * wall_frequency + wall_frequency * wall_frequency
        )
    max_step = flow.MAX_SCALED_STEP / max_angular_rate
    # energy of y^(6), as for x in `flight_coefficients.make_flow_coefficients`: y^(7)^2 + (1 + k2) y^(6)^2
    jet_bound_slope = jnp.sqrt(stiffness + 4.0 * damping * damping)
    series = flow.flow_series(frequency, damping, stiffness)
    drive_term_series = tuple(
        flow.flow_series(further_drive_terms.term_angular_rate(term, frequency), damping, stiffness)
        for term in drive_terms
    )
    first_step = make_first_step_in_wall(
        wall,
        amplitude,
        frequency,
        series,
        wall_motion_series,
        stiffness,
        list(zip(drive_terms, drive_term_series, strict=True)),
    )
    return SoftWallFlow(
        stiffness,
        root_stiffness,
        damping,
        series,
        wall_motion_series,
        first_step,
        max_step,
        force_deriv_bound * (1.0 + jet_bound_slope * max_step),
        jet_bound_slope,
        drive_term_series,
    )


def is_inside_soft_wall(contact):
    """Return the lanes inside a soft wall.

    Parameters
    ----------
    contact : array
        Contact code times the sign of the wall.

    Returns
    -------
    array of bool
        True inside a soft wall.
    """
    contact_code = lax.abs(contact)
    return (contact_code == Contact.WITHIN) | (contact_code == Contact.ENTERED)


def is_soft_side(coeffs, side):
    """Return the lanes whose wall on a side is soft.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    side : array
        Side of the wall: -1, 1, or 0 for none.

    Returns
    -------
    array of bool
        True if the wall is soft. False for none.
    """
    is_soft = side != side
    for wall, soft_flow in zip(coeffs.walls, coeffs.soft_flows, strict=True):
        if soft_flow is not None:
            is_soft |= side == float(wall.sign)
    return is_soft


def restitution_of(coeffs, side):
    """Return the restitution of the wall on a side.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    side : array
        Side of the wall, -1 or 1.

    Returns
    -------
    array
        Restitution. -1 for a soft wall, which does not change the velocity.
    """
    restitutions = [
        lax.full_like(wall.position, -1.0) if wall.restitution is None else wall.restitution for wall in coeffs.walls
    ]
    return select_by_side(side, coeffs.walls, restitutions)


def lane_coefficients(coeffs, contact):
    """Compute the coefficients that differ between lanes.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    contact : array
        Contact code times the sign of the wall.

    Returns
    -------
    LaneCoefficients
        Coefficients of each lane. Inside a wall the motion has no in-phase part.
    """
    soft_flows = [soft_flow for soft_flow in coeffs.soft_flows if soft_flow is not None]
    is_inside_wall = is_inside_soft_wall(contact)

    def select_field(field_name, value_outside):
        return choose(
            is_inside_wall,
            _select_by_soft_wall(contact, [getattr(soft_flow, field_name) for soft_flow in soft_flows]),
            value_outside,
        )

    max_step = select_field("max_step", coeffs.max_step)
    return LaneCoefficients(
        damping=select_field("damping", coeffs.damping),
        in_phase_amplitude=choose(is_inside_wall, 0.0, coeffs.in_phase_amplitude),
        stiffness=select_field("stiffness", 1.0),
        root_stiffness=select_field("root_stiffness", 1.0),
        max_step=max_step,
        inverse_max_step=1.0 / max_step,
        jet_bound=select_field("jet_bound", coeffs.jet_bound),
        jet_bound_slope=select_field("jet_bound_slope", coeffs.jet_bound_slope),
    )


def coeffs_by_lane(coeffs, contact):
    """Return the coefficients of the scene for each lane.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    contact : array
        Contact code times the sign of the wall.

    Returns
    -------
    FlowCoefficients
        Coefficients with the `LaneCoefficients` of each lane.
    """
    return coeffs._replace(**lane_coefficients(coeffs, contact)._asdict())


def _select_by_soft_wall(contact, values_by_wall):
    """Select the value of the soft wall of each lane from the values of all soft walls, left first."""
    return values_by_wall[0] if len(values_by_wall) == 1 else choose(contact < 0, *values_by_wall)


def has_moving_soft_wall(coeffs):
    """Return True if a soft wall moves."""
    return any(soft_flow is not None and soft_flow.wall_motion_series is not None for soft_flow in coeffs.soft_flows)


def lane_propagator(coeffs, contact, time):
    """Return the `flow.Propagator` of each lane."""
    return flow.step_propagator(_flow_series_by_lane(coeffs, contact), coeffs.frequency, time)


def has_harmonic_forces(coeffs):
    """Return True if the list of `harmonic_forces` is not empty."""
    return bool(coeffs.drive_terms) or has_moving_soft_wall(coeffs)


def harmonic_responses(coeffs, contact, time):
    """Return [(cos_response, sin_response)] of each lane for each of its `harmonic_forces`."""
    responses = [flow.drive_responses(series, time) for series in _term_series_by_lane(coeffs, contact)]
    if has_moving_soft_wall(coeffs):
        responses.append(
            flow.drive_responses(
                _wall_series_by_lane(coeffs, contact), choose(_is_in_moving_wall(coeffs, contact), time, 0.0)
            )
        )
    return responses


def harmonic_forces(coeffs, contact, cosine, sine):
    """Return the harmonic forces on lanes as a list of (force_cos, force_sin, angular rate).

    The forces are the further drive terms and, if a soft wall moves, the force due to the motion of the wall of each
    lane. `cosine` and `sine` belong to t = 0. At the time t a force is force_cos cos(rate t) - force_sin sin(rate t).
    """
    drive_term_forces = further_drive_terms.term_forces(coeffs.drive_terms, coeffs.frequency, cosine, sine)
    wall_forces = [wall_motion_force(coeffs, contact, cosine, sine)] if has_moving_soft_wall(coeffs) else []
    return [*drive_term_forces, *wall_forces]


def _is_in_moving_wall(coeffs, contact):
    """Return the lanes inside a moving wall."""
    is_in_moving_wall = contact != contact
    for wall, soft_flow in zip(coeffs.walls, coeffs.soft_flows, strict=True):
        if soft_flow is not None and soft_flow.wall_motion_series is not None:
            is_in_moving_wall |= is_inside_soft_wall(contact) & (contact * wall.sign > 0)
    return is_in_moving_wall


def _flow_series_by_lane(coeffs, contact):
    """Return the `flow.FlowSeries` of each lane as lists of rows."""
    return _select_series(
        contact, coeffs.series, [soft_flow.series for soft_flow in coeffs.soft_flows if soft_flow is not None]
    )


def _term_series_by_lane(coeffs, contact):
    """Return the `flow.FlowSeries` of each lane under each further drive term."""
    term_series = zip(
        *(soft_flow.drive_term_series for soft_flow in coeffs.soft_flows if soft_flow is not None), strict=True
    )
    return [
        _select_series(contact, term.series, wall_series)
        for term, wall_series in zip(coeffs.drive_terms, term_series, strict=True)
    ]


def _select_series(contact, series_outside, series_by_wall):
    """Select the `flow.FlowSeries` of each lane from those outside and inside the soft walls."""
    is_inside_wall = is_inside_soft_wall(contact)

    def select_rows(rows_outside, *rows_by_wall):
        row_indices = range(rows_outside.shape[0])
        return [
            choose(is_inside_wall, _select_by_soft_wall(contact, [rows[k] for rows in rows_by_wall]), rows_outside[k])
            for k in row_indices
        ]

    return flow.FlowSeries(*map(select_rows, series_outside, *series_by_wall))


def _wall_series_by_lane(coeffs, contact):
    """Return the `flow.FlowSeries` of each lane under the motion of its wall."""

    def select_rows(*rows_by_wall):
        return [
            _select_by_soft_wall(contact, [rows[k] for rows in rows_by_wall]) for k in range(rows_by_wall[0].shape[0])
        ]

    series_by_wall = [
        soft_flow.wall_motion_series
        for soft_flow in coeffs.soft_flows
        if soft_flow is not None and soft_flow.wall_motion_series is not None
    ]
    return flow.FlowSeries(*map(select_rows, *series_by_wall))


def frame_force_derivs(coeffs, contact, cosine, sine, order):
    """Compute the force on y due to the position and motion of the wall, and its time derivatives.

    The force is - x_b - 2 gamma2 x_b' - x_b'', in addition to the drive.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    contact : array
        Contact code times the sign of the wall.
    cosine : array
        Cosine of the drive angle.
    sine : array
        Sine of the drive angle.
    order : int
        Order of the last derivative.

    Returns
    -------
    list of array or None
        Force and its derivatives, 0 in lanes outside. None stands for zero in all lanes.
    """
    is_inside_wall = is_inside_soft_wall(contact)
    soft_walls = [
        wall for wall, soft_flow in zip(coeffs.walls, coeffs.soft_flows, strict=True) if soft_flow is not None
    ]
    force_derivs = []
    for values_by_wall in zip(
        *(_wall_frame_force_derivs(wall, coeffs.frequency, cosine, sine, order) for wall in soft_walls), strict=True
    ):
        is_zero = all(wall_value is None for wall_value in values_by_wall)
        values_by_wall = [
            0.0 * cosine if wall_value is None else wall_value + 0.0 * cosine for wall_value in values_by_wall
        ]
        force_derivs.append(
            None if is_zero else choose(is_inside_wall, _select_by_soft_wall(contact, values_by_wall), 0.0)
        )
    return force_derivs


def _wall_frame_force_derivs(wall, frequency, cosine, sine, order):
    """Return the `frame_force_derivs` of one wall."""
    wall_derivs = wall_jet(wall, frequency, cosine, sine, order + 2)
    force_derivs = []
    for k in range(order + 1):
        drag_term = None if wall_derivs[k + 1] is None else 2.0 * wall.damping * wall_derivs[k + 1]
        force_derivs.append(
            None
            if wall_derivs[k] is None
            else subtract_optional(subtract_optional(-wall_derivs[k], drag_term), wall_derivs[k + 2])
        )
    return force_derivs


def extra_increments(coeffs, contact, motion, propagator, harmonic_responses):
    """Return the increments of y and y' over a flight due to the further drive terms and `frame_force_derivs`.

    `harmonic_responses` is the result of the function of this name.
    """
    dx, dv = mean_position_increments(coeffs, contact, motion.cosine, propagator.p00_minus_1, propagator.p01)
    if harmonic_responses:
        forces = harmonic_forces(coeffs, contact, motion.cosine, motion.sine)
        for (force_cos, force_sin, angular_rate), (cos_response, sin_response) in zip(
            forces, harmonic_responses, strict=True
        ):
            dx = dx + (force_cos * cos_response - force_sin * sin_response)
            dv = dv + (
                force_cos * (propagator.p01 - angular_rate * sin_response) - force_sin * (angular_rate * cos_response)
            )
    return dx, dv


def mean_position_increments(coeffs, contact, template, p00_minus_1, p01):
    """Return the increments of y and y' due to the mean position of the wall."""
    soft_walls = [
        wall_and_flow
        for wall_and_flow in zip(coeffs.walls, coeffs.soft_flows, strict=True)
        if wall_and_flow[1] is not None
    ]
    mean_position = choose(
        is_inside_soft_wall(contact),
        _select_by_soft_wall(contact, [wall.position + 0.0 * template for wall, _ in soft_walls]),
        0.0,
    )
    return mean_position * p00_minus_1 / _select_by_soft_wall(
        contact, [soft_flow.stiffness for _, soft_flow in soft_walls]
    ), -mean_position * p01


def wall_motion_force(coeffs, contact, cosine, sine):
    """Return (force_cos, force_sin, angular rate) of the force due to the wall's motion, see `harmonic_forces`."""
    walls_and_flows = zip(coeffs.walls, coeffs.soft_flows, strict=True)
    moving_walls = [
        wall
        for wall, soft_flow in walls_and_flows
        if soft_flow is not None and soft_flow.wall_motion_series is not None
    ]
    force_cos, force_sin, angular_rate = (
        _select_by_soft_wall(contact, list(values))
        for values in zip(
            *(_wall_motion_force(wall, coeffs.frequency, cosine, sine) for wall in moving_walls), strict=True
        )
    )
    is_in_moving_wall = _is_in_moving_wall(coeffs, contact)
    return choose(is_in_moving_wall, force_cos, 0.0), choose(is_in_moving_wall, force_sin, 0.0), angular_rate


def _wall_motion_force(wall, frequency, cosine, sine):
    """Return the `wall_motion_force` of one wall, whose total force is - x_b - 2 gamma2 x_b' - x_b''."""
    angular_rate = frequency * float(wall.harmonic)
    wall_displacement, wall_velocity = wall_jet(wall, frequency, cosine, sine, 1)
    # amplitude times cosine and sine of the wall's angle
    wall_displacement, wall_quadrature = (
        wall_displacement - wall.position,
        -wall_velocity / angular_rate,
    )
    in_phase_gain, quadrature_gain = angular_rate * angular_rate - 1.0, 2.0 * wall.damping * angular_rate
    return (
        in_phase_gain * wall_displacement + quadrature_gain * wall_quadrature,
        in_phase_gain * wall_quadrature - quadrature_gain * wall_displacement,
        angular_rate + 0.0 * cosine,
    )


class ContactResponse(NamedTuple):
    """Response of the motion inside a soft wall over a given duration.

    Attributes
    ----------
    free_flow : tuple of array
        Matrix of the free flow, see `flow.doubling_responses`.
    forced_flow : tuple
        Motion under the first drive term.
    harmonic_flows : tuple
        Motion under each of the `harmonic_forces`.
    """

    free_flow: flow.FreeFlow
    forced_flow: flow.ForcedFlow
    harmonic_flows: tuple[flow.ForcedFlow, ...]


def contact_response(coeffs, contact, time):
    """Compute the response of each lane over a contact phase.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of each lane, see `coeffs_by_lane`.
    contact : array
        Contact code times the sign of the wall.
    time : array
        Duration, at least 0, in units of t.

    Returns
    -------
    ContactResponse
        Response of each lane.
    """
    flow_arguments = coeffs.damping, time, coeffs.stiffness
    free_flow, forced_flow, _ = flow.doubling_responses(
        _flow_series_by_lane(coeffs, contact), coeffs.frequency, *flow_arguments
    )
    harmonic_flows = []
    for term, series in zip(coeffs.drive_terms, _term_series_by_lane(coeffs, contact), strict=True):
        harmonic_flows.append(
            flow.doubling_responses(
                series, further_drive_terms.term_angular_rate(term, coeffs.frequency), *flow_arguments
            )[1]
        )
    if has_moving_soft_wall(coeffs):
        *_, angular_rate = wall_motion_force(coeffs, contact, 0.0 * time, 0.0 * time)
        time_in_moving_wall = choose(_is_in_moving_wall(coeffs, contact), time, 0.0)
        harmonic_flows.append(
            flow.doubling_responses(
                _wall_series_by_lane(coeffs, contact),
                angular_rate,
                coeffs.damping,
                time_in_moving_wall,
                coeffs.stiffness,
            )[1]
        )
    return ContactResponse(free_flow, forced_flow, tuple(harmonic_flows))


def apply_response(coeffs, contact, contact_response, start_state, cosine, sine):
    """Compute the state after a contact phase from its response.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of each lane, see `coeffs_by_lane`.
    contact : array
        Contact code times the sign of the wall.
    contact_response : ContactResponse
        Response over the phase.
    start_state : tuple of array
        Initial y and y'.
    cosine : array
        Cosine of the drive angle at the start.
    sine : array
        Sine of the drive angle at the start.

    Returns
    -------
    y : array
        Displacement past the wall.
    v : array
        Velocity relative to the wall.
    """
    free_flow, forced_flow, harmonic_flows = contact_response
    force = coeffs.amplitude * cosine, coeffs.amplitude * sine
    displacement, velocity = flow.apply_responses((free_flow, forced_flow), *force, *start_state, coeffs.stiffness)
    displacement_change, velocity_change = mean_position_increments(
        coeffs, contact, cosine, free_flow[0] - 1.0, free_flow[1]
    )
    displacement, velocity = displacement + displacement_change, velocity + velocity_change
    if harmonic_flows:
        for (force_cos, force_sin, _), forced_flow in zip(
            harmonic_forces(coeffs, contact, cosine, sine), harmonic_flows, strict=True
        ):
            displacement_change, velocity_change = flow.apply_responses(
                (free_flow, forced_flow), force_cos, force_sin, 0.0 * displacement, 0.0 * velocity, coeffs.stiffness
            )
            displacement, velocity = displacement + displacement_change, velocity + velocity_change
    return displacement, velocity


def first_steps_by_lane(coeffs, contact):
    """Return the `FirstStepInWall` of each lane."""
    first_steps = [soft_flow.first_step for soft_flow in coeffs.soft_flows if soft_flow is not None]
    wall_motion_responses = [
        first_step.wall_motion_response for first_step in first_steps if first_step.wall_motion_response is not None
    ]
    first_steps = [
        first_step._replace(wall_motion_response=first_step.wall_motion_response or wall_motion_responses[0])
        if wall_motion_responses
        else first_step
        for first_step in first_steps
    ]
    return jax.tree.map(lambda *leaves: _select_by_soft_wall(contact, list(leaves)), *first_steps)


def displacement_per_time(coeffs, contact, entry_velocity, cosine, sine, time):
    """Compute y / time after an entry into a wall.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of each lane, see `coeffs_by_lane`.
    contact : array
        Contact code times the sign of the wall.
    entry_velocity : array
        Velocity of entry relative to the wall.
    cosine : array
        Cosine of the drive angle at the entry.
    sine : array
        Sine of the drive angle at the entry.
    time : array
        Time since the entry, at most one step.

    Returns
    -------
    array
        Quotient of the displacement past the wall and the time.
    """
    series = _flow_series_by_lane(coeffs, contact)
    p00_value, p01_value, cos_value, sin_value = (flow.horner(rows, time) for rows in series)
    force = coeffs.amplitude * cosine, coeffs.amplitude * sine
    mean_position_part, _ = mean_position_increments(coeffs, contact, cosine, p00_value * time, 0.0 * time)
    forced_part = time * (force[0] * cos_value - force[1] * (time * sin_value))
    quotient = entry_velocity * p01_value + forced_part + mean_position_part
    forces = further_drive_terms.term_forces(coeffs.drive_terms, coeffs.frequency, cosine, sine)
    for (force_cos, force_sin, _), rows in zip(forces, _term_series_by_lane(coeffs, contact), strict=True):
        cos_value, sin_value = (flow.horner(coefficients, time) for coefficients in rows[2:])
        quotient = quotient + time * (force_cos * cos_value - force_sin * (time * sin_value))
    if has_moving_soft_wall(coeffs):
        force_cos, force_sin, _ = wall_motion_force(coeffs, contact, cosine, sine)
        time_in_moving_wall = choose(_is_in_moving_wall(coeffs, contact), time, 0.0)
        _, _, cos_value, sin_value = (
            flow.horner(rows, time_in_moving_wall) for rows in _wall_series_by_lane(coeffs, contact)
        )
        quotient = quotient + time * (force_cos * cos_value - force_sin * (time * sin_value))
    return quotient


def velocity_after_entry(coeffs, contact, entry_velocity, cosine, sine, time):
    """Compute y' after an entry into a wall.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of each lane, see `coeffs_by_lane`.
    contact : array
        Contact code times the sign of the wall.
    entry_velocity : array
        Velocity of entry relative to the wall.
    cosine : array
        Cosine of the drive angle at the entry.
    sine : array
        Sine of the drive angle at the entry.
    time : array
        Time since the entry, at most one step.

    Returns
    -------
    array
        Velocity relative to the wall.
    """
    p00_minus_1, p01, cos_response, sin_response, _, _ = flow.step_propagator(
        _flow_series_by_lane(coeffs, contact), coeffs.frequency, time
    )
    forced_velocity = coeffs.amplitude * cosine * (p01 - coeffs.frequency * sin_response) - coeffs.amplitude * sine * (
        coeffs.frequency * cos_response
    )
    _, mean_position_part = mean_position_increments(coeffs, contact, cosine, p00_minus_1, p01)
    velocity = (1.0 + p00_minus_1 - 2.0 * coeffs.damping * p01) * entry_velocity + forced_velocity + mean_position_part
    if has_harmonic_forces(coeffs):
        forces = harmonic_forces(coeffs, contact, cosine, sine)
        for (force_cos, force_sin, angular_rate), (cos_response, sin_response) in zip(
            forces, harmonic_responses(coeffs, contact, time), strict=True
        ):
            velocity = (
                velocity + force_cos * (p01 - angular_rate * sin_response) - force_sin * (angular_rate * cos_response)
            )
    return velocity

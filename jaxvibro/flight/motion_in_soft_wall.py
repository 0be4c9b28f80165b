"""Model the motion inside a soft wall with spring and damper (paper, (39)).

The mass is then another oscillator in y = x - x_b, the displacement past the wall:

    y'' + 2 gamma2 y' + (1 + k2) y = A cos(theta) - x_b - 2 gamma2 x_b' - x_b''

The right-hand side is the contact force on a mass that sticks to the wall. The displacement y is accurate at any
stiffness, because x is measured from the wall. A lane is inside a wall from the step that ends at the entry to the step
that ends at the exit.
"""

from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import choose
from ..scene.state import Contact
from . import flow, further_drive_terms
from .soft_wall_first_step import FirstStepInWall, make_first_step_in_wall
from .wall_motion import select_by_side, subtract_wall_motion, wall_derivative_bounds, wall_jet


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
    first_step : FirstStepInWall
        First step after an entry.
    max_step : array
        Longest of the steps after the first.
    jet_bound : array
        Constant part of the bound on ``|y^(8)|``, as in `flight_coefficients.FlowCoefficients`.
    jet_bound_slope : array
        Factor of ``|y^(6)|`` and ``|y^(7)|`` in this bound, as in `flight_coefficients.FlowCoefficients`.
    harmonic_series : tuple of FlowSeries
        Series of the flow under each of the `harmonic_forces`.
    """

    stiffness: Float[jax.Array, "..."]
    root_stiffness: Float[jax.Array, "..."]
    damping: Float[jax.Array, "..."]
    series: flow.FlowSeries
    first_step: FirstStepInWall
    max_step: Float[jax.Array, "..."]
    jet_bound: Float[jax.Array, "..."]
    jet_bound_slope: Float[jax.Array, "..."]
    harmonic_series: tuple[flow.FlowSeries, ...]


# fields of `flight_coefficients.FlowCoefficients` that differ between lanes outside walls and inside each wall
LANE_FIELDS = "damping", "stiffness", "root_stiffness", "max_step", "jet_bound", "jet_bound_slope"


def soft_wall_flow(wall, amplitude, frequency, drive_terms, is_any_soft_wall_moving):
    """Return the `SoftWallFlow` of a soft wall.

    `is_any_soft_wall_moving` is True if a soft wall of the scene moves. Then the motion of each soft wall counts as
    one of the `harmonic_forces`, also that of a fixed wall.
    """
    stiffness, damping = 1.0 + wall.stiffness, wall.damping
    harmonics = [term.harmonic for term in drive_terms] + ([wall.harmonic] if is_any_soft_wall_moving else [])
    rates = [frequency * float(harmonic) for harmonic in harmonics]
    max_step = flow.MAX_SCALED_STEP / reduce(jnp.maximum, rates, flow.max_angular_rate(frequency, damping, stiffness))
    force_deriv_bound, _ = wall_derivative_bounds(wall, amplitude, frequency, damping, 6, drive_terms)
    # energy of y^(6), as for x in `linear_flow.make_coefficients`: y^(7)^2 + (1 + k2) y^(6)^2
    jet_bound_slope = jnp.sqrt(stiffness + 4.0 * damping * damping)
    series, *harmonic_series = (flow.flow_series(rate, damping, stiffness) for rate in (frequency, *rates))
    first_step = make_first_step_in_wall(
        wall, amplitude, frequency, drive_terms, stiffness, series, list(zip(harmonic_series, rates, strict=True))
    )
    return SoftWallFlow(
        stiffness,
        jnp.sqrt(stiffness),
        damping,
        series,
        first_step,
        max_step,
        force_deriv_bound * (1.0 + jet_bound_slope * max_step),
        jet_bound_slope,
        tuple(harmonic_series),
    )


def soft_walls(coeffs):
    """Return [(wall, its entry of `FlowCoefficients.soft_flows`)] of the soft walls, left first."""
    walls_and_flows = zip(coeffs.walls, coeffs.soft_flows, strict=True)
    return [(wall, soft_flow) for wall, soft_flow in walls_and_flows if soft_flow is not None]


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
    for wall, _ in soft_walls(coeffs):
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
    dict of str to array
        Fields of `flight_coefficients.FlowCoefficients`. Inside a wall the motion has no in-phase part.
    """
    is_inside_wall, outside = is_inside_soft_wall(contact), coeffs._replace(stiffness=1.0, root_stiffness=1.0)
    fields = {
        name: choose(
            is_inside_wall,
            _value_in_wall(coeffs, contact, lambda _, soft_flow, name=name: getattr(soft_flow, name)),
            value,
        )
        for name, value in outside._asdict().items()
        if name in LANE_FIELDS
    }
    in_phase_amplitude = choose(is_inside_wall, 0.0, coeffs.in_phase_amplitude)
    return fields | {"in_phase_amplitude": in_phase_amplitude, "inverse_max_step": 1.0 / fields["max_step"]}


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
        Coefficients with the `lane_coefficients` of each lane.
    """
    return coeffs._replace(**lane_coefficients(coeffs, contact))


def _value_in_wall(coeffs, contact, value):
    """Return value(wall, soft flow) for the soft wall of each lane; arbitrary outside walls."""
    values_by_wall = [value(*wall_and_flow) for wall_and_flow in soft_walls(coeffs)]
    return jax.tree.map(lambda *leaves: _select_by_wall(contact, leaves), *values_by_wall)


def _select_by_wall(contact, values_by_wall):
    """Select the value of the soft wall of each lane from the values of all soft walls, left first."""
    return values_by_wall[0] if len(values_by_wall) == 1 else choose(contact < 0, *values_by_wall)


def has_moving_soft_wall(coeffs):
    """Return True if a soft wall moves."""
    return any(wall.amplitude is not None for wall, _ in soft_walls(coeffs))


def lane_propagator(coeffs, contact, time):
    """Return the `flow.Propagator` of each lane."""
    return flow.step_propagator(_flow_series_by_lane(coeffs, contact), coeffs.frequency, time)


def harmonic_responses(coeffs, contact, time):
    """Return [(cos_response, sin_response)] of each lane for each of its `harmonic_forces`."""
    return [flow.drive_responses(*series_and_time) for series_and_time in _harmonic_series(coeffs, contact, time)]


def harmonic_forces(coeffs, contact, cosine, sine):
    """Return the harmonic forces on lanes as a list of (force_cos, force_sin, angular rate).

    The forces are the further drive terms and, if a soft wall moves, the force due to the motion of the wall of each
    lane. `cosine` and `sine` belong to t = 0. At the time t a force is force_cos cos(rate t) - force_sin sin(rate t).
    """
    forces = further_drive_terms.term_forces(coeffs.drive_terms, coeffs.frequency, cosine, sine)
    if has_moving_soft_wall(coeffs):
        force_cos, force_sin, angular_rate = _value_in_wall(
            coeffs, contact, lambda wall, _: _wall_motion_force(wall, coeffs.frequency, cosine, sine)
        )
        is_inside_wall = is_inside_soft_wall(contact)
        forces.append((choose(is_inside_wall, force_cos, 0.0), choose(is_inside_wall, force_sin, 0.0), angular_rate))
    return forces


def _flow_series_by_lane(coeffs, contact):
    """Return the `flow.FlowSeries` of each lane as lists of rows."""
    series_by_wall = [soft_flow.series for _, soft_flow in soft_walls(coeffs)]
    return _select_outside(contact, _select_series(contact, series_by_wall), coeffs.series)


def _harmonic_series(coeffs, contact, time):
    """Return [(`flow.FlowSeries` of each lane, time)] for each of the `harmonic_forces`.

    The time is 0 outside walls for the motion of a wall, because the series of a wall are valid within its steps only.
    """
    series_by_wall = zip(*(soft_flow.harmonic_series for _, soft_flow in soft_walls(coeffs)), strict=True)
    series_inside = [_select_series(contact, series) for series in series_by_wall]
    series_and_times = [
        (_select_outside(contact, series, term.series), time)
        for term, series in zip(coeffs.drive_terms, series_inside, strict=False)
    ]
    time_inside = choose(is_inside_soft_wall(contact), time, 0.0)
    return series_and_times + [(series, time_inside) for series in series_inside[len(coeffs.drive_terms) :]]


def _select_series(contact, series_by_wall):
    """Select the `flow.FlowSeries` of the soft wall of each lane as lists of rows."""

    def select_rows(*rows_by_wall):
        n_rows = rows_by_wall[0].shape[0]
        return [_select_by_wall(contact, [rows[k] for rows in rows_by_wall]) for k in range(n_rows)]

    return flow.FlowSeries(*map(select_rows, *series_by_wall))


def _select_outside(contact, series_inside, series_outside):
    """Return the `flow.FlowSeries` of each lane from those inside and outside the soft walls."""
    is_inside_wall = is_inside_soft_wall(contact)

    def select_rows(rows_inside, rows_outside):
        return [choose(is_inside_wall, row, rows_outside[k]) for k, row in enumerate(rows_inside)]

    return flow.FlowSeries(*map(select_rows, series_inside, series_outside))


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
    force_derivs = []
    for values_by_wall in zip(
        *(
            subtract_wall_motion([None] * (order + 1), wall, coeffs.frequency, wall.damping, cosine, sine)
            for wall, _ in soft_walls(coeffs)
        ),
        strict=True,
    ):
        is_zero = all(wall_value is None for wall_value in values_by_wall)
        values_by_wall = [
            0.0 * cosine if wall_value is None else wall_value + 0.0 * cosine for wall_value in values_by_wall
        ]
        force_derivs.append(None if is_zero else choose(is_inside_wall, _select_by_wall(contact, values_by_wall), 0.0))
    return force_derivs


def extra_increments(coeffs, contact, motion, propagator, harmonic_responses):
    """Return the increments of y and y' over a flight due to the further drive terms and `frame_force_derivs`.

    `harmonic_responses` is the result of the function of this name.
    """
    increments = mean_position_increments(coeffs, contact, motion.cosine, propagator.p00_minus_1, propagator.p01)
    forces = harmonic_forces(coeffs, contact, motion.cosine, motion.sine)
    return further_drive_terms.add_force_increments(*increments, forces, propagator.p01, harmonic_responses)


def mean_position_increments(coeffs, contact, template, p00_minus_1, p01):
    """Return the increments of y and y' due to the mean position of the wall."""
    position, stiffness = _value_in_wall(
        coeffs, contact, lambda wall, soft_flow: (wall.position + 0.0 * template, soft_flow.stiffness)
    )
    mean_position = choose(is_inside_soft_wall(contact), position, 0.0)
    return mean_position * p00_minus_1 / stiffness, -mean_position * p01


def _wall_motion_force(wall, frequency, cosine, sine):
    """Return the harmonic force due to the motion of a wall, whose total force is - x_b - 2 gamma2 x_b' - x_b''."""
    angular_rate = frequency * float(wall.harmonic)
    if wall.amplitude is None:
        return 0.0 * cosine, 0.0 * cosine, angular_rate + 0.0 * cosine
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
    rates = [angular_rate for *_, angular_rate in harmonic_forces(coeffs, contact, 0.0 * time, 0.0 * time)]
    series_and_times = [(_flow_series_by_lane(coeffs, contact), time), *_harmonic_series(coeffs, contact, time)]
    responses = [
        flow.doubling_responses(series, rate, coeffs.damping, series_time, coeffs.stiffness)
        for (series, series_time), rate in zip(series_and_times, (coeffs.frequency, *rates), strict=True)
    ]
    return ContactResponse(*responses[0][:2], tuple(forced_flow for _, forced_flow, _ in responses[1:]))


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
    changes = [mean_position_increments(coeffs, contact, cosine, free_flow[0] - 1.0, free_flow[1])]
    forces = harmonic_forces(coeffs, contact, cosine, sine)
    for (force_cos, force_sin, _), flow_of_force in zip(forces, harmonic_flows, strict=True):
        start_at_rest = force_cos, force_sin, 0.0 * displacement, 0.0 * velocity
        changes.append(flow.apply_responses((free_flow, flow_of_force), *start_at_rest, coeffs.stiffness))
    for displacement_change, velocity_change in changes:
        displacement, velocity = displacement + displacement_change, velocity + velocity_change
    return displacement, velocity


def first_steps_by_lane(coeffs, contact):
    """Return the `FirstStepInWall` of each lane."""
    return _value_in_wall(coeffs, contact, lambda _, soft_flow: soft_flow.first_step)


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
    forces = harmonic_forces(coeffs, contact, cosine, sine)
    series_and_times = _harmonic_series(coeffs, contact, time)
    for (force_cos, force_sin, _), (series, series_time) in zip(forces, series_and_times, strict=True):
        cos_value, sin_value = (flow.horner(rows, series_time) for rows in series[2:])
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
    p00_minus_1, p01, cos_response, sin_response, _, _ = lane_propagator(coeffs, contact, time)
    forced_velocity = coeffs.amplitude * cosine * (p01 - coeffs.frequency * sin_response) - coeffs.amplitude * sine * (
        coeffs.frequency * cos_response
    )
    _, mean_position_part = mean_position_increments(coeffs, contact, cosine, p00_minus_1, p01)
    velocity = (1.0 + p00_minus_1 - 2.0 * coeffs.damping * p01) * entry_velocity + forced_velocity + mean_position_part
    forces = harmonic_forces(coeffs, contact, cosine, sine)
    responses = harmonic_responses(coeffs, contact, time)
    for (force_cos, force_sin, angular_rate), (cos_response, sin_response) in zip(forces, responses, strict=True):
        velocity = (
            velocity + force_cos * (p01 - angular_rate * sin_response) - force_sin * (angular_rate * cos_response)
        )
    return velocity

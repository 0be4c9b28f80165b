"""Model the motion inside a soft wall (paper, (39)).

The mass is then another oscillator in y = x - x_b, the displacement past the wall:

    y'' + 2 gamma2 y' + (1 + k2) y = A cos(theta) - x_b - 2 gamma2 x_b' - x_b''

The right-hand side is the contact force on a mass that sticks to the wall. Relative to the wall, y keeps its digits at
any stiffness of the wall. A lane is inside a wall from the step that reaches the wall to the step that returns to it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from ..scene.codes import Contact
from . import drive, flow
from .soft_entry_step import EntryStep, entry_step
from .wall_motion import select_by_side, subtract, wall_jet


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
    wall_series : FlowSeries or None
        Series of the flow under the motion of the wall. None for a fixed wall.
    entry_step : EntryStep
        First step after an entry.
    max_step : array
        Longest of the other steps.
    jet_bound : array
        Constant part of the bound on ``|y^(8)|``, as in `coefficients.FlowCoefficients`.
    jet_bound_slope : array
        Slope of that bound.
    term_series : tuple of FlowSeries
        Series of the flow under each further drive term.
    """

    stiffness: Float[jax.Array, "..."]
    root_stiffness: Float[jax.Array, "..."]
    damping: Float[jax.Array, "..."]
    series: flow.FlowSeries
    wall_series: flow.FlowSeries | None
    entry_step: EntryStep
    max_step: Float[jax.Array, "..."]
    jet_bound: Float[jax.Array, "..."]
    jet_bound_slope: Float[jax.Array, "..."]
    term_series: tuple[flow.FlowSeries, ...] = ()


class LaneCoefficients(NamedTuple):
    """Coefficients of `coefficients.FlowCoefficients` that differ between lanes inside and outside soft walls."""

    damping: Float[jax.Array, "..."]
    swift_amplitude: Float[jax.Array, "..."]
    stiffness: Float[jax.Array, "..."]
    root_stiffness: Float[jax.Array, "..."]
    max_step: Float[jax.Array, "..."]
    inverse_max_step: Float[jax.Array, "..."]
    jet_bound: Float[jax.Array, "..."]
    jet_bound_slope: Float[jax.Array, "..."]


def soft_wall_flow(wall, amplitude, frequency, drive_terms=()):
    """Return the `SoftWallFlow` of a wall, None for a rigid wall or a wall law."""
    if wall.stiffness is None:
        return None
    stiffness, damping = 1.0 + wall.stiffness, wall.damping
    root_stiffness = jnp.sqrt(stiffness)
    max_rate, wall_series = flow.max_rate(frequency, damping, stiffness), None
    force_bound = drive.total_derivative_bound(drive_terms, amplitude, frequency, 6)
    if drive_terms:
        max_rate = jnp.maximum(max_rate, frequency * float(drive.highest_harmonic(drive_terms)))
    if wall.amplitude is not None:
        wall_frequency = frequency * float(wall.harmonic)
        max_rate = jnp.maximum(max_rate, wall_frequency)
        wall_series = flow.flow_series(wall_frequency, damping, stiffness)
        force_bound = force_bound + abs(wall.amplitude) * wall_frequency**6 * (
            1.0 + 2.0 * damping * wall_frequency + wall_frequency * wall_frequency
        )
    max_step = flow.MAX_SCALED_STEP / max_rate
    # energy of y^(6), as for x in `coefficients.compute_coefficients`: y^(7)^2 + (1 + k2) y^(6)^2
    jet_bound_slope = jnp.sqrt(stiffness + 4.0 * damping * damping)
    series = flow.flow_series(frequency, damping, stiffness)
    term_series = tuple(
        flow.flow_series(drive.angular_rate(term, frequency), damping, stiffness) for term in drive_terms
    )
    entry = entry_step(
        wall, amplitude, frequency, series, wall_series, stiffness, list(zip(drive_terms, term_series, strict=True))
    )
    return SoftWallFlow(
        stiffness,
        root_stiffness,
        damping,
        series,
        wall_series,
        entry,
        max_step,
        force_bound * (1.0 + jet_bound_slope * max_step),
        jet_bound_slope,
        term_series,
    )


def is_inside(contact):
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
    code = lax.abs(contact)
    return (code == Contact.WITHIN) | (code == Contact.ENTERED)


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
        Coefficients of each lane. Inside a wall the motion has no swift part.
    """
    soft_flows = [soft_flow for soft_flow in coeffs.soft_flows if soft_flow is not None]
    inside = is_inside(contact)

    def select_field(field_name, free_value):
        return choose(
            inside, _select_by_wall(contact, [getattr(soft_flow, field_name) for soft_flow in soft_flows]), free_value
        )

    max_step = select_field("max_step", coeffs.max_step)
    return LaneCoefficients(
        damping=select_field("damping", coeffs.damping),
        swift_amplitude=choose(inside, 0.0, coeffs.swift_amplitude),
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


def _select_by_wall(contact, values):
    """Select the value of the soft wall of each lane from the values of all soft walls, left first."""
    return values[0] if len(values) == 1 else choose(contact < 0, *values)


def has_moving_soft_wall(coeffs):
    """Return True if a soft wall moves."""
    return any(soft_flow is not None and soft_flow.wall_series is not None for soft_flow in coeffs.soft_flows)


def lane_propagator(coeffs, contact, time):
    """Return the `flow.Propagator` of each lane."""
    return flow.step_propagator(_lane_series(coeffs, contact), coeffs.frequency, time)


def has_harmonic_forces(coeffs):
    """Return True if there are `harmonic_forces`."""
    return bool(coeffs.drive_terms) or has_moving_soft_wall(coeffs)


def harmonic_responses(coeffs, contact, time):
    """Return [(cos_response, sin_response)] of each lane for each of its `harmonic_forces`."""
    responses = [flow.drive_responses(series, time) for series in _term_series_of_lanes(coeffs, contact)]
    if has_moving_soft_wall(coeffs):
        responses.append(
            flow.drive_responses(
                _wall_series_of_lanes(coeffs, contact), choose(_in_moving_wall(coeffs, contact), time, 0.0)
            )
        )
    return responses


def harmonic_forces(coeffs, contact, cosine, sine):
    """Return the harmonic forces on lanes as a list of (force_cos, force_sin, rate).

    They are the further drive terms and, if a soft wall moves, the force due to the motion of the lane's wall. At a
    time t from now each is force_cos cos(rate t) - force_sin sin(rate t).
    """
    force_terms = drive.term_forces(coeffs.drive_terms, coeffs.frequency, cosine, sine)
    return (
        [*force_terms, wall_motion_force(coeffs, contact, cosine, sine)]
        if has_moving_soft_wall(coeffs)
        else force_terms
    )


def _in_moving_wall(coeffs, contact):
    """Return the lanes inside a moving wall."""
    mask = contact != contact
    for wall, soft_flow in zip(coeffs.walls, coeffs.soft_flows, strict=True):
        if soft_flow is not None and soft_flow.wall_series is not None:
            mask |= is_inside(contact) & (contact * wall.sign > 0)
    return mask


def _lane_series(coeffs, contact):
    """Return the `flow.FlowSeries` of each lane as lists of rows."""
    return _select_series(
        contact, coeffs.series, [soft_flow.series for soft_flow in coeffs.soft_flows if soft_flow is not None]
    )


def _term_series_of_lanes(coeffs, contact):
    """Return the `flow.FlowSeries` of each lane under each further drive term."""
    term_series = zip(*(soft_flow.term_series for soft_flow in coeffs.soft_flows if soft_flow is not None), strict=True)
    return [
        _select_series(contact, term.series, wall_series)
        for term, wall_series in zip(coeffs.drive_terms, term_series, strict=True)
    ]


def _select_series(contact, free_series, wall_series):
    """Select the `flow.FlowSeries` of each lane from those outside and inside the soft walls."""
    inside = is_inside(contact)

    def select_rows(free_rows, *wall_rows):
        indices = range(free_rows.shape[0])
        return [
            choose(inside, _select_by_wall(contact, [rows[k] for rows in wall_rows]), free_rows[k]) for k in indices
        ]

    return flow.FlowSeries(*map(select_rows, free_series, *wall_series))


def _wall_series_of_lanes(coeffs, contact):
    """Return the `flow.FlowSeries` of each lane under the motion of its wall."""

    def select_rows(*wall_rows):
        return [_select_by_wall(contact, [rows[k] for rows in wall_rows]) for k in range(wall_rows[0].shape[0])]

    wall_series = [
        soft_flow.wall_series
        for soft_flow in coeffs.soft_flows
        if soft_flow is not None and soft_flow.wall_series is not None
    ]
    return flow.FlowSeries(*map(select_rows, *wall_series))


def extra_force_derivs(coeffs, contact, cosine, sine, order):
    """Compute the force on y in addition to the drive and its derivatives.

    The force is - x_b - 2 gamma2 x_b' - x_b''.

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
    inside = is_inside(contact)
    soft_walls = [wall for wall, value in zip(coeffs.walls, coeffs.soft_flows, strict=True) if value is not None]
    derivs = []
    for wall_values in zip(
        *(_wall_force_derivs(wall, coeffs.frequency, cosine, sine, order) for wall in soft_walls), strict=True
    ):
        is_zero = all(value is None for value in wall_values)
        wall_values = [0.0 * cosine if value is None else value + 0.0 * cosine for value in wall_values]
        derivs.append(None if is_zero else choose(inside, _select_by_wall(contact, wall_values), 0.0))
    return derivs


def _wall_force_derivs(wall, frequency, cosine, sine, order):
    """Return the force of one wall and its derivatives."""
    wall_derivs = wall_jet(wall, frequency, cosine, sine, order + 2)
    derivs = []
    for k in range(order + 1):
        drag = None if wall_derivs[k + 1] is None else 2.0 * wall.damping * wall_derivs[k + 1]
        derivs.append(None if wall_derivs[k] is None else subtract(subtract(-wall_derivs[k], drag), wall_derivs[k + 2]))
    return derivs


def extra_increments(coeffs, contact, motion, propagator, responses):
    """Return the increments (dx, dv) of y and y' over a flight due to `extra_force_derivs` and the further drive terms.

    `responses` are the `harmonic_responses`.
    """
    dx, dv = mean_position_increments(coeffs, contact, motion.cosine, propagator.p00_minus_1, propagator.p01)
    if responses:
        forces = harmonic_forces(coeffs, contact, motion.cosine, motion.sine)
        for (force_cos, force_sin, angular_rate), (cos_response, sin_response) in zip(forces, responses, strict=True):
            dx = dx + (force_cos * cos_response - force_sin * sin_response)
            dv = dv + (
                force_cos * (propagator.p01 - angular_rate * sin_response) - force_sin * (angular_rate * cos_response)
            )
    return dx, dv


def mean_position_increments(coeffs, contact, like, p00_minus_1, p01):
    """Return the increments of y and y' due to the mean position of the wall."""
    soft_walls = [pair for pair in zip(coeffs.walls, coeffs.soft_flows, strict=True) if pair[1] is not None]
    mean_position = choose(
        is_inside(contact), _select_by_wall(contact, [wall.position + 0.0 * like for wall, _ in soft_walls]), 0.0
    )
    return mean_position * p00_minus_1 / _select_by_wall(
        contact, [pair.stiffness for _, pair in soft_walls]
    ), -mean_position * p01


def wall_motion_force(coeffs, contact, cosine, sine):
    """Return (force_cos, force_sin, rate) of the force due to the motion of the wall, see `harmonic_forces`."""
    pairs = zip(coeffs.walls, coeffs.soft_flows, strict=True)
    moving_walls = [wall for wall, soft_flow in pairs if soft_flow is not None and soft_flow.wall_series is not None]
    force_cos, force_sin, angular_rate = (
        _select_by_wall(contact, list(values))
        for values in zip(
            *(_wall_motion_force(wall, coeffs.frequency, cosine, sine) for wall in moving_walls), strict=True
        )
    )
    in_moving_wall = _in_moving_wall(coeffs, contact)
    return choose(in_moving_wall, force_cos, 0.0), choose(in_moving_wall, force_sin, 0.0), angular_rate


def _wall_motion_force(wall, frequency, cosine, sine):
    """Return the `wall_motion_force` of one wall, whose total force is - x_b - 2 gamma2 x_b' - x_b''."""
    angular_rate = frequency * float(wall.harmonic)
    displacement, wall_velocity = wall_jet(wall, frequency, cosine, sine, 1)
    # amplitude times cosine and sine of the wall's angle
    displacement, quadrature = (
        displacement - wall.position,
        -wall_velocity / angular_rate,
    )
    in_phase_gain, quadrature_gain = angular_rate * angular_rate - 1.0, 2.0 * wall.damping * angular_rate
    return (
        in_phase_gain * displacement + quadrature_gain * quadrature,
        in_phase_gain * quadrature - quadrature_gain * displacement,
        angular_rate + 0.0 * cosine,
    )


class ContactResponse(NamedTuple):
    """Response over a contact phase of a given duration.

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
    arguments = coeffs.damping, time, coeffs.stiffness
    free_flow, forced_flow, _ = flow.doubling_responses(_lane_series(coeffs, contact), coeffs.frequency, *arguments)
    harmonic_flows = []
    for term, series in zip(coeffs.drive_terms, _term_series_of_lanes(coeffs, contact), strict=True):
        harmonic_flows.append(
            flow.doubling_responses(series, drive.angular_rate(term, coeffs.frequency), *arguments)[1]
        )
    if has_moving_soft_wall(coeffs):
        *_, angular_rate = wall_motion_force(coeffs, contact, 0.0 * time, 0.0 * time)
        moving_time = choose(_in_moving_wall(coeffs, contact), time, 0.0)
        harmonic_flows.append(
            flow.doubling_responses(
                _wall_series_of_lanes(coeffs, contact), angular_rate, coeffs.damping, moving_time, coeffs.stiffness
            )[1]
        )
    return ContactResponse(free_flow, forced_flow, tuple(harmonic_flows))


def apply_response(coeffs, contact, response, start, cosine, sine):
    """Compute the state after a contact phase from its response.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of each lane, see `coeffs_by_lane`.
    contact : array
        Contact code times the sign of the wall.
    response : ContactResponse
        Response over the phase.
    start : tuple of array
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
    free_flow, forced_flow, harmonic_flows = response
    force = coeffs.amplitude * cosine, coeffs.amplitude * sine
    y, v = flow.apply_responses((free_flow, forced_flow), *force, *start, coeffs.stiffness)
    dy, dv = mean_position_increments(coeffs, contact, cosine, free_flow[0] - 1.0, free_flow[1])
    y, v = y + dy, v + dv
    if harmonic_flows:
        for (force_cos, force_sin, _), forced_flow in zip(
            harmonic_forces(coeffs, contact, cosine, sine), harmonic_flows, strict=True
        ):
            dy, dv = flow.apply_responses(
                (free_flow, forced_flow), force_cos, force_sin, 0.0 * y, 0.0 * v, coeffs.stiffness
            )
            y, v = y + dy, v + dv
    return y, v


def entry_steps(coeffs, contact):
    """Return the `EntryStep` of each lane."""
    entries = [entry.entry_step for entry in coeffs.soft_flows if entry is not None]
    wall_flows = [entry.wall_flow for entry in entries if entry.wall_flow is not None]
    entries = [entry._replace(wall_flow=entry.wall_flow or wall_flows[0]) if wall_flows else entry for entry in entries]
    return jax.tree.map(lambda *leaves: _select_by_wall(contact, list(leaves)), *entries)


def displacement_over_time(coeffs, contact, v, cosine, sine, time):
    """Compute y / time after an entry into a wall.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of each lane, see `coeffs_by_lane`.
    contact : array
        Contact code times the sign of the wall.
    v : array
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
    series = _lane_series(coeffs, contact)
    p00_sum, p01_sum, cos_sum, sin_sum = (flow.horner(rows, time) for rows in series)
    force = coeffs.amplitude * cosine, coeffs.amplitude * sine
    dy, _ = mean_position_increments(coeffs, contact, cosine, p00_sum * time, 0.0 * time)
    quotient = v * p01_sum + time * (force[0] * cos_sum - force[1] * (time * sin_sum)) + dy
    forces = drive.term_forces(coeffs.drive_terms, coeffs.frequency, cosine, sine)
    for (force_cos, force_sin, _), rows in zip(forces, _term_series_of_lanes(coeffs, contact), strict=True):
        cos_sum, sin_sum = (flow.horner(coefficients, time) for coefficients in rows[2:])
        quotient = quotient + time * (force_cos * cos_sum - force_sin * (time * sin_sum))
    if has_moving_soft_wall(coeffs):
        force_cos, force_sin, _ = wall_motion_force(coeffs, contact, cosine, sine)
        moving_time = choose(_in_moving_wall(coeffs, contact), time, 0.0)
        _, _, cos_sum, sin_sum = (flow.horner(rows, moving_time) for rows in _wall_series_of_lanes(coeffs, contact))
        quotient = quotient + time * (force_cos * cos_sum - force_sin * (time * sin_sum))
    return quotient


def velocity_after_entry(coeffs, contact, v, cosine, sine, time):
    """Compute y' after an entry into a wall.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of each lane, see `coeffs_by_lane`.
    contact : array
        Contact code times the sign of the wall.
    v : array
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
        _lane_series(coeffs, contact), coeffs.frequency, time
    )
    forced = coeffs.amplitude * cosine * (p01 - coeffs.frequency * sin_response) - coeffs.amplitude * sine * (
        coeffs.frequency * cos_response
    )
    _, dv = mean_position_increments(coeffs, contact, cosine, p00_minus_1, p01)
    velocity = (1.0 + p00_minus_1 - 2.0 * coeffs.damping * p01) * v + forced + dv
    if has_harmonic_forces(coeffs):
        forces = harmonic_forces(coeffs, contact, cosine, sine)
        for (force_cos, force_sin, angular_rate), (cos_response, sin_response) in zip(
            forces, harmonic_responses(coeffs, contact, time), strict=True
        ):
            velocity = (
                velocity + force_cos * (p01 - angular_rate * sin_response) - force_sin * (angular_rate * cos_response)
            )
    return velocity

"""What a mass feels within a soft wall (paper, (39)): another oscillator, in y = x - x_b, how far it is past the wall.

    y'' + 2 gamma2 y' + (1 + k2) y = A cos(theta) - x_b - 2 gamma2 x_b' - x_b''

The right-hand side is what presses a mass that is at rest on the wall. Counted from the wall, y keeps its digits
however stiff the wall is. A lane is within a wall from the step that meets it to the one that brings it back.
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
    """The oscillator within a wall: stiffness 1 + k2 and its root; damping gamma2; series: of its flow under the drive;
    wall_series: under the wall's own motion, None where it stands still; entry_step: the first step after an entry;
    max_step: the longest of the others; jet_bound, jet_bound_slope: as the `coefficients.Frame` has them, for y;
    term_series: as series, of the drive's further terms."""

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
    """What of a `coefficients.Frame` differs between lanes: damping; swift; stiffness, its root; reach, pace; curb,
    slope."""

    damping: Float[jax.Array, "..."]
    swift_amplitude: Float[jax.Array, "..."]
    stiffness: Float[jax.Array, "..."]
    root_stiffness: Float[jax.Array, "..."]
    max_step: Float[jax.Array, "..."]
    inverse_max_step: Float[jax.Array, "..."]
    jet_bound: Float[jax.Array, "..."]
    jet_bound_slope: Float[jax.Array, "..."]


def soft_wall_flow(wall, amplitude, frequency, drive_terms=()):
    """The `SoftWallFlow` of a wall's `Lane`, None for a rigid one; drive_terms: of the drive, beside its first."""
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
    # energy of y^(6), as for x in `frame`: y^(7)^2 + (1 + k2) y^(6)^2
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
    """The lanes that are within a soft wall."""
    code = lax.abs(contact)
    return (code == Contact.WITHIN) | (code == Contact.ENTERED)


def is_soft_side(coeffs, side):
    """Whether the wall on a side is a soft one; side: -1, +1, 0 for none."""
    is_soft = side != side
    for wall, soft_flow in zip(coeffs.walls, coeffs.soft_flows, strict=True):
        if soft_flow is not None:
            is_soft |= side == float(wall.sign)
    return is_soft


def restitution_of(coeffs, side):
    """The restitution of the wall on a side; -1 of a soft one, at which the velocity stays as it is."""
    restitutions = [
        lax.full_like(wall.position, -1.0) if wall.restitution is None else wall.restitution for wall in coeffs.walls
    ]
    return select_by_side(side, coeffs.walls, restitutions)


def lane_coefficients(coeffs, contact):
    """The `LaneCoefficients` of each lane: within a wall no part of the motion is swift."""
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
    """The `coefficients.Frame` as each lane feels it."""
    return coeffs._replace(**lane_coefficients(coeffs, contact)._asdict())


def _select_by_wall(contact, values):
    """The value of the soft wall that a lane is within: values of those that there are, left first."""
    return values[0] if len(values) == 1 else choose(contact < 0, *values)


def has_moving_soft_wall(coeffs):
    """Whether a soft wall moves."""
    return any(soft_flow is not None and soft_flow.wall_series is not None for soft_flow in coeffs.soft_flows)


def lane_propagator(coeffs, contact, time):
    """The `flow.Gains` of each lane."""
    return flow.step_propagator(_lane_series(coeffs, contact), coeffs.frequency, time)


def has_harmonic_forces(coeffs):
    """Whether there are `harmonic_forces`."""
    return bool(coeffs.drive_terms) or has_moving_soft_wall(coeffs)


def harmonic_responses(coeffs, contact, time):
    """[(lift, lag)] of each lane for each of its `harmonic_forces`."""
    responses = [flow.drive_responses(series, time) for series in _term_series_of_lanes(coeffs, contact)]
    if has_moving_soft_wall(coeffs):
        responses.append(
            flow.drive_responses(
                _wall_series_of_lanes(coeffs, contact), choose(_in_moving_wall(coeffs, contact), time, 0.0)
            )
        )
    return responses


def harmonic_forces(coeffs, contact, cosine, sine):
    """[(along, across, rate)]: what drives lanes beside A cos(theta) and where the wall is, each a force along cos -
    across sin of its own angle since now: the drive's further terms, and, where a soft wall moves, the motion of the
    wall that a lane is within."""
    force_terms = drive.term_forces(coeffs.drive_terms, coeffs.frequency, cosine, sine)
    return (
        [*force_terms, wall_motion_force(coeffs, contact, cosine, sine)]
        if has_moving_soft_wall(coeffs)
        else force_terms
    )


def _in_moving_wall(coeffs, contact):
    """The lanes that are within a wall that moves."""
    mask = contact != contact
    for wall, soft_flow in zip(coeffs.walls, coeffs.soft_flows, strict=True):
        if soft_flow is not None and soft_flow.wall_series is not None:
            mask |= is_inside(contact) & (contact * wall.sign > 0)
    return mask


def _lane_series(coeffs, contact):
    """The flow's `Series` of each lane, rows in place of arrays."""
    return _select_series(
        contact, coeffs.series, [soft_flow.series for soft_flow in coeffs.soft_flows if soft_flow is not None]
    )


def _term_series_of_lanes(coeffs, contact):
    """As `_lane_series`, under each further term of the drive."""
    term_series = zip(*(soft_flow.term_series for soft_flow in coeffs.soft_flows if soft_flow is not None), strict=True)
    return [
        _select_series(contact, term.series, wall_series)
        for term, wall_series in zip(coeffs.drive_terms, term_series, strict=True)
    ]


def _select_series(contact, free_series, wall_series):
    """The `Series` of each lane of that outside and those within the soft walls."""
    inside = is_inside(contact)

    def select_rows(free_rows, *wall_rows):
        indices = range(free_rows.shape[0])
        return [
            choose(inside, _select_by_wall(contact, [rows[k] for rows in wall_rows]), free_rows[k]) for k in indices
        ]

    return flow.FlowSeries(*map(select_rows, free_series, *wall_series))


def _wall_series_of_lanes(coeffs, contact):
    """As `_lane_series`, under the motion of the wall that a lane is within."""

    def select_rows(*wall_rows):
        return [_select_by_wall(contact, [rows[k] for rows in wall_rows]) for k in range(wall_rows[0].shape[0])]

    wall_series = [
        soft_flow.wall_series
        for soft_flow in coeffs.soft_flows
        if soft_flow is not None and soft_flow.wall_series is not None
    ]
    return flow.FlowSeries(*map(select_rows, *wall_series))


def extra_force_derivs(coeffs, contact, cosine, sine, order):
    """The force on y that is not the drive's, - x_b - 2 gamma2 x_b' - x_b'', and its derivatives, None where zero.

    Zero in lanes that are outside.
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
    wall_derivs = wall_jet(wall, frequency, cosine, sine, order + 2)
    derivs = []
    for k in range(order + 1):
        drag = None if wall_derivs[k + 1] is None else 2.0 * wall.damping * wall_derivs[k + 1]
        derivs.append(None if wall_derivs[k] is None else subtract(subtract(-wall_derivs[k], drag), wall_derivs[k + 2]))
    return derivs


def extra_increments(coeffs, contact, motion, propagator, responses):
    """What the `extra_force_derivs`, and the drive's further terms, add to y and y' over a flight: (dx, dv); responses:
    see there."""
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
    """What the wall's mean position adds to y and y'."""
    soft_walls = [pair for pair in zip(coeffs.walls, coeffs.soft_flows, strict=True) if pair[1] is not None]
    mean_position = choose(
        is_inside(contact), _select_by_wall(contact, [wall.position + 0.0 * like for wall, _ in soft_walls]), 0.0
    )
    return mean_position * p00_minus_1 / _select_by_wall(
        contact, [pair.stiffness for _, pair in soft_walls]
    ), -mean_position * p01


def wall_motion_force(coeffs, contact, cosine, sine):
    """(along, across, rate): of the wall's motion the force is along cos - across sin of its own angle since now."""
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
    """`_wave` of one wall: its force is - x_b - 2 gamma2 x_b' - x_b''."""
    angular_rate = frequency * float(wall.harmonic)
    displacement, wall_velocity = wall_jet(wall, frequency, cosine, sine, 1)
    displacement, quadrature = (
        displacement - wall.position,
        -wall_velocity / angular_rate,
    )  # swing times cosine and sine of the wall's angle
    in_phase_gain, quadrature_gain = angular_rate * angular_rate - 1.0, 2.0 * wall.damping * angular_rate
    return (
        in_phase_gain * displacement + quadrature_gain * quadrature,
        in_phase_gain * quadrature - quadrature_gain * displacement,
        angular_rate + 0.0 * cosine,
    )


class ContactResponse(NamedTuple):
    """What a stay of a given time does: `flow.doubled`'s matrix; motions forced by the drive, and by each of the
    `harmonic_forces`."""

    free_flow: flow.FreeFlow
    forced_flow: flow.ForcedFlow
    harmonic_flows: tuple[flow.ForcedFlow, ...]


def contact_response(coeffs, contact, time):
    """The `ContactResponse` of each lane over any time; coeffs: as the lanes feel it (`lane_coefficients`)."""
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
    """(y, y') after a stay of this `ContactResponse` from (y, y')."""
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
    """The `EntryStep` of each lane."""
    entries = [entry.entry_step for entry in coeffs.soft_flows if entry is not None]
    wall_flows = [entry.wall_flow for entry in entries if entry.wall_flow is not None]
    entries = [entry._replace(wall_flow=entry.wall_flow or wall_flows[0]) if wall_flows else entry for entry in entries]
    return jax.tree.map(lambda *leaves: _select_by_wall(contact, list(leaves)), *entries)


def displacement_over_time(coeffs, contact, v, cosine, sine, time):
    """y / time of a mass that enters a wall with the velocity v, to a time no longer than a step."""
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
    """y' of a mass that enters a wall with the velocity v, after a time no longer than a step."""
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

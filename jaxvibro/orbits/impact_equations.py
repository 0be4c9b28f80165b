"""Equations of periodic orbits in the times and speeds of their impacts, for walls hit in a given order.

Between an impact at time t_i and the next at t_j the mass flies freely. At t_j it must be at the wall, with the speed
u_j relative to it. These equations stay smooth where a speed vanishes. They ignore walls between impacts:
`flight_clearance` checks afterwards if an orbit passes through a wall. The functions act on one sequence. Arrays have a
row for each impact; rows beyond the last impact are empty, with side 0.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float, Int

from continuation.array_type import Array
from continuation.newton import newton

from ..contact.contact_duration import multiply_2x2_matrices
from ..contact.kinds import flow_coefficients
from ..contact.wall_at_contact import contact_force_derivatives
from ..flight import flow_matrix
from .contact_maps import ContactMap, evaluate_contact_map, saltation_matrices

MAX_TIME_CHANGE = 0.1  # of a drive period: largest change of a time in a Newton step


class ImpactSequence(NamedTuple):
    """Impacts of a periodic orbit in order of time.

    Attributes
    ----------
    times : Array
        Times since the phase of the section, in t, of shape (rows,).
    speeds : Array
        Speeds ``|y- - v_b|`` before the impacts, of shape (rows,).
    sides : Array
        Sides -1 or 1; 0 for an empty row.
    phase : Array
        Phase of the section, in rad.
    periods : Array
        Number of drive periods.
    closure_sign : Array or None
        1, or -1 if the impacts are half of an orbit, followed by their mirror image; None means 1.
    multiplier : Array or None
        Factor of a change of the first impact in the derivatives of the equations of the last impact; None means 1. The
        values of the equations do not depend on this factor.
    grazing : Array or None
        1 for grazings of a soft wall, which have no effect, of shape (rows,); None means that there are none.
    releases : Array or None
        Releases from a wall, in rows with zero speed, of shape (rows,): 0 for an impact, 1 for a release, 2 for a
        release if R is 0 and the mass lifts off this wall once more before it sticks. None means that there are none.
    min_contact_time : Array or None
        Time within the soft wall before which an exit does not count, of shape (rows,); None means 0.
    """

    times: Float[Array, "*lanes rows"]
    speeds: Float[Array, "*lanes rows"]
    sides: Float[Array, "*lanes rows"]
    phase: Float[Array, "*lanes"]
    periods: Float[Array, "*lanes"]
    closure_sign: Float[Array, "*lanes"] | None = None
    multiplier: Float[Array, "*lanes"] | None = None
    grazing: Float[Array, "*lanes rows"] | None = None
    releases: Float[Array, "*lanes rows"] | None = None
    min_contact_time: Float[Array, "*lanes rows"] | None = None


class Flights(NamedTuple):
    """Flights that follow the impacts, each field of shape (rows,).

    Attributes
    ----------
    time : Array
        Duration.
    x, v, cosine, sine : Array
        State, and cosine and sine of the drive's phase, at the start.
    end_x, end_v : Array
        State at the end.
    matrix : tuple of Array
        Flight matrix, as the flow's `fly_with_matrix` returns it.
    next_row : Array of int
        Row of the impact at the end.
    mirror_sign : Array
        -1 if the flight ends at the mirror image of that impact, else 1.
    contact_map : ContactMap
        Contact map of the impact before the flight.
    """

    time: Float[Array, " rows"]
    x: Float[Array, " rows"]
    v: Float[Array, " rows"]
    cosine: Float[Array, " rows"]
    sine: Float[Array, " rows"]
    end_x: Float[Array, " rows"]
    end_v: Float[Array, " rows"]
    matrix: tuple[Float[Array, " rows"], ...]
    next_row: Int[Array, " rows"]
    mirror_sign: Float[Array, " rows"]
    contact_map: ContactMap


@jax.jit
def compute_flights(coeffs, sequence):
    """Compute the flights of an impact sequence.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    sequence : ImpactSequence
        The impacts.

    Returns
    -------
    Flights
        The flights after the impacts.
    """
    sides, row_index = sequence.sides, jnp.arange(len(sequence.sides))
    last_row_index = jnp.sum(sides != 0) - 1
    next_row = jnp.where(row_index < last_row_index, row_index + 1, 0)
    one = jnp.ones((), sequence.times.dtype)
    mirror_sign = jnp.where(
        row_index == last_row_index, one if sequence.closure_sign is None else sequence.closure_sign, one
    )
    drive_phase = sequence.phase + coeffs.frequency * sequence.times
    contact_map = evaluate_contact_map(
        coeffs,
        sides,
        jnp.cos(drive_phase),
        jnp.sin(drive_phase),
        sequence.speeds,
        sequence.grazing,
        sequence.min_contact_time,
    )
    wrap_time = jnp.where(row_index == last_row_index, sequence.periods * coeffs.period, 0.0)
    time = _values_at_next_impact(sequence, sequence.times, next_row) - sequence.times + wrap_time
    time = time if contact_map.contact_time is None else time - contact_map.contact_time
    has_flight = sides != 0 if sequence.releases is None else (sides != 0) & (sequence.releases[next_row] == 0)
    time = jnp.where(has_flight, jnp.maximum(time, 0.0), 0.0)
    (x, v), (cosine, sine) = contact_map.state, contact_map.phasor
    (end_x, end_v), matrix = coeffs.flow.fly_with_matrix(coeffs, x, v, cosine, sine, time)
    return Flights(time, x, v, cosine, sine, end_x, end_v, matrix, next_row, mirror_sign, contact_map)


def _values_at_next_impact(sequence, impact_values, next_row):
    """Return values at the impact that follows each row, with derivatives scaled by `sequence.multiplier`."""
    next_values = impact_values[next_row]
    if sequence.multiplier is None:
        return next_values
    return next_values + jnp.where(next_row == 0, sequence.multiplier - 1.0, 0.0) * (
        next_values - lax.stop_gradient(next_values)
    )


def append_first_impact(sequence, drive_period, scaled_changes):
    """Append a copy of the first impact after the last impact.

    Parameters
    ----------
    sequence : ImpactSequence
        The impacts.
    drive_period : float
        Drive period, in t.
    scaled_changes : sequence of tuple
        Pairs (change to add to the unknowns, factor of this change at the repeated impact).

    Returns
    -------
    ImpactSequence
        Sequence with one more row.
    """
    n_rows, n_impacts = len(sequence.sides), jnp.sum(sequence.sides != 0)
    row_index = jnp.arange(n_rows + 1)
    is_appended_row, source_row = row_index == n_impacts, jnp.where(row_index < n_impacts, row_index, 0)
    times = sequence.times[source_row] + jnp.where(is_appended_row, sequence.periods * drive_period, 0.0)
    speeds = sequence.speeds[source_row] + 0.0
    for change, appended_row_factor in scaled_changes:
        row_factor = jnp.where(is_appended_row, appended_row_factor, 1.0)
        times, speeds = (
            times + row_factor * change[:n_rows][source_row],
            speeds + row_factor * change[n_rows:][source_row],
        )
    closure_sign = 1.0 if sequence.closure_sign is None else sequence.closure_sign
    sides = jnp.where(
        row_index <= n_impacts, jnp.where(is_appended_row, closure_sign, 1.0) * sequence.sides[source_row], 0.0
    )
    return ImpactSequence(times, speeds, sides, sequence.phase, sequence.periods)


class SequenceJacobian(NamedTuple):
    """Derivative of the two equations of each row: the gap and the speed error at the end of the flight.

    Attributes
    ----------
    diagonal : tuple of tuple of Array
        ((a, b), (c, d)): derivative of (gap, speed error) with respect to the row's own time and speed.
    coupling : tuple of Array
        (e, f) of ((e, 0), (f, -1)): derivative with respect to the time and speed of the next impact.
    last_row : Array of int
        Index of the row of the last impact, which precedes the first row in the cycle.
    """

    diagonal: tuple[
        tuple[Float[Array, " rows"], Float[Array, " rows"]], tuple[Float[Array, " rows"], Float[Array, " rows"]]
    ]
    coupling: tuple[Float[Array, " rows"], Float[Array, " rows"]]
    last_row: Int[Array, ""]


def residual_and_jacobian(coeffs, sequence, flights=None):
    """Evaluate the equations of an impact sequence and their derivative.

    The unknowns are u = (times, speeds). The residual is the gap between the end of each flight and the wall of the
    next impact, and the difference between the final speed and the speed of this impact. No flight ends at a release,
    because the motion after a release does not depend on the motion before it. Instead, contact force and speed must be
    zero at a release.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    sequence : ImpactSequence
        The impacts.
    flights : Flights, optional
        Flights of the sequence, if known.

    Returns
    -------
    residual : Array
        Gaps, then speed errors, of shape (2 rows,).
    jacobian : SequenceJacobian
        Derivative of the residual.
    """
    flights, sides = compute_flights(coeffs, sequence) if flights is None else flights, sequence.sides
    is_impact = sides != 0

    def value_at_next_impact(impact_values):
        return flights.mirror_sign * _values_at_next_impact(sequence, impact_values, flights.next_row)

    next_side, contact_map = value_at_next_impact(sides), flights.contact_map
    relative_velocity = flights.end_v - value_at_next_impact(contact_map.wall_velocity)
    acceleration, _ = coeffs.flow.acceleration_and_jerk(
        coeffs,
        flights.end_x,
        flights.end_v,
        value_at_next_impact(contact_map.cosine),
        value_at_next_impact(contact_map.sine),
    )
    gap = flights.end_x - value_at_next_impact(contact_map.wall_position)
    speed_error = next_side * relative_velocity - _values_at_next_impact(sequence, sequence.speeds, flights.next_row)
    (gap_by_time, speed_by_time), (gap_by_speed, speed_by_speed) = (
        flow_matrix.apply_matrix(flights.matrix, x, v)
        for x, v in (contact_map.state_by_time, contact_map.state_by_speed)
    )
    speed_by_time, speed_by_speed = next_side * speed_by_time, next_side * speed_by_speed
    diagonal = (gap_by_time, gap_by_speed), (speed_by_time, speed_by_speed)
    coupling = relative_velocity, next_side * (acceleration - value_at_next_impact(contact_map.wall_acceleration))
    if sequence.releases is not None:
        precedes_release = sequence.releases[flights.next_row] > 0
        contact_force, force_rate = (
            value_at_next_impact(force_values)
            for force_values in contact_force_derivatives(coeffs, sides, (contact_map.cosine, contact_map.sine))
        )
        gap = jnp.where(precedes_release, contact_force, gap)
        speed_error = jnp.where(
            precedes_release, -_values_at_next_impact(sequence, sequence.speeds, flights.next_row), speed_error
        )
        diagonal = jax.tree.map(lambda entry: jnp.where(precedes_release, 0.0, entry), diagonal)
        coupling = jnp.where(precedes_release, force_rate, coupling[0]), jnp.where(precedes_release, 0.0, coupling[1])
    residual = jnp.where(jnp.tile(is_impact, 2), jnp.concatenate([gap, speed_error]), 0.0)
    return residual, SequenceJacobian(diagonal, coupling, jnp.sum(is_impact) - 1)


def solve_cyclic(jacobian, residual):
    """Solve the linear system of a Newton step row by row.

    The change of each row follows from the change of the row before. The closure of the cycle determines the first
    change.

    Parameters
    ----------
    jacobian : SequenceJacobian
        Derivative of the equations.
    residual : Array
        Right side, of shape (2 rows,).

    Returns
    -------
    change : Array
        Solution, times then speeds, of shape (2 rows,).
    pivot_ratio : Array
        Relative distance from a singular system, a scalar.
    """
    n_rows = len(residual) // 2
    ((a, b), (c, d)), (e, f) = jacobian.diagonal, jacobian.coupling
    gap, speed_error = residual[:n_rows], residual[n_rows:]
    # (e, 0; f, -1) next = residual - (a, b; c, d) own
    transfer_entries = (-a / e, -b / e, c - f * a / e, d - f * b / e)
    transfer_shifts = (gap / e, f * gap / e - speed_error)
    zero, one = jnp.zeros_like(gap[0]), jnp.ones_like(gap[0])

    def compose_transfers(carry, row_data):
        row_index, ((t00, t01, t10, t11), (row_shift0, row_shift1)) = row_data
        (m00, m01, m10, m11), (cycle_shift0, cycle_shift1) = carry
        new_carry = (t00 * m00 + t01 * m10, t00 * m01 + t01 * m11, t10 * m00 + t11 * m10, t10 * m01 + t11 * m11)
        new_carry = (
            new_carry,
            (
                t00 * cycle_shift0 + t01 * cycle_shift1 + row_shift0,
                t10 * cycle_shift0 + t11 * cycle_shift1 + row_shift1,
            ),
        )
        return jax.tree.map(
            lambda new, old: jnp.where(row_index <= jacobian.last_row, new, old), new_carry, carry
        ), None

    row_indices = jnp.arange(n_rows)
    identity_transfer = (one, zero, zero, one), (zero, zero)
    (cycle_transfer, (cycle_shift0, cycle_shift1)), _ = lax.scan(
        compose_transfers, identity_transfer, (row_indices, (transfer_entries, transfer_shifts))
    )
    m00, m01, m10, m11 = cycle_transfer
    a, d = 1.0 - m00, 1.0 - m11
    determinant = a * d - m01 * m10
    first_change = (
        (d * cycle_shift0 + m01 * cycle_shift1) / determinant,
        (m10 * cycle_shift0 + a * cycle_shift1) / determinant,
    )

    def advance_change(change, row_data):
        row_index, ((t00, t01, t10, t11), (row_shift0, row_shift1)) = row_data
        row_change = jax.tree.map(lambda component: jnp.where(row_index <= jacobian.last_row, component, 0.0), change)
        return (
            t00 * change[0] + t01 * change[1] + row_shift0,
            t10 * change[0] + t11 * change[1] + row_shift1,
        ), row_change

    _, (times, speeds) = lax.scan(advance_change, first_change, (row_indices, (transfer_entries, transfer_shifts)))
    return jnp.concatenate([times, speeds]), abs(determinant) / (1.0 + abs(m00 * m11) + abs(m01 * m10))


def solve_sequence(scene, sequence):
    """Return the `newton.NewtonSolution` that Newton's method reaches from the times and speeds of a sequence."""
    coeffs, n_rows = flow_coefficients(scene), len(sequence.sides)

    def equations_of(unknowns):
        return residual_and_jacobian(coeffs, sequence._replace(times=unknowns[:n_rows], speeds=unknowns[n_rows:]))

    max_change = jnp.repeat(
        jnp.array([MAX_TIME_CHANGE * coeffs.period, jnp.inf]), n_rows, total_repeat_length=2 * n_rows
    )
    return newton(equations_of, jnp.concatenate([sequence.times, sequence.speeds]), max_change, solve=solve_cyclic)


def sort_sequence(scene, sequence, unknowns):
    """Return the sequence with these unknowns, its times within the periods and in order."""
    n_rows, orbit_duration = len(sequence.sides), sequence.periods * 2.0 * jnp.pi / scene.frequency
    times, speeds = unknowns[:n_rows], unknowns[n_rows:]
    times = jnp.where(sequence.sides != 0, times - orbit_duration * jnp.floor(times / orbit_duration), jnp.inf)
    order = jnp.argsort(times)
    times = jnp.where(jnp.isfinite(times), times, 0.0)
    releases = None if sequence.releases is None else sequence.releases[order]
    return ImpactSequence(
        times[order], speeds[order], sequence.sides[order], sequence.phase, sequence.periods, releases=releases
    )


def monodromy_invariants(coeffs, flights, sides):
    """Compute trace and determinant of the monodromy matrix from the matrices of flights and impacts.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    flights : Flights
        Flights of the sequence.
    sides : Array
        Sides of the impacts, of shape (rows,).

    Returns
    -------
    trace : Array
        Trace of the product of all flight matrices and saltation matrices.
    determinant : Array
        Determinant of this product.

    Notes
    -----
    The function does not apply to orbits that stick, whose trace and determinant are zero.
    """
    saltation_entries, saltation_dets = saltation_matrices(coeffs, flights.contact_map, sides)

    def multiply_flight_matrix(row, carry):
        matrix, determinant = carry
        flight_matrix = [entry[row] for entry in flights.matrix]
        q00, q01, q10, q11 = multiply_2x2_matrices([entry[row] for entry in saltation_entries], matrix)
        (m00, m10), (m01, m11) = (
            flow_matrix.apply_matrix(flight_matrix, q00, q10),
            flow_matrix.apply_matrix(flight_matrix, q01, q11),
        )
        new_carry = (m00, m01, m10, m11), determinant * saltation_dets[row] * flow_matrix.determinant(flight_matrix)
        return jax.tree.map(lambda new, old: jnp.where(sides[row] != 0, new, old), new_carry, carry)

    one, zero = jnp.ones_like(flights.time[0]), jnp.zeros_like(flights.time[0])
    (m00, _, _, m11), determinant = lax.fori_loop(0, len(sides), multiply_flight_matrix, ((one, zero, zero, one), one))
    return m00 + m11, determinant


def states_at(coeffs, sequence, flights, query_times):
    """Evaluate the state of a periodic orbit at given times.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    sequence : ImpactSequence
        The impacts.
    flights : Flights
        Flights of the sequence.
    query_times : Array
        Times since the phase of the section, of shape (times,).

    Returns
    -------
    tuple of Array
        (x, v), each of shape (times,).
    """
    orbit_duration = sequence.periods * coeffs.period
    elapsed_time = query_times[:, None] - sequence.times
    elapsed_time = jnp.where(
        sequence.sides != 0, elapsed_time - orbit_duration * jnp.floor(elapsed_time / orbit_duration), jnp.inf
    )
    last_impact_row = jnp.argmin(elapsed_time, axis=1)
    elapsed_time = jnp.take_along_axis(elapsed_time, last_impact_row[:, None], 1)[:, 0]
    flight_time = (
        elapsed_time
        if flights.contact_map.contact_time is None
        else jnp.maximum(elapsed_time - flights.contact_map.contact_time[last_impact_row], 0.0)
    )
    state = coeffs.flow.fly(
        coeffs,
        flights.x[last_impact_row],
        flights.v[last_impact_row],
        flights.cosine[last_impact_row],
        flights.sine[last_impact_row],
        flight_time,
    )[:2]
    return coeffs.contact.state_in_contact(
        coeffs, flights.contact_map, sequence.sides, last_impact_row, elapsed_time, state
    )

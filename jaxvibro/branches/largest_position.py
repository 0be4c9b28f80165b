"""Compute the largest ``|x|`` of orbits: at turning points of flights and contact phases, or at a wall that is hit.

Each flight and each contact phase is divided into cells. Where v changes sign in a cell, the turning point is located
by false position. All compared values are values of x on the orbit.
"""

import jax
import jax.numpy as jnp
import numpy as np

from ..contact.kinds import flow_coefficients
from ..flight import motion_in_soft_wall
from ..orbits import flight_clearance, impact_equations
from ..problem.orbit_curve import unknowns_of_rows
from ..problem.orbit_equations import evaluate_at_points, flight_without_impacts, scene_at, sequence_at

MAX_CELLS = 50_000
N_ITERATIONS = 6  # of false position; the error of x at a turning point is the square of that of its time


def branch_peak_positions(branch):
    """Return the largest ``|x|`` on the orbit of each point of a branch, array of shape (points,)."""
    positions = np.zeros(len(branch))
    for segment in branch.segments:
        segment_data = branch.data.isel(point=slice(segment.first, segment.last + 1))
        orbit_point = branch.located(segment.first)[1]
        zs = unknowns_of_rows(segment_data, branch.name, orbit_point.problem)
        positions[segment.first : segment.last + 1] = peak_positions(orbit_point.problem, zs)
    return positions


def peak_positions(problem, zs):
    """Return the largest ``|x|`` of orbits that share one itinerary, array of shape (points,)."""
    return evaluate_at_points(
        _peak_with_impacts if len(problem.sequence.sides) else _peak_without_impacts, problem, zs, 1
    )[0]


def _peak_with_impacts(problem, z, _):
    """Return the largest ``|x|`` of an orbit with impacts, as a tuple of one entry."""
    return (peak_of_sequence(flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)),)


def peak_of_sequence(coeffs, sequence):
    """Return the largest ``|x|`` of an orbit with impacts.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the flow.
    sequence : ImpactSequence
        Impacts of the orbit.

    Returns
    -------
    Array
        Largest ``|x|``.
    """
    flights, is_impact = impact_equations.compute_flights(coeffs, sequence), sequence.sides != 0

    def state_at(time):
        return impact_equations.states_at(coeffs, sequence, flights, time)

    largest_abs_x = jnp.where(is_impact, abs(flights.contact_map.wall_position), 0.0)
    start_times, durations = sequence.times, flights.time
    if flights.contact_map.contact_time is not None:
        is_soft_side = motion_in_soft_wall.is_soft_side(coeffs, sequence.sides)
        contact_durations = jnp.where(is_soft_side & is_impact, jnp.maximum(flights.contact_map.contact_time, 0.0), 0.0)
        largest_abs_x = _peak_over_spans(
            state_at,
            start_times,
            contact_durations,
            coeffs.contact.max_contact_step(coeffs, flights.contact_map, sequence.sides),
            largest_abs_x,
        )
        start_times = start_times + contact_durations

    def flight_state_at(time):  # avoids compiling the contact phase again
        return coeffs.flow.fly(coeffs, flights.x, flights.v, flights.cosine, flights.sine, time - start_times)[:2]

    largest_abs_x = _peak_over_spans(flight_state_at, start_times, durations, coeffs.max_step, largest_abs_x)
    return jnp.max(jnp.where(is_impact, largest_abs_x, 0.0))


def _peak_without_impacts(problem, z, _):
    return (peak_of_flight(*flight_without_impacts(problem, z)),)


def peak_of_flight(coeffs, flight):
    """Return the largest ``|x|`` of an orbit without impacts.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the flow.
    flight : Flight
        Flight of the orbit.

    Returns
    -------
    Array
        Largest ``|x|``.
    """

    def state_at(time):
        return coeffs.flow.fly(coeffs, flight.x, flight.v, flight.cosine, flight.sine, time)[:2]

    zero = jnp.zeros_like(flight.x)
    return jnp.max(_peak_over_spans(state_at, zero, flight.time, coeffs.max_step, zero))


def _peak_over_spans(state_at, start_times, durations, max_step, largest_abs_x):
    """Return the largest ``|x|`` of each row over a time span, or `largest_abs_x` if that is larger.

    `state_at` maps a time to (x, v). A cell is a small fraction of `max_step`, a step of the flow. The result is nan
    if there would be too many cells, for example if Newton's method diverges.
    """
    n_cells_needed = jnp.max(durations) / (flight_clearance.SAMPLE_ANGLE * max_step)
    has_few_cells = n_cells_needed <= MAX_CELLS
    n_cells = jnp.ceil(jnp.where(has_few_cells, n_cells_needed, 0.0)).astype(int) + 8
    cell_length = durations / n_cells

    def search_cell(cell_index, carry):
        largest_abs_x, previous_v = carry
        cell_start, cell_end = start_times + cell_index * cell_length, start_times + (cell_index + 1.0) * cell_length
        x, v = state_at(cell_end)
        turning_x, _ = state_at(_turning_time(state_at, cell_start, cell_end, previous_v, v))
        has_turning_point = previous_v * v < 0
        largest_abs_x = jnp.maximum(largest_abs_x, abs(x))
        return jnp.maximum(largest_abs_x, jnp.where(has_turning_point, abs(turning_x), 0.0)), v

    x, v = state_at(start_times)
    return jnp.where(
        has_few_cells, jax.lax.fori_loop(0, n_cells, search_cell, (jnp.maximum(largest_abs_x, abs(x)), v))[0], jnp.nan
    )


def _turning_time(state_at, lower_time, upper_time, v_lower, v_upper):
    """Locate the zero of v between two times by the Illinois variant of false position."""

    def narrow_bracket(_, carry):
        (lower_time, upper_time), (v_lower, v_upper), unchanged_end = (
            carry  # the last: 1 if the previous step kept the upper end, -1 if it kept the lower one
        )
        v_difference = jnp.where(v_lower == v_upper, 1.0, v_lower - v_upper)
        estimated_time = lower_time + (upper_time - lower_time) * jnp.clip(v_lower / v_difference, 0.0, 1.0)
        _, v = state_at(estimated_time)
        is_in_upper_part = v * v_upper < 0  # the zero lies between the middle and the upper end
        lower_time, upper_time = (
            jnp.where(is_in_upper_part, estimated_time, lower_time),
            jnp.where(is_in_upper_part, upper_time, estimated_time),
        )
        v_lower, v_upper = (
            v_lower * jnp.where(unchanged_end < 0, 0.5, 1.0),
            v_upper * jnp.where(unchanged_end > 0, 0.5, 1.0),
        )
        v_lower, v_upper = jnp.where(is_in_upper_part, v, v_lower), jnp.where(is_in_upper_part, v_upper, v)
        return (lower_time, upper_time), (v_lower, v_upper), jnp.where(is_in_upper_part, 1.0, -1.0)

    initial_carry = (lower_time, upper_time), (v_lower, v_upper), 0.0 * v_lower
    (lower_time, upper_time), (v_lower, v_upper), _ = jax.lax.fori_loop(0, N_ITERATIONS, narrow_bracket, initial_carry)
    v_difference = jnp.where(v_lower == v_upper, 1.0, v_lower - v_upper)
    return lower_time + (upper_time - lower_time) * jnp.clip(v_lower / v_difference, 0.0, 1.0)

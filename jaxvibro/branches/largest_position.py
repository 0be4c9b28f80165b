"""Compute the largest ``|x|`` of orbits: at turning points of flights and contact phases, or at a wall that is hit.

Each flight and each contact phase is divided into cells. Where v changes sign in a cell, the turning point is located
by false position. All compared values are values of x on the orbit, so a cell without a turning point does no harm.
"""

import jax
import jax.numpy as jnp
import numpy as np

from ..flight import soft_contact
from ..flight.coefficients import flow_coefficients
from ..flight.flows import flow_of
from ..orbits import flight_clearance, impact_equations, saltation
from ..problem.diagnostics import evaluate_points, free_flight
from ..problem.equations import scene_at, sequence_at
from ..problem.orbit_point import set_up_problem
from ..problem.orbit_rows import dataset_row, parse_orbit_row

MAX_CELLS = 50_000
N_ITERATIONS = 6  # of false position; the error of x at a turning point is the square of that of its time


def branch_peak_positions(branch):
    """Return the largest ``|x|`` on the orbit of each point of a branch, array of shape (points,)."""
    positions = np.zeros(len(branch))
    for segment in branch.segments:
        segment_data = branch.data.isel(point=slice(segment.first, segment.last + 1))
        orbit_row = parse_orbit_row(dataset_row(segment_data, 0), branch.name)
        problem, z = set_up_problem(branch.scene, branch.name, orbit_row)
        positions[segment.first : segment.last + 1] = peak_positions(
            problem, _unknowns_of_rows(segment_data, branch.name, problem, z)
        )
    return positions


def _unknowns_of_rows(segment_data, name, problem, z):
    """Return the unknowns z of rows with one itinerary."""
    n_rows, n_impacts = len(problem.sequence.sides), int(np.sum(problem.sequence.sides != 0))
    zs = np.zeros((segment_data.sizes["point"], len(z)))
    zs[:, -1] = segment_data[name].values
    if not n_rows:
        zs[:, 0], zs[:, 1] = segment_data["x"].values[:, 0], segment_data["v"].values[:, 0]
        return zs
    is_impact = segment_data["side"].values[0] != 0
    zs[:, :n_impacts], zs[:, n_rows : n_rows + n_impacts] = (
        segment_data["time"].values[:, is_impact],
        segment_data["speed"].values[:, is_impact],
    )
    return zs


def peak_positions(problem, zs):
    """Return the largest ``|x|`` at points z of orbits with one itinerary, array of shape (points,)."""
    return evaluate_points(
        _peak_with_impacts if len(problem.sequence.sides) else _peak_without_impacts, problem, zs, 1
    )[0]


def _peak_with_impacts(problem, z, _):
    """Return the largest ``|x|`` at one point of orbits with impacts, as a tuple."""
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

    def position_at(time):
        return impact_equations.states_at(coeffs, sequence, flights, time)

    largest = jnp.where(is_impact, abs(flights.contact_map.wall_position), 0.0)
    start_times, durations = sequence.times, flights.time
    if flights.contact_map.contact_time is not None:
        is_soft = soft_contact.is_soft_side(coeffs, sequence.sides)
        contact_durations = jnp.where(is_soft & is_impact, jnp.maximum(flights.contact_map.contact_time, 0.0), 0.0)
        largest = _peak_over_spans(
            position_at,
            start_times,
            contact_durations,
            saltation.max_contact_step(coeffs, flights.contact_map, sequence.sides),
            largest,
        )
        start_times = start_times + contact_durations

    def free_position_at(time):  # avoids compiling the contact phase again
        return flow_of(coeffs).fly(coeffs, flights.x, flights.v, flights.cosine, flights.sine, time - start_times)[:2]

    largest = _peak_over_spans(free_position_at, start_times, durations, coeffs.max_step, largest)
    return jnp.max(jnp.where(is_impact, largest, 0.0))


def _peak_without_impacts(problem, z, _):
    return (peak_of_flight(*free_flight(problem, z)),)


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

    def position_at(time):
        return flow_of(coeffs).fly(coeffs, flight.x, flight.v, flight.cosine, flight.sine, time)[:2]

    zero = jnp.zeros_like(flight.x)
    return jnp.max(_peak_over_spans(position_at, zero, flight.time, coeffs.max_step, zero))


def _peak_over_spans(position_at, start_times, durations, max_step, largest):
    """Return the largest ``|x|`` of each row over a time span, or `largest` if that is larger.

    `position_at` maps a time to (x, v). A cell is a small fraction of `max_step`, a step of the flow. The result is nan
    if there would be too many cells, as where Newton's method diverges.
    """
    n_needed = jnp.max(durations) / (flight_clearance.SAMPLE_ANGLE * max_step)
    is_feasible = n_needed <= MAX_CELLS
    n_cells = jnp.ceil(jnp.where(is_feasible, n_needed, 0.0)).astype(int) + 8
    cell_length = durations / n_cells

    def search_cell(cell, carry):
        largest, previous_v = carry
        lower, upper = start_times + cell * cell_length, start_times + (cell + 1.0) * cell_length
        x, v = position_at(upper)
        turning_x, _ = position_at(_turning_time(position_at, lower, upper, previous_v, v))
        has_turning_point = previous_v * v < 0
        largest = jnp.maximum(largest, abs(x))
        return jnp.maximum(largest, jnp.where(has_turning_point, abs(turning_x), 0.0)), v

    x, v = position_at(start_times)
    return jnp.where(
        is_feasible, jax.lax.fori_loop(0, n_cells, search_cell, (jnp.maximum(largest, abs(x)), v))[0], jnp.nan
    )


def _turning_time(position_at, lower, upper, v_lower, v_upper):
    """Locate the zero of v between two times by the Illinois variant of false position."""

    def narrow(_, carry):
        (lower, upper), (v_lower, v_upper), unchanged_end = (
            carry  # the last: 1 if the previous step kept the upper end, -1 if it kept the lower one
        )
        v_difference = jnp.where(v_lower == v_upper, 1.0, v_lower - v_upper)
        middle_time = lower + (upper - lower) * jnp.clip(v_lower / v_difference, 0.0, 1.0)
        _, v = position_at(middle_time)
        is_in_upper_part = v * v_upper < 0  # the zero lies between the middle and the upper end
        lower, upper = jnp.where(is_in_upper_part, middle_time, lower), jnp.where(is_in_upper_part, upper, middle_time)
        v_lower, v_upper = (
            v_lower * jnp.where(unchanged_end < 0, 0.5, 1.0),
            v_upper * jnp.where(unchanged_end > 0, 0.5, 1.0),
        )
        v_lower, v_upper = jnp.where(is_in_upper_part, v, v_lower), jnp.where(is_in_upper_part, v_upper, v)
        return (lower, upper), (v_lower, v_upper), jnp.where(is_in_upper_part, 1.0, -1.0)

    initial = (lower, upper), (v_lower, v_upper), 0.0 * v_lower
    (lower, upper), (v_lower, v_upper), _ = jax.lax.fori_loop(0, N_ITERATIONS, narrow, initial)
    v_difference = jnp.where(v_lower == v_upper, 1.0, v_lower - v_upper)
    return lower + (upper - lower) * jnp.clip(v_lower / v_difference, 0.0, 1.0)

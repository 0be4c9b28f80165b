"""Compute the clearance of the flights of an impact sequence: distance from the walls, or depth behind them.

A flight is sampled. Where the distance x - x_b turns between two samples, Newton steps locate the turning point. These
are measurements; certified flights decide if an orbit is admissible (`orbit_from_impacts`).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from continuation.array_type import Array

from ..flight.flows import flow_of
from ..flight.wall_motion import subtract, wall_jet

SAMPLE_ANGLE = 0.1  # rad between samples, of the fastest of drive, walls and free oscillation
NEWTON_STEPS = 5  # from the guess of a parabola
GRAZING_TOLERANCE = 1e-8  # of the scene's length: smaller clearances, and speeds (length per t), count as zero
OVERLAP_FACTOR = 1.0625  # of its periods: duration of the flight without impacts that is examined
STEP_TOLERANCE = 1e-3  # of the sampling interval: largest last Newton step at a turning point


class Flight(NamedTuple):
    """Duration, state and drive at the start of flights, of shape (rows,).

    `impact_equations.Flights` has these fields too.
    """

    time: Float[Array, " rows"]
    x: Float[Array, " rows"]
    v: Float[Array, " rows"]
    cosine: Float[Array, " rows"]
    sine: Float[Array, " rows"]


def impact_free_flight(coeffs, phase, periods, x, v):
    """Describe a periodic motion without impacts as a flight over slightly more than its periods.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    phase : float
        Phase of the section, in rad.
    periods : int
        Number of drive periods.
    x, v : float
        State at the section.

    Returns
    -------
    Flight
        One flight, of shape (1,).
    """
    flight_fields = OVERLAP_FACTOR * periods * coeffs.period, x, v, jnp.cos(phase), jnp.sin(phase)
    return Flight(*(jnp.reshape(field, 1) for field in flight_fields))


def sample_count(coeffs, flights):
    """Compute the number of samples that the longest flight needs.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    flights : Flight or Flights
        The flights.

    Returns
    -------
    Array of int
        Number of samples, a scalar.
    """
    time_scale = flow_of(coeffs).shortest_step(coeffs, flights)
    return jnp.ceil(jnp.max(flights.time) / (SAMPLE_ANGLE * time_scale)).astype(int) + 8


def turning_clearances(coeffs, flights, n_samples):
    """Compute the smallest distance to each wall at the turning points of each flight.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    flights : Flight or Flights
        The flights.
    n_samples : int
        Number of samples of a flight.

    Returns
    -------
    distance : Array
        Smallest distance at a turning point towards the wall, of shape (rows, walls). It is inf if there is none, and
        negative if the flight passes through the wall.
    time : Array
        Time of this turning point since the start of the flight, of shape (rows, walls).
    """
    if not coeffs.walls:
        empty = jnp.zeros((len(flights.time), 0), flights.time.dtype)
        return empty, empty
    sample_time = flights.time / n_samples
    nearest_distance, cell, cell_fraction = (
        jnp.stack(wall_arrays)
        for wall_arrays in zip(*_nearest_turning_points(coeffs, flights, sample_time, n_samples), strict=True)
    )

    def newton_step(_, carry):
        time, _, _ = carry
        motions = relative_motion(coeffs, flights, time)
        distance, approach_speed, approach_acceleration = (
            jnp.stack([wall_motion[derivative][flight] for flight, wall_motion in enumerate(motions)])
            for derivative in range(3)
        )
        step = approach_speed / jnp.where(approach_acceleration == 0, 1.0, approach_acceleration)
        turning_time = jnp.clip(time - step, cell * sample_time, (cell + 1.0) * sample_time)
        return (
            turning_time,
            distance + 0.5 * step * approach_speed,
            (approach_acceleration < 0) & (abs(step) <= STEP_TOLERANCE * sample_time),
        )

    start = (
        (cell + cell_fraction) * sample_time,
        jnp.zeros_like(nearest_distance),
        jnp.zeros_like(nearest_distance, bool),
    )
    time, distance, is_turning_point = lax.fori_loop(0, NEWTON_STEPS, newton_step, start)
    return jnp.where(jnp.isfinite(nearest_distance) & is_turning_point, distance, jnp.inf).T, time.T


def is_admissible(coeffs, flights, speeds, first_grazes=False):
    """Test that flights stay between the walls and hit them with positive speeds, one after the other.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    flights : Flight or Flights
        The flights.
    speeds : Array
        Impact speeds.
    first_grazes : bool, optional
        True if the first impact is a grazing, whose speed is zero.

    Returns
    -------
    Array of bool
        A scalar.
    """
    distances, _ = turning_clearances(coeffs, flights, sample_count(coeffs, flights))
    impact_speeds = speeds[1:] if first_grazes else speeds
    tolerance = GRAZING_TOLERANCE * coeffs.length_scale if first_grazes else 0.0
    return jnp.all(impact_speeds > 0) & jnp.all(distances >= -tolerance) & jnp.all(flights.time > 0)


def state_in_flight(coeffs, flights, time):
    """Compute the state some time after the start of each flight.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    flights : Flight or Flights
        The flights.
    time : Array
        Time since the start of each flight.

    Returns
    -------
    tuple of Array
        (x, v, cosine, sine), the last two of the drive's phase.
    """
    return flow_of(coeffs).fly(coeffs, flights.x, flights.v, flights.cosine, flights.sine, time)


def relative_motion(coeffs, flights, time):
    """Compute the motion relative to each wall some time after the start of each flight.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    flights : Flight or Flights
        The flights.
    time : Array
        Time since the start of each flight.

    Returns
    -------
    list of tuple
        For each wall (distance to it, speed towards it, acceleration towards it).
    """
    return _motion_towards_walls(coeffs, *state_in_flight(coeffs, flights, time))


def _motion_towards_walls(coeffs, x, v, cosine, sine):
    """Return for each wall (distance to it, speed towards it, acceleration towards it)."""
    acceleration, _ = flow_of(coeffs).acceleration_and_jerk(coeffs, x, v, cosine, sine)
    motions = []
    for wall in coeffs.walls:
        wall_position, wall_velocity, wall_acceleration = wall_jet(wall, coeffs.frequency, cosine, sine, 2)
        motions.append(
            (
                wall.sign * (wall_position - x),
                wall.sign * subtract(v, wall_velocity),
                wall.sign * subtract(acceleration, wall_acceleration),
            )
        )
    return motions


def _nearest_turning_points(coeffs, flights, sample_time, n_samples):
    """Return for each wall the nearest turning point of the samples: (distance, cell, initial fraction of the cell).

    The distance is inf without a turning point; Newton steps begin at the fraction of the cell.
    """
    zero, advance_sample = jnp.zeros_like(sample_time), flow_of(coeffs).flight_map(coeffs, sample_time)

    def scan_cell(cell, carry):
        state, cell_start, nearest = carry
        next_state = advance_sample(*state)
        cell_end = _motion_towards_walls(coeffs, *next_state)
        nearest = [
            _nearer_turning_point(cell, sample_time, *wall_data)
            for wall_data in zip(cell_start, cell_end, nearest, strict=True)
        ]
        return next_state, cell_end, nearest

    start = flights.x, flights.v, flights.cosine, flights.sine
    nearest = [(zero + jnp.inf, zero, zero) for _ in coeffs.walls]
    return lax.fori_loop(0, n_samples, scan_cell, (start, _motion_towards_walls(coeffs, *start), nearest))[2]


def _nearer_turning_point(cell, sample_time, cell_start, cell_end, nearest):
    """Return the nearer of the previous turning point and those of a cell.

    A cell has a turning point if the speed towards the wall crosses zero downwards once. From the slopes, the speed may
    also rise above zero and fall again within the cell, or fall below zero and rise again.
    """
    (start_distance, start_speed, start_accel), (end_distance, end_speed, end_accel) = cell_start, cell_end
    crosses_zero = (start_speed > 0) & (end_speed <= 0)
    may_rise = (start_speed <= 0) & (end_speed <= 0) & (start_accel > 0) & (end_accel < 0)
    may_dip = (start_speed > 0) & (end_speed > 0) & (start_accel < 0) & (end_accel > 0)
    safe_time = jnp.where(sample_time > 0, sample_time, 1.0)
    jerk = jnp.where(may_rise | may_dip, (end_accel - start_accel) / safe_time, 1.0)
    extremal_speed = start_speed - start_accel * (end_speed - end_accel * sample_time - start_speed) / (
        jerk * safe_time
    )  # at the intersection of the lines given by the slopes
    is_nearer = crosses_zero | (may_rise & (extremal_speed > 0)) | (may_dip & (extremal_speed < 0))
    # downward zero of a parabola through the end with the smaller slope
    from_start = abs(start_accel) < abs(end_accel)
    speed, accel, offset = (
        jnp.where(from_start, *values)
        for values in ((start_speed, end_speed), (start_accel, end_accel), (0.0, sample_time))
    )
    turning_time = offset - (accel + jnp.sqrt(jnp.maximum(accel * accel - 2.0 * jerk * speed, 0.0))) / jerk
    zero_fraction = start_speed / jnp.where(crosses_zero, start_speed - end_speed, 1.0)
    cell_fraction = jnp.where(crosses_zero, zero_fraction, jnp.clip(turning_time / safe_time, 0.0, 1.0))
    turning_distance = jnp.where(
        crosses_zero,
        start_distance - 0.5 * start_speed * zero_fraction * sample_time,
        jnp.minimum(start_distance, end_distance),
    )
    candidate = (turning_distance, cell + jnp.zeros_like(sample_time), cell_fraction)
    is_nearer &= turning_distance < nearest[0]
    return jax.tree.map(lambda new, old: jnp.where(is_nearer, new, old), candidate, nearest)

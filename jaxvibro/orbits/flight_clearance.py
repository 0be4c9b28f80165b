"""Compute the clearance of the flights of an impact sequence: distance from the walls, or depth behind them.

A flight is sampled. Where the distance from a wall has a minimum between two samples, Newton steps locate this turning
point. The result is not certified. In `orbit_from_impacts`, certified flights decide if an orbit is admissible.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from continuation.array_type import Array

from ..flight.wall_motion import subtract_optional, wall_jet

SAMPLE_ANGLE = 0.1  # rad between samples, of the fastest of drive, walls and free oscillation
NEWTON_STEPS = 5  # from the guess of a parabola
GRAZING_TOLERANCE = 1e-8  # of the scene's length: smaller clearances, and speeds (length per t), count as zero
OVERLAP_FACTOR = 1.0625  # of its periods: duration of the flight without impacts that is examined
STEP_TOLERANCE = 1e-3  # of the sampling interval: largest last Newton step at a turning point
END_FRACTION = 1e-6  # of the sampling interval: a turning point so near an end of a flight is the impact, with speed 0


class Flight(NamedTuple):
    """Flights between impacts, each field of shape (rows,).

    Attributes
    ----------
    time : Array
        Duration.
    x, v, cosine, sine : Array
        State, and cosine and sine of the drive's phase, at the start.

    Notes
    -----
    `impact_equations.Flights` has the same fields and more.
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
    time_scale = coeffs.flow.sampling_time_scale(coeffs, flights)
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
    sampling_interval = flights.time / n_samples
    nearest_distance, cell_index, cell_fraction = (
        jnp.stack(wall_arrays)
        for wall_arrays in zip(*_nearest_turning_points(coeffs, flights, sampling_interval, n_samples), strict=True)
    )

    def newton_step(_, carry):
        time, _, _ = carry
        motions = relative_motion(coeffs, flights, time)
        distance, approach_speed, approach_acceleration = (
            jnp.stack([wall_motion[derivative_order][wall_index] for wall_index, wall_motion in enumerate(motions)])
            for derivative_order in range(3)
        )
        step = approach_speed / jnp.where(approach_acceleration == 0, 1.0, approach_acceleration)
        turning_time = jnp.clip(time - step, cell_index * sampling_interval, (cell_index + 1.0) * sampling_interval)
        return (
            turning_time,
            distance + 0.5 * step * approach_speed,
            (approach_acceleration < 0) & (abs(step) <= STEP_TOLERANCE * sampling_interval),
        )

    initial_carry = (
        (cell_index + cell_fraction) * sampling_interval,
        jnp.zeros_like(nearest_distance),
        jnp.zeros_like(nearest_distance, bool),
    )
    time, distance, is_turning_point = lax.fori_loop(0, NEWTON_STEPS, newton_step, initial_carry)
    return jnp.where(jnp.isfinite(nearest_distance) & is_turning_point, distance, jnp.inf).T, time.T


def impact_free_clearances(coeffs, flight):
    """Compute the smallest distance to each wall during a periodic motion without impacts.

    At rest, rounding errors determine whether the motion has turning points. Without turning points the distance is
    that at the start.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    flight : Flight
        The motion, from `impact_free_flight`.

    Returns
    -------
    distance, time : Array
        As returned by `turning_clearances`, of shape (1, walls); the distance is finite.
    """
    distance, time = turning_clearances(coeffs, flight, sample_count(coeffs, flight))
    if not coeffs.walls:
        return distance, time
    start_motions = relative_motion(coeffs, flight, jnp.zeros_like(flight.time))
    start_distance = jnp.stack([wall_distance for wall_distance, _, _ in start_motions]).T
    return jnp.where(jnp.isfinite(distance), distance, start_distance), time


def is_admissible(coeffs, flights, speeds, is_first_grazing=False):
    """Test whether flights have positive durations, stay between the walls and hit them with positive speeds.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    flights : Flight or Flights
        The flights.
    speeds : Array
        Impact speeds.
    is_first_grazing : bool, optional
        True if the first impact is a grazing, whose speed is zero.

    Returns
    -------
    Array of bool
        A scalar.
    """
    distances, _ = turning_clearances(coeffs, flights, sample_count(coeffs, flights))
    impact_speeds = speeds[1:] if is_first_grazing else speeds
    tolerance = GRAZING_TOLERANCE * coeffs.length_scale if is_first_grazing else 0.0
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
    return coeffs.flow.fly(coeffs, flights.x, flights.v, flights.cosine, flights.sine, time)


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
    acceleration, _ = coeffs.flow.acceleration_and_jerk(coeffs, x, v, cosine, sine)
    motions = []
    for wall in coeffs.walls:
        wall_position, wall_velocity, wall_acceleration = wall_jet(wall, coeffs.frequency, cosine, sine, 2)
        motions.append(
            (
                wall.sign * (wall_position - x),
                wall.sign * subtract_optional(v, wall_velocity),
                wall.sign * subtract_optional(acceleration, wall_acceleration),
            )
        )
    return motions


def _nearest_turning_points(coeffs, flights, sampling_interval, n_samples):
    """Return for each wall the turning point nearest to it: (distance, cell, initial fraction of the cell).

    A cell lies between two samples. The distance is inf without a turning point. Newton steps begin at the fraction of
    the cell.
    """
    zero, advance_sample = jnp.zeros_like(sampling_interval), coeffs.flow.flight_map(coeffs, sampling_interval)

    def scan_cell(cell_index, carry):
        state, start_motions, nearest_points = carry
        next_state = advance_sample(*state)
        end_motions = _motion_towards_walls(coeffs, *next_state)
        nearest_points = [
            _nearer_turning_point(cell_index, n_samples, sampling_interval, *wall_data)
            for wall_data in zip(start_motions, end_motions, nearest_points, strict=True)
        ]
        return next_state, end_motions, nearest_points

    start_state = flights.x, flights.v, flights.cosine, flights.sine
    nearest_points = [(zero + jnp.inf, zero, zero) for _ in coeffs.walls]
    return lax.fori_loop(
        0, n_samples, scan_cell, (start_state, _motion_towards_walls(coeffs, *start_state), nearest_points)
    )[2]


def _nearer_turning_point(cell_index, n_samples, sampling_interval, start_motion, end_motion, nearest_point):
    """Return the turning point nearer to the wall: the previous nearest one or that of a cell.

    The ends of a flight do not count: rounding decides if the motion turns at an impact whose speed is zero.

    A cell has a turning point if the speed towards the wall crosses zero downwards once. A cell also has a turning
    point if, by the accelerations at both samples, the speed rises above zero and falls again, or falls below zero and
    rises again.
    """
    (start_distance, start_speed, start_accel), (end_distance, end_speed, end_accel) = start_motion, end_motion
    crosses_zero = (start_speed > 0) & (end_speed <= 0)
    may_rise_above_zero = (start_speed <= 0) & (end_speed <= 0) & (start_accel > 0) & (end_accel < 0)
    may_dip_below_zero = (start_speed > 0) & (end_speed > 0) & (start_accel < 0) & (end_accel > 0)
    nonzero_time = jnp.where(sampling_interval > 0, sampling_interval, 1.0)
    jerk = jnp.where(may_rise_above_zero | may_dip_below_zero, (end_accel - start_accel) / nonzero_time, 1.0)
    extremal_speed = start_speed - start_accel * (end_speed - end_accel * sampling_interval - start_speed) / (
        jerk * nonzero_time
    )  # at the intersection of the lines given by the slopes
    is_nearer = (
        crosses_zero | (may_rise_above_zero & (extremal_speed > 0)) | (may_dip_below_zero & (extremal_speed < 0))
    )
    # downward zero of a parabola through the end with the smaller slope
    is_start_flatter = abs(start_accel) < abs(end_accel)
    flatter_end_speed, flatter_end_accel, flatter_end_time = (
        jnp.where(is_start_flatter, *start_and_end_values)
        for start_and_end_values in ((start_speed, end_speed), (start_accel, end_accel), (0.0, sampling_interval))
    )
    turning_time = (
        flatter_end_time
        - (
            flatter_end_accel
            + jnp.sqrt(jnp.maximum(flatter_end_accel * flatter_end_accel - 2.0 * jerk * flatter_end_speed, 0.0))
        )
        / jerk
    )
    zero_fraction = start_speed / jnp.where(crosses_zero, start_speed - end_speed, 1.0)
    cell_fraction = jnp.where(crosses_zero, zero_fraction, jnp.clip(turning_time / nonzero_time, 0.0, 1.0))
    turning_distance = jnp.where(
        crosses_zero,
        start_distance - 0.5 * start_speed * zero_fraction * sampling_interval,
        jnp.minimum(start_distance, end_distance),
    )
    cell_turning_point = (turning_distance, cell_index + jnp.zeros_like(sampling_interval), cell_fraction)
    samples_before = cell_index + cell_fraction
    is_inside = (samples_before > END_FRACTION) & (samples_before < n_samples - END_FRACTION)
    is_nearer &= is_inside & (turning_distance < nearest_point[0])
    return jax.tree.map(lambda new, old: jnp.where(is_nearer, new, old), cell_turning_point, nearest_point)

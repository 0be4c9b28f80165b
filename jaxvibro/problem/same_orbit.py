"""Compare orbits whose impacts are counted from another impact or from another period."""

import numpy as np

from ..orbits.orbit_comparison import impacts_as_points, repetition_count
from .equations import parameter_at

REPEAT_TOLERANCE = 1e-6  # largest difference of identical times and speeds


def equivalent_points(problem, sequence, value, near_z):
    """Yield unknowns near a point that describe a given orbit, its impacts counted from another one.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbits.
    sequence : ImpactSequence
        The given orbit.
    value : float
        Its parameter value.
    near_z : ndarray
        Unknowns of the point.

    Yields
    ------
    ndarray
        Unknowns.
    """
    n_impacts, orbit_duration = int(np.sum(sequence.sides != 0)), float(sequence.periods) * 2.0 * np.pi
    n_rows = len(problem.sequence.sides)
    if len(sequence.sides) != n_rows or sequence.periods != problem.sequence.periods or not n_rows:
        return
    sides, own_sides = np.asarray(sequence.sides[:n_impacts]), np.asarray(problem.sequence.sides)
    if n_impacts != int(np.sum(own_sides != 0)):
        return
    frequency = float(value) if bool(problem.parameter_marks.frequency) else float(problem.scene.frequency)
    orbit_duration, period = orbit_duration / frequency, 2.0 * np.pi / frequency
    times, speeds = sequence.times[:n_impacts], sequence.speeds[:n_impacts]
    for first_row in range(n_impacts):
        if not np.array_equal(np.roll(sides, -first_row), own_sides[:n_impacts]):
            continue
        shifted_times = np.concatenate([times[first_row:], times[:first_row] + orbit_duration])
        shifted_times = shifted_times - period * np.round((shifted_times[0] - near_z[0]) / period)
        for period_shift in (-period, 0.0, period):
            z = np.zeros(2 * n_rows + 1)
            z[:n_impacts], z[n_rows : n_rows + n_impacts], z[-1] = (
                shifted_times + period_shift,
                np.roll(speeds, -first_row),
                value,
            )
            yield z


def is_repeated(problem, z):
    """Test whether an orbit is a shorter one that is traversed more than once.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    bool
        True if the orbit is repeated. Impacts with zero speed are ignored.
    """
    return repetition_count(impact_points(problem, z), int(problem.sequence.periods), REPEAT_TOLERANCE) > 1


def match_repeated_contacts(problem, z, contact_times, sides):
    """Match the grazing contacts of a repeated orbit after each traversal of the shorter orbit.

    Returns the index of the image of each contact, an array of shape (traversals, contacts). Its first row is the
    identity. Impacts with zero speed are ignored in the comparison.
    """
    periods = int(problem.sequence.periods)
    n_repeats = repetition_count(impact_points(problem, z), periods, REPEAT_TOLERANCE)
    orbit_duration = periods * 2.0 * np.pi / parameter_at(problem, z, "frequency")
    time_differences = (
        contact_times - contact_times[:, None] - orbit_duration / n_repeats * np.arange(n_repeats)[:, None, None]
    )
    distances = abs(
        time_differences - orbit_duration * np.round(time_differences / orbit_duration)
    ) + orbit_duration * (sides != sides[:, None])
    return distances.argmin(axis=2)


def impact_points(problem, z, speed_scale=None):
    """Return the impacts of an orbit in order as points for `orbit_comparison`.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns.
    speed_scale : float, optional
        Unit of the speeds. None is the largest speed.

    Returns
    -------
    ndarray
        Points.
    """
    n_rows = len(problem.sequence.sides)
    times, speeds = z[:n_rows], z[n_rows : 2 * n_rows]
    speed_scale = speed_scale or speeds.max(initial=0.0) or 1.0
    return impacts_as_points(parameter_at(problem, z, "frequency"), times, problem.sequence.sides, speeds, speed_scale)

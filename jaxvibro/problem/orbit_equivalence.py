"""Compare orbits whose impacts may be listed from different first impacts or first periods."""

import numpy as np

from ..orbits.orbit_comparison import impacts_as_points, repetition_count

REPEAT_TOLERANCE = 1e-6  # largest difference of identical times and speeds


def equivalent_unknowns(problem, given_problem, given_z, near_z):
    """Yield unknowns near a point that describe a given orbit, for each possible first impact.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbits.
    given_problem : OrbitProblem
        Problem of the given orbit.
    given_z : ndarray
        Unknowns of the given orbit.
    near_z : ndarray
        Unknowns of the point.

    Yields
    ------
    ndarray
        Unknowns of the given orbit.
    """
    n_rows, n_impacts, sequence = problem.n_rows, problem.n_used_rows, given_problem.sequence
    if len(sequence.sides) != n_rows or sequence.periods != problem.sequence.periods or not n_rows:
        return
    if given_problem.n_used_rows != n_impacts:
        return
    sides, problem_sides = np.asarray(sequence.sides[:n_impacts]), np.asarray(problem.sequence.sides)
    orbit_duration = given_problem.duration(given_z)
    drive_period = 2.0 * np.pi / given_problem.parameter_value(given_z, "frequency")
    times, speeds, _ = given_problem.impacts(given_z)
    for first_impact_index in range(n_impacts):
        if not np.array_equal(np.roll(sides, -first_impact_index), problem_sides[:n_impacts]):
            continue
        shifted_times = np.concatenate([times[first_impact_index:], times[:first_impact_index] + orbit_duration])
        shifted_times = shifted_times - drive_period * np.round((shifted_times[0] - near_z[0]) / drive_period)
        for period_shift in (-drive_period, 0.0, drive_period):
            z = np.zeros(2 * n_rows + 1)
            z[:n_impacts], z[n_rows : n_rows + n_impacts], z[-1] = (
                shifted_times + period_shift,
                np.roll(speeds, -first_impact_index),
                given_z[-1],
            )
            yield z


def is_repeated(problem, z):
    """Test whether an orbit consists of several traversals of a shorter orbit.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    bool
        True if the orbit is repeated. Impacts with zero speed are ignored.
    """
    return repetition_count(comparison_points(problem, z), int(problem.sequence.periods), REPEAT_TOLERANCE) > 1


def match_repeated_contacts(problem, z, contact_times, contact_sides):
    """Match the grazing contacts of a repeated orbit after each traversal of the shorter orbit.

    Returns the index of the contact that corresponds to each contact after 0, 1, ... traversals, an array of shape
    (traversals, contacts). Impacts with zero speed are ignored in the search for a shorter orbit.
    """
    n_periods = int(problem.sequence.periods)
    n_traversals = repetition_count(comparison_points(problem, z), n_periods, REPEAT_TOLERANCE)
    orbit_duration = problem.duration(z)
    time_differences = (
        contact_times - contact_times[:, None] - orbit_duration / n_traversals * np.arange(n_traversals)[:, None, None]
    )
    mismatches = abs(
        time_differences - orbit_duration * np.round(time_differences / orbit_duration)
    ) + orbit_duration * (contact_sides != contact_sides[:, None])
    return mismatches.argmin(axis=2)


def comparison_points(problem, z, speed_scale=None):
    """Return the impacts of an orbit in order as points for `orbit_comparison`.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.
    speed_scale : float, optional
        Unit of the speeds. None means the largest speed.

    Returns
    -------
    ndarray
        Points.
    """
    times, speeds, _ = problem.impacts(z)
    sides = np.asarray(problem.sequence.sides[: len(times)])
    speed_scale = speed_scale or speeds.max(initial=0.0) or 1.0
    return impacts_as_points(problem.parameter_value(z, "frequency"), times, sides, speeds, speed_scale)

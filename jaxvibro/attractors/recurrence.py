"""Detect the number of periods after which states on the section recur, and the convergence of the states."""

import numpy as np

from ..scene.check import MAX_ORBIT_PERIODS


def compute_return_distances(section_points):
    """Return the largest distance of states that are n periods apart, for n from 1 to `MAX_ORBIT_PERIODS`.

    The largest distance is taken over the last `MAX_ORBIT_PERIODS` periods.

    Parameters
    ----------
    section_points : ndarray
        x and v on the section, over at least twice `MAX_ORBIT_PERIODS` periods. Array of shape (periods, lanes, 2).

    Returns
    -------
    ndarray
        Distances. Array of shape (MAX_ORBIT_PERIODS, lanes).
    """
    last_section_points = section_points[-MAX_ORBIT_PERIODS:]
    return np.stack(
        [
            abs(last_section_points - section_points[-MAX_ORBIT_PERIODS - n_periods : -n_periods]).max(axis=(0, 2))
            for n_periods in range(1, MAX_ORBIT_PERIODS + 1)
        ]
    )


def bound_limit_distance(return_distances, earlier_distances, periods_between):
    """Return a bound on the distance of lanes from their limit, from return distances at two times.

    Return distances that shrink by a factor q per period sum up to ``return_distances / (1 - q^n)``. If they do not
    shrink, the bound is infinite, except for a return distance of exactly 0. return_distances, earlier_distances:
    (MAX_ORBIT_PERIODS, lanes); periods_between: periods between the two measurements."""
    period_numbers = np.arange(1, MAX_ORBIT_PERIODS + 1)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        shrink_factors = np.where(return_distances < earlier_distances, return_distances / earlier_distances, 1.0) ** (
            period_numbers / periods_between
        )
        limit_distances = return_distances / (1.0 - shrink_factors)
    return np.where(return_distances == 0, 0.0, np.where(np.isnan(limit_distances), np.inf, limit_distances))


def find_recurrence_periods(return_distances, earlier_distances, periods_between, max_state_magnitude, dtype):
    """Return the number of periods after which each lane recurs, 0 if it has not settled.

    Parameters
    ----------
    return_distances : ndarray
        Present return distances. Array of shape (MAX_ORBIT_PERIODS, lanes).
    earlier_distances : ndarray
        Earlier return distances, of the same shape.
    periods_between : int
        Periods between the two measurements.
    max_state_magnitude : float or ndarray
        Largest magnitude of x and v, for all lanes or of shape (lanes,).
    dtype : dtype
        Floating-point type of the states.

    Returns
    -------
    ndarray
        Periods. Array of shape (lanes,).

    Notes
    -----
    A lane has settled on period n if its distance from the limit is at most ``tol = eps^(1/2) scale``, where
    scale is `max_state_magnitude`. Rounding errors end the decrease of the return distances. A lane has therefore also
    settled if its return distance is at most ``64 eps scale``, or is at most tol and no longer decreases. The result is
    the smallest divisor of the smallest such n whose return distance is at most 10 tol. Smaller return distances cannot
    be required, because the limit is known only to about tol.
    """
    machine_eps = np.finfo(dtype).eps
    tolerance = machine_eps**0.5 * max_state_magnitude
    has_stopped_shrinking = (return_distances <= 64.0 * machine_eps * max_state_magnitude) | (
        (return_distances <= tolerance) & (return_distances >= earlier_distances)
    )
    is_settled = has_stopped_shrinking | (
        bound_limit_distance(return_distances, earlier_distances, periods_between) <= tolerance
    )
    recurrence_periods = np.where(is_settled.any(axis=0), is_settled.argmax(axis=0) + 1, 0)
    returns_nearby = return_distances <= 10.0 * tolerance
    for lane in np.flatnonzero(recurrence_periods):
        recurrence_periods[lane] = _recurrent_divisor(recurrence_periods[lane], returns_nearby[:, lane])
    return recurrence_periods


def _recurrent_divisor(n_periods, returns_nearby):
    """Return the smallest divisor of `n_periods` after which the lane returns nearby; 0 for `n_periods` = 0."""
    return next(
        (
            divisor
            for divisor in range(1, n_periods + 1)
            if n_periods % divisor == 0 and (returns_nearby[divisor - 1] or divisor == n_periods)
        ),
        0,
    )

"""Detect recurrence: periods after which states on the section return, and their convergence."""

import numpy as np

from ..scene.check import MAX_ORBIT_PERIODS


def recurrence_distances(points):
    """Return the largest distances of states n periods apart, n = 1 ... `MAX_ORBIT_PERIODS`.

    The maximum is over the last `MAX_ORBIT_PERIODS` periods.

    Parameters
    ----------
    points : ndarray
        x and v on the section, over at least twice `MAX_ORBIT_PERIODS` periods. Array of shape (periods, lanes, 2).

    Returns
    -------
    ndarray
        Distances. Array of shape (MAX_ORBIT_PERIODS, lanes).
    """
    last_points = points[-MAX_ORBIT_PERIODS:]
    return np.stack(
        [
            abs(last_points - points[-MAX_ORBIT_PERIODS - n : -n]).max(axis=(0, 2))
            for n in range(1, MAX_ORBIT_PERIODS + 1)
        ]
    )


def convergence_distance(distances, previous_distances, elapsed_periods):
    """Return a bound on the distance of lanes from their limit, from the return distances now and some periods before.

    Returns that shrink by a factor q per period sum up to ``now / (1 - q^n)``. Returns that no longer shrink give no
    bound: the result is infinite, except for returns of exactly 0. distances, previous_distances: (MAX_ORBIT_PERIODS,
    lanes); elapsed_periods: periods between them.
    """
    n = np.arange(1, MAX_ORBIT_PERIODS + 1)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        shrink_factors = np.where(distances < previous_distances, distances / previous_distances, 1.0) ** (
            n / elapsed_periods
        )
        remainder = distances / (1.0 - shrink_factors)
    return np.where(distances == 0, 0.0, np.where(np.isnan(remainder), np.inf, remainder))


def recurrence_periods(distances, previous_distances, elapsed_periods, scale, dtype):
    """Return the number of periods after which each lane recurs, 0 if it has not settled.

    Parameters
    ----------
    distances : ndarray
        Return distances now. Array of shape (MAX_ORBIT_PERIODS, lanes).
    previous_distances : ndarray
        Return distances before.
    elapsed_periods : int
        Periods between them.
    scale : float or ndarray
        Largest magnitude of x and v, for all lanes or of shape (lanes,).
    dtype : dtype
        Floating-point type of the states.

    Returns
    -------
    ndarray
        Periods. Array of shape (lanes,).

    Notes
    -----
    A lane has settled on period n if it is nearer than ``eps^(1/2) scale`` to its limit. Rounding ends the decrease of
    the returns. So returns below ``64 eps scale``, or below ``eps^(1/2) scale`` and no longer decreasing, count as
    settled too: an orbit that stretches rounding before it contracts it does not return more closely. The result is the
    first divisor of n whose return is within ten times that distance, since the lane is not known better.
    """
    eps = np.finfo(dtype).eps
    tolerance = eps**0.5 * scale
    is_stationary = (distances <= 64.0 * eps * scale) | ((distances <= tolerance) & (distances >= previous_distances))
    is_settled = is_stationary | (convergence_distance(distances, previous_distances, elapsed_periods) <= tolerance)
    periods = np.where(is_settled.any(axis=0), is_settled.argmax(axis=0) + 1, 0)
    is_recurrent = distances <= 10.0 * tolerance
    for lane in np.flatnonzero(periods):
        periods[lane] = _smallest_divisor(periods[lane], is_recurrent[:, lane])
    return periods


def _smallest_divisor(n, is_recurrent):
    """Return the smallest divisor of n that recurs, 0 for n = 0."""
    return next(
        (divisor for divisor in range(1, n + 1) if n % divisor == 0 and (is_recurrent[divisor - 1] or divisor == n)), 0
    )

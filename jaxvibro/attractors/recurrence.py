"""Recurrence: when the states on Sigma come back, after how many periods, and whether they still come nearer."""

import numpy as np

from ..scene.check import MAX_ORBIT_PERIODS


def recurrence_distances(points):
    """How far apart states are that lie n = 1 ... MOST_PERIODS periods apart, the largest over as many of the last.

    points: x and v on Sigma, shape (periods, lanes, 2), 2 MOST_PERIODS periods at least. Result: (MOST_PERIODS, lanes).
    """
    last_points = points[-MAX_ORBIT_PERIODS:]
    return np.stack(
        [
            abs(last_points - points[-MAX_ORBIT_PERIODS - n : -n]).max(axis=(0, 2))
            for n in range(1, MAX_ORBIT_PERIODS + 1)
        ]
    )


def convergence_distance(distances, previous_distances, elapsed_periods):
    """How far lanes may still be from what they converge to, from the returns now and some periods before.

    Returns that shrink by a factor q a period sum up to now / (1 - q^n). Those that have stopped shrinking tell
    nothing: infinite, but for returns of exactly 0. distances, previous_distances: (MOST_PERIODS, lanes),
    elapsed_periods: periods between them."""
    n = np.arange(1, MAX_ORBIT_PERIODS + 1)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        shrink_factors = np.where(distances < previous_distances, distances / previous_distances, 1.0) ** (
            n / elapsed_periods
        )
        remainder = distances / (1.0 - shrink_factors)
    return np.where(distances == 0, 0.0, np.where(np.isnan(remainder), np.inf, remainder))


def recurrence_periods(distances, previous_distances, elapsed_periods, scale, dtype):
    """The number of periods after which each lane recurs, 0 where it has not settled; shape (lanes,).

    A lane has settled on period n where it is nearer than eps^(1/2) scale to what it converges to. Rounding stops the
    returns from shrinking: those below 64 eps scale, or below eps^(1/2) scale and no longer shrinking, count as settled
    too: an orbit that stretches rounding before it contracts it comes back no better. Of the divisors of n the first is
    taken whose return lies within ten times that distance, since the lane is not known better. scale: of x and v, the
    largest, one for all lanes or (lanes,).
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
    return next(
        (divisor for divisor in range(1, n + 1) if n % divisor == 0 and (is_recurrent[divisor - 1] or divisor == n)), 0
    )

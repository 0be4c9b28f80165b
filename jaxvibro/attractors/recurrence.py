"""Recurrence: when the states on Sigma come back, after how many periods, and whether they still come nearer."""

import numpy as np

from ..scene.check import MOST_PERIODS


def returns(points):
    """How far apart states are that lie n = 1 ... MOST_PERIODS periods apart, the largest over as many of the last.

    points: x and v on Sigma, shape (periods, lanes, 2), 2 MOST_PERIODS periods at least. Result: (MOST_PERIODS, lanes).
    """
    last = points[-MOST_PERIODS:]
    return np.stack([abs(last - points[-MOST_PERIODS - n : -n]).max(axis=(0, 2)) for n in range(1, MOST_PERIODS + 1)])


def remaining(now, before, passed):
    """How far lanes may still be from what they converge to, from the returns now and some periods before.

    Returns that shrink by a factor q a period sum up to now / (1 - q^n). Those that have stopped shrinking tell
    nothing: infinite, but for returns of exactly 0. now, before: (MOST_PERIODS, lanes), passed: periods between them.
    """
    n = np.arange(1, MOST_PERIODS + 1)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        shrink = np.where(now < before, now / before, 1.0) ** (n / passed)
        left = now / (1.0 - shrink)
    return np.where(now == 0, 0.0, np.where(np.isnan(left), np.inf, left))


def settled_periods(now, before, passed, scale, dtype):
    """The number of periods after which each lane recurs, 0 where it has not settled; shape (lanes,).

    A lane has settled on period n where it is nearer than eps^(1/2) scale to what it converges to. Rounding stops the
    returns from shrinking: those below 64 eps scale, or below eps^(1/2) scale and no longer shrinking, count as settled
    too: an orbit that stretches rounding before it contracts it comes back no better. Of the divisors of n the first is
    taken whose return lies within ten times that distance, since the lane is not known better. scale: of x and v, the
    largest, one for all lanes or (lanes,).
    """
    eps = np.finfo(dtype).eps
    near = eps**0.5 * scale
    still = (now <= 64.0 * eps * scale) | ((now <= near) & (now >= before))
    settled = still | (remaining(now, before, passed) <= near)
    first = np.where(settled.any(axis=0), settled.argmax(axis=0) + 1, 0)
    recurs = now <= 10.0 * near
    for lane in np.flatnonzero(first):
        first[lane] = _least_divisor(first[lane], recurs[:, lane])
    return first


def _least_divisor(n, recurs):
    return next((m for m in range(1, n + 1) if n % m == 0 and (recurs[m - 1] or m == n)), 0)

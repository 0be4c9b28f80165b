"""The least distance between two walls over a drive cycle: moving walls may neither touch nor cross."""

from math import gcd

import numpy as np

POINTS_AT_ONCE = 1 << 20  # bounds the memory of one search: 8 MB an array


def least_gap(left, right):
    """How near two walls come over the cycle: one number a scene of the batch, float64, in the walls' unit.

    Its sign is certain: above 0 they never touch. It is the least gap itself, except where the walls' harmonics differ:
    there it is a bound that shows the gap to stay open, or the least value that a search met.
    left, right: `Wall`s whose numbers are known.
    """
    (low_cos, low_sin, low_harmonic), (high_cos, high_sin, high_harmonic) = _wave(left), _wave(right)
    mean = np.float64(right.position) - np.float64(left.position)
    if low_harmonic == high_harmonic:
        return mean - np.hypot(high_cos - low_cos, high_sin - low_sin)
    gap = mean - np.hypot(low_cos, low_sin) - np.hypot(high_cos, high_sin)
    waves = np.stack([np.ravel(one) for one in np.broadcast_arrays(mean, low_cos, low_sin, high_cos, high_sin)])
    common = gcd(low_harmonic, high_harmonic)
    return _searched(gap, waves, low_harmonic // common, high_harmonic // common)


def _wave(wall):
    """B cos p, B sin p and m of a wall's motion B cos(m theta + p)."""
    if wall.motion is None:
        return np.float64(0.0), np.float64(0.0), 1
    size, phase = np.float64(wall.motion.amplitude), np.float64(wall.motion.phase)
    return size * np.cos(phase), size * np.sin(phase), wall.motion.harmonic


def _searched(gap, waves, low_harmonic, high_harmonic):
    """The gaps with those that the sum of the amplitudes leaves in doubt replaced by what a search finds."""
    flat = np.array(gap).ravel()
    doubtful = np.flatnonzero(flat <= 0)
    block = max(1, POINTS_AT_ONCE // (8 * max(low_harmonic, high_harmonic)))
    for start in range(0, doubtful.size, block):
        lanes = doubtful[start : start + block]
        flat[lanes] = _search(waves[:, lanes], low_harmonic, high_harmonic)
    return flat.reshape(np.shape(gap))


def _search(waves, low_harmonic, high_harmonic):
    """The least gap met in each lane, 0 at most where the walls touch.

    Branch and bound: within h of c a gap f is at least f(c) - h abs f'(c) - h^2 max abs f'' / 2. Where that is above 0
    an interval is done, else it is halved; one in which f can vary by rounding alone counts as a touch.
    """
    sizes = np.hypot(waves[1], waves[2]), np.hypot(waves[3], waves[4])
    bend = sizes[0] * low_harmonic**2 + sizes[1] * high_harmonic**2
    noise = 4 * np.finfo(np.float64).eps * (abs(waves[0]) + sizes[0] + sizes[1])
    points = 8 * max(low_harmonic, high_harmonic)
    half = np.pi / points
    least = np.full(waves.shape[1], np.inf)
    lane = np.repeat(np.arange(least.size), points)
    centre = np.tile((2 * np.arange(points) + 1) * half, least.size)
    while lane.size:
        value, slope = _gap_and_slope(waves[:, lane], centre, low_harmonic, high_harmonic)
        fall = half * abs(slope) + half**2 * bend[lane] / 2
        open_here = value > fall
        touch = ~open_here & (fall < noise[lane])
        np.minimum.at(least, lane, np.where(touch, np.minimum(value, 0.0), value))
        half /= 2
        keep = ~open_here & (least[lane] > 0)
        lane = np.repeat(lane[keep], 2)
        centre = (centre[keep, None] + np.array([-half, half])).ravel()
    return least


def _gap_and_slope(waves, theta, low_harmonic, high_harmonic):
    mean, low_cos, low_sin, high_cos, high_sin = waves
    low, high = low_harmonic * theta, high_harmonic * theta
    value = mean + high_cos * np.cos(high) - high_sin * np.sin(high) - low_cos * np.cos(low) + low_sin * np.sin(low)
    slope = low_harmonic * (low_cos * np.sin(low) + low_sin * np.cos(low))
    slope = slope - high_harmonic * (high_cos * np.sin(high) + high_sin * np.cos(high))
    return value, slope

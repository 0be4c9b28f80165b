"""Compute the smallest distance between two walls over a drive cycle, to check that they neither touch nor cross."""

from math import gcd

import numpy as np

MAX_BATCH_POINTS = 1 << 20  # bounds the memory of one search: 8 MB per array


def minimum_gap(left, right):
    """Return the smallest distance of two known walls over the cycle, per scene of the batch.

    The result is float64, in the unit of the positions. Its sign is certain: above 0 the walls never touch. It is the
    exact minimum unless the harmonics of the walls differ. Then it is a lower bound that proves the gap to stay open,
    or the smallest value in a search.
    """
    (left_cos, left_sin, left_harmonic), (right_cos, right_sin, right_harmonic) = (
        _motion_components(left),
        _motion_components(right),
    )
    mean_gap = np.float64(right.position) - np.float64(left.position)
    if left_harmonic == right_harmonic:
        return mean_gap - np.hypot(right_cos - left_cos, right_sin - left_sin)
    gap = mean_gap - np.hypot(left_cos, left_sin) - np.hypot(right_cos, right_sin)
    lane_waves = np.stack(
        [np.ravel(array) for array in np.broadcast_arrays(mean_gap, left_cos, left_sin, right_cos, right_sin)]
    )
    common_factor = gcd(left_harmonic, right_harmonic)
    return _search_doubtful(gap, lane_waves, left_harmonic // common_factor, right_harmonic // common_factor)


def _motion_components(wall):
    """Return B cos p, B sin p and m of a wall's motion B cos(m theta + p)."""
    if wall.motion is None:
        return np.float64(0.0), np.float64(0.0), 1
    amplitude, phase = np.float64(wall.motion.amplitude), np.float64(wall.motion.phase)
    return amplitude * np.cos(phase), amplitude * np.sin(phase), wall.motion.harmonic


def _search_doubtful(gap, waves, left_harmonic, right_harmonic):
    """Replace the bounds that the sum of the amplitudes leaves undecided by results of a search."""
    flat_gaps = np.array(gap).ravel()
    doubtful_lanes = np.flatnonzero(flat_gaps <= 0)
    block_size = max(1, MAX_BATCH_POINTS // (8 * max(left_harmonic, right_harmonic)))
    for start in range(0, doubtful_lanes.size, block_size):
        lanes = doubtful_lanes[start : start + block_size]
        flat_gaps[lanes] = _branch_and_bound(waves[:, lanes], left_harmonic, right_harmonic)
    return flat_gaps.reshape(np.shape(gap))


def _branch_and_bound(waves, left_harmonic, right_harmonic):
    """Return the smallest gap in each lane, at most 0 where the walls touch.

    Branch and bound: within h of c a gap f is at least f(c) - h |f'(c)| - h^2 max |f''| / 2. An interval is finished if
    this bound is above 0, else it is halved. An interval in which f varies by rounding alone counts as a contact.
    """
    amplitudes = np.hypot(waves[1], waves[2]), np.hypot(waves[3], waves[4])
    max_curvature = amplitudes[0] * left_harmonic**2 + amplitudes[1] * right_harmonic**2
    rounding = 4 * np.finfo(np.float64).eps * (abs(waves[0]) + amplitudes[0] + amplitudes[1])
    n_points = 8 * max(left_harmonic, right_harmonic)
    half_width = np.pi / n_points
    min_gap = np.full(waves.shape[1], np.inf)
    lane = np.repeat(np.arange(min_gap.size), n_points)
    centre = np.tile((2 * np.arange(n_points) + 1) * half_width, min_gap.size)
    while lane.size:
        gap, slope = _gap_and_slope(waves[:, lane], centre, left_harmonic, right_harmonic)
        max_decrease = half_width * abs(slope) + half_width**2 * max_curvature[lane] / 2
        is_open = gap > max_decrease
        is_touching = ~is_open & (max_decrease < rounding[lane])
        np.minimum.at(min_gap, lane, np.where(is_touching, np.minimum(gap, 0.0), gap))
        half_width /= 2
        is_unresolved = ~is_open & (min_gap[lane] > 0)
        lane = np.repeat(lane[is_unresolved], 2)
        centre = (centre[is_unresolved, None] + np.array([-half_width, half_width])).ravel()
    return min_gap


def _gap_and_slope(waves, theta, left_harmonic, right_harmonic):
    """Return the gap and its derivative with respect to theta."""
    mean_gap, left_cos, left_sin, right_cos, right_sin = waves
    left_angle, right_angle = left_harmonic * theta, right_harmonic * theta
    gap = (
        mean_gap
        + right_cos * np.cos(right_angle)
        - right_sin * np.sin(right_angle)
        - left_cos * np.cos(left_angle)
        + left_sin * np.sin(left_angle)
    )
    slope = left_harmonic * (left_cos * np.sin(left_angle) + left_sin * np.cos(left_angle))
    slope = slope - right_harmonic * (right_cos * np.sin(right_angle) + right_sin * np.cos(right_angle))
    return gap, slope

"""Whether a record is of a settled motion, which repeats: it then holds what one round does, and no more."""

import numpy as np
import scipy

from .records import SampleRecord

MAX_PERIODS = 8  # drive periods of a round
PHASE_DECIMALS = 6  # of a round: as near are two times of it the same
MIN_ROUNDS = 3  # a record of fewer is not called settled
REJECTION_PROBABILITY = 1e-3  # of a settled record's noise: as rarely is it taken for a motion that still changes


def count_impact_values(data, frequency, has_free_frequency):
    """How many numbers a settled record of impacts holds; None where it is none. has_free_frequency: whether the
    frequency is, and with it the period is one more; the phase's origin, where it is not known, takes none away: it is
    one of the unknowns."""
    times, sides = np.asarray(data.times), np.asarray(data.sides)
    for n_impacts in range(1, len(times) // MIN_ROUNDS + 1):
        if np.any(sides[n_impacts:] != sides[:-n_impacts]):
            continue
        period = 2.0 * np.pi / frequency
        round_periods = (times[n_impacts:] - times[:-n_impacts]) / period
        periods = np.round(np.mean(round_periods))
        if not 1 <= periods <= MAX_PERIODS:
            continue
        if _is_periodic(times, n_impacts, None if has_free_frequency else periods * period, data.sigma):
            return n_impacts + bool(has_free_frequency)
    return None


def count_sample_values(data: SampleRecord, frequency: float) -> int | None:
    """How many numbers a settled record of samples holds, those of one round; None where it is none, or its times do
    not come round."""
    measurements, sigma = data.measured
    for periods in range(1, MAX_PERIODS + 1):
        rounds_elapsed = np.asarray(data.times) * frequency / (2.0 * np.pi * periods)
        round_fractions = np.round((rounds_elapsed - rounds_elapsed[0]) % 1.0, PHASE_DECIMALS) % 1.0
        _, group_indices, group_sizes = np.unique(round_fractions, return_inverse=True, return_counts=True)
        if np.min(group_sizes) < MIN_ROUNDS:
            continue
        group_means = np.stack([np.bincount(group_indices, column) / group_sizes for column in measurements.T], 1)
        residuals = (measurements - group_means[group_indices]) / sigma
        if np.sum(residuals**2) <= scipy.special.chdtri(residuals.size - group_means.size, REJECTION_PROBABILITY):
            return int(group_means.size)
    return None


def _is_periodic(times, n_impacts, round_time, sigma):
    """Whether times are those of the first impacts, over and over, within their errors."""
    impact_indices, round_indices = np.arange(len(times)) % n_impacts, np.arange(len(times)) // n_impacts
    design_matrix = (impact_indices[:, None] == np.arange(n_impacts)).astype(float)
    targets = times if round_time is None else times - round_indices * round_time
    if round_time is None:
        design_matrix = np.column_stack([design_matrix, round_indices])
    solution = np.linalg.lstsq(design_matrix, targets, rcond=None)[0]
    residuals = (targets - design_matrix @ solution) / sigma
    return bool(
        residuals @ residuals
        <= scipy.special.chdtri(max(1, len(times) - design_matrix.shape[1]), REJECTION_PROBABILITY)
    )

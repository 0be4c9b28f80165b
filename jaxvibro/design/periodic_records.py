"""Detect records of settled motions, which repeat and hold no more values than one cycle."""

import numpy as np
import scipy

from .records import SampleRecord

MAX_PERIODS = 8  # largest number of drive periods of a cycle
PHASE_DECIMALS = 6  # decimals of the fraction of a cycle to which equal times agree
MIN_ROUNDS = 3  # smallest number of cycles of a settled record
REJECTION_PROBABILITY = 1e-3  # probability that noise makes a settled record appear unsettled


def count_impact_values(data, frequency, has_free_frequency):
    """Count the independent values of a settled record of impacts; None if the motion is not settled.

    A free frequency adds one value, the period. An unknown origin of the phase removes none, because it is one of the
    unknowns.
    """
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
    """Count the independent values of a settled record of samples, those of one cycle.

    Returns None if the motion is not settled, or if its times do not repeat.
    """
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
    """Check that times repeat those of the first impacts within their errors."""
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

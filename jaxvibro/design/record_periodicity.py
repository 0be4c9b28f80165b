"""Detect records of settled (periodic) motions, and count their independent values."""

import numpy as np
import scipy

from .records import SampleRecord

MAX_PERIODS = 8  # largest number of drive periods of a cycle
PHASE_DECIMALS = 6  # decimals of the fraction of a cycle to which equal times agree
MIN_ROUNDS = 3  # smallest number of cycles of a settled record
REJECTION_PROBABILITY = 1e-3  # probability that noise makes a settled record appear unsettled


def count_impact_information(data, drive_frequency, has_free_frequency):
    """Count the independent values of a settled record of impacts.

    Each impact in a cycle yields one value. A free frequency adds one value, the period. An unknown phase does not
    reduce the number, because the phase is counted as a free parameter. Returns None if the motion is not settled.
    """
    times, sides = np.asarray(data.times), np.asarray(data.sides)
    for impacts_per_cycle in range(1, len(times) // MIN_ROUNDS + 1):
        if np.any(sides[impacts_per_cycle:] != sides[:-impacts_per_cycle]):
            continue
        drive_period = 2.0 * np.pi / drive_frequency
        periods_per_cycle = (times[impacts_per_cycle:] - times[:-impacts_per_cycle]) / drive_period
        periods = np.round(np.mean(periods_per_cycle))
        if not 1 <= periods <= MAX_PERIODS:
            continue
        if _do_times_repeat(
            times, impacts_per_cycle, None if has_free_frequency else periods * drive_period, data.sigma
        ):
            return impacts_per_cycle + bool(has_free_frequency)
    return None


def count_sample_information(data: SampleRecord, drive_frequency: float) -> int | None:
    """Count the independent values of a settled record of samples: the values in one cycle.

    Returns None if the motion is not settled, or if the sampling phases do not repeat from cycle to cycle.
    """
    measurements, sigma = data.measured
    for periods in range(1, MAX_PERIODS + 1):
        elapsed_cycles = np.asarray(data.times) * drive_frequency / (2.0 * np.pi * periods)
        cycle_fractions = np.round((elapsed_cycles - elapsed_cycles[0]) % 1.0, PHASE_DECIMALS) % 1.0
        _, phase_indices, samples_per_phase = np.unique(cycle_fractions, return_inverse=True, return_counts=True)
        if np.min(samples_per_phase) < MIN_ROUNDS:
            continue
        phase_means = np.stack([np.bincount(phase_indices, column) / samples_per_phase for column in measurements.T], 1)
        residuals = (measurements - phase_means[phase_indices]) / sigma
        if np.sum(residuals**2) <= scipy.special.chdtri(residuals.size - phase_means.size, REJECTION_PROBABILITY):
            return int(phase_means.size)
    return None


def _do_times_repeat(times, impacts_per_cycle, cycle_time, sigma):
    """Check that impact times repeat within their errors after each `impacts_per_cycle` impacts.

    `cycle_time` is the duration of a cycle, or None if it is unknown.
    """
    index_in_cycle, cycle_indices = (
        np.arange(len(times)) % impacts_per_cycle,
        np.arange(len(times)) // impacts_per_cycle,
    )
    regression_matrix = (index_in_cycle[:, None] == np.arange(impacts_per_cycle)).astype(float)
    fit_targets = times if cycle_time is None else times - cycle_indices * cycle_time
    if cycle_time is None:
        regression_matrix = np.column_stack([regression_matrix, cycle_indices])
    solution = np.linalg.lstsq(regression_matrix, fit_targets, rcond=None)[0]
    residuals = (fit_targets - regression_matrix @ solution) / sigma
    return bool(
        residuals @ residuals
        <= scipy.special.chdtri(max(1, len(times) - regression_matrix.shape[1]), REJECTION_PROBABILITY)
    )

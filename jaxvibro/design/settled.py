"""Whether a record is of a settled motion, which repeats: it then holds what one round does, and no more."""

import numpy as np
import scipy

from .records import SampleRecord

LONGEST = 8  # drive periods of a round
PLACES = 6  # of a round: as near are two times of it the same
ROUNDS = 3  # a record of fewer is not called settled
RARE = 1e-3  # of a settled record's noise: as rarely is it taken for a motion that still changes


def impacts_hold(data, frequency, free):
    """How many numbers a settled record of impacts holds; None where it is none. free: whether the frequency is, and
    with it the period is one more; the phase's origin, where it is not known, takes none away: it is one of the
    unknowns."""
    times, sides = np.asarray(data.times), np.asarray(data.sides)
    for impacts in range(1, len(times) // ROUNDS + 1):
        if np.any(sides[impacts:] != sides[:-impacts]):
            continue
        period = 2.0 * np.pi / frequency
        rounds = (times[impacts:] - times[:-impacts]) / period
        periods = np.round(np.mean(rounds))
        if not 1 <= periods <= LONGEST:
            continue
        if _repeats(times, impacts, None if free else periods * period, data.sigma):
            return impacts + bool(free)
    return None


def samples_hold(data: SampleRecord, frequency: float) -> int | None:
    """How many numbers a settled record of samples holds, those of one round; None where it is none, or its times do
    not come round."""
    measured, sigma = data.measured
    for periods in range(1, LONGEST + 1):
        turns = np.asarray(data.times) * frequency / (2.0 * np.pi * periods)
        part = np.round((turns - turns[0]) % 1.0, PLACES) % 1.0
        _, which, often = np.unique(part, return_inverse=True, return_counts=True)
        if np.min(often) < ROUNDS:
            continue
        means = np.stack([np.bincount(which, one) / often for one in measured.T], 1)
        left = (measured - means[which]) / sigma
        if np.sum(left**2) <= scipy.special.chdtri(left.size - means.size, RARE):
            return int(means.size)
    return None


def _repeats(times, impacts, span, sigma):
    """Whether times are those of the first impacts, over and over, within their errors."""
    which, turn = np.arange(len(times)) % impacts, np.arange(len(times)) // impacts
    design = (which[:, None] == np.arange(impacts)).astype(float)
    given = times if span is None else times - turn * span
    if span is None:
        design = np.column_stack([design, turn])
    found = np.linalg.lstsq(design, given, rcond=None)[0]
    left = (given - design @ found) / sigma
    return bool(left @ left <= scipy.special.chdtri(max(1, len(times) - design.shape[1]), RARE))

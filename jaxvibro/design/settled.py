"""Whether a record of impacts is of a settled motion, which repeats: it then holds the impacts of one round alone."""

import numpy as np
from scipy import special

LONGEST = 8  # drive periods of a round
ROUNDS = 3  # a record of fewer is not called settled
RARE = 1e-3  # of a settled record's noise: as rarely is it taken for a motion that still changes


def settled(data, frequency, free):
    """How many numbers a settled record holds; None where it is none. free: whether the frequency is, and with it the
    period is one more; the phase's origin, where it is not known, takes none away: it is one of the unknowns."""
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


def _repeats(times, impacts, span, sigma):
    """Whether times are those of the first impacts, over and over, within their errors."""
    which, turn = np.arange(len(times)) % impacts, np.arange(len(times)) // impacts
    design = (which[:, None] == np.arange(impacts)).astype(float)
    given = times if span is None else times - turn * span
    if span is None:
        design = np.column_stack([design, turn])
    found = np.linalg.lstsq(design, given, rcond=None)[0]
    left = (given - design @ found) / sigma
    return bool(left @ left <= special.chdtri(max(1, len(times) - design.shape[1]), RARE))

"""Estimate standard errors of means along trajectories by batch means, for correlated samples."""

import numpy as np

MIN_BATCHES = 8  # fewest batches of a copy for a standard error that counts the copies one by one
MIN_TIME_BATCHES = 32  # fewest batches in time for a standard error of the means over the copies
EXCESS_ERRORS = 3.0  # standard errors of its own by which the second estimate must exceed the first


def standard_error(block_sums, block_periods):
    """Estimate the standard error of a mean per period by batch means.

    Parameters
    ----------
    block_sums : ndarray
        Sums over blocks of periods. Array of shape (blocks, copies).
    block_periods : int
        Periods of a block.

    Returns
    -------
    float
        Standard error; inf for fewer than `MIN_BATCHES` blocks.

    Notes
    -----
    Blocks of a copy are correlated, so batches of 1, 2, 4, ... blocks are formed. The error grows with their length
    until they are long enough, and the largest error counts. Copies may be correlated as well. The spread in time of
    the mean over the copies assumes no independence between them, and is used if it is larger beyond doubt.
    """
    errors, batch_length = [np.inf if len(block_sums) < MIN_BATCHES else 0.0], 1
    while (n_batches := len(block_sums) // batch_length) >= MIN_BATCHES:
        means = block_sums[: n_batches * batch_length].reshape(n_batches, batch_length, -1).mean(axis=1) / block_periods
        errors.append(means.std(ddof=1) / means.size**0.5)
        common_error = means.mean(axis=1).std(ddof=1) / n_batches**0.5
        if n_batches >= MIN_TIME_BATCHES and common_error > errors[-1] * (
            1.0 + EXCESS_ERRORS / (2.0 * n_batches) ** 0.5
        ):
            errors.append(common_error)
        batch_length *= 2
    return float(max(errors))

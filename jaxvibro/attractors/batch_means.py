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
        Sums of the quantity over blocks of periods, one column per copy of the motion. Array of shape (blocks, copies).
    block_periods : int
        Periods of a block.

    Returns
    -------
    float
        Standard error; inf for fewer than `MIN_BATCHES` blocks.

    Notes
    -----
    Successive blocks of a copy are correlated. Batches of 1, 2, 4, ... blocks are therefore formed. The estimated error
    grows with the length of the batches until the batches are independent. The result is the largest estimate.

    The copies may be correlated as well. A second estimate, from the variation in time of the mean over the copies,
    does not assume independent copies. The second estimate is included if there are at least `MIN_TIME_BATCHES` batches
    and it is significantly larger than the first.
    """
    error_estimates, blocks_per_batch = [np.inf if len(block_sums) < MIN_BATCHES else 0.0], 1
    while (n_batches := len(block_sums) // blocks_per_batch) >= MIN_BATCHES:
        batch_means = (
            block_sums[: n_batches * blocks_per_batch].reshape(n_batches, blocks_per_batch, -1).mean(axis=1)
            / block_periods
        )
        error_estimates.append(batch_means.std(ddof=1) / batch_means.size**0.5)
        time_scatter_error = batch_means.mean(axis=1).std(ddof=1) / n_batches**0.5
        if n_batches >= MIN_TIME_BATCHES and time_scatter_error > error_estimates[-1] * (
            1.0 + EXCESS_ERRORS / (2.0 * n_batches) ** 0.5
        ):
            error_estimates.append(time_scatter_error)
        blocks_per_batch *= 2
    return float(max(error_estimates))

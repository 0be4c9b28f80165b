"""How well a mean along trajectories is known: standard errors by batch means, of numbers that hang together."""

import numpy as np

MIN_BATCHES = 8  # batches of a copy that a standard error is told from, where copies count one by one
MIN_TIME_BATCHES = 32  # batches in time, where only their means over the copies count
EXCESS_ERRORS = 3.0  # standard errors of its own by which the second estimate must exceed the first


def standard_error(block_sums, block_periods):
    """The standard error of the mean a period, from sums over blocks of so many periods, shape (blocks, copies).

    Blocks of a copy hang together, so batches of 1, 2, 4, ... blocks are tried, which makes the error grow until they
    are long enough: the largest counts. Copies may hang together as well; the spread in time of the copies' mean knows
    of no independence between them, and takes over where it is larger beyond doubt. inf for less than FEWEST blocks.
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

"""How well a mean along trajectories is known: standard errors by batch means, of numbers that hang together."""

import numpy as np

FEWEST = 8  # batches of a copy that a standard error is told from, where copies count one by one
ROWS = 32  # batches in time, where only their means over the copies count
DOUBT = 3.0  # standard errors of its own by which the second estimate must exceed the first


def standard_error(sums, periods):
    """The standard error of the mean a period, from sums over blocks of so many periods, shape (blocks, copies).

    Blocks of a copy hang together, so batches of 1, 2, 4, ... blocks are tried, which makes the error grow until they
    are long enough: the largest counts. Copies may hang together as well; the spread in time of the copies' mean knows
    of no independence between them, and takes over where it is larger beyond doubt. inf for less than FEWEST blocks.
    """
    found, width = [np.inf if len(sums) < FEWEST else 0.0], 1
    while (count := len(sums) // width) >= FEWEST:
        batches = sums[: count * width].reshape(count, width, -1).mean(axis=1) / periods
        found.append(batches.std(ddof=1) / batches.size**0.5)
        together = batches.mean(axis=1).std(ddof=1) / count**0.5
        if count >= ROWS and together > found[-1] * (1.0 + DOUBT / (2.0 * count) ** 0.5):
            found.append(together)
        width *= 2
    return float(max(found))

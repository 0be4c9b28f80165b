"""Find runs of equal consecutive entries of an array."""

from itertools import pairwise

import numpy as np


def find_equal_runs(entries):
    """Return the maximal runs of equal consecutive entries of an array.

    Parameters
    ----------
    entries : ndarray
        Array of shape (entries,).

    Returns
    -------
    list of tuple of int
        First index and one past the last index of each run.
    """
    run_boundaries = [0, *(np.flatnonzero(entries[1:] != entries[:-1]) + 1).tolist(), len(entries)]
    return [(start, stop) for start, stop in pairwise(run_boundaries) if stop > start]

"""Runs of equal entries."""

from itertools import pairwise

import numpy as np


def find_equal_runs(entries):
    """[(first, one past the last)] of each run of equal entries, (entries,)."""
    edges = [0, *(np.flatnonzero(entries[1:] != entries[:-1]) + 1).tolist(), len(entries)]
    return [(start, stop) for start, stop in pairwise(edges) if stop > start]

"""What is asked of compiled code, brought to few shapes, so that few programs are compiled."""

import jax
import numpy as np

from ..scene.scene import changed

LEAST_ROWS = 64  # rows are filled up to a power of two
MOST = 8  # free numbers: derivatives are worked out by a multiple of as many


def filled(given, least=LEAST_ROWS, axis=0):
    """An array of floats with its last row repeated until there are `least`, or a power of two times as many."""
    given, full = np.asarray(given, float), least
    while full < given.shape[axis]:
        full *= 2
    widths = [(0, full - given.shape[axis] if k == axis % given.ndim else 0) for k in range(given.ndim)]
    return np.pad(given, widths, mode="edge")


def with_ways(scene, names, numbers):
    """(the scene whose numbers of these names are others, the directions of these in the space of all its numbers, one
    after the other, then none)."""
    there = jax.tree.map(np.asarray, changed(scene, dict(zip(names, numbers, strict=True))))
    zero = jax.tree.map(lambda leaf: np.zeros(()), there)
    ways = [changed(zero, {name: np.ones(())}) for name in names]
    ways += [zero] * (-len(ways) % MOST)
    return there, jax.tree.map(lambda *leaves: np.stack(leaves), *ways)

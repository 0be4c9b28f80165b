"""What is asked of compiled code, brought to few shapes, so that few programs are compiled."""

import jax
import numpy as np

from ..scene.scene import replace_unchecked

MIN_ROWS = 64  # rows are filled up to a power of two
PARAMETER_BLOCK = 8  # free numbers: derivatives are worked out by a multiple of as many


def pad_to_power_of_two(array, min_length=MIN_ROWS, axis=0):
    """An array of floats with its last row repeated until there are `min_length`, or a power of two times as many."""
    array, padded_length = np.asarray(array, float), min_length
    while padded_length < array.shape[axis]:
        padded_length *= 2
    pad_widths = [(0, padded_length - array.shape[axis] if k == axis % array.ndim else 0) for k in range(array.ndim)]
    return np.pad(array, pad_widths, mode="edge")


def scene_with_tangents(scene, names, parameters):
    """(the scene whose numbers of these names are others, the directions of these in the space of all its numbers, one
    after the other, then none)."""
    changed_scene = jax.tree.map(np.asarray, replace_unchecked(scene, dict(zip(names, parameters, strict=True))))
    zero_scene = jax.tree.map(lambda leaf: np.zeros(()), changed_scene)
    tangents = [replace_unchecked(zero_scene, {name: np.ones(())}) for name in names]
    tangents += [zero_scene] * (-len(tangents) % PARAMETER_BLOCK)
    return changed_scene, jax.tree.map(lambda *leaves: np.stack(leaves), *tangents)

"""Pad arguments of compiled functions to few shapes, so that few programs are compiled."""

import jax
import numpy as np

from ..scene.scene import replace_unchecked

MIN_ROWS = 64  # smallest number of rows; more are padded to a power of two times this number
PARAMETER_BLOCK = 8  # the number of tangents is padded to a multiple of this


def pad_to_power_of_two(array, min_length=MIN_ROWS, axis=0):
    """Repeat the last row of an array until its length is `min_length` times a power of two."""
    array, padded_length = np.asarray(array, float), min_length
    while padded_length < array.shape[axis]:
        padded_length *= 2
    pad_widths = [(0, padded_length - array.shape[axis] if k == axis % array.ndim else 0) for k in range(array.ndim)]
    return np.pad(array, pad_widths, mode="edge")


def scene_with_tangents(scene, names, parameters):
    """Return the scene with other values of the named parameters, and the unit tangents of these, padded with zeros."""
    changed_scene = jax.tree.map(np.asarray, replace_unchecked(scene, dict(zip(names, parameters, strict=True))))
    zero_scene = jax.tree.map(lambda leaf: np.zeros(()), changed_scene)
    tangents = [replace_unchecked(zero_scene, {name: np.ones(())}) for name in names]
    tangents += [zero_scene] * (-len(tangents) % PARAMETER_BLOCK)
    return changed_scene, jax.tree.map(lambda *leaves: np.stack(leaves), *tangents)

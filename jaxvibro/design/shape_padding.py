"""Pad the arguments of compiled functions to a few shapes, to compile few programs."""

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


def scene_with_tangents(scene, parameter_names, parameters):
    """Return the scene with other values of the named parameters, and its unit tangents along these parameters.

    The tangents are scenes stacked along the first axis and are padded with zeros.
    """
    changed_scene = jax.tree.map(
        np.asarray, replace_unchecked(scene, dict(zip(parameter_names, parameters, strict=True)))
    )
    zero_scene = jax.tree.map(lambda leaf: np.zeros(()), changed_scene)
    tangents = [replace_unchecked(zero_scene, {name: np.ones(())}) for name in parameter_names]
    tangents += [zero_scene] * (-len(tangents) % PARAMETER_BLOCK)
    return changed_scene, jax.tree.map(lambda *leaves: np.stack(leaves), *tangents)

"""Read one saved file of each kind, as `compute.save` wrote them."""

import numpy as np

import continuation
import jaxvibro as jv
from tests.baseline import compute


def _continuation(path):
    return continuation.load(path, continuation.equilibria(compute.fold))


def _special_amplitudes(curve):
    return [point.scene.amplitude for point in curve.special]


# How each file is read, and numbers in it.
READERS = {
    "branch.nc": (jv.load_branch, _special_amplitudes),
    "locus.nc": (jv.load_locus, _special_amplitudes),
    "held_branch.nc": (jv.load_held_branch, lambda curve: curve.data.amplitude.values),
    "diagram": (jv.load_diagram, lambda diagram: [value for branch in diagram.branches for value in branch.values]),
    "scene.toml": (jv.load_scene, lambda scene: [scene.amplitude, scene.frequency, scene.damping, scene.restitution]),
    "map": (jv.load_store, lambda data: data.label.values),
    "continuation.npz": (_continuation, lambda branch: [*branch.u[:, 0], *branch.p["mu"]]),
}


def unreadable(folder):
    """Return {name: error} of the files in a folder that cannot be read."""
    errors = {}
    for name in READERS:
        try:
            contents(name, folder / name)
        except Exception as error:
            errors[name] = error
    return errors


def contents(name, path):
    """Return numbers read from a file."""
    read, numbers = READERS[name]
    return np.asarray(numbers(read(path)), float).ravel()

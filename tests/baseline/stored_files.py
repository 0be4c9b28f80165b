"""Read one saved file of each kind, as `compute.save` wrote them."""

import numpy as np

import continuation
import jaxvibro as jv
from tests.baseline import compute


def _continuation(path):
    return continuation.load(path, continuation.equilibria(compute.fold))


READERS = {
    "branch.nc": jv.load_branch,
    "locus.nc": jv.load_locus,
    "held_branch.nc": jv.load_held_branch,
    "diagram": jv.load_diagram,
    "scene.toml": jv.load_scene,
    "map": jv.load_store,
    "continuation.npz": _continuation,
}


def unreadable(folder):
    """{name: error} of the files in a folder that cannot be read."""
    errors = {}
    for name, read in READERS.items():
        try:
            read(folder / name)
        except Exception as error:
            errors[name] = error
    return errors


def contents(name, path):
    """Numbers read from a file."""
    content = READERS[name](path)
    if name in ("branch.nc", "locus.nc"):
        values = [point.scene.amplitude for point in content.special]
    elif name == "held_branch.nc":
        values = content.data.amplitude.values
    elif name == "diagram":
        values = [value for branch in content.branches for value in branch.values]
    elif name == "scene.toml":
        values = [content.amplitude, content.frequency, content.damping, content.restitution]
    elif name == "map":
        values = content.period.values if "period" in content else content.label.values
    else:
        values = [*content.u[:, 0], *content.p["mu"]]
    return np.asarray(values, float).ravel()

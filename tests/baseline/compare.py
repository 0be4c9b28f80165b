"""Compare the working tree with an earlier commit, bit by bit: `python -m tests.baseline.compare [COMMIT] [FOLDER]`.

Both run `compute.py` on this machine, each in an environment of its own, made from the locked requirements
of its commit. The script reports each array that differs, whether the files written by the earlier commit can be read,
and public names, parameters and attributes that are missing. The exit status is 1 if anything differs. With `--store`
the files of the earlier commit and the present values and signatures replace those in `tests/baseline/stored`, which
the tests read.

The strobes of `solver` differ from those of d03bcd9: step 17 bounded the error of a step by its motion (8e3943b).
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import jax
import numpy as np

import continuation
import jaxvibro as jv
from tests.baseline import compute

ROOT = Path(__file__).parents[2]
COMMIT = "d03bcd9"  # the end of step 16
SCRIPT = Path(compute.__file__)
VALUES, SIGNATURES = "values.npz", "signatures.json"


def _special_amplitudes(curve):
    return [point.scene.amplitude for point in curve.special]


# how each file that `compute.save` writes is read, and numbers in it
READERS = {
    "branch.nc": (jv.load_branch, _special_amplitudes),
    "locus.nc": (jv.load_locus, _special_amplitudes),
    "held_branch.nc": (jv.load_held_branch, lambda curve: curve.data.amplitude.values),
    "diagram": (jv.load_diagram, lambda diagram: [value for branch in diagram.branches for value in branch.values]),
    "scene.toml": (jv.load_scene, lambda scene: [scene.amplitude, scene.frequency, scene.damping, scene.restitution]),
    "map": (jv.load_store, lambda data: data.label.values),
    "continuation.npz": (
        lambda path: continuation.load(path, continuation.equilibria(compute.fold)),
        lambda branch: [*branch.u[:, 0], *branch.p["mu"]],
    ),
}


def contents(folder, name):
    """Return numbers read from a file."""
    read, numbers = READERS[name]
    return np.asarray(numbers(read(folder / name)), float).ravel()


def unreadable(folder):
    """Return {name: error} of the files in a folder that cannot be read."""
    errors = {}
    for name in READERS:
        try:
            contents(folder, name)
        except Exception as error:
            errors[name] = error
    return errors


def results(checkout, folder):
    """Make the environment of a checkout, run `compute.py` in it, and return the values and the signatures."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    subprocess.run(["make", "--silent", ".venv/.dev"], cwd=checkout, check=True)
    clean = {key: value for key, value in os.environ.items() if not key.startswith(("JAX_", "PYTHON", "XLA_"))}
    environment = clean | {"PYTHONPATH": str(checkout)}
    subprocess.run([checkout / ".venv" / "bin" / "python", SCRIPT, folder], cwd=folder, env=environment, check=True)
    return read(folder)


def read(folder):
    """Return the values and signatures in a folder: ({name: array}, {name: entry})."""
    with np.load(folder / VALUES) as values:
        return dict(values), json.loads((folder / SIGNATURES).read_text())


def ulps(first, second):
    """Return the largest difference of two arrays in units in the last place, inf if they do not match."""
    if first.dtype != second.dtype or first.shape != second.shape:
        return np.inf
    if first.dtype.kind == "c":
        return max(ulps(first.real, second.real), ulps(first.imag, second.imag))
    if first.dtype.kind != "f":
        return 0.0 if np.array_equal(first, second) else np.inf
    if not np.array_equal(np.isfinite(first), np.isfinite(second)):
        return np.inf
    same = (first == second) | (np.isnan(first) & np.isnan(second))
    first, second = first[~same], second[~same]
    return float(max(abs(first - second) / np.spacing(np.maximum(abs(first), abs(second))), default=0.0))


def removed(old, new):
    """List the public names, parameters and attributes of old signatures that new ones lack; additions are allowed."""
    lacking = []
    for name, entry in old.items():
        if name not in new:
            lacking.append(name)
            continue
        attributes = new[name].get("attributes", {})
        lacking += [f"{name}({part})" for part in entry["signature"] if part not in new[name]["signature"]]
        for key, signature in entry.get("attributes", {}).items():
            parts = [part for part in signature if part not in attributes[key]] if key in attributes else [""]
            lacking += [f"{name}.{key}({part})" for part in parts]
    return lacking


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commit", nargs="?", default=COMMIT)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--store", action="store_true")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    folder = arguments.folder or Path(tempfile.mkdtemp())
    checkout = folder / "checkout"
    if not checkout.exists():
        subprocess.run(["git", "clone", "--quiet", ROOT, checkout], check=True)
        subprocess.run(["git", "checkout", "--quiet", arguments.commit], cwd=checkout, check=True)
    old, signatures = results(checkout, folder / "before")
    new, present = results(ROOT, folder / "after")
    distances = {name: ulps(old[name], new[name]) if name in new else np.inf for name in old}
    differences = [f"{name}: differs by {by:.3g} units in the last place" for name, by in distances.items() if by]
    differences += [f"{name}: no longer public" for name in removed(signatures, present)]
    differences += [f"{name}: cannot be read: {error}" for name, error in unreadable(folder / "before").items()]
    print(*differences, f"{len(differences)} differences, {len(old)} arrays compared", sep="\n")
    if arguments.store:
        target = SCRIPT.parent / "stored"
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(folder / "before", target)
        for name in (VALUES, SIGNATURES):
            shutil.copy(folder / "after" / name, target)
    return int(bool(differences))


if __name__ == "__main__":
    sys.exit(main())

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

from tests.baseline import compute, stored_files

ROOT = Path(__file__).parents[2]
COMMIT = "d03bcd9"  # the end of step 16
SCRIPT = Path(compute.__file__)


def results(checkout, folder):
    """Make the environment of a checkout, run `compute.py` in it, and return the values and the
    signatures."""
    subprocess.run(["make", "--silent", ".venv/.dev"], cwd=checkout, check=True)
    clean = {key: value for key, value in os.environ.items() if not key.startswith(("JAX_", "PYTHON", "XLA_"))}
    environment = clean | {"PYTHONPATH": str(checkout)}
    subprocess.run([checkout / ".venv" / "bin" / "python", SCRIPT, folder], cwd=folder, env=environment, check=True)
    return read(folder)


def read(folder):
    """Return the values and signatures in a folder: ({name: array}, {name: entry})."""
    values = json.loads((folder / "values.json").read_text())
    return (
        {name: compute.decode(record) for name, record in values.items()},
        json.loads((folder / "signatures.json").read_text()),
    )


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
        lacking += [f"{name}({part})" for part in _lacking(entry["signature"], new[name]["signature"])]
        attributes = new[name].get("attributes", {})
        for key, signature in entry.get("attributes", {}).items():
            parts = _lacking(signature, attributes[key]) if key in attributes else [""]
            lacking += [f"{name}.{key}({part})" for part in parts]
    return lacking


def _lacking(old, new):
    return [part for part in old if part not in new]


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
    for name in ("before", "after"):
        shutil.rmtree(folder / name, ignore_errors=True)
        (folder / name).mkdir()
    old, signatures = results(checkout, folder / "before")
    new, present = results(ROOT, folder / "after")
    different = {name: ulps(old[name], new[name]) if name in new else np.inf for name in old}
    different = {name: distance for name, distance in different.items() if distance}
    for name, distance in different.items():
        print(f"{name}: differs by {distance:.3g} units in the last place")
    changed = removed(signatures, present)
    for name in changed:
        print(f"{name}: no longer public")
    unreadable = stored_files.unreadable(folder / "before")
    for kind, error in unreadable.items():
        print(f"{kind}: cannot be read: {error}")
    print(f"{len(old) - len(different)} of {len(old)} arrays identical, {len(unreadable)} files unreadable")
    if arguments.store:
        target = SCRIPT.parent / "stored"
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(folder / "before", target)
        for name in ("values.json", "signatures.json"):
            shutil.copy(folder / "after" / name, target)
    return int(bool(different or changed or unreadable))


if __name__ == "__main__":
    sys.exit(main())

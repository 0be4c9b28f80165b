"""A branch in a file and back: arrays and JSON in one NumPy archive, nothing that is evaluated or unpickled."""

import json
import os
import tempfile
import zipfile
from os import PathLike
from typing import Any

import numpy as np

from .branch import Branch, Special
from .errors import ContinuationError, typed
from .problem import System

FORM = 1  # of the file
FIELDS = ("kind", "p", "names", "residual", "place", "bounds")  # of a special point, as JSON


@typed
def save(branch: Branch, path: str | PathLike[str]) -> None:
    """Write a `Branch` to a file, from which `load` reads the same numbers. Its system and args are not in it.

    It is written beside its place and renamed into it. Raises OSError where it cannot be written.
    """
    told = [{key: getattr(one, key) for key in FIELDS} for one in branch.special]
    plain: dict[str, Any] = {
        "form": FORM,
        "kind": branch.kind,
        "names": branch.names,
        "reasons": branch.reasons,
        "special": told,
    }
    plain |= {"system": [branch.system.kind, branch.system.times, branch.system.segments, branch.system.within]}
    tangents = np.array([one.tangent for one in branch.special])
    arrays: dict[str, Any] = {
        "u": branch.u,
        "eigenvalues": branch.eigenvalues,
        "residual": branch.residual,
        "tangents": tangents,
    }
    arrays |= {f"p.{name}": each for name, each in branch.p.items()}
    handle, part = tempfile.mkstemp(dir=os.path.dirname(os.path.abspath(path)), suffix=".npz")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, plain=np.array(json.dumps(plain)), **arrays)
        os.replace(part, path)
    except BaseException:
        os.unlink(part)
        raise


@typed
def load(path: str | PathLike[str], system: System, args: Any = None) -> Branch:
    """The `Branch` of a file that `save` wrote.

    system, args: those that it was followed with; its function is not in the file. Raises ContinuationError where the
    file is damaged, or of a system of another kind, OSError where it cannot be read.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            plain, data = json.loads(str(file["plain"])), {key: file[key] for key in file.files if key != "plain"}
        return _branch(plain, data, system, args)
    except (zipfile.BadZipFile, LookupError, ValueError, TypeError, EOFError) as error:
        if isinstance(error, ContinuationError):
            raise
        raise ContinuationError("path", f"must be a file of save ({type(error).__name__})", str(path)) from None


def _branch(plain, data, system, args):
    if plain["form"] != FORM:
        raise ValueError("another form")
    kind, times, segments, within = plain["system"]
    if not isinstance(system, System) or (system.kind, system.segments) != (kind, segments):
        raise ContinuationError("system", f"must be the one of {kind} that the branch is of", system)
    system = system._replace(times=times, within=within)
    names, size = tuple(plain["names"]), len(data["u"])
    columns = {name: data[f"p.{name}"] for name in names}
    if any(len(each) != size for each in (data["eigenvalues"], data["residual"], *columns.values())):
        raise ValueError("rows")
    special = []
    for one, tangent in zip(plain["special"], data["tangents"], strict=True):
        bounds = {name: (low, high) for name, (low, high) in one["bounds"].items()}
        k = one["place"]
        found = data["u"][k], one["p"], tuple(one["names"]), data["eigenvalues"][k], one["residual"], k
        special.append(Special(one["kind"], *found, system, args, bounds, tangent))
    reasons = tuple(plain["reasons"])
    numbers = data["u"], columns, data["eigenvalues"], data["residual"]
    return Branch(system, plain["kind"], names, *numbers, tuple(special), reasons)

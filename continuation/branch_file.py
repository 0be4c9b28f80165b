"""A branch in a file and back: arrays and JSON in one NumPy archive, nothing that is evaluated or unpickled."""

import json
import os
import tempfile
import zipfile
from os import PathLike
from typing import Any

import numpy as np

from .branch import Branch, Special
from .errors import ContinuationError, check_types
from .problem import System

FORMAT_VERSION = 1  # of the file
SPECIAL_FIELDS = ("kind", "p", "names", "residual", "place", "bounds")  # of a special point, as JSON


@check_types
def save(branch: Branch, path: str | PathLike[str]) -> None:
    """Write a `Branch` to a file, from which `load` reads the same numbers. Its system and args are not in it.

    It is written beside its place and renamed into it. Raises OSError where it cannot be written.
    """
    special_records = [{key: getattr(special, key) for key in SPECIAL_FIELDS} for special in branch.special]
    metadata: dict[str, Any] = {
        "form": FORMAT_VERSION,
        "kind": branch.kind,
        "names": branch.names,
        "reasons": branch.reasons,
        "special": special_records,
    }
    metadata |= {"system": [branch.system.kind, branch.system.times, branch.system.segments, branch.system.within]}
    tangents = np.array([special.tangent for special in branch.special])
    arrays: dict[str, Any] = {
        "u": branch.u,
        "eigenvalues": branch.eigenvalues,
        "residual": branch.residual,
        "tangents": tangents,
    }
    arrays |= {f"p.{name}": values for name, values in branch.p.items()}
    descriptor, temporary_path = tempfile.mkstemp(dir=os.path.dirname(os.path.abspath(path)), suffix=".npz")
    try:
        with os.fdopen(descriptor, "wb") as file:
            np.savez(file, plain=np.array(json.dumps(metadata)), **arrays)
        os.replace(temporary_path, path)
    except BaseException:
        os.unlink(temporary_path)
        raise


@check_types
def load(path: str | PathLike[str], system: System, args: Any = None) -> Branch:
    """The `Branch` of a file that `save` wrote.

    system, args: those that it was followed with; its function is not in the file. Raises ContinuationError where the
    file is damaged, or of a system of another kind, OSError where it cannot be read.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            metadata, arrays = json.loads(str(file["plain"])), {key: file[key] for key in file.files if key != "plain"}
        return _branch(metadata, arrays, system, args)
    except (zipfile.BadZipFile, LookupError, ValueError, TypeError, EOFError) as error:
        if isinstance(error, ContinuationError):
            raise
        raise ContinuationError("path", f"must be a file of save ({type(error).__name__})", str(path)) from None


def _branch(metadata, arrays, system, args):
    if metadata["form"] != FORMAT_VERSION:
        raise ValueError("another form")
    kind, times, segments, within = metadata["system"]
    if not isinstance(system, System) or (system.kind, system.segments) != (kind, segments):
        raise ContinuationError("system", f"must be the one of {kind} that the branch is of", system)
    system = system._replace(times=times, within=within)
    names, n_points = tuple(metadata["names"]), len(arrays["u"])
    parameter_columns = {name: arrays[f"p.{name}"] for name in names}
    if any(
        len(column) != n_points for column in (arrays["eigenvalues"], arrays["residual"], *parameter_columns.values())
    ):
        raise ValueError("rows")
    special = []
    for special_record, tangent in zip(metadata["special"], arrays["tangents"], strict=True):
        bounds = {name: (lower, upper) for name, (lower, upper) in special_record["bounds"].items()}
        row = special_record["place"]
        special_values = (
            arrays["u"][row],
            special_record["p"],
            tuple(special_record["names"]),
            arrays["eigenvalues"][row],
            special_record["residual"],
            row,
        )
        special.append(Special(special_record["kind"], *special_values, system, args, bounds, tangent))
    reasons = tuple(metadata["reasons"])
    point_arrays = arrays["u"], parameter_columns, arrays["eigenvalues"], arrays["residual"]
    return Branch(system, metadata["kind"], names, *point_arrays, tuple(special), reasons)

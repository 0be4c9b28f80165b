"""Save and load branches as NumPy archives of arrays and JSON; loading executes no code from the file."""

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

FORMAT_VERSION = 1  # version of the file format
SPECIAL_FIELDS = ("kind", "p", "names", "residual", "place", "bounds")  # fields of a special point stored as JSON


@check_types
def save(branch: Branch, path: str | PathLike[str]) -> None:
    """Write a branch to a file.

    Parameters
    ----------
    branch : Branch
        Branch to write. Its system and `args` are not stored.
    path : str or path-like
        File to write. The content is written to a temporary file in the same folder, which is then renamed. An existing
        file is replaced.

    Raises
    ------
    OSError
        If the file cannot be written.

    See Also
    --------
    load : Read the file.

    Examples
    --------
    >>> import os, tempfile
    >>> system = co.equilibria(lambda u, p, args: p["a"] - 0.5 - u * u)
    >>> branch = co.trace(system, [1.0], {"a": 1.5}, "a", bounds=(0.0, 2.0))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     co.save(branch, os.path.join(folder, "branch.npz"))
    ...     print(co.load(os.path.join(folder, "branch.npz"), system).reasons == branch.reasons)
    True
    """
    special_records = [
        {field_name: getattr(special, field_name) for field_name in SPECIAL_FIELDS} for special in branch.special
    ]
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
    arrays |= {f"p.{name}": parameter_values for name, parameter_values in branch.p.items()}
    file_descriptor, temporary_path = tempfile.mkstemp(dir=os.path.dirname(os.path.abspath(path)), suffix=".npz")
    try:
        with os.fdopen(file_descriptor, "wb") as file:
            np.savez(file, plain=np.array(json.dumps(metadata)), **arrays)
        os.replace(temporary_path, path)
    except BaseException:
        os.unlink(temporary_path)
        raise


@check_types
def load(path: str | PathLike[str], system: System, args: Any = None) -> Branch:
    """Read a branch that `save` wrote.

    Parameters
    ----------
    path : str or path-like
        File to read.
    system : System
        System with which the branch was computed. The file does not contain the function of the system.
    args : Any, optional
        Further argument of the function, as in `trace`.

    Returns
    -------
    Branch
        The saved branch, with identical numbers.

    Raises
    ------
    ContinuationError
        If the file is damaged, or belongs to a system of another kind or with another number of segments.
    OSError
        If the file cannot be read.

    See Also
    --------
    save : Write the file.

    Examples
    --------
    >>> import os, tempfile
    >>> system = co.equilibria(lambda u, p, args: p["a"] - 0.5 - u * u)
    >>> branch = co.trace(system, [1.0], {"a": 1.5}, "a", bounds=(0.0, 2.0))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     co.save(branch, os.path.join(folder, "branch.npz"))
    ...     loaded = co.load(os.path.join(folder, "branch.npz"), system)
    >>> len(loaded) == len(branch)
    True
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            metadata, arrays = (
                json.loads(str(file["plain"])),
                {array_name: file[array_name] for array_name in file.files if array_name != "plain"},
            )
        return _make_branch(metadata, arrays, system, args)
    except (zipfile.BadZipFile, LookupError, ValueError, TypeError, EOFError) as error:
        if isinstance(error, ContinuationError):
            raise
        raise ContinuationError(
            "path", f"must be a file written by `save` ({type(error).__name__})", str(path)
        ) from None


def _make_branch(metadata, arrays, system, args):
    """Make the `Branch` of a file's metadata and arrays."""
    if metadata["form"] != FORMAT_VERSION:
        raise ValueError("unknown format version")
    system_kind, n_iterations, n_segments, restricts_to_symmetric = metadata["system"]
    if not isinstance(system, System) or (system.kind, system.segments) != (system_kind, n_segments):
        raise ContinuationError(
            "system", f"must be a system of {system_kind} with {n_segments} segments, as in the file", system
        )
    system = system._replace(times=n_iterations, within=restricts_to_symmetric)
    param_names, n_points = tuple(metadata["names"]), len(arrays["u"])
    parameter_columns = {name: arrays[f"p.{name}"] for name in param_names}
    if any(
        len(column) != n_points for column in (arrays["eigenvalues"], arrays["residual"], *parameter_columns.values())
    ):
        raise ValueError("arrays of different lengths")
    special_points = []
    for special_record, tangent in zip(metadata["special"], arrays["tangents"], strict=True):
        bounds = {
            name: (lower_bound, upper_bound) for name, (lower_bound, upper_bound) in special_record["bounds"].items()
        }
        row = special_record["place"]
        special_fields = (
            arrays["u"][row],
            special_record["p"],
            tuple(special_record["names"]),
            arrays["eigenvalues"][row],
            special_record["residual"],
            row,
        )
        special_points.append(Special(special_record["kind"], *special_fields, system, args, bounds, tangent))
    reasons = tuple(metadata["reasons"])
    point_arrays = arrays["u"], parameter_columns, arrays["eigenvalues"], arrays["residual"]
    return Branch(system, metadata["kind"], param_names, *point_arrays, tuple(special_points), reasons)

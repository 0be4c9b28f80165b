"""Define branches and the special points on them, and save and load them."""

import json
import os
import tempfile
import zipfile
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Float

from .errors import ContinuationError, check_types
from .problem import EQUILIBRIA, System, SystemConstants

KIND_MEANINGS = {
    "SN": "fold",
    "BP": "branch point",
    "SB": "symmetry breaking",
    "HB": "Hopf point",
    "PD": "period doubling",
    "NS": "Neimark-Sacker point",
    "CP": "cusp",
    "DSB": "degenerate symmetry breaking",
    "GPD": "generalized period doubling",
    "BT": "Bogdanov-Takens point",
    "ZH": "zero-Hopf point",
    "HH": "double Hopf point",
    "GH": "generalized Hopf point",
    "CH": "Chenciner point",
    "FF": "fold-flip",
    "R1": "1:1 resonance",
    "R2": "1:2 resonance",
    "R3": "1:3 resonance",
    "R4": "1:4 resonance",
    "FN": "fold and Neimark-Sacker point",
    "PN": "period doubling and Neimark-Sacker point",
    "NN": "double Neimark-Sacker point",
    "EP": "end",
}
MAX_SHOWN = 5  # entries of u shown in a table


@dataclass(frozen=True, eq=False)
class Special:
    """Special point of a branch.

    Attributes
    ----------
    kind : str
        SN, BP, SB, HB, PD, NS or another key of ``continuation.branch.KIND_MEANINGS``, the name of a monitor, or EP for
        an end.
    u : ndarray
        Solution. Array of shape (n,).
    p : dict of str to float
        Values of all parameters.
    names : tuple of str
        Continuation parameters of the branch.
    eigenvalues : ndarray
        Eigenvalues of dF/du for equilibria, in descending order of their real parts. Multipliers for maps and periodic
        orbits, in descending order of their moduli, without the trivial multiplier of a periodic orbit. Complex array
        of shape (n,), or (n - 1,) for a periodic orbit of n differential equations.
    residual : float
        Largest residual of the equations of the point.
    place : int
        Index among the points of the branch.
    system : System
        System of the branch.
    args : Any
        Further argument of the function of the system.
    bounds : dict of str to tuple of float
        Bounds of the continuation parameters.
    tangent : ndarray
        Unit tangent of the branch. Array of shape (n + names,).

    Examples
    --------
    >>> system = co.equilibria(lambda u, p, args: p["a"] - 0.5 - u * u)
    >>> branch = co.trace(system, [1.0], {"a": 1.5}, "a", bounds=(0.0, 2.0))
    >>> (fold,) = branch.points("SN")
    >>> fold.kind, round(fold.p["a"], 6), fold.place > 0
    ('SN', 0.5, True)
    """

    kind: str
    u: Float[np.ndarray, " unknowns"]
    p: dict[str, float]
    names: tuple[str, ...]
    eigenvalues: Complex[np.ndarray, " values"]
    residual: float
    place: int
    system: System = field(repr=False)
    args: Any = field(repr=False)
    bounds: dict[str, tuple[float, float]] = field(repr=False)
    tangent: Float[np.ndarray, " z"] = field(repr=False)

    @property
    def z(self) -> Float[np.ndarray, " z"]:
        """Solution and values of the continuation parameters, shape (n + names,)."""
        return np.append(self.u, [self.p[name] for name in self.names])


def unknowns_and_constants(special, param_names):
    """Return z = (u, values of the named parameters) at a `Special` and the `SystemConstants` of the others."""
    fixed_params = {name: value for name, value in special.p.items() if name not in param_names}
    z = np.append(special.u, [special.p[name] for name in param_names])
    return z, SystemConstants(fixed_params, special.args)


@dataclass(frozen=True, eq=False)
class Branch:
    """Branch of solutions, or curve of special points.

    Attributes
    ----------
    system : System
        System of the solutions.
    kind : str or None
        Kind of the special points of a curve; None for a branch of solutions.
    names : tuple of str
        Continuation parameters. A branch has one parameter, and one more for each held function. A curve has two.
    u : ndarray
        Solutions. Array of shape (points, n).
    p : dict of str to ndarray
        Values of the continuation parameters. Arrays of shape (points,).
    eigenvalues : ndarray
        Eigenvalues or multipliers, as in `Special`. Complex array with one row per point.
    residual : ndarray
        Largest residual at each point. Array of shape (points,).
    special : tuple of Special
        Special points in order along the branch, both ends included.
    reasons : tuple of str
        Termination reasons at the first and at the last point.

    Examples
    --------
    >>> system = co.equilibria(lambda u, p, args: p["a"] - 0.5 - u * u)
    >>> branch = co.trace(system, [1.0], {"a": 1.5}, "a", bounds=(0.0, 2.0))
    >>> [special.kind for special in branch.special]
    ['EP', 'SN', 'EP']
    >>> branch.u.shape == (len(branch), 1)
    True
    """

    system: System = field(repr=False)
    kind: str | None
    names: tuple[str, ...]
    u: Float[np.ndarray, "points unknowns"] = field(repr=False)
    p: dict[str, Float[np.ndarray, " points"]] = field(repr=False)
    eigenvalues: Complex[np.ndarray, "points values"] = field(repr=False)
    residual: Float[np.ndarray, " points"] = field(repr=False)
    special: tuple[Special, ...]
    reasons: tuple[str, str]

    def __len__(self) -> int:
        return len(self.u)

    def __repr__(self) -> str:
        special_kinds = " ".join(special.kind for special in self.special)
        kind_prefix = f"{self.kind} " if self.kind else ""
        return f"Branch({kind_prefix}along {' and '.join(self.names)}, {len(self)} points, {special_kinds})"

    @property
    def stable(self) -> Bool[np.ndarray, " points"]:
        """Stability of each solution, bool array of shape (points,), True if the solution is stable.

        An equilibrium is stable if all eigenvalues have negative real parts. A fixed point or periodic orbit is stable
        if all multipliers lie inside the unit circle.
        """
        eigenvalues = self.eigenvalues
        return np.all((eigenvalues.real < 0.0) if self.system.kind == EQUILIBRIA else (abs(eigenvalues) < 1.0), axis=1)

    @property
    def reason(self) -> dict[str, str]:
        """Termination reasons by end: ``{"first": ..., "last": ...}``."""
        return dict(zip(("first", "last"), self.reasons, strict=True))

    def points(self, kind: str) -> tuple[Special, ...]:
        """Select the special points of a kind.

        Parameters
        ----------
        kind : str
            Kind of special point, for example ``"SN"``, or the name of a monitor.

        Returns
        -------
        tuple of Special
            Special points of this kind in order along the branch.
        """
        return tuple(special for special in self.special if special.kind == kind)

    def table(self) -> str:
        """Format the special points and the termination reasons as text.

        Returns
        -------
        str
            One line per special point: kind, parameters, norm of u, its first entries and the residual. Two lines with
            the termination reasons follow.
        """
        rows = [("kind", *self.names, "norm", "u", "residual")]
        for special in self.special:
            parameter_texts = [f"{special.p[name]:.12g}" for name in self.names]
            u_texts = [f"{entry:.6g}" for entry in special.u[:MAX_SHOWN]] + ["..."] * (len(special.u) > MAX_SHOWN)
            norm_text = f"{np.linalg.norm(special.u):.9g}"
            rows.append((special.kind, *parameter_texts, norm_text, " ".join(u_texts), f"{special.residual:.1e}"))
        column_widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, column_widths)).rstrip() for row in rows]
        return "\n".join([*lines, *(f"{end_name} point: {reason}" for end_name, reason in self.reason.items())])


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

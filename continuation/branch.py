"""Define branches and the special points on them."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Float

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

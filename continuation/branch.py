"""What a branch is, and the special points on it."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Float

from .problem import EQUILIBRIA, System

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
MAX_SHOWN = 5  # numbers of u in a table


@dataclass(frozen=True, eq=False)
class Special:
    """A special point. kind: SN, BP, SB, HB, PD, NS (see `KIND_MEANINGS`), a monitor's name, or EP, an end. u: (n,); p:
    {name: number}, all parameters; names: those along which it was found; eigenvalues: (n,), of the derivative by u, of
    a map the multipliers, of a periodic orbit those but for its field's own, the largest first; residual: the largest
    error left in its equations; place: among the branch's points; tangent: of the branch there, (n + names,).
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
        """u and the values of the names, (n + names,)."""
        return np.append(self.u, [self.p[name] for name in self.names])


@dataclass(frozen=True, eq=False)
class Branch:
    """Solutions in a row. names: of the parameters along it, one of a branch, two of a curve of special points; kind:
    of these, None of a branch; u: (points, n); p: {name: (points,)} of the names; eigenvalues: (points, n), complex,
    the largest first, as of `Special`; residual: (points,), the largest error left;
    special: the special points in order; reasons: why it ends, at its first and its last point."""

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
        kinds = " ".join(special.kind for special in self.special)
        kind_prefix = f"{self.kind} " if self.kind else ""
        return f"Branch({kind_prefix}along {' and '.join(self.names)}, {len(self)} points, {kinds})"

    @property
    def stable(self) -> Bool[np.ndarray, " points"]:
        """Whether each solution attracts, (points,): all real parts below 0, of a map all multipliers within 1."""
        eigenvalues = self.eigenvalues
        return np.all((eigenvalues.real < 0.0) if self.system.kind == EQUILIBRIA else (abs(eigenvalues) < 1.0), axis=1)

    @property
    def reason(self) -> dict[str, str]:
        """Why each end is one: {"first": ..., "last": ...}."""
        return dict(zip(("first", "last"), self.reasons, strict=True))

    def points(self, kind: str) -> tuple[Special, ...]:
        """The special points of a kind, a tuple."""
        return tuple(special for special in self.special if special.kind == kind)

    def table(self) -> str:
        """The special points as a text, a line each, with the length of u and its first numbers, and why the branch
        ends."""
        rows = [("kind", *self.names, "norm", "u", "residual")]
        for special in self.special:
            parameter_texts = [f"{special.p[name]:.12g}" for name in self.names]
            u_texts = [f"{entry:.6g}" for entry in special.u[:MAX_SHOWN]] + ["..."] * (len(special.u) > MAX_SHOWN)
            norm = f"{np.linalg.norm(special.u):.9g}"
            rows.append((special.kind, *parameter_texts, norm, " ".join(u_texts), f"{special.residual:.1e}"))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        return "\n".join([*lines, *(f"{end} point: {reason}" for end, reason in self.reason.items())])

"""What a branch is, and the special points on it."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .problem import FIXED_POINTS, System

MEANINGS = {
    "SN": "fold",
    "BP": "branch point",
    "HB": "Hopf point",
    "PD": "period doubling",
    "NS": "Neimark-Sacker point",
    "CP": "cusp",
    "GPD": "generalized period doubling",
    "BT": "Bogdanov-Takens point",
    "EP": "end",
}


@dataclass(frozen=True, eq=False)
class Special:
    """A special point. kind: SN, BP, HB, PD, NS (see `MEANINGS`), a monitor's name, or EP, an end. u: (n,); p: {name:
    number}, all parameters; names: those along which it was found; eigenvalues: (n,), of the function's derivative by u
    (for a map the multipliers), the largest first; residual: the largest error left in its equations; place: among the
    branch's points; tangent: of the branch there, (n + names,)."""

    kind: str
    u: np.ndarray
    p: dict
    names: tuple[str, ...]
    eigenvalues: np.ndarray
    residual: float
    place: int
    system: System = field(repr=False)
    args: Any = field(repr=False)
    bounds: dict = field(repr=False)
    tangent: np.ndarray = field(repr=False)

    @property
    def z(self):
        """u and the values of the names, (n + names,)."""
        return np.append(self.u, [self.p[name] for name in self.names])


@dataclass(frozen=True, eq=False)
class Branch:
    """Solutions in a row. names: of the parameters along it, one of a branch, two of a curve of special points; kind:
    of these, None of a branch; u: (points, n); p: {name: (points,)} of the names; eigenvalues: (points, n), complex,
    the largest first: of the derivative by u, of a map its multipliers; residual: (points,), the largest error left;
    special: the special points in order; reasons: why it ends, at its first and its last point."""

    system: System = field(repr=False)
    kind: str | None
    names: tuple[str, ...]
    u: np.ndarray = field(repr=False)
    p: dict = field(repr=False)
    eigenvalues: np.ndarray = field(repr=False)
    residual: np.ndarray = field(repr=False)
    special: tuple[Special, ...]
    reasons: tuple[str, str]

    def __len__(self):
        return len(self.u)

    def __repr__(self):
        kinds = " ".join(one.kind for one in self.special)
        of = f"{self.kind} " if self.kind else ""
        return f"Branch({of}along {' and '.join(self.names)}, {len(self)} points, {kinds})"

    @property
    def stable(self):
        """Whether each solution attracts, (points,): all real parts below 0, of a map all multipliers within 1."""
        found = self.eigenvalues
        return ((abs(found) < 1.0) if self.system.kind == FIXED_POINTS else (found.real < 0.0)).all(axis=1)

    @property
    def reason(self):
        """Why each end is one: {"first": ..., "last": ...}."""
        return dict(zip(("first", "last"), self.reasons, strict=True))

    def points(self, kind):
        """The special points of a kind, a tuple."""
        return tuple(one for one in self.special if one.kind == kind)

    def table(self):
        """The special points as a text, a line each, and why the branch ends."""
        rows = [("kind", *self.names, "u", "residual")]
        for one in self.special:
            numbers = [f"{one.p[name]:.12g}" for name in self.names]
            rows.append((one.kind, *numbers, " ".join(f"{each:.6g}" for each in one.u), f"{one.residual:.1e}"))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        return "\n".join([*lines, *(f"{end} point: {why}" for end, why in self.reason.items())])

"""What is told of a fit: numbers, errors, and the combinations of numbers that a record says, or does not."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from ..output.table_text import columns, headed
from ..output.units import TIME, unit_in, unit_of
from ..scene.scene import SIDES, Scene
from .least_squares import SHORT, Free, Solved, largest_chi2

SAID = 1.0  # scales: a record that says no more than this of a combination does not say it
INVOLVED = 0.05  # of a combination that is held: a number with as large a share has no error of its own
SHOWN = 0.1  # of a combination, a smaller share is left out of its text
LEAST = 1e-30  # of what is said of a combination


class FitStatus(IntEnum):
    """What became of a fit. OK: the numbers are found. UNIDENTIFIABLE: some of their combinations are not in the
    record, and were held. BOUND: a number is at the end of where it may be. MISFIT: the scene does not explain the
    record within its errors. NONE: no motion of the scene goes along it; the numbers are the first ones."""

    OK = 0
    UNIDENTIFIABLE = 1
    BOUND = 2
    MISFIT = 3
    NONE = 4


@dataclass(frozen=True)
class Combination:
    """A combination of the free numbers, each in its scale: its shares, a unit vector, and its error."""

    shares: dict[str, float]
    sigma: float

    def __str__(self) -> str:
        parts = sorted(self.shares.items(), key=lambda one: -abs(one[1]))
        return " ".join(f"{share:+.2f} {name}" for name, share in parts if abs(share) >= SHOWN)


@dataclass(frozen=True, eq=False)
class Fit:
    """What a record says of a scene, made by `fit`. values, sigma: {name: number}, sigma infinite where the number is
    part of a combination that the record does not say; covariance: (name, other), of what it says; residuals: measured
    less fitted, in errors; chi2, dof: their squares' sum, and what noise makes of it on average; identifiable,
    unidentifiable: `Combination`s, best known first; missed: (time, side) of impacts that the record lacks; spurious:
    places in the record of those that are none; scene: with the numbers put in; status: a `FitStatus`."""

    values: dict[str, float]
    sigma: dict[str, float]
    covariance: xr.DataArray
    residuals: Float[np.ndarray, " residuals"]
    chi2: float
    dof: int
    identifiable: tuple[Combination, ...]
    unidentifiable: tuple[Combination, ...]
    missed: tuple[tuple[float, int], ...]
    spurious: tuple[int, ...]
    scene: Scene
    status: FitStatus

    def table(self, units: str = "scene") -> str:
        """The fit as text. units: "scene", or "physical" (Hz, N, mm, s) of a scene that has scales.

        Raises ArgumentError for other units, and where the scene has no scales.
        """
        rows: list[tuple[str | float, ...]] = [("number", "value", "sigma")]
        for name in self.values:
            unit, size = unit_in(self.scene, unit_of(name), units)
            rows.append((headed(name, unit, units), size * self.values[name], size * self.sigma[name]))
        late = unit_in(self.scene, TIME, units)[1]
        lines = [columns(rows), f"chi2 {self.chi2:.4g} of {self.dof}, {self.status.name}"]
        lines += [f"not in the record: {one}" for one in self.unidentifiable]
        lines += [f"missed: {late * time:.6g} {SIDES[int(side > 0)]}" for time, side in self.missed]
        return "\n".join([*lines, *(f"spurious: impact {k}" for k in self.spurious)])


class Said(NamedTuple):
    """Combinations of the free numbers in their scales, best known first. errors; ways: a column each; lost: whether
    the record does not say it."""

    errors: Float[np.ndarray, " free"]
    ways: Float[np.ndarray, "free free"]
    lost: Bool[np.ndarray, " free"]

    @property
    def held(self) -> Float[np.ndarray, "free free"]:
        """The projection on what is lost."""
        return self.ways[:, self.lost] @ self.ways[:, self.lost].T

    def named(self, names: Sequence[str], which: slice | Bool[np.ndarray, " free"]) -> tuple[Combination, ...]:
        """Some of them as `Combination`s."""
        chosen = zip(self.errors[which], self.ways.T[which], strict=True)
        return tuple(Combination(dict(zip(names, map(float, way), strict=True)), float(error)) for error, way in chosen)


def said(information) -> Said:
    """What a record's information, a matrix, says of combinations; one that is no number says nothing."""
    information = information if np.isfinite(information).all() else np.zeros_like(information)
    information, ways = np.linalg.eigh(0.5 * (information + information.T))
    errors = np.maximum(information, LEAST) ** -0.5
    return Said(errors[::-1], ways[:, ::-1], errors[::-1] > SAID)


def identified(now: Solved, free: Free, solved: Callable[[Free], Solved]) -> tuple[Solved, Said]:
    """(the least squares with what is lost held, and nothing else; what is said). solved: from where `now` is on."""
    first = said(np.linalg.inv(now.covariance) - free.known)
    final = free._replace(known=first.held)
    found = solved(final)
    return found, first if first.lost.any() else said(np.linalg.inv(found.covariance))


def status(free: Free, found: Solved, about: Said, dof: int) -> FitStatus:
    """The `FitStatus` of least squares that are met."""
    if np.min(np.abs(free.room(found.numbers))) <= SHORT:
        return FitStatus.BOUND
    return misfit(found.chi2, dof) or (FitStatus.UNIDENTIFIABLE if about.lost.any() else FitStatus.OK)


def misfit(chi2: float, dof: int) -> FitStatus | None:
    """MISFIT where noise makes a chi2 as large too seldom."""
    return FitStatus.MISFIT if chi2 > largest_chi2(dof) else None


def told(scene, names, scales, numbers, about, covariance, residuals, dof, found, missed=(), spurious=()) -> Fit:
    """The `Fit` of numbers; covariance: in scales; found: a `FitStatus`."""
    left = np.eye(len(names)) - about.held
    covariance = left @ covariance @ left * np.outer(scales, scales)
    open_ones = np.sum(about.ways[:, about.lost] ** 2, 1) > INVOLVED**2
    sigma = np.where(open_ones, np.inf, np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    return Fit(
        dict(zip(names, map(float, numbers), strict=True)),
        dict(zip(names, map(float, sigma), strict=True)),
        _labelled(names, covariance),
        -residuals,
        float(residuals @ residuals),
        dof,
        about.named(names, ~about.lost),
        about.named(names, about.lost),
        missed,
        spurious,
        scene,
        found,
    )


def nothing(scene, names, begun) -> Fit:
    """The `Fit` that says nothing."""
    values, sigma = dict(zip(names, map(float, begun), strict=True)), dict.fromkeys(names, np.inf)
    nan, blank = np.full((len(names),) * 2, np.nan), np.zeros(0)
    return Fit(values, sigma, _labelled(names, nan), blank, np.inf, 0, (), (), (), (), scene, FitStatus.NONE)


def _labelled(names, covariance):
    return xr.DataArray(covariance, dims=("name", "other"), coords={"name": list(names), "other": list(names)})

"""What is told of a fit: numbers, errors, and the combinations of numbers that a record says, or does not."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float

from ..output.table_text import align_columns, column_header
from ..output.units import TIME, unit_in_system, unit_of
from ..scene.scene import SIDES, Scene
from .least_squares import STEP_TOLERANCE, FreeParameters, LeastSquaresSolution, largest_chi2

MAX_KNOWN_ERROR = 1.0  # scales: a record that says no more than this of a combination does not say it
MIN_INVOLVED_SHARE = 0.05  # of a combination that is held: a number with as large a share has no error of its own
MIN_SHOWN_SHARE = 0.1  # of a combination, a smaller share is left out of its text
MIN_INFORMATION = 1e-30  # of what is said of a combination


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
        ordered_shares = sorted(self.shares.items(), key=lambda share_entry: -abs(share_entry[1]))
        return " ".join(f"{share:+.2f} {name}" for name, share in ordered_shares if abs(share) >= MIN_SHOWN_SHARE)


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
            unit, unit_size = unit_in_system(self.scene, unit_of(name), units)
            rows.append((column_header(name, unit, units), unit_size * self.values[name], unit_size * self.sigma[name]))
        time_unit = unit_in_system(self.scene, TIME, units)[1]
        lines = [align_columns(rows), f"chi2 {self.chi2:.4g} of {self.dof}, {self.status.name}"]
        lines += [f"not in the record: {combination}" for combination in self.unidentifiable]
        lines += [f"missed: {time_unit * time:.6g} {SIDES[int(side > 0)]}" for time, side in self.missed]
        return "\n".join([*lines, *(f"spurious: impact {k}" for k in self.spurious)])


class IdentifiableDirections(NamedTuple):
    """Combinations of the free numbers in their scales, best known first. errors; vectors: a column each;
    is_undetermined: whether the record does not say it."""

    errors: Float[np.ndarray, " free"]
    vectors: Float[np.ndarray, "free free"]
    is_undetermined: Bool[np.ndarray, " free"]

    @property
    def undetermined_projector(self) -> Float[np.ndarray, "free free"]:
        """The projection on what is lost."""
        return self.vectors[:, self.is_undetermined] @ self.vectors[:, self.is_undetermined].T

    def combinations(
        self, names: Sequence[str], selection: slice | Bool[np.ndarray, " free"]
    ) -> tuple[Combination, ...]:
        """Some of them as `Combination`s."""
        error_directions = zip(self.errors[selection], self.vectors.T[selection], strict=True)
        return tuple(
            Combination(dict(zip(names, map(float, direction), strict=True)), float(error))
            for error, direction in error_directions
        )


def identify_directions(information) -> IdentifiableDirections:
    """What a record's information, a matrix, says of combinations; one that is no number says nothing."""
    information = information if np.isfinite(information).all() else np.zeros_like(information)
    information, directions = np.linalg.eigh(0.5 * (information + information.T))
    errors = np.maximum(information, MIN_INFORMATION) ** -0.5
    return IdentifiableDirections(errors[::-1], directions[:, ::-1], errors[::-1] > MAX_KNOWN_ERROR)


def solve_identifiable(
    solution: LeastSquaresSolution,
    free_params: FreeParameters,
    solve_with: Callable[[FreeParameters], LeastSquaresSolution],
) -> tuple[LeastSquaresSolution, IdentifiableDirections]:
    """(the least squares with what is lost held, and nothing else; what is said). solve_with: from where `solution` is
    on."""
    initial_directions = identify_directions(np.linalg.inv(solution.covariance) - free_params.prior_information)
    constrained_params = free_params._replace(prior_information=initial_directions.undetermined_projector)
    constrained_solution = solve_with(constrained_params)
    return (
        constrained_solution,
        initial_directions
        if initial_directions.is_undetermined.any()
        else identify_directions(np.linalg.inv(constrained_solution.covariance)),
    )


def fit_status(
    free_params: FreeParameters, solution: LeastSquaresSolution, directions: IdentifiableDirections, dof: int
) -> FitStatus:
    """The `FitStatus` of least squares that are met."""
    if np.min(np.abs(free_params.remaining_range(solution.parameters))) <= STEP_TOLERANCE:
        return FitStatus.BOUND
    return misfit_status(solution.chi2, dof) or (
        FitStatus.UNIDENTIFIABLE if directions.is_undetermined.any() else FitStatus.OK
    )


def misfit_status(chi2: float, dof: int) -> FitStatus | None:
    """MISFIT where noise makes a chi2 as large too seldom."""
    return FitStatus.MISFIT if chi2 > largest_chi2(dof) else None


def build_fit(
    scene,
    names,
    scales,
    parameters,
    directions,
    covariance,
    residuals,
    dof,
    status,
    missed_impacts=(),
    spurious_indices=(),
) -> Fit:
    """The `Fit` of numbers; covariance: in scales; status: a `FitStatus`."""
    determined_projector = np.eye(len(names)) - directions.undetermined_projector
    covariance = determined_projector @ covariance @ determined_projector * np.outer(scales, scales)
    is_undetermined = np.sum(directions.vectors[:, directions.is_undetermined] ** 2, 1) > MIN_INVOLVED_SHARE**2
    sigma = np.where(is_undetermined, np.inf, np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    return Fit(
        dict(zip(names, map(float, parameters), strict=True)),
        dict(zip(names, map(float, sigma), strict=True)),
        _label_covariance(names, covariance),
        -residuals,
        float(residuals @ residuals),
        dof,
        directions.combinations(names, ~directions.is_undetermined),
        directions.combinations(names, directions.is_undetermined),
        missed_impacts,
        spurious_indices,
        scene,
        status,
    )


def build_empty_fit(scene, names, start_values) -> Fit:
    """The `Fit` that says nothing."""
    values, sigma = dict(zip(names, map(float, start_values), strict=True)), dict.fromkeys(names, np.inf)
    nan_covariance, no_residuals = np.full((len(names),) * 2, np.nan), np.zeros(0)
    return Fit(
        values,
        sigma,
        _label_covariance(names, nan_covariance),
        no_residuals,
        np.inf,
        0,
        (),
        (),
        (),
        (),
        scene,
        FitStatus.NONE,
    )


def _label_covariance(names, covariance):
    return xr.DataArray(covariance, dims=("name", "other"), coords={"name": list(names), "other": list(names)})

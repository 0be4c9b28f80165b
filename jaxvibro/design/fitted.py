"""Report a fit: values, errors, and combinations of parameters that a record determines or does not determine."""

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

MAX_KNOWN_ERROR = 1.0  # in scales: a combination with a larger error is undetermined
MIN_INVOLVED_SHARE = 0.05  # share in an undetermined combination above which a parameter has no error of its own
MIN_SHOWN_SHARE = 0.1  # smallest share that the text of a combination shows
MIN_INFORMATION = 1e-30  # smallest information of a combination


class FitStatus(IntEnum):
    """Outcome of a fit.

    Attributes
    ----------
    OK : int
        The parameters are determined.
    UNIDENTIFIABLE : int
        The record does not determine some combinations of parameters, which were held at their initial values.
    BOUND : int
        A parameter is at a bound.
    MISFIT : int
        The scene does not explain the record within its errors.
    NONE : int
        No motion of the scene follows the record. The parameters are the initial ones.

    Examples
    --------
    >>> int(jv.FitStatus.OK), jv.FitStatus(3).name
    (0, 'MISFIT')
    """

    OK = 0
    UNIDENTIFIABLE = 1
    BOUND = 2
    MISFIT = 3
    NONE = 4


@dataclass(frozen=True)
class Combination:
    """Linear combination of the free parameters, each in units of its scale.

    Attributes
    ----------
    shares : dict of str to float
        Coefficient of each parameter. The coefficients form a unit vector.
    sigma : float
        Standard error of the combination.

    Examples
    --------
    >>> print(jv.Combination({"damping": 0.8, "amplitude": -0.6}, sigma=0.01))
    +0.80 damping -0.60 amplitude
    """

    shares: dict[str, float]
    sigma: float

    def __str__(self) -> str:
        ordered_shares = sorted(self.shares.items(), key=lambda share_entry: -abs(share_entry[1]))
        return " ".join(f"{share:+.2f} {name}" for name, share in ordered_shares if abs(share) >= MIN_SHOWN_SHARE)


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters of a scene that fit a record.

    Made by `fit`.

    Attributes
    ----------
    values : dict of str to float
        Value of each free parameter.
    sigma : dict of str to float
        Standard error of each parameter, infinite if the parameter is part of a combination that the record does not
        determine.
    covariance : xarray.DataArray
        Covariance of the parameters along ``"name"`` and ``"other"``, without undetermined combinations.
    residuals : numpy.ndarray
        Measured minus fitted values, in units of the standard errors. Array of shape (residuals,).
    chi2 : float
        Sum of squares of the residuals.
    dof : int
        Number of degrees of freedom, the expected value of `chi2`.
    identifiable : tuple of Combination
        Combinations that the record determines, the best known first.
    unidentifiable : tuple of Combination
        Combinations that the record does not determine.
    missed : tuple of tuple
        Time and side of impacts that are missing from the record.
    spurious : tuple of int
        Indices of the spurious impacts of the record.
    scene : Scene
        Scene with the fitted parameters.
    status : FitStatus
        Outcome of the fit.

    Examples
    --------
    >>> record = jv.PointRecord(branch.points("SN"), [0.52], sigma=0.01)
    >>> result = jv.fit(scene, record, {"damping": 0.01})
    >>> round(result.sigma["damping"], 5), [str(combination) for combination in result.identifiable]
    (0.00249, ['+1.00 damping'])
    """

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
        """Format the fit as text.

        Parameters
        ----------
        units : {"scene", "physical"}, optional
            Units of the values. Physical units (Hz, N, mm, s) require a scene with scales.

        Returns
        -------
        str
            Table with one line per parameter, followed by chi2, the status, undetermined combinations, and missing and
            spurious impacts.

        Raises
        ------
        ArgumentError
            If `units` is unknown, or if physical units are requested of a scene without scales.
        """
        rows: list[tuple[str | float, ...]] = [("parameter", "value", "sigma")]
        for name in self.values:
            unit, unit_size = unit_in_system(self.scene, unit_of(name), units)
            rows.append((column_header(name, unit, units), unit_size * self.values[name], unit_size * self.sigma[name]))
        time_unit = unit_in_system(self.scene, TIME, units)[1]
        lines = [align_columns(rows), f"chi2 {self.chi2:.4g} of {self.dof}, {self.status.name}"]
        lines += [f"undetermined: {combination}" for combination in self.unidentifiable]
        lines += [f"missing impact: {time_unit * time:.6g} {SIDES[int(side > 0)]}" for time, side in self.missed]
        return "\n".join([*lines, *(f"spurious impact: {k}" for k in self.spurious)])


class IdentifiableDirections(NamedTuple):
    """Combinations of the free parameters in units of their scales, the best known first.

    `errors` has shape (free,), `vectors` one column per combination, and `is_undetermined` marks combinations that the
    record does not determine.
    """

    errors: Float[np.ndarray, " free"]
    vectors: Float[np.ndarray, "free free"]
    is_undetermined: Bool[np.ndarray, " free"]

    @property
    def undetermined_projector(self) -> Float[np.ndarray, "free free"]:
        """Projection on the undetermined combinations. Array of shape (free, free)."""
        return self.vectors[:, self.is_undetermined] @ self.vectors[:, self.is_undetermined].T

    def combinations(
        self, names: Sequence[str], selection: slice | Bool[np.ndarray, " free"]
    ) -> tuple[Combination, ...]:
        """Return a selection of the combinations as `Combination` records."""
        error_directions = zip(self.errors[selection], self.vectors.T[selection], strict=True)
        return tuple(
            Combination(dict(zip(names, map(float, direction), strict=True)), float(error))
            for error, direction in error_directions
        )


def identify_directions(information) -> IdentifiableDirections:
    """Diagonalise an information matrix; a matrix that is not finite determines nothing."""
    information = information if np.isfinite(information).all() else np.zeros_like(information)
    information, directions = np.linalg.eigh(0.5 * (information + information.T))
    errors = np.maximum(information, MIN_INFORMATION) ** -0.5
    return IdentifiableDirections(errors[::-1], directions[:, ::-1], errors[::-1] > MAX_KNOWN_ERROR)


def solve_identifiable(
    solution: LeastSquaresSolution,
    free_params: FreeParameters,
    solve_with: Callable[[FreeParameters], LeastSquaresSolution],
) -> tuple[LeastSquaresSolution, IdentifiableDirections]:
    """Solve the least squares with the undetermined combinations held, and nothing else.

    `solve_with` continues from `solution`. Returns the new solution and the `IdentifiableDirections`.
    """
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
    """Return the `FitStatus` of a converged least-squares solution."""
    if np.min(np.abs(free_params.remaining_range(solution.parameters))) <= STEP_TOLERANCE:
        return FitStatus.BOUND
    return misfit_status(solution.chi2, dof) or (
        FitStatus.UNIDENTIFIABLE if directions.is_undetermined.any() else FitStatus.OK
    )


def misfit_status(chi2: float, dof: int) -> FitStatus | None:
    """Return MISFIT if noise rarely causes a chi2 as large, else None."""
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
    """Build the `Fit` of parameter values; `covariance` is in units of the scales."""
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
    """Build the `Fit` with status NONE."""
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

"""Build the result of a fit: values, errors, and combinations of parameters that are determined or undetermined."""

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
from .constrained_least_squares import STEP_TOLERANCE, FreeParameterSpec, LeastSquaresSolution, max_plausible_chi2

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
        The record does not determine some combinations of parameters, which remain near their initial values.
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
        sorted_shares = sorted(self.shares.items(), key=lambda share_entry: -abs(share_entry[1]))
        return " ".join(f"{share:+.2f} {name}" for name, share in sorted_shares if abs(share) >= MIN_SHOWN_SHARE)


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
        Covariance of the parameters along ``"name"`` and ``"other"``. Undetermined combinations are projected out.
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
        table_lines = [align_columns(rows), f"chi2 {self.chi2:.4g} of {self.dof}, {self.status.name}"]
        table_lines += [f"undetermined: {combination}" for combination in self.unidentifiable]
        table_lines += [f"missing impact: {time_unit * time:.6g} {SIDES[int(side > 0)]}" for time, side in self.missed]
        return "\n".join([*table_lines, *(f"spurious impact: {record_index}" for record_index in self.spurious)])


class IdentifiableDirections(NamedTuple):
    """Combinations of the free parameters in units of their scales, the best determined first.

    Attributes
    ----------
    errors : numpy.ndarray
        Standard errors of the combinations. Array of shape (free,).
    combination_vectors : numpy.ndarray
        Coefficients of the combinations, one column each. Array of shape (free, free).
    is_undetermined : numpy.ndarray
        True for combinations that the record does not determine. Array of shape (free,).
    """

    errors: Float[np.ndarray, " free"]
    combination_vectors: Float[np.ndarray, "free free"]
    is_undetermined: Bool[np.ndarray, " free"]

    @property
    def undetermined_projection(self) -> Float[np.ndarray, "free free"]:
        """Projection on the undetermined combinations. Array of shape (free, free)."""
        return self.combination_vectors[:, self.is_undetermined] @ self.combination_vectors[:, self.is_undetermined].T

    def combinations(
        self, parameter_names: Sequence[str], combination_selection: slice | Bool[np.ndarray, " free"]
    ) -> tuple[Combination, ...]:
        """Return a selection of the combinations as `Combination` records."""
        errors_and_vectors = zip(
            self.errors[combination_selection], self.combination_vectors.T[combination_selection], strict=True
        )
        return tuple(
            Combination(dict(zip(parameter_names, map(float, unit_vector), strict=True)), float(standard_error))
            for standard_error, unit_vector in errors_and_vectors
        )


def identify_directions(information) -> IdentifiableDirections:
    """Diagonalise an information matrix; if the matrix is not finite, no combination is determined."""
    information = information if np.isfinite(information).all() else np.zeros_like(information)
    information, eigenvectors = np.linalg.eigh(0.5 * (information + information.T))
    errors = np.maximum(information, MIN_INFORMATION) ** -0.5
    return IdentifiableDirections(errors[::-1], eigenvectors[:, ::-1], errors[::-1] > MAX_KNOWN_ERROR)


def solve_identifiable(
    solution: LeastSquaresSolution,
    free_spec: FreeParameterSpec,
    solve_with_spec: Callable[[FreeParameterSpec], LeastSquaresSolution],
) -> tuple[LeastSquaresSolution, IdentifiableDirections]:
    """Solve a least-squares problem again, with a prior on the undetermined combinations of parameters only.

    `solve_with_spec` is a function of a `FreeParameterSpec` that solves the problem from `solution`. Returns the new
    solution and the `IdentifiableDirections`.
    """
    initial_directions = identify_directions(np.linalg.inv(solution.covariance) - free_spec.prior_information)
    constrained_spec = free_spec._replace(prior_information=initial_directions.undetermined_projection)
    constrained_solution = solve_with_spec(constrained_spec)
    return (
        constrained_solution,
        initial_directions
        if initial_directions.is_undetermined.any()
        else identify_directions(np.linalg.inv(constrained_solution.covariance)),
    )


def status_of_solution(
    free_spec: FreeParameterSpec,
    solution: LeastSquaresSolution,
    identifiable_directions: IdentifiableDirections,
    dof: int,
) -> FitStatus:
    """Return the `FitStatus` of a least-squares solution that has converged."""
    if np.min(np.abs(free_spec.remaining_change_bounds(solution.parameters))) <= STEP_TOLERANCE:
        return FitStatus.BOUND
    return status_if_misfit(solution.chi2, dof) or (
        FitStatus.UNIDENTIFIABLE if identifiable_directions.is_undetermined.any() else FitStatus.OK
    )


def status_if_misfit(chi2: float, dof: int) -> FitStatus | None:
    """Return MISFIT if noise rarely causes such a large chi2, else None."""
    return FitStatus.MISFIT if chi2 > max_plausible_chi2(dof) else None


def build_fit(
    scene,
    parameter_names,
    scales,
    parameters,
    identifiable_directions,
    covariance,
    residuals,
    dof,
    status,
    missed_impacts=(),
    spurious_indices=(),
) -> Fit:
    """Build the `Fit` of parameter values. `covariance` is in units of the scales, `residuals` in standard errors."""
    determined_projection = np.eye(len(parameter_names)) - identifiable_directions.undetermined_projection
    covariance = determined_projection @ covariance @ determined_projection * np.outer(scales, scales)
    is_undetermined = (
        np.sum(identifiable_directions.combination_vectors[:, identifiable_directions.is_undetermined] ** 2, 1)
        > MIN_INVOLVED_SHARE**2
    )
    sigma = np.where(is_undetermined, np.inf, np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    return Fit(
        dict(zip(parameter_names, map(float, parameters), strict=True)),
        dict(zip(parameter_names, map(float, sigma), strict=True)),
        _covariance_with_names(parameter_names, covariance),
        -residuals,
        float(residuals @ residuals),
        dof,
        identifiable_directions.combinations(parameter_names, ~identifiable_directions.is_undetermined),
        identifiable_directions.combinations(parameter_names, identifiable_directions.is_undetermined),
        missed_impacts,
        spurious_indices,
        scene,
        status,
    )


def build_empty_fit(scene, parameter_names, start_values) -> Fit:
    """Build the `Fit` with status NONE and the initial parameter values."""
    values, sigma = (
        dict(zip(parameter_names, map(float, start_values), strict=True)),
        dict.fromkeys(parameter_names, np.inf),
    )
    nan_covariance, empty_residuals = np.full((len(parameter_names),) * 2, np.nan), np.zeros(0)
    return Fit(
        values,
        sigma,
        _covariance_with_names(parameter_names, nan_covariance),
        empty_residuals,
        np.inf,
        0,
        (),
        (),
        (),
        (),
        scene,
        FitStatus.NONE,
    )


def _covariance_with_names(parameter_names, covariance):
    return xr.DataArray(
        covariance, dims=("name", "other"), coords={"name": list(parameter_names), "other": list(parameter_names)}
    )

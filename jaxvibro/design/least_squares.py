"""Solve least squares under equality constraints by the Gauss-Newton method.

Unknowns are all nodes of a record and the free parameters (multiple shooting; Bock 1981). The sum of squares of the
residuals is minimised subject to c = 0, the conditions between consecutive nodes. A step solves the Karush-Kuhn-Tucker
system ((H, C^T), (C, 0)) with the normal matrix H and the Jacobian C of c. The block of its inverse that belongs to the
parameters is their covariance.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ..scene.scene import Scene, replace_unchecked

MAX_ITERATIONS = 200  # Newton steps
STEP_TOLERANCE = 1e-6  # in standard errors: a shorter step is the last
CONSTRAINT_FACTOR = 1e-3  # relative to the step tolerance: largest violation of the constraints
MAX_STEP = 4.0  # largest change of a parameter in a step, in scales
MAX_HALVINGS = 8
MISFIT_PROBABILITY = 1e-5  # a chi2 that noise exceeds less often is a misfit
REGULARISATION = 1e-12  # relative to the diagonal of H: regularises unknowns without measurements


class FreeParameters(NamedTuple):
    """Free parameters of a fit.

    `names` ends with ``"phase"`` if the phase of the drive at time 0 is free. `start_values` are the initial values.
    `lower` and `upper` bound the change from them, in units of `scales`. `prior_information` is the information matrix
    of the prior, in the same units.
    """

    names: tuple[str, ...]
    scales: Float[np.ndarray, " free"]
    start_values: Float[np.ndarray, " free"]
    lower: Float[np.ndarray, " free"]
    upper: Float[np.ndarray, " free"]
    prior_information: Float[np.ndarray, "free free"]

    def split_phase(self, parameters: Float[np.ndarray, "free ..."], phase: float) -> tuple[tuple[str, ...], Any]:
        """Return the names of the parameters of the scene, and the phase of the drive at time 0.

        The phase is the last parameter if it is free.
        """
        return (self.names[:-1], parameters[-1]) if self.names[-1:] == ("phase",) else (self.names, phase)

    def scene_and_phase(
        self, scene: Scene, phase: float, parameters: Float[np.ndarray, " free"]
    ) -> tuple[Scene, float]:
        """Return the scene with these parameters, and the phase."""
        names, phase = self.split_phase(parameters, phase)
        return replace_unchecked(scene, dict(zip(names, parameters[: len(names)], strict=True))), float(phase)

    def with_start_phase(self, parameters: Float[np.ndarray, " free"]) -> "FreeParameters":
        """Return the free parameters with the phase of `parameters` as initial value, if the phase is free."""
        if self.names[-1] != "phase":
            return self
        return self._replace(start_values=np.append(self.start_values[:-1], parameters[-1]))

    def remaining_range(self, parameters: Float[np.ndarray, " free"]) -> Float[np.ndarray, "2 free"]:
        """Return the bounds of the further change of parameters, in units of their scales."""
        return np.array([self.lower, self.upper]) - (parameters - self.start_values) / self.scales


class Linearisation(NamedTuple):
    """Constraints and residuals at nodes and parameters, with their Jacobians.

    The columns are the unknowns of the nodes, then the parameters in units of their scales. Residuals are in standard
    errors.
    """

    constraints: Float[np.ndarray, " equations"]
    constraint_jacobian: "scipy.sparse.csr_array"
    residuals: Float[np.ndarray, " seen"]
    residual_jacobian: "scipy.sparse.csr_array"


class LeastSquaresProblem(NamedTuple):
    """Functions that define a problem.

    `linearise` maps (nodes, parameters) to a `Linearisation`. `shift_nodes` applies a change of the unknowns to nodes.
    `max_step_fraction` returns the admissible fraction, at most 1, of a step (nodes, parameters, change of the
    unknowns, change of the parameters).
    """

    linearise: Callable[[Any, Float[np.ndarray, " free"]], Linearisation]
    shift_nodes: Callable[[Any, Float[np.ndarray, " inner"]], Any]
    max_step_fraction: Callable[
        [Any, Float[np.ndarray, " free"], Float[np.ndarray, " inner"], Float[np.ndarray, " free"]], float
    ]


class LeastSquaresSolution(NamedTuple):
    """Solution of a least-squares problem.

    `chi2` is the sum of squares of `residuals`, in standard errors, `prior_chi2` that of the prior. `max_constraint` is
    the largest violation of a constraint. `factors` factorise the last system, None if it is singular.
    `n_node_unknowns` counts the unknowns of the nodes. `converged` states whether the last step was short.
    """

    nodes: Any
    parameters: Float[np.ndarray, " free"]
    residuals: Float[np.ndarray, " seen"]
    chi2: float
    prior_chi2: float
    max_constraint: float
    factors: "scipy.sparse.linalg.SuperLU | None"
    n_node_unknowns: int
    converged: bool

    @property
    def covariance(self) -> Float[np.ndarray, "free free"]:
        """Covariance of the parameters, in units of their scales."""
        return self.covariance_with([])

    def covariance_with(self, node_indices: Sequence[int]) -> Float[np.ndarray, "some some"]:
        """Return the covariance of some unknowns of the nodes, followed by the parameters.

        It is nan if the system is singular.
        """
        selection = np.array([*node_indices, *range(self.n_node_unknowns, self.n_node_unknowns + len(self.parameters))])
        if self.factors is None:
            return np.full((len(selection),) * 2, np.nan)
        columns = np.zeros((self.factors.shape[0], len(selection)))
        columns[selection, np.arange(len(selection))] = 1.0
        return self.factors.solve(columns)[selection]


class _Iterate(NamedTuple):
    """Nodes and parameters of an iteration with their `Linearisation`."""

    nodes: Any
    parameters: Float[np.ndarray, " free"]
    linearisation: Linearisation


def solve_least_squares(
    problem: LeastSquaresProblem,
    nodes,
    free_params: FreeParameters,
    parameters,
    max_iterations=MAX_ITERATIONS,
    step_tolerance=STEP_TOLERANCE,
) -> LeastSquaresSolution:
    """Solve the least squares from approximate nodes and parameters.

    The iteration ends at a step below `step_tolerance`, in units of standard errors and scales.
    """
    iterate = _Iterate(nodes, parameters, problem.linearise(nodes, parameters))
    penalty, converged = 0.0, False
    for _ in range(max_iterations):
        newton_step = _newton_step(iterate, free_params)
        if newton_step is None:
            break
        full_step, multipliers, factors = newton_step
        penalty = max(penalty, 1.5 * np.max(abs(multipliers), initial=0.0))
        is_last = _step_size(iterate, full_step) <= step_tolerance
        next_iterate = _line_search(problem, iterate, free_params, full_step, penalty, factors, is_last)
        if not np.isfinite(_merit(next_iterate, free_params, penalty)):
            break
        iterate = next_iterate
        converged = bool(is_last and _max_constraint(iterate) <= CONSTRAINT_FACTOR * step_tolerance)
        if converged:
            break
    return _make_solution(iterate, free_params, converged)


def largest_chi2(dof: int) -> float:
    """Return the chi2 that noise exceeds with probability `MISFIT_PROBABILITY`."""
    return float(scipy.special.chdtri(max(1, dof), MISFIT_PROBABILITY))


def _max_constraint(iterate):
    return float(abs(iterate.linearisation.constraints).max(initial=0.0))


def _prior_deviation(iterate, free_params):
    return (iterate.parameters - free_params.start_values) / free_params.scales


def _merit(iterate, free_params, penalty):
    prior_deviation, residuals = _prior_deviation(iterate, free_params), iterate.linearisation.residuals
    return (
        0.5 * (residuals @ residuals + prior_deviation @ free_params.prior_information @ prior_deviation)
        + penalty * abs(iterate.linearisation.constraints).sum()
    )


def _kkt_system(iterate, free_params):
    """Return the Karush-Kuhn-Tucker matrix and the gradient."""
    linearisation = iterate.linearisation
    n_node_unknowns = linearisation.constraint_jacobian.shape[1] - len(iterate.parameters)
    normal_matrix = linearisation.residual_jacobian.T @ linearisation.residual_jacobian
    gradient = linearisation.residual_jacobian.T @ linearisation.residuals
    gradient[n_node_unknowns:] += free_params.prior_information @ _prior_deviation(iterate, free_params)
    regularisation = REGULARISATION * np.max(normal_matrix.diagonal()[:n_node_unknowns], initial=1.0)
    normal_matrix = normal_matrix + scipy.sparse.block_diag(
        [regularisation * scipy.sparse.eye_array(n_node_unknowns), free_params.prior_information]
    )
    return scipy.sparse.block_array(
        [[normal_matrix, linearisation.constraint_jacobian.T], [linearisation.constraint_jacobian, None]], format="csc"
    ), gradient


def _factorise(matrix):
    """Return the sparse LU factors of a matrix, or None if it is singular."""
    if not np.isfinite(matrix.data).all():
        return None
    try:
        return scipy.sparse.linalg.splu(matrix)
    except RuntimeError:  # the matrix is singular
        return None


def _newton_step(iterate, free_params):
    """Return (step, multipliers, factors), or None. A parameter that would exceed a bound is set to it."""
    matrix, gradient = _kkt_system(iterate, free_params)
    n_unknowns, n_node_unknowns = len(gradient), len(gradient) - len(iterate.parameters)
    right_side = -np.concatenate([gradient, iterate.linearisation.constraints])
    lower, upper = free_params.remaining_range(iterate.parameters)
    is_fixed = np.zeros(len(lower), bool)
    while (factors := _factorise(matrix)) is not None:
        solution = factors.solve(right_side)
        if not np.isfinite(solution).all():
            break
        step = solution[n_node_unknowns:n_unknowns]
        is_beyond = ((step < lower) | (step > upper)) & ~is_fixed
        if not is_beyond.any():
            return solution[:n_unknowns], solution[n_unknowns:], factors
        fixed_rows = np.isin(np.arange(len(right_side)), n_node_unknowns + np.flatnonzero(is_beyond)).astype(float)
        matrix = (scipy.sparse.diags_array(1.0 - fixed_rows) @ matrix + scipy.sparse.diags_array(fixed_rows)).tocsc()
        right_side[n_node_unknowns + np.flatnonzero(is_beyond)] = np.where(step < lower, lower, upper)[is_beyond]
        is_fixed |= is_beyond
    return None


def _line_search(problem, iterate, free_params, step, penalty, factors, is_last):
    """Return the `_Iterate` after the largest tried fraction of a step that decreases the merit function.

    The last step is taken in full. If a full step fails, a second-order correction first removes the violation of the
    constraints (Maratos effect).
    """

    def iterate_after(change):
        node_change, parameter_change = _split_step(iterate, change)
        nodes, parameters = (
            problem.shift_nodes(iterate.nodes, node_change),
            iterate.parameters + parameter_change * free_params.scales,
        )
        return _Iterate(nodes, parameters, problem.linearise(nodes, parameters))

    def step_fraction(change):
        node_change, parameter_change = _split_step(iterate, change)
        fraction = problem.max_step_fraction(
            iterate.nodes, iterate.parameters, node_change, parameter_change * free_params.scales
        )
        return min(fraction, MAX_STEP / max(np.max(abs(parameter_change), initial=0.0), MAX_STEP))

    full_fraction = step_fraction(step)
    fraction, merit_before = full_fraction, _merit(iterate, free_params, penalty)
    for _ in range(MAX_HALVINGS):
        next_iterate = iterate_after(fraction * step)
        if is_last or _merit(next_iterate, free_params, penalty) <= merit_before:
            break
        if fraction == full_fraction == 1.0:
            constraint_rhs = np.concatenate([0.0 * step, -next_iterate.linearisation.constraints])
            corrected_step = step + factors.solve(constraint_rhs)[: len(step)]
            next_iterate = iterate_after(step_fraction(corrected_step) * corrected_step)
            if _merit(next_iterate, free_params, penalty) <= merit_before:
                break
        fraction *= 0.5
    return next_iterate


def _split_step(iterate, step):
    """Return the change of the unknowns of the nodes, and that of the parameters in units of their scales."""
    n_node_unknowns = len(step) - len(iterate.parameters)
    return step[:n_node_unknowns], step[n_node_unknowns:]


def _step_size(iterate, step):
    """Return the largest change of a measured value in standard errors, or of a parameter in units of its scale."""
    return max(
        abs(iterate.linearisation.residual_jacobian @ step).max(initial=0.0),
        abs(_split_step(iterate, step)[1]).max(initial=0.0),
    )


def _make_solution(iterate, free_params, converged):
    matrix, _ = _kkt_system(iterate, free_params)
    residuals, prior_deviation = iterate.linearisation.residuals, _prior_deviation(iterate, free_params)
    chi2, prior_chi2 = (
        float(residuals @ residuals),
        float(prior_deviation @ free_params.prior_information @ prior_deviation),
    )
    n_node_unknowns = iterate.linearisation.constraint_jacobian.shape[1] - len(iterate.parameters)
    return LeastSquaresSolution(
        iterate.nodes,
        iterate.parameters,
        residuals,
        chi2,
        prior_chi2,
        _max_constraint(iterate),
        _factorise(matrix),
        n_node_unknowns,
        converged,
    )

"""Solve least-squares problems with equality constraints by the Gauss-Newton method.

The unknowns are all nodes of a record and the free parameters (multiple shooting; Bock 1981). The sum of squares of the
residuals is minimised subject to c = 0, the conditions between consecutive nodes. A step solves the Karush-Kuhn-Tucker
system ((H, C^T), (C, 0)) with the normal matrix H and the Jacobian C of c. The parameter block of the inverse of this
matrix is the covariance of the parameters.
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


class FreeParameterSpec(NamedTuple):
    """Free parameters of a fit: names, scales, initial values, bounds and prior.

    Attributes
    ----------
    scene : Scene
        Initial scene.
    phase : float
        Phase of the drive at time 0; not used if the phase is a free parameter.
    names : tuple of str
        Names of the parameters. The last is ``"phase"`` if the phase of the drive at time 0 is free.
    scales : numpy.ndarray
        Scale of each parameter. Array of shape (free,).
    start_values : numpy.ndarray
        Initial values. Array of shape (free,).
    lower, upper : numpy.ndarray
        Bounds of the change from the initial values, in scales. Arrays of shape (free,).
    prior_information : numpy.ndarray
        Information matrix of the prior, in scales. Array of shape (free, free).
    """

    scene: Scene
    phase: float
    names: tuple[str, ...]
    scales: Float[np.ndarray, " free"]
    start_values: Float[np.ndarray, " free"]
    lower: Float[np.ndarray, " free"]
    upper: Float[np.ndarray, " free"]
    prior_information: Float[np.ndarray, "free free"]

    def separate_start_phase(self, parameters: Float[np.ndarray, "free ..."]) -> tuple[tuple[str, ...], Any]:
        """Return the names of the parameters of the scene, and the phase of the drive at time 0.

        The phase is the last of `parameters` if it is free.
        """
        return (self.names[:-1], parameters[-1]) if self.names[-1:] == ("phase",) else (self.names, self.phase)

    def scene_and_start_phase(self, parameters: Float[np.ndarray, " free"]) -> tuple[Scene, float]:
        """Return the scene with these parameters, and the phase of the drive at time 0."""
        names, phase = self.separate_start_phase(parameters)
        scene = replace_unchecked(self.scene, dict(zip(names, parameters[: len(names)], strict=True)))
        return scene, float(phase)

    def with_start_phase(self, parameters: Float[np.ndarray, " free"]) -> "FreeParameterSpec":
        """If the phase is free, return a copy whose initial phase is the last of `parameters`."""
        if self.names[-1] != "phase":
            return self
        return self._replace(start_values=np.append(self.start_values[:-1], parameters[-1]))

    def remaining_change_bounds(self, parameters: Float[np.ndarray, " free"]) -> Float[np.ndarray, "2 free"]:
        """Return the lower and upper bound of a further change of the parameters, in units of their scales."""
        return np.array([self.lower, self.upper]) - (parameters - self.start_values) / self.scales


class Linearisation(NamedTuple):
    """Constraints and residuals at nodes and parameters, with their Jacobians.

    The columns of both Jacobians are the unknowns of the nodes, then the parameters in units of their scales.

    Attributes
    ----------
    constraint_values : numpy.ndarray
        Values of the constraints, zero if they are satisfied. Array of shape (equations,).
    constraint_jacobian : scipy.sparse.csr_array
        Jacobian of the constraints.
    residuals : numpy.ndarray
        Computed minus measured values, in standard errors. Array of shape (measurements,).
    residual_jacobian : scipy.sparse.csr_array
        Jacobian of the residuals.
    """

    constraint_values: Float[np.ndarray, " equations"]
    constraint_jacobian: "scipy.sparse.csr_array"
    residuals: Float[np.ndarray, " seen"]
    residual_jacobian: "scipy.sparse.csr_array"


class LeastSquaresProblem(NamedTuple):
    """Functions that define a constrained least-squares problem.

    Attributes
    ----------
    linearise : callable
        Function of (nodes, parameters) that returns a `Linearisation`.
    add_node_change : callable
        Function of (nodes, change of their unknowns) that returns the new nodes.
    max_step_fraction : callable
        Function of (nodes, parameters, change of the unknowns, change of the parameters) that returns the admissible
        fraction of this step, at most 1.
    """

    linearise: Callable[[Any, Float[np.ndarray, " free"]], Linearisation]
    add_node_change: Callable[[Any, Float[np.ndarray, " inner"]], Any]
    max_step_fraction: Callable[
        [Any, Float[np.ndarray, " free"], Float[np.ndarray, " inner"], Float[np.ndarray, " free"]], float
    ]


class LeastSquaresSolution(NamedTuple):
    """Solution of a least-squares problem.

    Attributes
    ----------
    nodes : object
        Nodes at the solution.
    parameters : numpy.ndarray
        Parameter values. Array of shape (free,).
    residuals : numpy.ndarray
        Residuals in standard errors.
    chi2 : float
        Sum of squares of the residuals.
    prior_chi2 : float
        Quadratic form of the prior information matrix in the deviations of the parameters from their initial values, in
        scales. The sum of `chi2` and `prior_chi2` is minimised.
    max_constraint : float
        Largest violation of a constraint.
    kkt_factors : scipy.sparse.linalg.SuperLU or None
        Factors of the Karush-Kuhn-Tucker matrix, None if it is singular.
    n_node_unknowns : int
        Number of unknowns of the nodes.
    converged : bool
        True if the last step was short and the constraints are satisfied.
    """

    nodes: Any
    parameters: Float[np.ndarray, " free"]
    residuals: Float[np.ndarray, " seen"]
    chi2: float
    prior_chi2: float
    max_constraint: float
    kkt_factors: "scipy.sparse.linalg.SuperLU | None"
    n_node_unknowns: int
    converged: bool

    @property
    def covariance(self) -> Float[np.ndarray, "free free"]:
        """Covariance of the parameters, in units of their scales."""
        return self.covariance_with([])

    def covariance_with(self, node_unknown_indices: Sequence[int]) -> Float[np.ndarray, "some some"]:
        """Return the joint covariance of selected unknowns of the nodes and all parameters, in this order.

        `node_unknown_indices` are the indices of the selected unknowns. The covariance is nan if the matrix is
        singular.
        """
        unknown_indices = np.array(
            [*node_unknown_indices, *range(self.n_node_unknowns, self.n_node_unknowns + len(self.parameters))]
        )
        if self.kkt_factors is None:
            return np.full((len(unknown_indices),) * 2, np.nan)
        unit_columns = np.zeros((self.kkt_factors.shape[0], len(unknown_indices)))
        unit_columns[unknown_indices, np.arange(len(unknown_indices))] = 1.0
        return self.kkt_factors.solve(unit_columns)[unknown_indices]


class _GaussNewtonIterate(NamedTuple):
    """Nodes and parameters of an iteration with their `Linearisation`."""

    nodes: Any
    parameters: Float[np.ndarray, " free"]
    linearisation: Linearisation


def solve_least_squares(
    problem: LeastSquaresProblem,
    nodes,
    free_spec: FreeParameterSpec,
    parameters,
    max_iterations=MAX_ITERATIONS,
    step_tolerance=STEP_TOLERANCE,
) -> LeastSquaresSolution:
    """Solve a constrained least-squares problem from approximate nodes and parameters.

    The iteration converges with a step that is shorter than `step_tolerance`, if the constraints are satisfied after
    this step. The step is measured in standard errors of the measured values and in scales of the parameters. The
    iteration ends without convergence after `max_iterations` steps, if a system is singular, or if a step leads to
    values that are not finite.
    """
    iterate = _GaussNewtonIterate(nodes, parameters, problem.linearise(nodes, parameters))
    constraint_penalty, converged = 0.0, False
    for _ in range(max_iterations):
        step_solution = _newton_step_in_bounds(iterate, free_spec)
        if step_solution is None:
            break
        full_step, constraint_multipliers, kkt_factors = step_solution
        constraint_penalty = max(constraint_penalty, 1.5 * np.max(abs(constraint_multipliers), initial=0.0))
        is_last_step = _scaled_step_size(iterate, full_step) <= step_tolerance
        next_iterate = _line_search(
            problem, iterate, free_spec, full_step, constraint_penalty, kkt_factors, is_last_step
        )
        if not np.isfinite(_merit_function(next_iterate, free_spec, constraint_penalty)):
            break
        iterate = next_iterate
        converged = bool(is_last_step and _max_violation(iterate) <= CONSTRAINT_FACTOR * step_tolerance)
        if converged:
            break
    return _make_solution(iterate, free_spec, converged)


def max_plausible_chi2(dof: int) -> float:
    """Return the chi2 that noise exceeds with probability `MISFIT_PROBABILITY`."""
    return float(scipy.special.chdtri(max(1, dof), MISFIT_PROBABILITY))


def _max_violation(iterate):
    return float(abs(iterate.linearisation.constraint_values).max(initial=0.0))


def _deviation_from_prior(iterate, free_spec):
    return (iterate.parameters - free_spec.start_values) / free_spec.scales


def _merit_function(iterate, free_spec, constraint_penalty):
    prior_deviation, residuals = _deviation_from_prior(iterate, free_spec), iterate.linearisation.residuals
    return (
        0.5 * (residuals @ residuals + prior_deviation @ free_spec.prior_information @ prior_deviation)
        + constraint_penalty * abs(iterate.linearisation.constraint_values).sum()
    )


def _kkt_system(iterate, free_spec):
    """Return the Karush-Kuhn-Tucker matrix and the gradient of the cost, without the constraint terms."""
    linearisation = iterate.linearisation
    n_node_unknowns = linearisation.constraint_jacobian.shape[1] - len(iterate.parameters)
    normal_matrix = linearisation.residual_jacobian.T @ linearisation.residual_jacobian
    cost_gradient = linearisation.residual_jacobian.T @ linearisation.residuals
    cost_gradient[n_node_unknowns:] += free_spec.prior_information @ _deviation_from_prior(iterate, free_spec)
    regularisation = REGULARISATION * np.max(normal_matrix.diagonal()[:n_node_unknowns], initial=1.0)
    normal_matrix = normal_matrix + scipy.sparse.block_diag(
        [regularisation * scipy.sparse.eye_array(n_node_unknowns), free_spec.prior_information]
    )
    return scipy.sparse.block_array(
        [[normal_matrix, linearisation.constraint_jacobian.T], [linearisation.constraint_jacobian, None]], format="csc"
    ), cost_gradient


def _factorise_matrix(sparse_matrix):
    """Return the sparse LU factors of a matrix, or None if it is singular."""
    if not np.isfinite(sparse_matrix.data).all():
        return None
    try:
        return scipy.sparse.linalg.splu(sparse_matrix)
    except RuntimeError:  # the matrix is singular
        return None


def _newton_step_in_bounds(iterate, free_spec):
    """Return (step, constraint multipliers, factors) of a Gauss-Newton step, or None if the system is singular.

    A parameter that would exceed a bound is set to this bound.
    """
    kkt_matrix, cost_gradient = _kkt_system(iterate, free_spec)
    n_unknowns, n_node_unknowns = len(cost_gradient), len(cost_gradient) - len(iterate.parameters)
    right_side = -np.concatenate([cost_gradient, iterate.linearisation.constraint_values])
    lower, upper = free_spec.remaining_change_bounds(iterate.parameters)
    is_at_bound = np.zeros(len(lower), bool)
    while (kkt_factors := _factorise_matrix(kkt_matrix)) is not None:
        kkt_solution = kkt_factors.solve(right_side)
        if not np.isfinite(kkt_solution).all():
            break
        parameter_step = kkt_solution[n_node_unknowns:n_unknowns]
        is_beyond_bound = ((parameter_step < lower) | (parameter_step > upper)) & ~is_at_bound
        if not is_beyond_bound.any():
            return kkt_solution[:n_unknowns], kkt_solution[n_unknowns:], kkt_factors
        fixed_row_mask = np.isin(np.arange(len(right_side)), n_node_unknowns + np.flatnonzero(is_beyond_bound)).astype(
            float
        )
        kkt_matrix = (
            scipy.sparse.diags_array(1.0 - fixed_row_mask) @ kkt_matrix + scipy.sparse.diags_array(fixed_row_mask)
        ).tocsc()
        right_side[n_node_unknowns + np.flatnonzero(is_beyond_bound)] = np.where(parameter_step < lower, lower, upper)[
            is_beyond_bound
        ]
        is_at_bound |= is_beyond_bound
    return None


def _line_search(problem, iterate, free_spec, full_step, constraint_penalty, kkt_factors, is_last_step):
    """Return the iterate after the largest tried fraction of a step that does not increase the merit function.

    The last step is accepted without a test of the merit function. If a full step increases the merit function, a
    second-order correction first reduces the violation of the constraints (Maratos effect).
    """

    def iterate_after_step(step):
        node_change, parameter_change = _split_nodes_parameters(iterate, step)
        nodes, parameters = (
            problem.add_node_change(iterate.nodes, node_change),
            iterate.parameters + parameter_change * free_spec.scales,
        )
        return _GaussNewtonIterate(nodes, parameters, problem.linearise(nodes, parameters))

    def admissible_fraction(step):
        node_change, parameter_change = _split_nodes_parameters(iterate, step)
        fraction = problem.max_step_fraction(
            iterate.nodes, iterate.parameters, node_change, parameter_change * free_spec.scales
        )
        return min(fraction, MAX_STEP / max(np.max(abs(parameter_change), initial=0.0), MAX_STEP))

    max_fraction = admissible_fraction(full_step)
    fraction, merit_before = max_fraction, _merit_function(iterate, free_spec, constraint_penalty)
    for _ in range(MAX_HALVINGS):
        next_iterate = iterate_after_step(fraction * full_step)
        if is_last_step or _merit_function(next_iterate, free_spec, constraint_penalty) <= merit_before:
            break
        if fraction == max_fraction == 1.0:
            correction_right_side = np.concatenate([0.0 * full_step, -next_iterate.linearisation.constraint_values])
            corrected_step = full_step + kkt_factors.solve(correction_right_side)[: len(full_step)]
            next_iterate = iterate_after_step(admissible_fraction(corrected_step) * corrected_step)
            if _merit_function(next_iterate, free_spec, constraint_penalty) <= merit_before:
                break
        fraction *= 0.5
    return next_iterate


def _split_nodes_parameters(iterate, step):
    """Split a step into the change of the node unknowns and the change of the parameters in units of their scales."""
    n_node_unknowns = len(step) - len(iterate.parameters)
    return step[:n_node_unknowns], step[n_node_unknowns:]


def _scaled_step_size(iterate, step):
    """Return the largest change of a measured value in standard errors, or of a parameter in units of its scale."""
    return max(
        abs(iterate.linearisation.residual_jacobian @ step).max(initial=0.0),
        abs(_split_nodes_parameters(iterate, step)[1]).max(initial=0.0),
    )


def _make_solution(iterate, free_spec, converged):
    kkt_matrix, _ = _kkt_system(iterate, free_spec)
    residuals, prior_deviation = iterate.linearisation.residuals, _deviation_from_prior(iterate, free_spec)
    chi2, prior_chi2 = (
        float(residuals @ residuals),
        float(prior_deviation @ free_spec.prior_information @ prior_deviation),
    )
    n_node_unknowns = iterate.linearisation.constraint_jacobian.shape[1] - len(iterate.parameters)
    return LeastSquaresSolution(
        iterate.nodes,
        iterate.parameters,
        residuals,
        chi2,
        prior_chi2,
        _max_violation(iterate),
        _factorise_matrix(kkt_matrix),
        n_node_unknowns,
        converged,
    )

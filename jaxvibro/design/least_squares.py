"""Numbers of a scene, and what they leave open between nodes: least squares under equations, by Gauss and Newton.

Unknown are all nodes of a record and the free numbers together (multiple shooting; Bock 1981): the sum of squares of
residuals is least under c = 0, what is left open between one node and the next. A step solves the Karush-Kuhn-Tucker
system ((H, C^T), (C, 0)), H the squares' normal matrix, C the derivative of c. The part of its inverse that belongs to
the numbers is their covariance.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from ..scene.scene import Scene, replace_unchecked

MAX_ITERATIONS = 200  # of Newton's steps
STEP_TOLERANCE = 1e-6  # of the errors: a step as short is the last
CONSTRAINT_FACTOR = 1e-3  # of that: what may be left open between nodes
MAX_STEP = 4.0  # scales that a number may change by in a step
MAX_HALVINGS = 8
MISFIT_PROBABILITY = 1e-5  # a chi2 that noise makes larger so seldom is too large
REGULARISATION = 1e-12  # of H's first entries: what makes it regular in unknowns that nothing is known of


class FreeParameters(NamedTuple):
    """The free numbers: their names, the drive's phase at time 0 last where it is free; scales; where they began; in
    scales, how far from there they may go, and how much is known of them beforehand, a matrix."""

    names: tuple[str, ...]
    scales: Float[np.ndarray, " free"]
    start_values: Float[np.ndarray, " free"]
    lower: Float[np.ndarray, " free"]
    upper: Float[np.ndarray, " free"]
    prior_information: Float[np.ndarray, "free free"]

    def split_phase(self, parameters: Float[np.ndarray, "free ..."], phase: float) -> tuple[tuple[str, ...], Any]:
        """(the names of the scene's numbers among them, the drive's phase at time 0, which may be one of the
        numbers)."""
        return (self.names[:-1], parameters[-1]) if self.names[-1:] == ("phase",) else (self.names, phase)

    def scene_and_phase(
        self, scene: Scene, phase: float, parameters: Float[np.ndarray, " free"]
    ) -> tuple[Scene, float]:
        """(the scene with these numbers, the phase)."""
        names, phase = self.split_phase(parameters, phase)
        return replace_unchecked(scene, dict(zip(names, parameters[: len(names)], strict=True))), float(phase)

    def with_start_phase(self, parameters: Float[np.ndarray, " free"]) -> "FreeParameters":
        """The same begun at the phase of other numbers, where it is free."""
        if self.names[-1] != "phase":
            return self
        return self._replace(start_values=np.append(self.start_values[:-1], parameters[-1]))

    def remaining_range(self, parameters: Float[np.ndarray, " free"]) -> Float[np.ndarray, "2 free"]:
        """(low, high) of the further change of numbers, in scales."""
        return np.array([self.lower, self.upper]) - (parameters - self.start_values) / self.scales


class Linearisation(NamedTuple):
    """Of nodes and numbers: what is left open and its derivative by the nodes' unknowns, then by the numbers in their
    scales; the residuals in errors, and their derivative."""

    constraints: Float[np.ndarray, " equations"]
    constraint_jacobian: "scipy.sparse.csr_array"
    residuals: Float[np.ndarray, " seen"]
    residual_jacobian: "scipy.sparse.csr_array"


class LeastSquaresProblem(NamedTuple):
    """linearise: (nodes, numbers) -> `Linearisation`; shift_nodes: (nodes, change of their unknowns) -> nodes;
    max_step_fraction: (nodes, numbers, change of the unknowns, of the numbers) -> how much of it may be made at once, 1
    at most."""

    linearise: Callable[[Any, Float[np.ndarray, " free"]], Linearisation]
    shift_nodes: Callable[[Any, Float[np.ndarray, " inner"]], Any]
    max_step_fraction: Callable[
        [Any, Float[np.ndarray, " free"], Float[np.ndarray, " inner"], Float[np.ndarray, " free"]], float
    ]


class LeastSquaresSolution(NamedTuple):
    """nodes, numbers; residuals in errors; chi2: their squares' sum; prior_chi2: the same of what was known beforehand;
    max_constraint: what is left open at most; factors: the factors of the last system, None where it is singular;
    n_node_unknowns: how many unknowns the nodes have; converged: whether the last step was a short one."""

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
        """Of the numbers, in scales."""
        return self.covariance_with([])

    def covariance_with(self, node_indices: Sequence[int]) -> Float[np.ndarray, "some some"]:
        """The covariance of some of the nodes' unknowns, and then the numbers in scales; nan where there is none."""
        selection = np.array([*node_indices, *range(self.n_node_unknowns, self.n_node_unknowns + len(self.parameters))])
        if self.factors is None:
            return np.full((len(selection),) * 2, np.nan)
        columns = np.zeros((self.factors.shape[0], len(selection)))
        columns[selection, np.arange(len(selection))] = 1.0
        return self.factors.solve(columns)[selection]


class _Iterate(NamedTuple):
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
    """The `LeastSquaresSolution` least squares from nodes and numbers near it; step_tolerance: of errors and scales, a
    step as short is the last."""
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
    """What noise makes larger too seldom."""
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
    """(the matrix of Karush, Kuhn and Tucker, the gradient)."""
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
    """The factors of a matrix, None where it has none."""
    if not np.isfinite(matrix.data).all():
        return None
    try:
        return scipy.sparse.linalg.splu(matrix)
    except RuntimeError:  # it is singular
        return None


def _newton_step(iterate, free_params):
    """(step, multipliers, the matrix's factors), None where there is none. A number that would pass the end of where it
    may be goes there."""
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
    """The `_Iterate` after as much of a step as makes it better, of the last step after all of it. Where the whole step
    does not, what is then left open is taken away first (Maratos's effect)."""

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
    """(of the nodes' unknowns, of the numbers in scales)."""
    n_node_unknowns = len(step) - len(iterate.parameters)
    return step[:n_node_unknowns], step[n_node_unknowns:]


def _step_size(iterate, step):
    """The largest change of what was measured, in errors, and of the numbers, in scales."""
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

"""Find the point on an edge of a boundary that is nearest to a scene.

The vector w consists of the times, the speeds, the null vector and the offset y from the scene. The equations of the
edge are r(w) = 0. At the nearest point, the Lagrangian ``y y / 2 + m r(w)`` is stationary (Karush-Kuhn-Tucker
conditions). Newton's method solves these conditions for w and the multipliers m.
"""

from functools import partial

import jax
import numpy as np

from ..scene.codes import SolutionStatus
from .boundary_edge import evaluate_clearances
from .nearest_boundary_point import NearestBoundaryPoint

MAX_GAUSS_NEWTON = 30  # Gauss-Newton steps onto the edge
MAX_NEWTON = 40  # Newton steps on the optimality conditions
MAX_STEP = 0.3  # relative to 1 + the largest unknown: longest step
DIFFERENCE_STEP = 1e-5  # relative to 1 + the largest unknown: step of central differences
STEP_TOLERANCE = 1e-10  # relative to 1 + the largest unknown: a shorter step is the last
TINY = 1e-300


@jax.jit
def _residuals_and_jacobians(edge, scene_vector, unit_changes, variable_rows):
    """Return r and its Jacobian with respect to unknowns and offset, for each row of `variable_rows`."""
    n_params = len(unit_changes)

    def edge_residual(unknowns_and_offset):
        return edge.residual(
            unknowns_and_offset[:-n_params], scene_vector + unknowns_and_offset[-n_params:] @ unit_changes
        )

    return jax.vmap(edge_residual)(variable_rows), jax.vmap(jax.jacfwd(edge_residual))(variable_rows)


def find_nearest_edge_point(edge, unknowns, scene_vector, unit_changes, offset):
    """Return the `NearestBoundaryPoint` on an edge to which Newton's method converges from a guess.

    Returns None if the method fails, or if fewer than two parameters are free. The arguments are those of
    `nearest_boundary_point.find_nearest_point`.
    """
    n_unknowns, n_params = len(unknowns), len(offset)
    if n_params < 2:
        return None
    evaluate_edge = partial(_evaluate_edge, edge, scene_vector, unit_changes)
    offset_mask = np.concatenate([np.zeros(n_unknowns), np.ones(n_params)])
    projection = _project_onto_edge(evaluate_edge, np.concatenate([unknowns, offset]))
    solution = None if projection is None else _solve_optimality_condition(evaluate_edge, offset_mask, *projection)
    if solution is None:
        return None
    unknowns_and_offset, multipliers = solution
    residual, jacobian, jacobian_derivatives = evaluate_edge(unknowns_and_offset)
    edge_tangent_basis = np.linalg.svd(jacobian)[2][len(jacobian) :]
    gradient_residual = float(abs(offset_mask * unknowns_and_offset + jacobian.T @ multipliers).max())
    hessian = _lagrangian_hessian(jacobian_derivatives, multipliers, offset_mask)
    curvatures = (
        np.linalg.eigvalsh(edge_tangent_basis @ hessian @ edge_tangent_basis.T)
        if len(edge_tangent_basis)
        else np.zeros(0)
    )
    unknowns, offset = unknowns_and_offset[:n_unknowns], unknowns_and_offset[n_unknowns:]
    clearances = jax.device_get(
        evaluate_clearances(edge.boundary_equations, unknowns, scene_vector + offset @ unit_changes)
    )
    is_admissible = (
        (clearances.min_clearances >= -clearances.slack).all()
        and (clearances.speeds >= -clearances.slack).all()
        and (clearances.flight_times > 0).all()
    )
    status = SolutionStatus.OK if is_admissible else SolutionStatus.VIRTUAL
    return NearestBoundaryPoint(
        edge, unknowns, offset, gradient_residual, curvatures, float(abs(residual).max()), int(status)
    )


def _evaluate_edge(edge, scene_vector, unit_changes, unknowns_and_offset):
    """Return r, its Jacobian, and the derivatives of the Jacobian by central differences."""
    n_variables = len(unknowns_and_offset)
    difference_step = DIFFERENCE_STEP * (1.0 + abs(unknowns_and_offset).max())
    shifts = difference_step * np.eye(n_variables)
    shifted_rows = unknowns_and_offset + np.concatenate([shifts, -shifts, np.zeros((1, n_variables))])
    residuals, jacobians = jax.device_get(_residuals_and_jacobians(edge, scene_vector, unit_changes, shifted_rows))
    jacobian_derivatives = (jacobians[:n_variables] - jacobians[n_variables:-1]) / (2.0 * difference_step)
    return residuals[-1], jacobians[-1], jacobian_derivatives


def _lagrangian_hessian(jacobian_derivatives, multipliers, offset_mask):
    """Return the second derivatives of the Lagrangian with respect to the unknowns and the offset."""
    weighted_derivatives = np.einsum("iej,e->ij", jacobian_derivatives, multipliers)
    return 0.5 * (weighted_derivatives + weighted_derivatives.T) + np.diag(offset_mask)


def _project_onto_edge(evaluate_edge, unknowns_and_offset):
    """Return (point on the edge, Jacobian before the last step) by the Gauss-Newton method, or None if it fails."""
    for _ in range(MAX_GAUSS_NEWTON):
        residual, jacobian, _ = evaluate_edge(unknowns_and_offset)
        if not np.isfinite(jacobian).all():
            return None
        step = _limit_step(-np.linalg.lstsq(jacobian, residual, rcond=None)[0], unknowns_and_offset)
        unknowns_and_offset = unknowns_and_offset + step
        if abs(step).max() <= STEP_TOLERANCE * (1.0 + abs(unknowns_and_offset).max()):
            return unknowns_and_offset, jacobian
    return None


def _solve_optimality_condition(evaluate_edge, offset_mask, unknowns_and_offset, jacobian):
    """Return (nearest point on the edge, multipliers) by Newton's method, or None if it fails."""
    multipliers = -np.linalg.lstsq(jacobian.T, offset_mask * unknowns_and_offset, rcond=None)[0]
    n_variables, n_equations = len(unknowns_and_offset), len(jacobian)
    for _ in range(MAX_NEWTON):
        residual, jacobian, jacobian_derivatives = evaluate_edge(unknowns_and_offset)
        if not np.isfinite(jacobian_derivatives).all():
            return None
        hessian = _lagrangian_hessian(jacobian_derivatives, multipliers, offset_mask)
        kkt_matrix = np.block([[hessian, jacobian.T], [jacobian, np.zeros((n_equations, n_equations))]])
        right_side = -np.concatenate([offset_mask * unknowns_and_offset, residual])
        solution = np.linalg.lstsq(kkt_matrix, right_side, rcond=None)[0]
        step = _limit_step(solution[:n_variables], unknowns_and_offset)
        unknowns_and_offset, multipliers = unknowns_and_offset + step, solution[n_variables:]
        if abs(step).max() <= STEP_TOLERANCE * (1.0 + abs(unknowns_and_offset).max()):
            return unknowns_and_offset, multipliers
    return None


def _limit_step(step, unknowns_and_offset):
    return step * min(1.0, MAX_STEP * (1.0 + abs(unknowns_and_offset).max()) / max(abs(step).max(), TINY))

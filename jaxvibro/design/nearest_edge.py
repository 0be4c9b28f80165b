"""Find the point of the edge of a boundary that is nearest to a scene.

It is a root of the complete Karush-Kuhn-Tucker conditions. With w the times, speeds, null vector and offset y, and with
the equations r(w) = 0 of the edge, ``y y / 2 + m r(w)`` is stationary. Newton's method solves for w and the multipliers
m.
"""

import jax
import numpy as np

from ..scene.codes import SolutionStatus
from .edge import evaluate_clearances
from .nearest_point import NearestBoundaryPoint

MAX_GAUSS_NEWTON = 30  # Gauss-Newton steps onto the edge
MAX_NEWTON = 40  # Newton steps on the optimality conditions
MAX_STEP = 0.3  # relative to 1 + the largest unknown: longest step
DIFFERENCE_STEP = 1e-5  # relative to 1 + the largest unknown: step of central differences
STEP_TOLERANCE = 1e-10  # relative to 1 + the largest unknown: a shorter step is the last
TINY = 1e-300


@jax.jit
def _residuals_and_jacobians(edge, scene_vector, unit_vectors, rows):
    """Return r and its Jacobian with respect to unknowns and offsets, for variables in rows."""
    n_params = len(unit_vectors)

    def residual(variables):
        return edge.residual(variables[:-n_params], scene_vector + variables[-n_params:] @ unit_vectors)

    return jax.vmap(residual)(rows), jax.vmap(jax.jacfwd(residual))(rows)


def find_nearest_edge_point(edge, unknowns, scene_vector, unit_vectors, offset):
    """Return the `NearestBoundaryPoint` that Newton's method reaches from a guess.

    Returns None if it fails, or if fewer than two parameters are free. The arguments are those of
    `nearest_point.find_nearest_point`.
    """
    n_unknowns, n_params = len(unknowns), len(offset)
    if n_params < 2:
        return None
    variables = np.concatenate([unknowns, offset])
    offset_mask = np.concatenate([np.zeros(n_unknowns), np.ones(n_params)])

    def evaluate(variables):
        """Return r, its Jacobian, and differences of the Jacobian, which only determine the search direction."""
        spacing = DIFFERENCE_STEP * (1.0 + abs(variables).max())
        shifts = spacing * np.eye(len(variables))
        variable_rows = variables + np.concatenate([shifts, -shifts, np.zeros((1, len(variables)))])
        residuals, jacobians = jax.device_get(_residuals_and_jacobians(edge, scene_vector, unit_vectors, variable_rows))
        upper_jacobians, lower_jacobians = jacobians[: len(variables)], jacobians[len(variables) : -1]
        return residuals[-1], jacobians[-1], (upper_jacobians - lower_jacobians) / (2.0 * spacing)

    def hessian(second_derivatives, multipliers):
        weighted_sum = np.einsum("iej,e->ij", second_derivatives, multipliers)
        return 0.5 * (weighted_sum + weighted_sum.T) + np.diag(offset_mask)

    for _ in range(MAX_GAUSS_NEWTON):
        residual, jacobian, _ = evaluate(variables)
        if not np.isfinite(jacobian).all():
            return None
        step = _limit_step(-np.linalg.lstsq(jacobian, residual, rcond=None)[0], variables)
        variables = variables + step
        if abs(step).max() <= STEP_TOLERANCE * (1.0 + abs(variables).max()):
            break
    else:
        return None
    multipliers = -np.linalg.lstsq(jacobian.T, offset_mask * variables, rcond=None)[0]
    for _ in range(MAX_NEWTON):
        residual, jacobian, second_derivatives = evaluate(variables)
        if not np.isfinite(second_derivatives).all():
            return None
        kkt_matrix = np.block(
            [
                [hessian(second_derivatives, multipliers), jacobian.T],
                [jacobian, np.zeros((n_unknowns + 2, n_unknowns + 2))],
            ]
        )
        solution = np.linalg.lstsq(kkt_matrix, -np.concatenate([offset_mask * variables, residual]), rcond=None)[0]
        step = _limit_step(solution[: n_unknowns + n_params], variables)
        variables, multipliers = variables + step, solution[n_unknowns + n_params :]
        if abs(step).max() <= STEP_TOLERANCE * (1.0 + abs(variables).max()):
            break
    else:
        return None
    residual, jacobian, second_derivatives = evaluate(variables)
    tangent_basis = np.linalg.svd(jacobian)[2][n_unknowns + 2 :]
    slope = float(abs(offset_mask * variables + jacobian.T @ multipliers).max())
    curvatures = (
        np.linalg.eigvalsh(tangent_basis @ hessian(second_derivatives, multipliers) @ tangent_basis.T)
        if len(tangent_basis)
        else np.zeros(0)
    )
    unknowns, offset = variables[:n_unknowns], variables[n_unknowns:]
    flight_gaps = jax.device_get(evaluate_clearances(edge.equations, unknowns, scene_vector + offset @ unit_vectors))
    is_real = (
        (flight_gaps.min_clearances >= -flight_gaps.slack).all()
        and (flight_gaps.speeds >= -flight_gaps.slack).all()
        and (flight_gaps.flight_times > 0).all()
    )
    status = SolutionStatus.OK if is_real else SolutionStatus.VIRTUAL
    return NearestBoundaryPoint(edge, unknowns, offset, slope, curvatures, float(abs(residual).max()), int(status))


def _limit_step(step, variables):
    return step * min(1.0, MAX_STEP * (1.0 + abs(variables).max()) / max(abs(step).max(), TINY))

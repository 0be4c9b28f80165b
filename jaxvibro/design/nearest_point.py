"""Find the point of a boundary that is nearest to a scene, in the space of several parameters, each in its unit.

Near a point of the boundary in the unit direction e, the boundary is a graph over the transverse plane: ``x(y) = T y +
tau(y) e``, where tau is the distance along e from the scene moved by T y (`point_equations`). The nearest point
satisfies the Karush-Kuhn-Tucker condition ``y + tau tau' = 0``: the offset is parallel to the normal. tau and tau' are
exact. tau'' is a difference of tau', which only determines the search direction. e is turned to the point after each
step.
"""

from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..scene.codes import SolutionStatus
from .edge import BoundaryEdge
from .located_point import solve_points
from .point_equations import PointEquations

MAX_ITERATIONS = 40
BLOCK_SIZE = 8  # scenes per call are a multiple of this, so that few shapes are compiled
DIFFERENCE_STEP = 1e-5  # relative to 1 + distance: step of central differences
MAX_STEP_FRACTION = 0.3  # relative to the distance: longest step
STEP_TOLERANCE = 1e-9  # relative to the distance: after a shorter step the error is rounding
NEWTON_STEP_FRACTION = 1e-4  # relative to the distance: a shorter step is taken in full
TINY = 1e-300


class NearestBoundaryPoint(NamedTuple):
    """Nearest point of a boundary or of its edge.

    `equations` are `PointEquations` or a `BoundaryEdge`, with their `unknowns` along the direction to the point.
    `offset` is the change from the scene in units, (free,). `slope` is the component of tau' across the direction, or
    at an edge the residual of the optimality condition; it vanishes at the nearest point. `curvatures` are the
    eigenvalues of the second derivative of the distance, positive at a minimum. `residual` is the largest residual of
    the equations, `status` a `SolutionStatus`.
    """

    equations: PointEquations | BoundaryEdge
    unknowns: Float[np.ndarray, " unknowns"]
    offset: Float[np.ndarray, " free"]
    slope: float
    curvatures: Float[np.ndarray, " across"]
    residual: float
    status: int

    @property
    def distance(self) -> float:
        """Distance from the scene."""
        return float(np.linalg.norm(self.offset))


@jax.jit
def _solve_with_gradients(equations, start_unknowns, start_vector, rows, direction):
    """Return the `LocatedPoint`, the unknowns and the gradient of the value for each scene in rows."""

    def value(scene_vector):
        located_point, unknowns = solve_points(equations, start_unknowns, start_vector, scene_vector[None], direction)
        return located_point.value[0], jax.tree.map(lambda leaf: leaf[0], (located_point, unknowns))

    gradients, (located_points, unknowns) = jax.vmap(jax.grad(value, has_aux=True))(rows)
    return located_points, unknowns, gradients


def find_nearest_point(equations, unknowns, scene_vector, unit_vectors, offset):
    """Return the `NearestBoundaryPoint` that Newton's method reaches from a point of the boundary.

    Its status is NONE if the method fails. `scene_vector` has shape (numbers,). `unit_vectors` holds the change of
    these for one unit of each free parameter, (free, numbers). `offset` leads to the starting point, (free,), with its
    `unknowns` along this direction.
    """
    step_length = np.inf
    for _ in range(MAX_ITERATIONS):
        distance = np.linalg.norm(offset)
        direction = offset / distance
        transverse_basis, spacing = _transverse_basis(direction), DIFFERENCE_STEP * (1.0 + distance)
        start_unknowns = np.array(unknowns)
        start_unknowns[equations.n_orbit_unknowns] = distance
        solve_rows = partial(
            _solve_with_gradients, equations, start_unknowns, scene_vector, direction=direction @ unit_vectors
        )
        n_padded = -(-(2 * len(transverse_basis) + 1) // BLOCK_SIZE) * BLOCK_SIZE
        padding = np.zeros((n_padded - 2 * len(transverse_basis), len(direction)))
        shifts = spacing * np.concatenate([transverse_basis, -transverse_basis, padding])
        located_points, unknown_rows, gradients = jax.device_get(solve_rows(rows=scene_vector + shifts @ unit_vectors))
        gradients = gradients @ unit_vectors.T @ transverse_basis.T
        gradient, n_transverse = gradients[-1], len(transverse_basis)
        second_derivative = (gradients[:n_transverse] - gradients[n_transverse : 2 * n_transverse]) / (2.0 * spacing)
        hessian = (
            np.eye(n_transverse)
            + np.outer(gradient, gradient)
            + 0.5 * distance * (second_derivative + second_derivative.T)
        )
        if not np.isfinite(hessian).all():
            break
        curvatures = np.linalg.eigvalsh(hessian) if n_transverse else np.zeros(0)
        remaining_fields = (
            float(abs(gradient).max(initial=0.0)),
            curvatures,
            float(located_points.residual[-1]),
            int(located_points.status[-1]),
        )
        nearest_point = NearestBoundaryPoint(
            equations, unknown_rows[-1], located_points.value[-1] * direction, *remaining_fields
        )
        if step_length <= STEP_TOLERANCE * distance or not n_transverse:
            return nearest_point
        newton_step = -distance * np.linalg.solve(hessian if curvatures.min() > 0 else np.eye(n_transverse), gradient)
        newton_step *= min(1.0, MAX_STEP_FRACTION * distance / max(np.linalg.norm(newton_step), TINY))
        trial_steps = newton_step * 0.5 ** np.arange(n_padded)[:, None]  # the same number of rows: one compiled shape
        located_points, unknown_rows, _ = jax.device_get(
            solve_rows(rows=scene_vector + trial_steps @ transverse_basis @ unit_vectors)
        )
        offsets = trial_steps @ transverse_basis + located_points.value[:, None] * direction
        best_index = int(np.argmin(np.where(np.isnan(located_points.value), np.inf, np.linalg.norm(offsets, axis=1))))
        if (
            step_length > np.linalg.norm(newton_step)
            and np.isfinite(located_points.value[0])
            and curvatures.min() > 0
            and np.linalg.norm(newton_step) < NEWTON_STEP_FRACTION * distance
        ):
            best_index = 0  # near convergence the distances differ by rounding only
        if not np.isfinite(located_points.value[best_index]):
            break
        offset, unknowns, step_length = (
            offsets[best_index],
            unknown_rows[best_index],
            np.linalg.norm(trial_steps[best_index]),
        )
    return NearestBoundaryPoint(equations, unknowns, offset, np.inf, np.zeros(0), np.nan, SolutionStatus.NONE)


def _transverse_basis(direction):
    """Return an orthonormal basis perpendicular to a unit vector, (free - 1, free)."""
    return np.linalg.svd(direction[None])[2][1:]

"""The point of a boundary that is nearest to a scene, in the space of some of its numbers, each in a unit of its own.

About a point of the boundary that lies in a unit direction e, the boundary is a graph over the plane across: x(y) =
T y + tau(y) e, tau how far from the scene moved by T y it is along e (`point_equations`). Nearest is where y + tau tau'
= 0, the condition of Karush, Kuhn and Tucker: the offset is parallel to the normal. tau and tau' are exact, tau'' is
taken from differences of tau', which only points the way; e is turned to the point after each step.
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
BLOCK_SIZE = 8  # places that are asked for at once: a multiple, so that few shapes are compiled
DIFFERENCE_STEP = 1e-5  # of 1 + the distance: the points of a difference
MAX_STEP_FRACTION = 0.3  # of the distance: the longest step
STEP_TOLERANCE = 1e-9  # of the distance: a step from which the next leaves rounding alone
NEWTON_STEP_FRACTION = 1e-4  # of the distance: a step as short is Newton's own
TINY = 1e-300


class NearestBoundaryPoint(NamedTuple):
    """A point of a boundary, or of its edge. equations: its `PointEquations`, or the `BoundaryEdge`; unknowns: of them,
    along the direction to it; offset: from the scene, in units of each number, (free,); slope: the part of tau' across
    the direction, of an edge what is left of the condition, zero where it is nearest; curvatures: eigenvalues of the
    distance's second derivative, positive where it is a minimum; residual: the largest number left in the equations;
    status: a `SolutionStatus`."""

    equations: PointEquations | BoundaryEdge
    unknowns: Float[np.ndarray, " unknowns"]
    offset: Float[np.ndarray, " free"]
    slope: float
    curvatures: Float[np.ndarray, " across"]
    residual: float
    status: int

    @property
    def distance(self) -> float:
        """From the scene."""
        return float(np.linalg.norm(self.offset))


@jax.jit
def _solve_with_gradients(equations, start_unknowns, start_vector, rows, direction):
    """(`LocatedPoint`s, unknowns, derivatives by the numbers) from scenes in rows."""

    def value(scene_vector):
        located_point, unknowns = solve_points(equations, start_unknowns, start_vector, scene_vector[None], direction)
        return located_point.value[0], jax.tree.map(lambda leaf: leaf[0], (located_point, unknowns))

    gradients, (located_points, unknowns) = jax.vmap(jax.grad(value, has_aux=True))(rows)
    return located_points, unknowns, gradients


def find_nearest_point(equations, unknowns, scene_vector, unit_vectors, offset):
    """The `NearestBoundaryPoint` that Newton's method reaches from a point of the boundary; its status NONE where it
    reaches none.

    scene_vector: the scene's, (numbers,); unit_vectors: what one unit of each free number is of these, (free, numbers);
    offset: to the point, (free,); unknowns: there, along the direction to it."""
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
        trial_steps = newton_step * 0.5 ** np.arange(n_padded)[:, None]  # as many as before: one compiled shape
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
            best_index = 0  # near the end distances differ by roundings alone
        if not np.isfinite(located_points.value[best_index]):
            break
        offset, unknowns, step_length = (
            offsets[best_index],
            unknown_rows[best_index],
            np.linalg.norm(trial_steps[best_index]),
        )
    return NearestBoundaryPoint(equations, unknowns, offset, np.inf, np.zeros(0), np.nan, SolutionStatus.NONE)


def _transverse_basis(direction):
    """Unit vectors across a unit vector, (free - 1, free)."""
    return np.linalg.svd(direction[None])[2][1:]

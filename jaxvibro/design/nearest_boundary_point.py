"""Find the point on a bifurcation boundary that is nearest to a scene, in the space of the free parameters.

Parameters are measured in their units. e is the unit vector from the scene to a point on the boundary, and the columns
of T span the transverse plane. Near this point the boundary is a graph over the transverse plane: ``x(y) = T y + tau(y)
e``. tau is the distance from the scene, moved by T y, to the boundary along e (`special_point_equations`). The nearest
point satisfies the Karush-Kuhn-Tucker condition ``y + tau tau' = 0``: the offset is parallel to the normal. tau and
tau' are exact. tau'' is a central difference of tau' and only determines the search direction. After each step, e is
the direction to the new point."""

from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..scene.codes import SolutionStatus
from .boundary_edge import BoundaryEdge
from .located_point import solve_points
from .special_point_equations import SpecialPointEquations

MAX_ITERATIONS = 40
BLOCK_SIZE = 8  # scenes per call are a multiple of this, so that few shapes are compiled
DIFFERENCE_STEP = 1e-5  # relative to 1 + distance: step of central differences
MAX_STEP_FRACTION = 0.3  # relative to the distance: longest step
STEP_TOLERANCE = 1e-9  # relative to the distance: after a shorter step the error is rounding
NEWTON_STEP_FRACTION = 1e-4  # relative to the distance: a shorter step is taken in full
TINY = 1e-300


class NearestBoundaryPoint(NamedTuple):
    """Nearest point on a boundary or on its edge.

    Attributes
    ----------
    equations : SpecialPointEquations or BoundaryEdge
        Equations of the boundary or of the edge.
    unknowns : numpy.ndarray
        Unknowns of the equations, for the direction from the scene to the point.
    offset : numpy.ndarray
        Change from the scene in units. Array of shape (free,).
    slope : float
        Largest component of tau', or at an edge the residual of the optimality condition; 0 at the nearest point.
    curvatures : numpy.ndarray
        Eigenvalues of the second derivative of half the squared distance along the boundary, positive at a minimum.
    residual : float
        Largest residual of the equations.
    status : int
        `SolutionStatus` of the point.
    """

    equations: SpecialPointEquations | BoundaryEdge
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
def _locate_with_gradients(equations, start_unknowns, start_scene_vector, scene_vectors, scene_direction):
    """Return the `LocatedPoint`, the unknowns and the gradient of the distance for the scene in each row."""

    def distance_and_point(scene_vector):
        located_point, unknowns = solve_points(
            equations, start_unknowns, start_scene_vector, scene_vector[None], scene_direction
        )
        return located_point.value[0], jax.tree.map(lambda leaf: leaf[0], (located_point, unknowns))

    gradients, (located_points, unknowns) = jax.vmap(jax.grad(distance_and_point, has_aux=True))(scene_vectors)
    return located_points, unknowns, gradients


def find_nearest_point(equations, unknowns, scene_vector, unit_changes, offset):
    """Find the nearest point on a boundary by Newton's method, from another point on the boundary.

    Parameters
    ----------
    equations : SpecialPointEquations
        Equations of the boundary.
    unknowns : numpy.ndarray
        Unknowns of the equations at the starting point, for the direction of `offset`.
    scene_vector : numpy.ndarray
        Numbers of the scene. Array of shape (numbers,).
    unit_changes : numpy.ndarray
        Change of these numbers for one unit of each free parameter. Array of shape (free, numbers).
    offset : numpy.ndarray
        Offset of the starting point from the scene, in units. Array of shape (free,).

    Returns
    -------
    NearestBoundaryPoint
        The nearest point. The status is NONE if the method fails.
    """
    step_length = np.inf
    for _ in range(MAX_ITERATIONS):
        distance = np.linalg.norm(offset)
        unit_direction = offset / distance
        transverse_basis, difference_step = _transverse_basis(unit_direction), DIFFERENCE_STEP * (1.0 + distance)
        start_unknowns = np.array(unknowns)
        start_unknowns[equations.n_orbit_unknowns] = distance
        locate_in_scenes = partial(
            _locate_with_gradients,
            equations,
            start_unknowns,
            scene_vector,
            scene_direction=unit_direction @ unit_changes,
        )
        n_padded_rows = -(-(2 * len(transverse_basis) + 1) // BLOCK_SIZE) * BLOCK_SIZE
        zero_shift_rows = np.zeros((n_padded_rows - 2 * len(transverse_basis), len(unit_direction)))
        shifts = difference_step * np.concatenate([transverse_basis, -transverse_basis, zero_shift_rows])
        located_points, solution_unknowns, distance_gradients = jax.device_get(
            locate_in_scenes(scene_vectors=scene_vector + shifts @ unit_changes)
        )
        distance_gradients = distance_gradients @ unit_changes.T @ transverse_basis.T
        distance_gradient, n_transverse = distance_gradients[-1], len(transverse_basis)
        distance_hessian = (distance_gradients[:n_transverse] - distance_gradients[n_transverse : 2 * n_transverse]) / (
            2.0 * difference_step
        )
        objective_hessian = (
            np.eye(n_transverse)
            + np.outer(distance_gradient, distance_gradient)
            + 0.5 * distance * (distance_hessian + distance_hessian.T)
        )
        if not np.isfinite(objective_hessian).all():
            break
        curvatures = np.linalg.eigvalsh(objective_hessian) if n_transverse else np.zeros(0)
        diagnostic_fields = (
            float(abs(distance_gradient).max(initial=0.0)),
            curvatures,
            float(located_points.residual[-1]),
            int(located_points.status[-1]),
        )
        nearest_point = NearestBoundaryPoint(
            equations, solution_unknowns[-1], located_points.value[-1] * unit_direction, *diagnostic_fields
        )
        if step_length <= STEP_TOLERANCE * distance or not n_transverse:
            return nearest_point
        newton_step = -distance * np.linalg.solve(
            objective_hessian if curvatures.min() > 0 else np.eye(n_transverse), distance_gradient
        )
        newton_step *= min(1.0, MAX_STEP_FRACTION * distance / max(np.linalg.norm(newton_step), TINY))
        trial_steps = (
            newton_step * 0.5 ** np.arange(n_padded_rows)[:, None]
        )  # the same number of rows: one compiled shape
        located_points, solution_unknowns, _ = jax.device_get(
            locate_in_scenes(scene_vectors=scene_vector + trial_steps @ transverse_basis @ unit_changes)
        )
        trial_offsets = trial_steps @ transverse_basis + located_points.value[:, None] * unit_direction
        best_trial_index = int(
            np.argmin(np.where(np.isnan(located_points.value), np.inf, np.linalg.norm(trial_offsets, axis=1)))
        )
        if (
            step_length > np.linalg.norm(newton_step)
            and np.isfinite(located_points.value[0])
            and curvatures.min() > 0
            and np.linalg.norm(newton_step) < NEWTON_STEP_FRACTION * distance
        ):
            best_trial_index = 0  # near convergence the distances differ by rounding only
        if not np.isfinite(located_points.value[best_trial_index]):
            break
        offset, unknowns, step_length = (
            trial_offsets[best_trial_index],
            solution_unknowns[best_trial_index],
            np.linalg.norm(trial_steps[best_trial_index]),
        )
    return NearestBoundaryPoint(equations, unknowns, offset, np.inf, np.zeros(0), np.nan, SolutionStatus.NONE)


def _transverse_basis(unit_direction):
    """Return an orthonormal basis perpendicular to a unit vector, (free - 1, free)."""
    return np.linalg.svd(unit_direction[None])[2][1:]

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
        transverse_basis = _transverse_basis(unit_direction)
        start_unknowns = np.array(unknowns)
        start_unknowns[equations.n_orbit_unknowns] = distance
        locate_after_shifts = partial(
            _locate_after_shifts, equations, start_unknowns, scene_vector, unit_changes, unit_direction
        )
        located_points, solution_unknowns, distance_gradient, distance_hessian = _differentiate_distance(
            locate_after_shifts, transverse_basis, distance
        )
        n_transverse = len(transverse_basis)
        objective_hessian = (
            np.eye(n_transverse) + np.outer(distance_gradient, distance_gradient) + 0.5 * distance * distance_hessian
        )
        if not np.isfinite(objective_hessian).all():
            break
        curvatures = np.linalg.eigvalsh(objective_hessian) if n_transverse else np.zeros(0)
        if step_length <= STEP_TOLERANCE * distance or not n_transverse:
            return NearestBoundaryPoint(
                equations,
                solution_unknowns[-1],
                located_points.value[-1] * unit_direction,
                float(abs(distance_gradient).max(initial=0.0)),
                curvatures,
                float(located_points.residual[-1]),
                int(located_points.status[-1]),
            )
        is_minimum = curvatures.min() > 0
        newton_step = -distance * np.linalg.solve(
            objective_hessian if is_minimum else np.eye(n_transverse), distance_gradient
        )
        newton_step *= min(1.0, MAX_STEP_FRACTION * distance / max(np.linalg.norm(newton_step), TINY))
        newton_step_length = np.linalg.norm(newton_step)
        # Near convergence the distances differ by rounding only.
        is_near_solution = is_minimum and newton_step_length < min(step_length, NEWTON_STEP_FRACTION * distance)
        step_result = _search_along_step(
            locate_after_shifts, transverse_basis, unit_direction, newton_step, is_near_solution
        )
        if step_result is None:
            break
        offset, unknowns, step_length = step_result
    return NearestBoundaryPoint(equations, unknowns, offset, np.inf, np.zeros(0), np.nan, SolutionStatus.NONE)


def _locate_after_shifts(equations, start_unknowns, scene_vector, unit_changes, unit_direction, shifts):
    """Return the `LocatedPoint`, the unknowns and the gradient of the distance, in units, for each shift."""
    located_points, unknowns, gradients = jax.device_get(
        _locate_with_gradients(
            equations,
            start_unknowns,
            scene_vector,
            scene_vector + shifts @ unit_changes,
            unit_direction @ unit_changes,
        )
    )
    return located_points, unknowns, gradients @ unit_changes.T


def _n_padded_rows(transverse_basis):
    """Return the number of scenes of each call; the number is the same, so that one shape is compiled."""
    return -(-(2 * len(transverse_basis) + 1) // BLOCK_SIZE) * BLOCK_SIZE


def _differentiate_distance(locate_after_shifts, transverse_basis, distance):
    """Return the `LocatedPoint` and the unknowns for shifts, the last of them zero, with tau' and twice tau''."""
    n_transverse, difference_step = len(transverse_basis), DIFFERENCE_STEP * (1.0 + distance)
    zero_shifts = np.zeros((_n_padded_rows(transverse_basis) - 2 * n_transverse, transverse_basis.shape[1]))
    located_points, unknowns, gradients = locate_after_shifts(
        difference_step * np.concatenate([transverse_basis, -transverse_basis, zero_shifts])
    )
    gradients = gradients @ transverse_basis.T
    hessian = (gradients[:n_transverse] - gradients[n_transverse : 2 * n_transverse]) / (2.0 * difference_step)
    return located_points, unknowns, gradients[-1], hessian + hessian.T


def _search_along_step(locate_after_shifts, transverse_basis, unit_direction, newton_step, is_near_solution):
    """Return (offset, unknowns, step length) of the nearest point after a step and its halves, or None without a point.

    If `is_near_solution`, the full step is taken.
    """
    trial_steps = newton_step * 0.5 ** np.arange(_n_padded_rows(transverse_basis))[:, None]
    located_points, unknowns, _ = locate_after_shifts(trial_steps @ transverse_basis)
    offsets = trial_steps @ transverse_basis + located_points.value[:, None] * unit_direction
    distances = np.where(np.isnan(located_points.value), np.inf, np.linalg.norm(offsets, axis=1))
    takes_full_step = is_near_solution and np.isfinite(located_points.value[0])
    index = 0 if takes_full_step else int(np.argmin(distances))
    if not np.isfinite(located_points.value[index]):
        return None
    return offsets[index], unknowns[index], np.linalg.norm(trial_steps[index])


def _transverse_basis(unit_direction):
    """Return an orthonormal basis perpendicular to a unit vector, (free - 1, free)."""
    return np.linalg.svd(unit_direction[None])[2][1:]

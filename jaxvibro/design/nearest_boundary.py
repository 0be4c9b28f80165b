"""Find the point on a bifurcation boundary, or on an edge of it, that is nearest to a scene.

Define the equations of the edges of a bifurcation boundary. In the space of several parameters, the scenes at which an
orbit bifurcates form a boundary. A boundary of SN, PD, SB or GR ends at an edge where a further flight of the orbit
grazes a wall, or where a further impact has zero speed. Two boundaries of SN end at a cusp. Each of these conditions
adds one equation. An edge therefore has one dimension less than the boundary.

Find the point on a bifurcation boundary that is nearest to a scene, in the space of the free parameters. Parameters are
measured in their units. e is the unit vector from the scene to a point on the boundary, and the columns of T span the
transverse plane. Near this point the boundary is a graph over the transverse plane: ``x(y) = T y + tau(y) e``. tau is
the distance from the scene, moved by T y, to the boundary along e (`special_point_equations`). The nearest point
satisfies the Karush-Kuhn-Tucker condition ``y + tau tau' = 0``: the offset is parallel to the normal. tau and tau' are
exact. tau'' is a central difference of tau' and only determines the search direction. After each step, e is the
direction to the new point.

Find the point on an edge of a boundary that is nearest to a scene. The vector w consists of the times, the speeds, the
null vector and the offset y from the scene. The equations of the edge are r(w) = 0. At the nearest point, the
Lagrangian ``y y / 2 + m r(w)`` is stationary (Karush-Kuhn-Tucker conditions). Newton's method solves these conditions
for w and the multipliers m.
"""

from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Int

from continuation import augmented_systems
from continuation.array_type import Array
from continuation.implicit_function import Parameters, Unknowns

from ..contact.kinds import flow_coefficients
from ..orbits import cyclic_system, flight_clearance, impact_equations
from ..orbits.flight_clearance import GRAZING_TOLERANCE
from ..orbits.impact_equations import ImpactSequence
from ..scene.state import SolutionStatus
from .located import solve_points
from .special_point_equations import STATIC, SpecialPointEquations, closed_jacobian

TOUCHES, ZERO_SPEED, CUSP = "a touch", "an impact without speed", "a cusp"


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class BoundaryEdge:
    """Equations of an edge of a bifurcation boundary, a pytree.

    Attributes
    ----------
    boundary_equations : SpecialPointEquations
        Equations of the boundary.
    edge_kind : str
        TOUCHES (a flight grazes a wall), ZERO_SPEED (an impact has zero speed) or CUSP.
    row : jax.Array
        Row of the impact before the flight that grazes, or of the impact with zero speed.
    wall : jax.Array
        Index of the wall that the flight grazes.
    left_null_guess : jax.Array or None
        Vector close to the left null vector, at a cusp; None at other edges.
    """

    boundary_equations: SpecialPointEquations
    edge_kind: str = field(metadata=STATIC)
    row: Int[Array, ""]
    wall: Int[Array, ""]
    left_null_guess: Float[Array, " speeds"] | None = None

    @property
    def kind(self) -> str:
        """Kind of the bifurcation of the boundary."""
        return self.boundary_equations.kind

    def sequence_at(self, unknowns: Unknowns) -> ImpactSequence:
        """Return the `ImpactSequence` with the times and speeds in these unknowns."""
        return self.boundary_equations.sequence_at(unknowns)

    def residual(self, unknowns: Unknowns, scene_vector: Parameters) -> Float[Array, " equations"]:
        """Return the residual of the boundary and edge equations in the scene with the numbers `scene_vector`.

        There are two more equations than unknowns. The unknowns are the times and speeds, the null vector (except at a
        GR), and at a grazing edge the time of the grazing since the start of its flight.
        """
        boundary_equations = self.boundary_equations
        n_orbit_unknowns = boundary_equations.n_orbit_unknowns
        n_null_components = 0 if boundary_equations.is_grazing else n_orbit_unknowns
        boundary_unknowns = jnp.concatenate(
            [
                unknowns[:n_orbit_unknowns],
                jnp.zeros(1),
                unknowns[n_orbit_unknowns : n_orbit_unknowns + n_null_components],
            ]
        )
        residual = boundary_equations.residual(boundary_unknowns, scene_vector, jnp.zeros_like(scene_vector))
        coeffs, sequence = (
            flow_coefficients(boundary_equations.scene_at(scene_vector)),
            boundary_equations.sequence_at(boundary_unknowns),
        )
        if self.edge_kind == ZERO_SPEED:
            return jnp.append(residual, sequence.speeds[self.row])
        if self.edge_kind == TOUCHES:
            flights = impact_equations.compute_flights(coeffs, sequence)
            grazing_times = jnp.where(jnp.arange(len(sequence.sides)) == self.row, unknowns[-1], 0.0)
            relative_motions = jnp.stack(
                [
                    jnp.stack(relative_motion[:2])
                    for relative_motion in flight_clearance.relative_motion(coeffs, flights, grazing_times)
                ]
            )
            return jnp.concatenate([residual, relative_motions[self.wall, :, self.row]])
        return jnp.append(
            residual,
            self._cusp_test(coeffs, sequence, unknowns[n_orbit_unknowns : n_orbit_unknowns + n_null_components]),
        )

    def _cusp_test(self, coeffs, sequence, null_vector):
        """Return w F_uu v v of a fold, which vanishes at a cusp.

        F is the residual of the orbit with times and speeds u. v is the null vector and w the left null vector of F_u.
        """
        residual_derivatives = impact_equations.residual_and_jacobian(coeffs, sequence)[1]
        jacobian, n_unknowns = (
            cyclic_system.dense_matrix(cyclic_system.assemble_block_matrix(residual_derivatives), 1.0),
            len(null_vector),
        )
        bordered_matrix = jnp.block([[jacobian, self.left_null_guess[:, None]], [null_vector[None], jnp.zeros((1, 1))]])
        left_null_vector = jnp.linalg.solve(bordered_matrix.T, jnp.eye(n_unknowns + 1)[-1])[:n_unknowns]

        def projected_residual(null_amplitude):
            time_shifts, speed_shifts = jnp.split(null_amplitude * null_vector, 2)
            shifted_sequence = sequence._replace(
                times=sequence.times + time_shifts, speeds=sequence.speeds + speed_shifts
            )
            return left_null_vector @ impact_equations.residual_and_jacobian(coeffs, shifted_sequence)[0]

        return jax.jacfwd(jax.jacfwd(projected_residual))(0.0)


def find_crossed_edges(boundary_equations, unknowns, scene_vector):
    """Return [(`BoundaryEdge`, guess of its unknowns)] of the edges beyond which a point of a boundary lies.

    There is one edge for each flight that passes through a wall and for each impact with negative speed. `unknowns` are
    the unknowns of the `SpecialPointEquations`, and `scene_vector` holds the numbers of the scene at the point.
    """
    clearances = jax.device_get(evaluate_clearances(boundary_equations, unknowns, scene_vector))
    orbit_and_null_unknowns = np.delete(unknowns, boundary_equations.n_orbit_unknowns)
    grazing_edges = [
        (
            _make_edge(boundary_equations, TOUCHES, impact_row, wall_index),
            np.append(orbit_and_null_unknowns, clearances.turning_times[impact_row, wall_index]),
        )
        for impact_row, wall_index in np.argwhere(
            clearances.min_clearances < (-clearances.slack if boundary_equations.is_grazing else 0.0)
        )
    ]
    return grazing_edges + [
        (_make_edge(boundary_equations, ZERO_SPEED, impact_row), orbit_and_null_unknowns)
        for impact_row in np.flatnonzero(clearances.speeds < 0)
    ]


def make_cusp_edge(boundary_equations, unknowns, scene_vector):
    """Return the `BoundaryEdge` of a cusp, and a guess of its unknowns from a point of a boundary of SN."""
    orbit_and_null_unknowns = np.delete(unknowns, boundary_equations.n_orbit_unknowns)
    jacobian = np.asarray(
        closed_jacobian(
            replace(boundary_equations, sequence=boundary_equations.sequence_at(jnp.asarray(orbit_and_null_unknowns))),
            jnp.asarray(scene_vector),
        )
    )
    return _make_edge(
        boundary_equations, CUSP, left_null_guess=jnp.asarray(augmented_systems.null_vector(jacobian.T))
    ), orbit_and_null_unknowns


def _make_edge(boundary_equations, edge_kind, impact_row=0, wall_index=0, left_null_guess=None):
    return BoundaryEdge(
        boundary_equations, edge_kind, jnp.asarray(impact_row), jnp.asarray(wall_index), left_null_guess
    )


class FlightClearances(NamedTuple):
    """Smallest clearances of flights from walls.

    Attributes
    ----------
    min_clearances : array_like
        Smallest clearance of each flight from each wall. Array of shape (rows, walls).
    turning_times : array_like
        Times from the start of the flight to the smallest clearances. Array of shape (rows, walls).
    speeds : array_like
        Speeds of the impacts. Array of shape (rows,).
    flight_times : array_like
        Durations of the flights. Array of shape (rows,).
    slack : array_like
        Clearances and speeds whose absolute value is below this count as zero.
    """

    min_clearances: Float[ArrayLike, "rows walls"]
    turning_times: Float[ArrayLike, "rows walls"]
    speeds: Float[ArrayLike, " rows"]
    flight_times: Float[ArrayLike, " rows"]
    slack: Float[ArrayLike, ""]


@jax.jit
def evaluate_clearances(boundary_equations, unknowns, scene_vector):
    """Return the `FlightClearances` of the orbit with these unknowns in the scene with the numbers `scene_vector`."""
    coeffs, sequence = (
        flow_coefficients(boundary_equations.scene_at(scene_vector)),
        boundary_equations.sequence_at(unknowns),
    )
    flights = impact_equations.compute_flights(coeffs, sequence)
    min_clearances, turning_times = flight_clearance.turning_clearances(
        coeffs, flights, flight_clearance.sample_count(coeffs, flights)
    )
    return FlightClearances(
        min_clearances, turning_times, sequence.speeds, flights.time, GRAZING_TOLERANCE * coeffs.length_scale
    )


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


MAX_GAUSS_NEWTON = 30  # Gauss-Newton steps onto the edge
MAX_NEWTON = 40  # Newton steps on the optimality conditions
MAX_STEP = 0.3  # relative to 1 + the largest unknown: longest step
EDGE_DIFFERENCE_STEP = 1e-5  # relative to 1 + the largest unknown: step of central differences
EDGE_STEP_TOLERANCE = 1e-10  # relative to 1 + the largest unknown: a shorter step is the last


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
    `find_nearest_point`.
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
    difference_step = EDGE_DIFFERENCE_STEP * (1.0 + abs(unknowns_and_offset).max())
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
        if abs(step).max() <= EDGE_STEP_TOLERANCE * (1.0 + abs(unknowns_and_offset).max()):
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
        if abs(step).max() <= EDGE_STEP_TOLERANCE * (1.0 + abs(unknowns_and_offset).max()):
            return unknowns_and_offset, multipliers
    return None


def _limit_step(step, unknowns_and_offset):
    return step * min(1.0, MAX_STEP * (1.0 + abs(unknowns_and_offset).max()) / max(abs(step).max(), TINY))

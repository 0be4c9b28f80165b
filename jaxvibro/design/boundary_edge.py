"""Define the equations of the edges of a bifurcation boundary.

In the space of several parameters, the scenes at which an orbit bifurcates form a boundary. A boundary of SN, PD, SB or
GR ends at an edge where a further flight of the orbit grazes a wall, or where a further impact has zero speed. Two
boundaries of SN end at a cusp. Each of these conditions adds one equation. An edge therefore has one dimension less
than the boundary.
"""

from dataclasses import dataclass, field, replace
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

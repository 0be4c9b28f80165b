"""Define the equations of the edges of a sheet of bifurcations.

An SN, PD, SB or GR ends where its orbit grazes another wall, or where one of its impacts loses its speed. Two sheets of
SN end at a cusp. Each is one more equation, so that an edge has one dimension less than the sheet.
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

from ..flight.coefficients import flow_coefficients
from ..orbits import cyclic_system, flight_clearance, impact_equations
from ..orbits.flight_clearance import GRAZING_TOLERANCE
from ..orbits.impact_equations import ImpactSequence
from .point_equations import STATIC, PointEquations, closed_jacobian

TOUCHES, ZERO_SPEED, CUSP = "a touch", "an impact without speed", "a cusp"


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class BoundaryEdge:
    """Equations of an edge, a pytree.

    `equations` are the `PointEquations` of the sheet. `end_kind` is TOUCHES (grazing of the flight after the impact in
    `row` at a `wall`, an index of the walls), ZERO_SPEED (the impact in `row`), or CUSP, with `left_null` close to a
    left null vector.
    """

    equations: PointEquations
    end_kind: str = field(metadata=STATIC)
    row: Int[Array, ""]
    wall: Int[Array, ""]
    left_null: Float[Array, " speeds"] | None = None

    @property
    def kind(self) -> str:
        """Kind of the sheet."""
        return self.equations.kind

    def sequence_at(self, unknowns: Unknowns) -> ImpactSequence:
        """Return the `ImpactSequence` with these unknowns."""
        return self.equations.sequence_at(unknowns)

    def residual(self, unknowns: Unknowns, scene_vector: Parameters) -> Float[Array, " equations"]:
        """Return the residual in the scene with these numbers: equations of the sheet and of the edge.

        There are two more equations than unknowns. The unknowns are times and speeds, the null vector, and the time of
        a grazing since the start of its flight.
        """
        equations = self.equations
        n_orbit_unknowns = equations.n_orbit_unknowns
        n_null_components = 0 if equations.is_grazing else n_orbit_unknowns
        point_unknowns = jnp.concatenate(
            [
                unknowns[:n_orbit_unknowns],
                jnp.zeros(1),
                unknowns[n_orbit_unknowns : n_orbit_unknowns + n_null_components],
            ]
        )
        residual = equations.residual(point_unknowns, scene_vector, jnp.zeros_like(scene_vector))
        coeffs, sequence = flow_coefficients(equations.scene_at(scene_vector)), equations.sequence_at(point_unknowns)
        if self.end_kind == ZERO_SPEED:
            return jnp.append(residual, sequence.speeds[self.row])
        if self.end_kind == TOUCHES:
            flights = impact_equations.compute_flights(coeffs, sequence)
            time = jnp.where(jnp.arange(len(sequence.sides)) == self.row, unknowns[-1], 0.0)
            wall_motions = jnp.stack(
                [jnp.stack(wall_motion[:2]) for wall_motion in flight_clearance.relative_motion(coeffs, flights, time)]
            )
            return jnp.concatenate([residual, wall_motions[self.wall, :, self.row]])
        return jnp.append(
            residual,
            self._cusp_function(coeffs, sequence, unknowns[n_orbit_unknowns : n_orbit_unknowns + n_null_components]),
        )

    def _cusp_function(self, coeffs, sequence, null_vector):
        """Return w F_uu v v of a fold with left null vector w; it vanishes at a cusp."""
        derivatives = impact_equations.residual_and_jacobian(coeffs, sequence)[1]
        matrix, n_unknowns = (
            cyclic_system.dense_matrix(cyclic_system.assemble_matrix(derivatives), 1.0),
            len(null_vector),
        )
        bordered_matrix = jnp.block([[matrix, self.left_null[:, None]], [null_vector[None], jnp.zeros((1, 1))]])
        left_vector = jnp.linalg.solve(bordered_matrix.T, jnp.eye(n_unknowns + 1)[-1])[:n_unknowns]

        def projected_residual(amplitude):
            times, speeds = jnp.split(amplitude * null_vector, 2)
            shifted_sequence = sequence._replace(times=sequence.times + times, speeds=sequence.speeds + speeds)
            return left_vector @ impact_equations.residual_and_jacobian(coeffs, shifted_sequence)[0]

        return jax.jacfwd(jax.jacfwd(projected_residual))(0.0)


def find_edges(equations, unknowns, scene_vector):
    """Return [(`BoundaryEdge`, its unknowns)] that an inadmissible point of a sheet has passed.

    There is one edge for each flight that passes through a wall and for each impact with negative speed. `unknowns` are
    those of `PointEquations`, `scene_vector` the numbers of the scene at the point.
    """
    flight_gaps = jax.device_get(evaluate_clearances(equations, unknowns, scene_vector))
    orbit_unknowns = np.delete(unknowns, equations.n_orbit_unknowns)
    touch_edges = [
        (_make_edge(equations, TOUCHES, row, wall), np.append(orbit_unknowns, flight_gaps.turning_times[row, wall]))
        for row, wall in np.argwhere(flight_gaps.min_clearances < (-flight_gaps.slack if equations.is_grazing else 0.0))
    ]
    return touch_edges + [
        (_make_edge(equations, ZERO_SPEED, row), orbit_unknowns) for row in np.flatnonzero(flight_gaps.speeds < 0)
    ]


def make_cusp(equations, unknowns, scene_vector):
    """Return the `BoundaryEdge` of the cusp of a sheet of SN and its unknowns, as a guess from a point of the sheet."""
    orbit_unknowns = np.delete(unknowns, equations.n_orbit_unknowns)
    matrix = np.asarray(
        closed_jacobian(
            replace(equations, sequence=equations.sequence_at(jnp.asarray(orbit_unknowns))), jnp.asarray(scene_vector)
        )
    )
    return _make_edge(equations, CUSP, left_null=jnp.asarray(augmented_systems.null_vector(matrix.T))), orbit_unknowns


def _make_edge(equations, end_kind, row=0, wall=0, left_null=None):
    return BoundaryEdge(equations, end_kind, jnp.asarray(row), jnp.asarray(wall), left_null)


class FlightClearances(NamedTuple):
    """Smallest clearances of flights from walls.

    `min_clearances` and `turning_times`, since the start of each flight, have shape (rows, walls). `speeds` of the
    impacts and `flight_times` have shape (rows,). A clearance or a speed below `slack` counts as zero.
    """

    min_clearances: Float[ArrayLike, "rows walls"]
    turning_times: Float[ArrayLike, "rows walls"]
    speeds: Float[ArrayLike, " rows"]
    flight_times: Float[ArrayLike, " rows"]
    slack: Float[ArrayLike, ""]


@jax.jit
def evaluate_clearances(equations, unknowns, scene_vector):
    """Return the `FlightClearances` of a point of a sheet with these unknowns in the scene with these numbers."""
    coeffs, sequence = flow_coefficients(equations.scene_at(scene_vector)), equations.sequence_at(unknowns)
    flights = impact_equations.compute_flights(coeffs, sequence)
    min_clearances, turning_times = flight_clearance.turning_clearances(
        coeffs, flights, flight_clearance.sample_count(coeffs, flights)
    )
    return FlightClearances(
        min_clearances, turning_times, sequence.speeds, flights.time, GRAZING_TOLERANCE * coeffs.length_scale
    )

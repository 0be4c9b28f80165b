"""The defining equations of where a sheet of bifurcations ends.

An SN, PD, SB or GR ends where its orbit touches a wall besides, or where one of its impacts loses its speed; two sheets
of SN end in each other at a cusp. That is one equation more, so that an edge has one dimension less than the sheet.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Int

from continuation import locate
from continuation.arrays import Array
from continuation.implicit import Numbers, Unknowns

from ..flight.coefficients import framed
from ..orbits import cyclic_system, flight_clearance, impact_equations
from ..orbits.flight_clearance import TOUCH
from ..orbits.impact_equations import Cycle
from .point_equations import STATIC, PointEquations, closed

TOUCHES, SLOW, CUSP = "a touch", "an impact without speed", "a cusp"


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Edge:
    """What is zero at an edge, a pytree. point: the sheet's `PointEquations`; end: TOUCHES, of the flight after the
    impact in a row and a wall among the walls; SLOW: the impact in that row; CUSP, with left: what comes nearest to a
    left null vector there."""

    point: PointEquations
    end: str = field(metadata=STATIC)
    row: Int[Array, ""]
    wall: Int[Array, ""]
    left: Float[Array, " speeds"] | None = None

    @property
    def kind(self) -> str:
        """Of the sheet."""
        return self.point.kind

    def cycle_at(self, unknowns: Unknowns) -> Cycle:
        """The `Cycle` with these unknowns."""
        return self.point.cycle_at(unknowns)

    def zero(self, unknowns: Unknowns, numbers: Numbers) -> Float[Array, " equations"]:
        """What is to be zero in the scene with these numbers, two more than the unknowns are: the sheet's equations,
        and the edge's. unknowns: times and speeds, the null vector, the time of a touch since its flight's start."""
        point = self.point
        size = point.size
        more = 0 if point.grazes else size
        sheet = jnp.concatenate([unknowns[:size], jnp.zeros(1), unknowns[size : size + more]])
        left = point.left(sheet, numbers, jnp.zeros_like(numbers))
        built, cycle = framed(point.scene(numbers)), point.cycle_at(sheet)
        if self.end == SLOW:
            return jnp.append(left, cycle.speeds[self.row])
        if self.end == TOUCHES:
            found = impact_equations.flights(built, cycle)
            time = jnp.where(jnp.arange(len(cycle.sides)) == self.row, unknowns[-1], 0.0)
            every = jnp.stack([jnp.stack(one[:2]) for one in flight_clearance.relative(built, found, time)])
            return jnp.concatenate([left, every[self.wall, :, self.row]])
        return jnp.append(left, self._bend(built, cycle, unknowns[size : size + more]))

    def _bend(self, built, cycle, null):
        """Of a fold, w F_uu v v, w the left null vector: zero at a cusp."""
        slopes = impact_equations.equations(built, cycle)[1]
        matrix, size = cyclic_system.dense(cyclic_system.of(slopes), 1.0), len(null)
        border = jnp.block([[matrix, self.left[:, None]], [null[None], jnp.zeros((1, 1))]])
        weights = jnp.linalg.solve(border.T, jnp.eye(size + 1)[-1])[:size]

        def weighed(share):
            times, speeds = jnp.split(share * null, 2)
            there = cycle._replace(times=cycle.times + times, speeds=cycle.speeds + speeds)
            return weights @ impact_equations.equations(built, there)[0]

        return jax.jacfwd(jax.jacfwd(weighed))(0.0)


def edges_of(point, unknowns, numbers):
    """[(`Edge`, its unknowns)] that a point of a sheet is beyond: of each flight that passes through a wall, of each
    impact from behind. unknowns: as `PointEquations` has them, numbers: of the scene there."""
    seen = jax.device_get(clearances(point, unknowns, numbers))
    plain = np.delete(unknowns, point.size)
    touches = [
        (_edge(point, TOUCHES, row, wall), np.append(plain, seen.late[row, wall]))
        for row, wall in np.argwhere(seen.clear < (-seen.slack if point.grazes else 0.0))
    ]
    return touches + [(_edge(point, SLOW, row), plain) for row in np.flatnonzero(seen.speeds < 0)]


def cusp(point, unknowns, numbers):
    """(`Edge`, its unknowns): the cusp of a sheet of SN, to be looked for from one of its points."""
    plain = np.delete(unknowns, point.size)
    matrix = np.asarray(closed(replace(point, cycle=point.cycle_at(jnp.asarray(plain))), jnp.asarray(numbers)))
    return _edge(point, CUSP, left=jnp.asarray(locate.null(matrix.T))), plain


def _edge(point, end, row=0, wall=0, left=None):
    return Edge(point, end, jnp.asarray(row), jnp.asarray(wall), left)


class Clearances(NamedTuple):
    """The least clearances of flights and walls, and when, since the flights' starts, (rows, walls); the impacts'
    speeds, and how long the flights are, (rows,); slack: a clearance or a speed as small is zero."""

    clear: Float[ArrayLike, "rows walls"]
    late: Float[ArrayLike, "rows walls"]
    speeds: Float[ArrayLike, " rows"]
    time: Float[ArrayLike, " rows"]
    slack: Float[ArrayLike, ""]


@jax.jit
def clearances(point, unknowns, numbers):
    """The `Clearances` of a point of a sheet with these unknowns, of the scene with these numbers."""
    built, cycle = framed(point.scene(numbers)), point.cycle_at(unknowns)
    found = impact_equations.flights(built, cycle)
    clear, late = flight_clearance.clearances(built, found, flight_clearance.samples(built, found))
    return Clearances(clear, late, cycle.speeds, found.time, TOUCH * built.size)

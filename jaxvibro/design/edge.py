"""Where a sheet of bifurcations ends: the point of such an edge that is nearest to a scene.

An SN, PD, SB or GR ends where its orbit touches a wall besides, or where one of its impacts loses its speed; two sheets
of SN end in each other at a cusp. That is one equation more, so that an edge has one dimension less than the sheet. The
nearest point is a root of the whole condition of Karush, Kuhn and Tucker: with w the times, speeds, null vector and
offset y, r(w) = 0 the edge's equations, stationary is y y / 2 + m r(w), by Newton's method in w and the multipliers m.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation.arrays import Array
from continuation.implicit import Numbers, Unknowns

from ..flight.coefficients import framed
from ..orbits import cyclic_system, flight_clearance, impact_equations
from ..orbits.flight_clearance import TOUCH
from ..orbits.impact_equations import Cycle
from ..scene.codes import SolutionStatus
from .point_equations import STATIC, PointEquations

TOUCHES, SLOW, CUSP = "a touch", "an impact without speed", "a cusp"
CLOSING = 30  # of Gauss and Newton's steps onto the edge
ROUNDS = 40  # of Newton's on the condition
FAR = 0.3  # of 1 + the largest unknown: the longest step
APART = 1e-5  # of 1 + the largest unknown: the points of a difference
SHARP = 1e-10  # of 1 + the largest unknown: a step as short is the last
TINY = 1e-300


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Edge:
    """What is zero at an edge, a pytree. point: the sheet's `PointEquations`; end: TOUCHES, of the flight after the
    impact in a row and a wall among the walls; SLOW: the impact in that row; CUSP, with left: what comes nearest to a
    left null vector there."""

    point: PointEquations
    end: str = field(metadata=STATIC)
    row: int = field(metadata=STATIC, default=0)
    wall: int = field(metadata=STATIC, default=0)
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
        more = 0 if point.null is None else len(point.null)
        sheet = jnp.concatenate([unknowns[:size], jnp.zeros(1), unknowns[size : size + more]])
        left = point.left(sheet, numbers, jnp.zeros_like(numbers))
        built, cycle = framed(point.scene(numbers)), point.cycle_at(sheet)
        if self.end == SLOW:
            return jnp.append(left, cycle.speeds[self.row])
        if self.end == TOUCHES:
            found = impact_equations.flights(built, cycle)
            time = jnp.where(jnp.arange(len(cycle.sides)) == self.row, unknowns[-1], 0.0)
            distance, closing, _ = flight_clearance.relative(built, found, time)[self.wall]
            return jnp.concatenate([left, jnp.stack([distance[self.row], closing[self.row]])])
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


class EdgeFoot(NamedTuple):
    """The nearest point of an edge, as `nearest.Foot` has it. point: the `Edge`."""

    point: Edge
    unknowns: Float[np.ndarray, " unknowns"]
    offset: Float[np.ndarray, " free"]
    slope: float
    bends: Float[np.ndarray, " along"]
    residual: float
    status: int

    @property
    def distance(self) -> float:
        """From the scene."""
        return float(np.linalg.norm(self.offset))


def edges_of(point, unknowns, numbers):
    """[(`Edge`, its unknowns)] that a point of a sheet is beyond: of each flight that passes through a wall, of each
    impact from behind. unknowns: as `PointEquations` has them, numbers: of the scene there."""
    clear, time, speeds = jax.device_get(_violated(point, unknowns, numbers))
    plain = np.delete(unknowns, point.size)
    touches = [
        (Edge(point, TOUCHES, int(row), int(wall)), np.append(plain, time[row, wall]))
        for row, wall in np.argwhere(clear < 0)
    ]
    return touches + [(Edge(point, SLOW, int(row)), plain) for row in np.flatnonzero(speeds < 0)]


def cusp(point, unknowns, numbers):
    """(`Edge`, its unknowns): the cusp of a sheet of SN, to be looked for from one of its points."""
    plain = np.delete(unknowns, point.size)
    left = np.linalg.svd(np.asarray(_matrix(point, plain, numbers)))[0][:, -1]
    return Edge(point, CUSP, left=jnp.asarray(left)), plain


@jax.jit
def _matrix(point, plain, numbers):
    cycle = point.cycle_at(plain)
    slopes = impact_equations.equations(framed(point.scene(numbers)), cycle)[1]
    return cyclic_system.dense(cyclic_system.of(slopes), 1.0)


@jax.jit
def _violated(point, unknowns, numbers):
    """(the least clearances of flights and walls, their times since the flights' starts, the impacts' speeds)."""
    built, cycle = framed(point.scene(numbers)), point.cycle_at(unknowns)
    found = impact_equations.flights(built, cycle)
    clear, late = flight_clearance.clearances(built, found, flight_clearance.samples(built, found))
    return clear + (TOUCH * built.size if point.grazes else 0.0), late, cycle.speeds


@jax.jit
def _terms(edge, numbers, units, rows):
    """(r, its derivative) by unknowns and offsets in rows."""
    free = len(units)

    def zero(w):
        return edge.zero(w[:-free], numbers + w[-free:] @ units)

    return jax.vmap(zero)(rows), jax.vmap(jax.jacfwd(zero))(rows)


@jax.jit
def _admissible(edge, unknowns, numbers):
    built, cycle = framed(edge.point.scene(numbers)), edge.cycle_at(unknowns)
    found, slack = impact_equations.flights(built, cycle), TOUCH * built.size
    clear, _ = flight_clearance.clearances(built, found, flight_clearance.samples(built, found))
    return jnp.all(clear >= -slack) & jnp.all(cycle.speeds >= -slack) & jnp.all(found.time > 0)


def nearest_on(edge, unknowns, numbers, units, offset):
    """The `EdgeFoot` that Newton's method reaches from a guess; None where it reaches none, or fewer than two numbers
    are free. Arguments as of `nearest.nearest`."""
    size, free = len(unknowns), len(offset)
    if free < 2:
        return None
    joined = np.concatenate([unknowns, offset])
    multipliers, wanted = np.zeros(size + 2), np.concatenate([np.zeros(size), np.ones(free)])

    def terms(joined):
        """(r, its derivative, and that's derivative, of differences: it only points the way)."""
        apart = APART * (1.0 + abs(joined).max())
        shifts = apart * np.eye(len(joined))
        rows = joined + np.concatenate([shifts, -shifts, np.zeros((1, len(joined)))])
        left, slopes = jax.device_get(_terms(edge, numbers, units, rows))
        up, down = slopes[: len(joined)], slopes[len(joined) : -1]
        return left[-1], slopes[-1], (up - down) / (2.0 * apart)

    def bent(bends, multipliers):
        whole = np.einsum("iej,e->ij", bends, multipliers)
        return 0.5 * (whole + whole.T) + np.diag(wanted)

    for _ in range(CLOSING):
        left, slopes, _ = terms(joined)
        if not np.isfinite(slopes).all():
            return None
        step = _shortened(-np.linalg.lstsq(slopes, left, rcond=None)[0], joined)
        joined = joined + step
        if abs(step).max() <= SHARP * (1.0 + abs(joined).max()):
            break
    else:
        return None
    multipliers = -np.linalg.lstsq(slopes.T, wanted * joined, rcond=None)[0]
    for _ in range(ROUNDS):
        left, slopes, bends = terms(joined)
        if not np.isfinite(bends).all():
            return None
        whole = np.block([[bent(bends, multipliers), slopes.T], [slopes, np.zeros((size + 2, size + 2))]])
        found = np.linalg.lstsq(whole, -np.concatenate([wanted * joined, left]), rcond=None)[0]
        step = _shortened(found[: size + free], joined)
        joined, multipliers = joined + step, found[size + free :]
        if abs(step).max() <= SHARP * (1.0 + abs(joined).max()):
            break
    else:
        return None
    left, slopes, bends = terms(joined)
    along = np.linalg.svd(slopes)[2][size + 2 :]
    slope = float(abs(wanted * joined + slopes.T @ multipliers).max())
    curved = np.linalg.eigvalsh(along @ bent(bends, multipliers) @ along.T) if len(along) else np.zeros(0)
    unknowns, offset = joined[:size], joined[size:]
    real = bool(_admissible(edge, unknowns, numbers + offset @ units))
    status = SolutionStatus.OK if real else SolutionStatus.VIRTUAL
    return EdgeFoot(edge, unknowns, offset, slope, curved, float(abs(left).max()), int(status))


def _shortened(step, joined):
    return step * min(1.0, FAR * (1.0 + abs(joined).max()) / max(abs(step).max(), TINY))

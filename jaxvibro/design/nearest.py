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
from .edge import Edge
from .located_point import solved
from .point_equations import PointEquations

ROUNDS = 40
WIDTH = 8  # places that are asked for at once: a multiple, so that few shapes are compiled
APART = 1e-5  # of 1 + the distance: the points of a difference
FAR = 0.3  # of the distance: the longest step
SHARP = 1e-9  # of the distance: a step from which the next leaves rounding alone
SURE = 1e-4  # of the distance: a step as short is Newton's own
TINY = 1e-300


class Foot(NamedTuple):
    """A point of a boundary, or of its edge. point: its `PointEquations`, or the `Edge`; unknowns: of them, along the
    direction to it; offset: from the scene, in units of each number, (free,); slope: the part of tau' across the
    direction, of an edge what is left of the condition, zero where it is nearest; bends: eigenvalues of the distance's
    second derivative, positive where it is a minimum; residual: the largest number left in the equations; status: a
    `SolutionStatus`."""

    point: PointEquations | Edge
    unknowns: Float[np.ndarray, " unknowns"]
    offset: Float[np.ndarray, " free"]
    slope: float
    bends: Float[np.ndarray, " across"]
    residual: float
    status: int

    @property
    def distance(self) -> float:
        """From the scene."""
        return float(np.linalg.norm(self.offset))


@jax.jit
def _sloped(point, start, begin, rows, direction):
    """(`LocatedPoint`s, unknowns, derivatives by the numbers) from scenes in rows."""

    def value(row):
        found, unknowns = solved(point, start, begin, row[None], direction)
        return found.value[0], jax.tree.map(lambda leaf: leaf[0], (found, unknowns))

    slopes, (found, unknowns) = jax.vmap(jax.grad(value, has_aux=True))(rows)
    return found, unknowns, slopes


def nearest(point, unknowns, numbers, units, offset):
    """The `Foot` that Newton's method reaches from a point of the boundary; its status NONE where it reaches none.

    numbers: the scene's, (numbers,); units: what one unit of each free number is of these, (free, numbers); offset: to
    the point, (free,); unknowns: there, along the direction to it.
    """
    step = np.inf
    for _ in range(ROUNDS):
        tau = np.linalg.norm(offset)
        ahead = offset / tau
        across, apart = _across(ahead), APART * (1.0 + tau)
        start = np.array(unknowns)
        start[point.size] = tau
        ask = partial(_sloped, point, start, numbers, direction=ahead @ units)
        width = -(-(2 * len(across) + 1) // WIDTH) * WIDTH
        blank = np.zeros((width - 2 * len(across), len(ahead)))
        shifts = apart * np.concatenate([across, -across, blank])
        found, seen, slopes = jax.device_get(ask(rows=numbers + shifts @ units))
        slopes = slopes @ units.T @ across.T
        slope, count = slopes[-1], len(across)
        bend = (slopes[:count] - slopes[count : 2 * count]) / (2.0 * apart)
        curved = np.eye(count) + np.outer(slope, slope) + 0.5 * tau * (bend + bend.T)
        if not np.isfinite(curved).all():
            break
        bends = np.linalg.eigvalsh(curved) if count else np.zeros(0)
        told = float(abs(slope).max(initial=0.0)), bends, float(found.residual[-1]), int(found.status[-1])
        here = Foot(point, seen[-1], found.value[-1] * ahead, *told)
        if step <= SHARP * tau or not count:
            return here
        way = -tau * np.linalg.solve(curved if bends.min() > 0 else np.eye(count), slope)
        way *= min(1.0, FAR * tau / max(np.linalg.norm(way), TINY))
        tried = way * 0.5 ** np.arange(width)[:, None]  # as many as before: one compiled shape
        found, seen, _ = jax.device_get(ask(rows=numbers + tried @ across @ units))
        offsets = tried @ across + found.value[:, None] * ahead
        best = int(np.argmin(np.where(np.isnan(found.value), np.inf, np.linalg.norm(offsets, axis=1))))
        if (
            step > np.linalg.norm(way)
            and np.isfinite(found.value[0])
            and bends.min() > 0
            and np.linalg.norm(way) < SURE * tau
        ):
            best = 0  # near the end distances differ by roundings alone
        if not np.isfinite(found.value[best]):
            break
        offset, unknowns, step = offsets[best], seen[best], np.linalg.norm(tried[best])
    return Foot(point, unknowns, offset, np.inf, np.zeros(0), np.nan, SolutionStatus.NONE)


def _across(ahead):
    """Unit vectors across a unit vector, (free - 1, free)."""
    return np.linalg.svd(ahead[None])[2][1:]

"""A fold or grazing carried to other numbers of its scene, by the host alone, and how its value changes with them.

F(u, p, q) = 0 are an orbit's equations, p the point's value, q the numbers that are kept. At a fold F_u is singular:
with w its null vector from the left, dp/dq = -(w F_q) / (w F_p). At a grazing one speed is zero and no unknown: what is
left of (F_u, F_p) is regular, and dp/dq is the last row of -(F_u, F_p)^-1 F_q. No second derivative is asked for.
"""

from contextlib import suppress
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from continuation import locate

from ..problem.equations import OrbitEquations, problem
from ..scene import check
from ..scene.parameters import marked
from ..scene.scene import Scene
from .extended_system import Grazing
from .first_point import equations, start_of

SHORTEST = 1.0 / 256.0  # of the way to other numbers: a step as short that fails is the end
WARY = 0.3  # of 1 + the largest unknown: more must nothing change in a step


class HeldPoint(NamedTuple):
    """A fold or grazing, and the numbers of its scene that are kept. along: its orbit's equations; z: (times, speeds,
    value); still: places in z of speeds that are zero; kept: the numbers, (count,); marks: for each the scene's tree,
    1 where it stands; residual: the largest error left in the equations."""

    along: OrbitEquations
    z: Float[np.ndarray, " unknowns"]
    still: Int[np.ndarray, " places"]
    kept: Float[np.ndarray, " count"]
    marks: tuple[Scene, ...]
    residual: float

    @property
    def value(self) -> float:
        """Of the point's parameter."""
        return float(self.z[-1])


def hold(special, names):
    """The `HeldPoint` of a `Special`, SN or GR, and names of numbers that are kept; at a GR the first touch that the
    point's value matters to."""
    start = start_of(special)
    for sheet in equations(start, (special.name, *names)):
        one = _held(*sheet, special.name, names)
        with suppress(np.linalg.LinAlgError):
            slopes(one)
            return one
    raise check.ArgumentError("special", f"must be moved by {special.name}", start.kind)


def _held(curve, z, name, names):
    """The `HeldPoint` of a curve's point along a parameter and others."""
    rows, own = len(curve.cycle.sides), z[: len(z) - len(names)]
    scene, which = marked(curve.scene, name)
    still = rows + np.flatnonzero(curve.pick) if isinstance(curve, Grazing) else np.zeros(0, int)
    marks = tuple(marked(scene, each)[1] for each in names)
    one = HeldPoint(
        OrbitEquations(scene, which, curve.cycle._replace(still=None)), own, still, z[len(own) :], marks, np.nan
    )
    one = _with(one, one.kept)  # `marked` has put the hardness to zero
    return _solved(one) or one


def slopes(one):
    """dp/dq at a `HeldPoint`, (count,)."""
    whole, by = _slopes(one.along, one.z), _by_kept(one)
    if len(one.still):
        return -np.linalg.solve(np.delete(whole, one.still, 1), by)[-1]
    left = locate.null(whole[:, :-1].T)
    return -(left @ by) / (left @ whole[:, -1])


def move(one, kept, steps=1):
    """(the `HeldPoint` of the same point where its numbers are others, how much of the way there it is: 1 all of it).

    kept: (count,); the way is cut into steps at first, and into shorter ones where Newton's method does not follow.
    """
    start, way = one.kept, np.asarray(kept) - one.kept
    share, step, before = 0.0, 1.0 / steps, None
    while share < 1.0 and step >= SHORTEST:
        ahead = min(1.0, share + step)
        z = np.array(one.z)
        if before is not None:  # on along the line through the last two
            z += (one.z - before[0].z) * (ahead - share) / (share - before[1])
        else:
            z[-1] += slopes(one) @ way * (ahead - share)
        found = _solved(_with(one, start + ahead * way)._replace(z=z))
        if found is None or abs(found.z - one.z).max() > WARY * (1.0 + abs(one.z).max()):
            step *= 0.5
        else:
            before, one, share, step = (one, share), found, ahead, 2.0 * step
    return one, share


def _with(one, kept):
    """The `HeldPoint` with other numbers, its orbit not yet theirs."""
    scene = one.along.scene
    for mark, value in zip(one.marks, kept, strict=True):
        scene = _put(scene, mark, value)
    return one._replace(along=one.along._replace(scene=scene), kept=kept)


def _put(scene, mark, value):
    return jax.tree.map(lambda leaf, here: np.where(here, value, leaf), scene, mark)


def _by_kept(one):
    """F_q, a column for each number."""
    there = _put(one.along.scene, one.along.which, one.z[-1])
    columns = [
        _slopes(one.along._replace(scene=there, which=mark), np.append(one.z[:-1], value))[:, -1]
        for mark, value in zip(one.marks, one.kept, strict=True)
    ]
    return np.stack(columns, 1)


def _slopes(along, z):
    return locate.slopes_of(problem(along), z, along)


def _solved(one):
    """The `HeldPoint` by Newton's method from this one, None where there is none whose impacts are into the walls."""
    try:
        with np.errstate(all="ignore"):
            found = _grazing(one) if len(one.still) else locate.fold(problem(one.along), one.z, one.along)
    except np.linalg.LinAlgError:  # a flight without an end
        return None
    if found.z is None:
        return None
    cycle = one.along.cycle
    rows = len(cycle.sides)
    moving = np.setdiff1d(rows + np.flatnonzero(cycle.sides != 0), one.still)
    return one._replace(z=found.z, residual=found.residual) if np.all(found.z[moving] > 0.0) else None


def _grazing(one):
    """`locate.Located` where the speeds that are still stay zero."""
    free = np.delete(np.arange(len(one.z)), one.still)

    def whole(y):
        z = np.zeros(len(one.z))
        z[free] = y
        return z

    def system(y):
        value, by = locate.evaluated(problem(one.along), whole(y), one.along)
        return np.asarray(value), np.asarray(by)[:, free]

    found = locate.newton(system, one.z[free])
    return found if found.z is None else found._replace(z=whole(found.z))

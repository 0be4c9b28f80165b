"""The defining equations of a special point: a regular root, as smooth as the orbit's own equations are.

Unknowns are the impacts' times and speeds and the point's parameter. At a GR one speed is zero, and no unknown. At an
SN, PD or SB a matrix J is singular, and its null vector is unknown too: F = 0, J v = 0, l v = 1 (Moore and Spence, SIAM
J. Numer. Anal. 17, 567, 1980). J is the derivative of F by times and speeds, closed as the kind asks: at a PD what
comes after the last impact is the opposite of what came before. An SB is one of half the orbit, whose other half is its
mirror image; the scene is then taken by its symmetric part, as no other has an SB.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from continuation import locate
from continuation.arrays import Array

from ..flight.coefficients import framed
from ..loci.extended_system import Grazing
from ..orbits import cyclic_system, impact_equations
from ..orbits.impact_equations import Cycle
from ..scene.scene import changed
from ..scene.symmetry import symmetric_part

CLOSING = {"SN": 1.0, "PD": -1.0, "SB": -1.0}
STATIC = {"static": True}


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PointEquations:
    """What is zero at a special point, a pytree. kind; names: of the parameter, and of what takes its value; touch: at
    a GR the row of the impact without speed, else None; cycle: the impacts, of half the orbit at an SB; along: l, the
    null vector where the point was found, None at a GR."""

    kind: str = field(metadata=STATIC)
    names: tuple[str, ...] = field(metadata=STATIC)
    touch: int | None = field(metadata=STATIC)
    cycle: Cycle
    along: Float[Array, " unknowns"] | None

    @property
    def size(self) -> int:
        """How many times and speeds are unknown: the parameter comes after them."""
        return 2 * len(self.cycle.sides) - (self.touch is not None)

    def scene_at(self, scene, value):
        """The scene where the parameter has a value."""
        scene = changed(scene, dict.fromkeys(self.names, value))
        return symmetric_part(scene) if self.kind == "SB" else scene

    def cycle_at(self, unknowns):
        """The `Cycle` with these unknowns."""
        rows = len(self.cycle.sides)
        times, speeds = unknowns[:rows], unknowns[rows : self.size]
        if self.touch is not None:
            speeds = jnp.concatenate([speeds[: self.touch], jnp.zeros_like(times[:1]), speeds[self.touch :]])
        return self.cycle._replace(times=times, speeds=speeds)

    def left(self, unknowns, scene):
        """What is to be zero."""
        built = framed(self.scene_at(scene, unknowns[self.size]))
        left, slopes = impact_equations.equations(built, self.cycle_at(unknowns))
        if self.touch is not None:
            return left
        null = unknowns[self.size + 1 :]
        return jnp.concatenate(
            [left, _turned(slopes, null, CLOSING[self.kind]), (jnp.sum(self.along * null) - 1.0)[None]]
        )


def _turned(slopes, change, closing):
    """J times a change of times and speeds, row by row: the kernels of many lanes take no products of matrices."""
    ((a, b), (c, d)), (e, f) = slopes.own, slopes.following
    times, speeds = jnp.split(change, 2)
    later, faster = (jnp.concatenate([each[1:], closing * each[:1]]) for each in (times, speeds))
    return jnp.concatenate([a * times + b * speeds + e * later, c * times + d * speeds + f * later - faster])


def at_point(kind, names, curve, z):
    """(`PointEquations`, unknowns) at a point of a curve, as a locus begins with it (`loci.first_point`)."""
    rows, count = len(curve.cycle.sides), int(np.sum(curve.cycle.sides != 0))
    parts = {"times": z[:count], "speeds": z[rows : rows + count], "sides": curve.cycle.sides[:count]}
    still = None if curve.cycle.still is None else curve.cycle.still[:count]
    cycle = curve.cycle._replace(**parts, still=still)
    if isinstance(curve, Grazing):
        touch = int(np.argmax(curve.pick))
        speeds = np.delete(parts["speeds"], touch)
        return PointEquations(kind, names, touch, cycle, None), np.concatenate([parts["times"], speeds, z[-1:]])
    along = PointEquations(kind, names, None, cycle, None)
    slopes = _slopes(along, along.scene_at(curve.scene, z[-1]))
    null = locate.null(np.asarray(cyclic_system.dense(cyclic_system.of(slopes), CLOSING[kind])))
    begun = np.concatenate([parts["times"], parts["speeds"], z[-1:], null])
    return PointEquations(kind, names, None, cycle, null), begun


@jax.jit
def _slopes(along, scene):
    return impact_equations.equations(framed(scene), along.cycle)[1]

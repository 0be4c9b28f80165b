"""The defining equations of a special point: a regular root, as smooth as the orbit's own equations are.

Unknowns are the impacts' times and speeds, and how far the point is from a scene along a direction in the space of all
its numbers: along one of its parameters, or any other. At a GR one speed is zero, and no unknown. At an
SN, PD or SB a matrix J is singular, and its null vector is unknown too: F = 0, J v = 0, v v = 1 (Moore and Spence 1980,
SIAM J. Numer. Anal. 17, 567, have l v = 1, which fails where v has turned until it is across l). J is the derivative of
F by times and speeds, closed as the kind asks: at a PD what comes after the last impact is the opposite of what came
before. An SB is one of half the orbit, whose other half is its mirror image; the scene is then taken by its symmetric
part, as no other has an SB.
"""

from dataclasses import dataclass, field, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from continuation import locate
from continuation.implicit import Numbers, Unknowns

from ..flight.coefficients import framed
from ..loci.extended_system import Grazing
from ..orbits import cyclic_system, impact_equations
from ..orbits.impact_equations import Cycle
from ..problem.equations import there
from ..scene.scene import Scene, changed
from ..scene.symmetry import symmetric_part

CLOSING = {"SN": 1.0, "PD": -1.0, "SB": -1.0}
STATIC = {"static": True}


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PointEquations:
    """What is zero at a special point, a pytree. kind; grazes: whether the first impact is one without speed, as at a
    GR; tree: of the scene's numbers; cycle: the impacts, of half the orbit at an SB."""

    kind: str = field(metadata=STATIC)
    grazes: bool = field(metadata=STATIC)
    tree: jax.tree_util.PyTreeDef = field(metadata=STATIC)
    cycle: Cycle

    @property
    def size(self) -> int:
        """How many times and speeds are unknown: how far comes after them."""
        return 2 * len(self.cycle.sides) - self.grazes

    def scene(self, numbers: Numbers) -> Scene:
        """The scene with these numbers, (numbers,), of which an SB takes the symmetric part."""
        scene = self.tree.unflatten(list(numbers))
        return symmetric_part(scene) if self.kind == "SB" else scene

    def cycle_at(self, unknowns: Unknowns) -> Cycle:
        """The `Cycle` with these unknowns."""
        rows = len(self.cycle.sides)
        times, speeds = unknowns[:rows], unknowns[rows : self.size]
        if self.grazes:
            speeds = jnp.concatenate([jnp.zeros_like(times[:1]), speeds])
        return self.cycle._replace(times=times, speeds=speeds)

    def left(self, unknowns: Unknowns, numbers: Numbers, direction: Numbers) -> Unknowns:
        """What is to be zero: the point is to lie so far from a scene with these numbers, along a direction of them."""
        built = framed(self.scene(numbers + unknowns[self.size] * direction))
        left, slopes = impact_equations.equations(built, self.cycle_at(unknowns))
        if self.grazes:
            return left
        change = unknowns[self.size + 1 :]
        away = sum(each * each for each in change) - 1.0  # a sum of products would be one of matrices
        return jnp.concatenate([left, _turned(slopes, change, CLOSING[self.kind]), away[None]])


def _turned(slopes, change, closing):
    """J times a change of times and speeds, row by row: the kernels of many lanes take no products of matrices."""
    ((a, b), (c, d)), (e, f) = slopes.own, slopes.following
    times, speeds = jnp.split(change, 2)
    later, faster = (jnp.concatenate([each[1:], closing * each[:1]]) for each in (times, speeds))
    return jnp.concatenate([a * times + b * speeds + e * later, c * times + d * speeds + f * later - faster])


def at_point(kind, curve, z):
    """(`PointEquations`, times and speeds, how far from a scene whose parameter is zero, null vector) at a point of a
    curve, as a locus begins with it (`loci.first_point`), in one row."""
    rows, count = len(curve.cycle.sides), int(np.sum(curve.cycle.sides != 0))
    times, speeds, sides = z[:count], z[rows : rows + count], curve.cycle.sides[:count]
    marks = {name: _part(getattr(curve.cycle, name), slice(count)) for name in ("still", "releases")}
    cycle = curve.cycle._replace(times=times, speeds=speeds, sides=sides, **marks)
    scene = whole(there(curve, z))
    tree = jax.tree.structure(scene)
    if isinstance(curve, Grazing):
        return grazing(tree, cycle, int(np.argmax(curve.pick)), z[-1], float(there(curve, z).frequency))
    point = PointEquations(kind, False, tree, cycle)
    null = null_at(point, jnp.stack(jax.tree.leaves(scene)))
    return point, np.concatenate([times, speeds, z[-1:], null])


def grazing(tree, cycle, touch, value, frequency):
    """(`PointEquations`, unknowns) of a GR at which the impact in a row has no speed: it becomes the first."""
    late = np.where(np.arange(len(cycle.sides)) < touch, float(cycle.periods) * 2.0 * np.pi / frequency, 0.0)
    times, speeds, sides = (np.roll(each, -touch) for each in (cycle.times + late, cycle.speeds, cycle.sides))
    turned = np.roll(np.arange(len(sides)), -touch)
    marks = {name: _part(getattr(cycle, name), turned) for name in ("still", "releases")}
    cycle = cycle._replace(times=times, speeds=speeds, sides=sides, **marks)
    return PointEquations("GR", True, tree, cycle), np.concatenate([times, speeds[1:], [value]])


def _part(marks, places):
    """Some rows of what a cycle marks them by, None: of nothing."""
    return None if marks is None else marks[places]


def null_at(point, numbers):
    """The null vector of J, or what comes nearest to one, where its own impacts are in a scene with these numbers."""
    return locate.null(np.asarray(closed(point, jnp.asarray(numbers))))


@jax.jit
def closed(point, numbers):
    """J, where the point's own impacts are in a scene with these numbers."""
    slopes = impact_equations.equations(framed(point.scene(numbers)), point.cycle)[1]
    return cyclic_system.dense(cyclic_system.of(slopes), CLOSING[point.kind])


def whole(scene):
    """The scene with all numbers of its walls their own, and a hardness of soft walls to be added: a tree of arrays
    that is the same for all scenes with walls of these kinds."""
    own = {f"{side}.{name}": scene.parameter(name) for side, wall in scene.walls.items() for name in wall.taken}
    scene = changed(scene, own)
    if scene.hardens and scene.harder is None:
        scene = replace(scene, harder=jnp.zeros_like(scene.amplitude))
    return jax.tree.map(partial(jnp.asarray, dtype=scene.dtype), scene)


def mark(scene, name):
    """1 at the numbers of the `whole` scene that a parameter stands for, walls that take it from the scene among them,
    else 0: (numbers,)."""
    taken = [f"{side}.{name}" for side, wall in scene.walls.items() if name in wall.taken]
    blank = jax.tree.map(lambda leaf: 0.0, whole(scene))
    if name == "hardness":
        return np.array(jax.tree.leaves(replace(blank, harder=1.0)))
    return np.array(jax.tree.leaves(changed(blank, dict.fromkeys([name, *taken], 1.0))))

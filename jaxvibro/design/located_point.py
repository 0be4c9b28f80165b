"""A special point's value as a function of its whole scene: what `located_orbit.located` gives of it."""

from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from continuation.arrays import Array
from continuation.implicit import JUMPED, LOST, carried, in_turn, root

from ..branches.branch import Special
from ..compiled.kernels import one_kernel
from ..flight.coefficients import framed
from ..loci.first_point import equations, start_of
from ..orbits import impact_equations
from ..orbits.flight_clearance import is_real
from ..scene import check
from ..scene.codes import SolutionStatus
from ..scene.force import LOOSEST
from ..scene.scene import SIDES, Scene
from .point_equations import STATIC, PointEquations, at_point, mark, whole

LOOSER = 100.0  # the steps by which the flow's error is estimated


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class LocatedPoint:
    """A special point of each scene. value: of the parameter; times: of the impacts, since the drive was at phase 0,
    that which grazes first; speeds: before them, 0 of that one; residual: the largest number left in the equations;
    status: a `SolutionStatus`; sides: -1 left, 1 right, of an impact; periods: of the drive. At an SB half of the
    orbit, with half of its periods: the other half is its mirror image."""

    value: Float[Array, "..."]
    times: Float[Array, "... impacts"]
    speeds: Float[Array, "... impacts"]
    residual: Float[Array, "..."]
    status: Int[Array, "..."]
    sides: tuple[int, ...] = field(metadata=STATIC, default=())
    periods: float = field(metadata=STATIC, default=1.0)


@dataclass(frozen=True, eq=False)
class Located:
    """A special point as a function of scenes, made by `located`: `value(scene)` is the parameter's value there,
    `value.solve(scene)` a `LocatedPoint`.

    special: the point that it was made of; name: of the parameter; wall: that is touched, where it was given. A scene
    has the walls of the point's; a batch of scenes gives arrays of its shape. Under jit, vmap and grad, forward and
    reverse, at any order.
    """

    special: Special
    name: str
    wall: str | None
    _equations: PointEquations = field(repr=False)
    _start: Float[np.ndarray, " unknowns"] = field(repr=False)

    def __call__(self, scene: Scene) -> Float[Array, "..."]:
        """The parameter's value at the point, of the scene's shape; nan where there is none.

        What the scene itself says of the parameter does not matter. Raises ArgumentError for a scene with other walls.
        """
        return self.solve(scene).value

    def solve(self, scene: Scene) -> LocatedPoint:
        """The `LocatedPoint` of the scene. Raises ArgumentError for a scene with other walls."""
        require_walls(scene, self.special.scene)
        begin, end, shape = whole(self.special.scene), whole(scene), scene.shape
        rows = jnp.stack([jnp.broadcast_to(leaf, shape).reshape(-1) for leaf in jax.tree.leaves(end)], 1)
        here, way = (mark(each, self.name) for each in (self.special.scene, scene))
        given = jnp.stack(jax.tree.leaves(begin)) * (1.0 - here), rows * (1.0 - way), way
        found, _ = solved(self._equations, self._start, *given)
        found = jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), found)
        if self.name == "hardness":  # it is counted from the walls' stiffness
            found = replace(found, value=found.value + scene.parameter("hardness"))
        cycle = self._equations.cycle
        sides = tuple(int(side) for side in np.asarray(cycle.sides))
        return replace(found, sides=sides, periods=float(cycle.periods))

    def flow_error(self) -> float:
        """How far the flow's own error has the value off, as two tolerances tell: what it changes by where steps under
        a `Force` are to be `LOOSER` times as loose, over that. 0 under spring and damper, whose flow is exact."""
        scene = self.special.scene
        if scene.force is None:
            return 0.0
        loose = min(LOOSER * scene.force.tolerance, LOOSEST)
        special = replace(self.special, scene=replace(scene, force=replace(scene.force, tolerance=loose)))
        other = located_point(special, self.name, self.wall)
        change = abs(float(other(special.scene)) - float(self(scene)))
        return change * scene.force.tolerance / loose


def located_point(special: Special, name: str | None = None, wall: str | None = None) -> Located:
    """The `Located` of a special point, as `located_orbit.located` tells."""
    start = start_of(special)
    if special.orbit.rests:
        raise check.ArgumentError(
            "point", "must be of an orbit that does not rest: `sensitivity` has its derivatives", special.label
        )
    name = special.name if name is None else name
    check.require_known(name, start.scene.names, name)
    if wall not in (None, *SIDES):
        raise check.ArgumentError("wall", 'must be "left", "right" or None', wall)
    point, unknowns = _only(start, name, wall)
    if name == "hardness":
        unknowns[point.size] = 0.0
    return Located(special, name, wall, point, unknowns)


def _only(start, name, wall):
    """(`PointEquations`, unknowns) of the one touch of a wall."""
    found = [at_point(start.kind, *sheet) for sheet in equations(start, (name,), whole=True)]
    sides = [SIDES[int(each.cycle.sides[0] > 0)] if each.grazes else None for each, _ in found]
    chosen = [one for one, side in zip(found, sides, strict=True) if wall in (None, side)]
    if len(chosen) != 1:
        told = ", ".join(side for side in sides if side) or "none"
        raise check.ArgumentError("wall", f"must be one of those that are touched, {told}", wall)
    return chosen[0]


def require_walls(scene: Scene, known: Scene) -> None:
    """Raise ArgumentError where what is no scene, or has walls of other kinds than one that is known."""
    kind = _kind(known)
    if not isinstance(scene, Scene) or _kind(scene) != kind:
        raise check.ArgumentError("scene", f"must be a Scene with the walls of the point's, {kind}", _told(scene))


def _kind(scene):
    """What is static of a scene, in words."""
    walls = []
    for side, wall in scene.walls.items():
        moving = "" if wall.motion is None else f", moving {wall.motion.harmonic} times a period"
        walls.append(f"{side} {'soft' if wall.soft else 'rigid'}{moving}")
    return "; ".join(walls)


def _told(scene):
    return _kind(scene) if isinstance(scene, Scene) else scene


@jax.jit
def solved(point, start, begin, rows, direction):
    """(the `LocatedPoint`s from scenes whose numbers are in rows, along a direction of them, value: how far; the
    unknowns).

    point: the `PointEquations`; start: their unknowns where the numbers are those of begin.
    """
    find, look = root(_left, _found, one_kernel), in_turn(_admissible, one_kernel)
    fixed = point, jnp.asarray(direction), jnp.asarray(start), jnp.asarray(begin)

    def at(row):
        unknowns, told = find(row, fixed)
        real = look(point, fixed[1], *lax.stop_gradient((row, unknowns)))
        return _record(point, unknowns, *told, real), unknowns

    return jax.vmap(at)(rows)


def _left(unknowns, numbers, fixed):
    point, direction, *_ = fixed
    return point.left(unknowns, numbers, direction)


def _found(numbers, fixed):
    """(unknowns, (the residual, how they were found))."""
    *_, start, begin = fixed
    found = carried(_left, start, begin, numbers, fixed)
    return found.u, (found.residual, found.kind)


def _record(point, unknowns, residual, kind, admissible):
    value, cycle = unknowns[point.size], point.cycle_at(unknowns)
    status = jnp.where(admissible, SolutionStatus.OK, SolutionStatus.VIRTUAL)
    status = jnp.where((status == SolutionStatus.OK) & (kind == JUMPED), SolutionStatus.JUMPED, status)
    status = jnp.where(kind == LOST, SolutionStatus.NONE, status)
    blank = jnp.where(kind == LOST, jnp.nan, 1.0)
    return LocatedPoint(value * blank, cycle.times * blank, cycle.speeds * blank, residual, status)


def _admissible(point, direction, numbers, unknowns):
    """Whether the orbit keeps to its walls and hits them with positive speed, one after the other."""
    cycle = point.cycle_at(unknowns)
    built = framed(point.scene(numbers + unknowns[point.size] * direction))
    return is_real(built, impact_equations.flights(built, cycle), cycle.speeds, point.grazes)

"""What an orbit has as a function of its scene: what `located.located` gives of an orbit."""

from dataclasses import dataclass, field, fields
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation.arrays import Array
from continuation.implicit import JUMPED, LOST, carried, in_turn, smooth

from ..branches.largest_position import of_cycle, of_flight
from ..compiled.kernels import one_kernel
from ..flight.coefficients import framed
from ..orbits import solve
from ..orbits.flight_clearance import without_impacts
from ..orbits.orbit import Orbit, OrbitError
from ..orbits.solve import Itinerary, OrbitSolutions
from ..scene import check
from ..scene.codes import SolutionStatus
from ..scene.scene import Scene
from .located_point import require_walls
from .point_equations import whole

QUANTITIES = ("multipliers", "speeds", "peak")


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class OrbitOfScene(OrbitSolutions):
    """What `OrbitSolutions` says, times since the orbit's own phase, and peak: the largest abs x on the orbit. A status
    is JUMPED where the way from the orbit's own scene was lost."""

    peak: Float[Array, "*shape"]


@dataclass(frozen=True, eq=False)
class LocatedOrbit:
    """An orbit as a function of scenes, made by `located`: `value(scene)` is what was asked for of it,
    `value.solve(scene)` an `OrbitOfScene`.

    orbit: that it was made of; quantity: "multipliers", (..., 2) complex, "speeds", (..., impacts), or "peak", the
    largest abs x. A batch of scenes gives arrays of its shape first. Under jit, vmap and grad, forward and reverse.
    """

    orbit: Orbit
    quantity: str
    _asked: Itinerary = field(repr=False)
    _start: Float[np.ndarray, " unknowns"] = field(repr=False)

    def __call__(self, scene: Scene) -> Array:
        """The quantity, nan where there is no such orbit. Raises ArgumentError for a scene with other walls."""
        return getattr(self.solve(scene), self.quantity)

    def solve(self, scene: Scene) -> OrbitOfScene:
        """The `OrbitOfScene` of the scene. Raises ArgumentError for a scene with other walls."""
        found = self.along(jax.tree.map(lambda leaf: jnp.asarray(leaf)[..., None], scene))
        return jax.tree.map(lambda leaf: jnp.take(leaf, 0, len(scene.shape)), found)

    def along(self, scenes: Scene) -> OrbitOfScene:
        """The `OrbitOfScene`s of scenes whose last axis is a way: each is followed from the one before, the first from
        the orbit's own. Raises ArgumentError for scenes with other walls."""
        require_walls(scenes, self.orbit.scene)
        begin, end, shape = whole(self.orbit.scene), whole(scenes), scenes.shape
        leaves = [jnp.broadcast_to(leaf, shape).reshape(-1, shape[-1]) for leaf in jax.tree.leaves(end)]
        phase = jnp.asarray(self.orbit.state.phase, scenes.dtype)
        start, numbers = jnp.asarray(self._start), jnp.stack(jax.tree.leaves(begin))
        found = _solved(self._asked, start, numbers, jnp.stack(leaves, -1), phase)
        return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), found)


@partial(jax.jit, static_argnums=0)
def _solved(asked, start, begin, rows, phase):
    """The `OrbitOfScene`s, one row after the other, of scenes whose numbers are in rows, (ways, places, numbers)."""
    fixed = phase, start
    follow = jax.vmap(in_turn(partial(_followed, asked), one_kernel), (None, None, 0, None))
    unknowns, kind = follow(start, begin, lax.stop_gradient(rows), phase)
    unknowns, kind, rows = unknowns.reshape(-1, len(start)), kind.reshape(-1), rows.reshape(-1, rows.shape[-1])
    unknowns = jnp.where((kind == LOST)[:, None], jnp.nan, unknowns)
    found = solve.solved(asked, rows, jnp.broadcast_to(phase, kind.shape), unknowns)
    status = jnp.where((kind == JUMPED) & (found.status == SolutionStatus.OK), SolutionStatus.JUMPED, found.status)
    pair = (found.times, found.speeds) if len(asked.sides) else (found.state.x[:, None], found.state.v[:, None])
    high = smooth(partial(_peak, asked), one_kernel)
    peak = jax.vmap(high, (0, None))(jnp.concatenate([*pair, rows], 1), fixed)
    peak = peak * jnp.where(found.status == SolutionStatus.NONE, jnp.nan, 1.0)
    told = {one.name: getattr(found, one.name) for one in fields(found)} | {"status": status, "peak": peak}
    return OrbitOfScene(**told)


def _followed(asked, start, begin, rows, phase):
    """(unknowns, how they were found at worst so far) from the numbers begin on straight ways from row to row."""

    def advance(carry, row):
        unknowns, before, worst = carry
        found = carried(partial(solve.left, asked), unknowns, before, row, (phase, start))
        worst = jnp.maximum(worst, found.kind)
        return (found.u, row, worst), (found.u, worst)

    first = start, begin, jnp.zeros((), start.dtype)
    return lax.scan(advance, first, rows)[1]


def _peak(asked, joined, fixed):
    """The largest abs x, of unknowns and numbers in one row."""
    phase, start = fixed
    unknowns, scene = joined[: len(start)], asked.tree.unflatten(list(joined[len(start) :]))
    built = framed(scene)
    if len(asked.sides):
        return of_cycle(built, solve.cycle_of(asked, unknowns, phase))
    return of_flight(built, without_impacts(built, phase, asked.periods, *unknowns))


def located_orbit(orbit: Orbit, quantity: str | None) -> LocatedOrbit:
    """The `LocatedOrbit` of a quantity of an orbit. Raises ArgumentError, OrbitError for one that rests on a wall."""
    if quantity not in QUANTITIES:
        raise check.ArgumentError("name", f"must be one of an orbit's {', '.join(QUANTITIES)}", quantity)
    impacts, state, count = orbit.impacts, orbit.state, int(orbit.impacts.count)
    if orbit.unknowns == "state" and count:
        raise OrbitError("the orbit rests on a wall, or chatters", orbit.residual, "separate impacts are needed")
    pair = (impacts.time[:count], impacts.speed[:count]) if count else ([state.x], [state.v])
    asked = Itinerary(jax.tree.structure(whole(orbit.scene)), tuple(orbit.itinerary))
    return LocatedOrbit(orbit, quantity, asked, np.concatenate([np.asarray(each, float) for each in pair]))

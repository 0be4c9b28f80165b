"""The range in which two motions live side by side, as a function of the scene: `hysteresis`."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from continuation.arrays import Array

from ..branches.branch import Special
from ..orbits.orbit import Orbit
from ..scene import check
from ..scene.scene import Scene
from .located_orbit import LocatedOrbit, OrbitOfScene, located_orbit
from .located_point import Located, located_point

NODES = 24  # Gauss and Legendre's, of an area


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class HysteresisLoop:
    """A hysteresis of each scene. first, last: the parameter's values at its ends; width: last - first; area: the
    integral of the upper orbit's measure less the lower's between them, nan where no orbits were given; status: the
    worst `SolutionStatus` of the ends and of the orbits between: VIRTUAL or NONE where another event ends it before."""

    first: Float[Array, "..."]
    last: Float[Array, "..."]
    width: Float[Array, "..."]
    area: Float[Array, "..."]
    status: Int[Array, "..."]


@dataclass(frozen=True, eq=False)
class Hysteresis:
    """A hysteresis as a function of scenes, made by `hysteresis`: `width(scene)`, `area(scene)`, `solve(scene)` a
    `HysteresisLoop`. Under jit, vmap and grad; smooth as long as the same events are its ends."""

    ends: tuple[Located, Located]
    orbits: tuple[LocatedOrbit, LocatedOrbit] | None
    measure: Callable[[OrbitOfScene], Float[Array, "..."]]

    @property
    def name(self) -> str:
        """Of the parameter."""
        return self.ends[0].name

    def width(self, scene: Scene) -> Float[Array, "..."]:
        """How wide it is, in the parameter's units."""
        first, last = (one(scene) for one in self.ends)
        return last - first

    def area(self, scene: Scene) -> Float[Array, "..."]:
        """Of the loop, the parameter's times the measure's units. Raises ArgumentError where no orbits were given."""
        if self.orbits is None:
            raise check.ArgumentError("orbits", "must be given to hysteresis for an area", None)
        return self.solve(scene).area

    def solve(self, scene: Scene) -> HysteresisLoop:
        """The `HysteresisLoop` of a scene, single or a batch."""
        first, last = (one.solve(scene) for one in self.ends)
        status, width = jnp.maximum(first.status, last.status), last.value - first.value
        if self.orbits is None:
            return HysteresisLoop(first.value, last.value, width, jnp.nan * width, status)
        nodes, weights = np.polynomial.legendre.leggauss(NODES)
        angles = 0.25 * np.pi * (nodes + 1.0)  # roots at the ends are smooth in them
        shares, weights = np.sin(angles) ** 2, 0.25 * np.pi * weights * np.sin(2.0 * angles)
        area, half = 0.0 * width, NODES // 2
        for part in (slice(half - 1, None, -1), slice(half, None)):  # from the middle to either end
            there = jnp.expand_dims(first.value, -1) + jnp.expand_dims(width, -1) * shares[part]
            wide = jax.tree.map(lambda leaf, shape=there.shape: jnp.broadcast_to(leaf[..., None], shape), scene)
            upper, lower = (one.along(wide.replace(**{self.name: there})) for one in self.orbits)
            area += width * jnp.sum(weights[part] * (self.measure(upper) - self.measure(lower)), -1)
            for one in (upper, lower):
                status = jnp.maximum(status, jnp.max(one.status, -1))
        return HysteresisLoop(first.value, last.value, width, area, status)


def of_peak(found: OrbitOfScene) -> Float[Array, "..."]:
    """The largest abs x of orbits."""
    return found.peak


@check.host("use the function that it gives")
def hysteresis(
    first: Special | Located,
    last: Special | Located,
    orbits: tuple[Orbit, Orbit] | None = None,
    measure: Callable[[OrbitOfScene], Float[Array, "..."]] = of_peak,
) -> Hysteresis:
    """The hysteresis between two special points of one parameter, as a function of the scene: a `Hysteresis`.

    first, last: `Special`s of the same parameter, the ends of the range in which two motions live side by side, such as
    an SN and a GR; a `Located` of one that has to be said the wall of. orbits: (upper, lower), an `Orbit` of each
    between the ends, for the area of the loop; measure: what is drawn of an orbit, a JAX function of an `OrbitOfScene`
    with an entry for each of a batch, by default the peak.

    The area is a sum over 24 places between the ends, Gauss and Legendre's in an angle in which square roots at the
    ends are smooth. It is smooth by pieces: where another event comes before, status says so.

    Raises ArgumentError for points of different parameters, and what `located` does.
    """
    begin, end = (one if isinstance(one, Located) else located_point(one) for one in (first, last))
    if begin.name != end.name:
        raise check.ArgumentError("last", f"must be of the same parameter, {begin.name}", end.name)
    if orbits is None:
        return Hysteresis((begin, end), None, measure)
    if len(orbits) != 2 or not all(isinstance(one, Orbit) for one in orbits):
        raise check.ArgumentError("orbits", "must be two Orbits, the upper and the lower", orbits)
    upper, lower = (located_orbit(one, "peak") for one in orbits)
    return Hysteresis((begin, end), (upper, lower), measure)

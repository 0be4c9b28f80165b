"""The range in which two motions live side by side, as a function of the scene: `hysteresis`."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from continuation.array_type import Array

from ..branches.branch import Special
from ..orbits.orbit import Orbit
from ..scene import check
from ..scene.scene import Scene
from .located_orbit import LocatedOrbit, OrbitOfScene, make_located_orbit
from .located_point import Located, make_located_point

N_QUADRATURE_NODES = 24  # Gauss and Legendre's, of an area


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
        first_value, last_value = (end(scene) for end in self.ends)
        return last_value - first_value

    def area(self, scene: Scene) -> Float[Array, "..."]:
        """Of the loop, the parameter's times the measure's units. Raises ArgumentError where no orbits were given."""
        if self.orbits is None:
            raise check.ArgumentError("orbits", "must be given to hysteresis for an area", None)
        return self.solve(scene).area

    def solve(self, scene: Scene) -> HysteresisLoop:
        """The `HysteresisLoop` of a scene, single or a batch."""
        first_point, last_point = (item.solve(scene) for item in self.ends)
        status, width = jnp.maximum(first_point.status, last_point.status), last_point.value - first_point.value
        if self.orbits is None:
            return HysteresisLoop(first_point.value, last_point.value, width, jnp.nan * width, status)
        nodes, weights = np.polynomial.legendre.leggauss(N_QUADRATURE_NODES)
        angles = 0.25 * np.pi * (nodes + 1.0)  # roots at the ends are smooth in them
        fractions, weights = np.sin(angles) ** 2, 0.25 * np.pi * weights * np.sin(2.0 * angles)
        area, half_count = 0.0 * width, N_QUADRATURE_NODES // 2
        for half_slice in (slice(half_count - 1, None, -1), slice(half_count, None)):  # from the middle to either end
            parameter_values = (
                jnp.expand_dims(first_point.value, -1) + jnp.expand_dims(width, -1) * fractions[half_slice]
            )
            scenes = jax.tree.map(
                lambda leaf, shape=parameter_values.shape: jnp.broadcast_to(leaf[..., None], shape), scene
            )
            upper_orbits, lower_orbits = (
                item.along(scenes.replace(**{self.name: parameter_values})) for item in self.orbits
            )
            area += width * jnp.sum(weights[half_slice] * (self.measure(upper_orbits) - self.measure(lower_orbits)), -1)
            for item in (upper_orbits, lower_orbits):
                status = jnp.maximum(status, jnp.max(item.status, -1))
        return HysteresisLoop(first_point.value, last_point.value, width, area, status)


def peak_of(orbit: OrbitOfScene) -> Float[Array, "..."]:
    """The largest abs x of orbits."""
    return orbit.peak


@check.host_only("use the function that it gives")
def hysteresis(
    first: Special | Located,
    last: Special | Located,
    orbits: tuple[Orbit, Orbit] | None = None,
    measure: Callable[[OrbitOfScene], Float[Array, "..."]] = peak_of,
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
    first_end, last_end = (item if isinstance(item, Located) else make_located_point(item) for item in (first, last))
    if first_end.name != last_end.name:
        raise check.ArgumentError("last", f"must be of the same parameter, {first_end.name}", last_end.name)
    if orbits is None:
        return Hysteresis((first_end, last_end), None, measure)
    if len(orbits) != 2 or not all(isinstance(item, Orbit) for item in orbits):
        raise check.ArgumentError("orbits", "must be two Orbits, the upper and the lower", orbits)
    upper_orbit, lower_orbit = (make_located_orbit(item, "peak") for item in orbits)
    return Hysteresis((first_end, last_end), (upper_orbit, lower_orbit), measure)

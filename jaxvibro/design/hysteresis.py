"""Compute the range in which two stable motions coexist as a function of the scene: `hysteresis`."""

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
from .located import Located, LocatedOrbit, OrbitOfScene, make_located_orbit, make_located_point

N_QUADRATURE_NODES = 24  # Gauss-Legendre nodes of an area


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class HysteresisLoop:
    """Hysteresis in each scene of a batch.

    Attributes
    ----------
    first : jax.Array
        Parameter value at the first end. Array of shape (...).
    last : jax.Array
        Parameter value at the last end. Array of shape (...).
    width : jax.Array
        Difference ``last - first``. Array of shape (...).
    area : jax.Array
        Integral over the parameter of the difference between the measures of the upper and the lower orbit; nan if no
        orbits were given. Array of shape (...).
    status : jax.Array
        Worst `SolutionStatus` of the ends and of the orbits between them. The status is VIRTUAL or NONE where another
        event ends the hysteresis earlier. Array of shape (...).

    Examples
    --------
    >>> loop = jv.hysteresis(branch.points("SN")[0], branch.points("SB")[0]).solve(scene)
    >>> round(float(loop.width), 6), int(loop.status)
    (3.035834, 0)
    """

    first: Float[Array, "..."]
    last: Float[Array, "..."]
    width: Float[Array, "..."]
    area: Float[Array, "..."]
    status: Int[Array, "..."]


@dataclass(frozen=True, eq=False)
class Hysteresis:
    """Hysteresis between two special points as a function of scenes.

    Made by `hysteresis`. The methods can be transformed by jit, vmap and grad. Their results are smooth functions of
    the scene as long as the same special points end the hysteresis.

    Attributes
    ----------
    ends : tuple of Located
        The two ends as functions of scenes.
    orbits : tuple of LocatedOrbit or None
        Upper and lower orbit as functions of scenes, if they were given.
    measure : callable
        Function of an `OrbitOfScene` that is integrated for the area.

    Examples
    --------
    >>> loop = jv.hysteresis(branch.points("SN")[0], branch.points("SB")[0])
    >>> loop.name
    'amplitude'
    """

    ends: tuple[Located, Located]
    orbits: tuple[LocatedOrbit, LocatedOrbit] | None
    measure: Callable[[OrbitOfScene], Float[Array, "..."]]

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.ends[0].name

    def width(self, scene: Scene) -> Float[Array, "..."]:
        """Compute the width of the hysteresis.

        Parameters
        ----------
        scene : Scene
            A single scene or a batch.

        Returns
        -------
        jax.Array
            Width in units of the parameter, of the shape of the scene.
        """
        first_value, last_value = (end(scene) for end in self.ends)
        return last_value - first_value

    def area(self, scene: Scene) -> Float[Array, "..."]:
        """Compute the area of the hysteresis loop.

        Parameters
        ----------
        scene : Scene
            A single scene or a batch.

        Returns
        -------
        jax.Array
            Area in units of the parameter times units of the measure, of the shape of the scene.

        Raises
        ------
        ArgumentError
            If no orbits were given to `hysteresis`.
        """
        if self.orbits is None:
            raise check.ArgumentError("orbits", "must be given to `hysteresis` for an area", None)
        return self.solve(scene).area

    def solve(self, scene: Scene) -> HysteresisLoop:
        """Compute the ends, the width, the area and the status of the hysteresis.

        Parameters
        ----------
        scene : Scene
            A single scene or a batch.

        Returns
        -------
        HysteresisLoop
            Hysteresis in each scene.
        """
        first_point, last_point = (point_or_orbit.solve(scene) for point_or_orbit in self.ends)
        status, width = jnp.maximum(first_point.status, last_point.status), last_point.value - first_point.value
        if self.orbits is None:
            return HysteresisLoop(first_point.value, last_point.value, width, jnp.nan * width, status)
        quadrature_nodes, quadrature_weights = np.polynomial.legendre.leggauss(N_QUADRATURE_NODES)
        quadrature_angles = (
            0.25 * np.pi * (quadrature_nodes + 1.0)
        )  # square roots at the ends are smooth in these angles
        range_fractions, quadrature_weights = (
            np.sin(quadrature_angles) ** 2,
            0.25 * np.pi * quadrature_weights * np.sin(2.0 * quadrature_angles),
        )
        area, n_half_nodes = 0.0 * width, N_QUADRATURE_NODES // 2
        for half_node_slice in (
            slice(n_half_nodes - 1, None, -1),
            slice(n_half_nodes, None),
        ):  # from the middle to either end
            parameter_values = (
                jnp.expand_dims(first_point.value, -1) + jnp.expand_dims(width, -1) * range_fractions[half_node_slice]
            )
            scenes = jax.tree.map(
                lambda leaf, shape=parameter_values.shape: jnp.broadcast_to(leaf[..., None], shape), scene
            )
            upper_orbits, lower_orbits = (
                point_or_orbit.along(scenes.replace(**{self.name: parameter_values})) for point_or_orbit in self.orbits
            )
            area += width * jnp.sum(
                quadrature_weights[half_node_slice] * (self.measure(upper_orbits) - self.measure(lower_orbits)), -1
            )
            for point_or_orbit in (upper_orbits, lower_orbits):
                status = jnp.maximum(status, jnp.max(point_or_orbit.status, -1))
        return HysteresisLoop(first_point.value, last_point.value, width, area, status)


def peak_of(orbit: OrbitOfScene) -> Float[Array, "..."]:
    """Return the largest ``|x|`` on each orbit."""
    return orbit.peak


@check.host_only("use the function that it gives")
def hysteresis(
    first: Special | Located,
    last: Special | Located,
    orbits: tuple[Orbit, Orbit] | None = None,
    measure: Callable[[OrbitOfScene], Float[Array, "..."]] = peak_of,
) -> Hysteresis:
    """Make the hysteresis between two special points a function of the scene.

    Parameters
    ----------
    first : Special or Located
        First end of the range in which two stable motions coexist, for example an SN. Pass a `Located` for a point
        whose wall must be given.
    last : Special or Located
        Other end, in the same parameter, for example a GR.
    orbits : tuple of Orbit, optional
        Upper and lower orbit, each between the ends. Required for the area.
    measure : callable, optional
        JAX function of an `OrbitOfScene` that returns one entry per orbit. By default the peak, the largest ``|x|``.

    Returns
    -------
    Hysteresis
        Width and area as functions of scenes.

    Raises
    ------
    ArgumentError
        If the points have different parameters, or if a point or an orbit is invalid for `located`.

    See Also
    --------
    located : Special points and orbits as functions of scenes.

    Notes
    -----
    The area is computed by Gauss-Legendre quadrature with 24 nodes, in an angle in which square roots at the ends are
    smooth. The area is a piecewise smooth function of the scene. If another event ends the range earlier, the status of
    the `HysteresisLoop` reports this.

    Examples
    --------
    >>> loop = jv.hysteresis(branch.points("SN")[0], branch.points("SB")[0])
    >>> round(float(loop.width(scene)), 6)
    3.035834
    """
    first_end, last_end = (
        point_or_orbit if isinstance(point_or_orbit, Located) else make_located_point(point_or_orbit)
        for point_or_orbit in (first, last)
    )
    if first_end.name != last_end.name:
        raise check.ArgumentError(
            "last", f"must be a point in the same parameter as `first`, {first_end.name}", last_end.name
        )
    if orbits is None:
        return Hysteresis((first_end, last_end), None, measure)
    if len(orbits) != 2 or not all(isinstance(point_or_orbit, Orbit) for point_or_orbit in orbits):
        raise check.ArgumentError("orbits", "must be the upper and the lower Orbit", orbits)
    upper_located_orbit, lower_located_orbit = (make_located_orbit(point_or_orbit, "peak") for point_or_orbit in orbits)
    return Hysteresis((first_end, last_end), (upper_located_orbit, lower_located_orbit), measure)

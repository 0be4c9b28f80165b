"""Express quantities of an orbit as functions of its scene, for `located.located`."""

from dataclasses import dataclass, field, fields
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation.array_type import Array
from continuation.implicit_function import FAILED, JUMPED, continue_root, forward_differentiable, loop_over_lanes

from ..branches.largest_position import peak_of_flight, peak_of_sequence
from ..compiled.kernels import call_as_kernel
from ..flight.coefficients import flow_coefficients
from ..orbits import solve
from ..orbits.flight_clearance import impact_free_flight
from ..orbits.orbit import Orbit, OrbitError
from ..orbits.solve import OrbitSolutions, OrbitTask
from ..scene import check
from ..scene.codes import SolutionStatus
from ..scene.scene import Scene
from .located_point import require_same_walls
from .point_equations import complete_scene

QUANTITIES = ("multipliers", "speeds", "peak")


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class OrbitOfScene(OrbitSolutions):
    """Orbit in each scene of a batch.

    Extends `OrbitSolutions`. Times count from the phase of the orbit. A status is ``SolutionStatus.JUMPED`` if the
    continuation from the scene of the orbit failed.

    Attributes
    ----------
    state : State
        State at the phase of the orbit.
    times : jax.Array
        Times of the impacts since that phase. Array of shape (..., impacts).
    speeds : jax.Array
        Relative speeds before the impacts. Array of shape (..., impacts).
    multipliers : jax.Array
        Floquet multipliers, the larger first. Array of shape (..., 2), complex.
    residual : jax.Array
        Largest residual of the equations before the last step of Newton's method. Array of shape (...).
    status : jax.Array
        `SolutionStatus` of each orbit. Array of shape (...).
    itinerary : tuple of str
        Sequence of walls hit, a word for each drive period.
    peak : jax.Array
        Largest ``|x|`` on the orbit, in lengths of the scene. Array of shape (...).

    Examples
    --------
    >>> solution = jv.located(orbit, "peak").solve(scene)
    >>> solution.itinerary, round(float(solution.peak), 6), int(solution.status)
    (('RL',), 1.0, 0)
    """

    peak: Float[Array, "*shape"]


@dataclass(frozen=True, eq=False)
class LocatedOrbit:
    """Quantity of an orbit as a function of scenes.

    Made by `located`. Calling it with a scene returns the quantity, of which the shape of the batch comes first. It can
    be transformed by jit, vmap and grad, in forward and reverse mode.

    Attributes
    ----------
    orbit : Orbit
        Orbit that defines the function.
    quantity : str
        ``"multipliers"``, complex, of shape (..., 2); ``"speeds"`` of shape (..., impacts); or ``"peak"``, the largest
        ``|x|``, of shape (...).

    Examples
    --------
    >>> peak = jv.located(orbit, "peak")
    >>> round(float(peak(scene.replace(amplitude=2.1))), 6)
    1.0
    """

    orbit: Orbit
    quantity: str
    _asked: OrbitTask = field(repr=False)
    _start: Float[np.ndarray, " unknowns"] = field(repr=False)

    def __call__(self, scene: Scene) -> Array:
        """Return the quantity in a scene.

        Parameters
        ----------
        scene : Scene
            A single scene or a batch, with walls of the same kinds as the scene of the orbit.

        Returns
        -------
        jax.Array
            The quantity, nan where there is no such orbit.

        Raises
        ------
        ArgumentError
            If the scene has other walls.
        """
        return getattr(self.solve(scene), self.quantity)

    def solve(self, scene: Scene) -> OrbitOfScene:
        """Solve for the orbit in a scene.

        Parameters
        ----------
        scene : Scene
            A single scene or a batch, with walls of the same kinds as the scene of the orbit.

        Returns
        -------
        OrbitOfScene
            Orbit in each scene.

        Raises
        ------
        ArgumentError
            If the scene has other walls.
        """
        orbits = self.along(jax.tree.map(lambda leaf: jnp.asarray(leaf)[..., None], scene))
        return jax.tree.map(lambda leaf: jnp.take(leaf, 0, len(scene.shape)), orbits)

    def along(self, scenes: Scene) -> OrbitOfScene:
        """Solve for the orbit along a path of scenes.

        Parameters
        ----------
        scenes : Scene
            Scenes whose last axis is the path. The orbit is continued from each scene to the next, and to the first
            scene from the scene of the orbit.

        Returns
        -------
        OrbitOfScene
            Orbit in each scene.

        Raises
        ------
        ArgumentError
            If the scenes have other walls.
        """
        require_same_walls(scenes, self.orbit.scene)
        start_scene, end_scenes, shape = complete_scene(self.orbit.scene), complete_scene(scenes), scenes.shape
        leaves = [jnp.broadcast_to(leaf, shape).reshape(-1, shape[-1]) for leaf in jax.tree.leaves(end_scenes)]
        phase = jnp.asarray(self.orbit.state.phase, scenes.dtype)
        start_unknowns, start_vector = jnp.asarray(self._start), jnp.stack(jax.tree.leaves(start_scene))
        orbits = _solve_orbits(self._asked, start_unknowns, start_vector, jnp.stack(leaves, -1), phase)
        return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), orbits)


@partial(jax.jit, static_argnums=0)
def _solve_orbits(itinerary, start_unknowns, start_vector, scene_vectors, phase):
    """Solve for orbits along paths of scene vectors of shape (paths, points, numbers); return an `OrbitOfScene`."""
    fixed_arguments = phase, start_unknowns
    follow = jax.vmap(loop_over_lanes(partial(_follow_orbits, itinerary), call_as_kernel), (None, None, 0, None))
    unknowns, outcomes = follow(start_unknowns, start_vector, lax.stop_gradient(scene_vectors), phase)
    unknowns, outcomes, scene_vectors = (
        unknowns.reshape(-1, len(start_unknowns)),
        outcomes.reshape(-1),
        scene_vectors.reshape(-1, scene_vectors.shape[-1]),
    )
    unknowns = jnp.where((outcomes == FAILED)[:, None], jnp.nan, unknowns)
    solutions = solve.solve_lanes(itinerary, scene_vectors, jnp.broadcast_to(phase, outcomes.shape), unknowns)
    status = jnp.where(
        (outcomes == JUMPED) & (solutions.status == SolutionStatus.OK), SolutionStatus.JUMPED, solutions.status
    )
    orbit_columns = (
        (solutions.times, solutions.speeds)
        if len(itinerary.sides)
        else (solutions.state.x[:, None], solutions.state.v[:, None])
    )
    peak_function = forward_differentiable(partial(_largest_position, itinerary), call_as_kernel)
    peak = jax.vmap(peak_function, (0, None))(jnp.concatenate([*orbit_columns, scene_vectors], 1), fixed_arguments)
    peak = peak * jnp.where(solutions.status == SolutionStatus.NONE, jnp.nan, 1.0)
    result_fields = {definition.name: getattr(solutions, definition.name) for definition in fields(solutions)} | {
        "status": status,
        "peak": peak,
    }
    return OrbitOfScene(**result_fields)


def _follow_orbits(itinerary, start_unknowns, start_vector, scene_vectors, phase):
    """Continue unknowns along straight paths from row to row; return them with the worst outcome up to each row."""

    def advance(carry, scene_vector):
        unknowns, previous_vector, worst_outcome = carry
        solution = continue_root(
            partial(solve.orbit_residual, itinerary), unknowns, previous_vector, scene_vector, (phase, start_unknowns)
        )
        worst_outcome = jnp.maximum(worst_outcome, solution.kind)
        return (solution.u, scene_vector, worst_outcome), (solution.u, worst_outcome)

    initial_carry = start_unknowns, start_vector, jnp.zeros((), start_unknowns.dtype)
    return lax.scan(advance, initial_carry, scene_vectors)[1]


def _largest_position(itinerary, unknowns_and_scene, fixed_arguments):
    """Return the largest ``|x|`` for unknowns and numbers of the scene in one row."""
    phase, start_unknowns = fixed_arguments
    unknowns, scene = (
        unknowns_and_scene[: len(start_unknowns)],
        itinerary.tree.unflatten(list(unknowns_and_scene[len(start_unknowns) :])),
    )
    coeffs = flow_coefficients(scene)
    if len(itinerary.sides):
        return peak_of_sequence(coeffs, solve.sequence_of(itinerary, unknowns, phase))
    return peak_of_flight(coeffs, impact_free_flight(coeffs, phase, itinerary.periods, *unknowns))


def make_located_orbit(orbit: Orbit, quantity: str | None) -> LocatedOrbit:
    """Make the `LocatedOrbit` of a quantity of an orbit.

    Raises ArgumentError for an unknown quantity, OrbitError if the orbit sticks or chatters.
    """
    if quantity not in QUANTITIES:
        raise check.ArgumentError("name", f"must be one of an orbit's {', '.join(QUANTITIES)}", quantity)
    impacts, state, n_impacts = orbit.impacts, orbit.state, int(orbit.impacts.count)
    if orbit.unknowns == "state" and n_impacts:
        raise OrbitError("the orbit sticks to a wall or chatters", orbit.residual, "separate impacts are required")
    orbit_columns = (impacts.time[:n_impacts], impacts.speed[:n_impacts]) if n_impacts else ([state.x], [state.v])
    itinerary = OrbitTask(jax.tree.structure(complete_scene(orbit.scene)), tuple(orbit.itinerary))
    return LocatedOrbit(
        orbit, quantity, itinerary, np.concatenate([np.asarray(column, float) for column in orbit_columns])
    )

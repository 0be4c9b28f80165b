"""Express quantities of an orbit as functions of its scene, for `located.located`."""

from dataclasses import dataclass, field, fields
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation.array_type import Array
from continuation.implicit_function import FAILED, JUMPED, continue_root, force_forward_mode, make_lane_loop_function

from ..branches.largest_position import peak_of_flight, peak_of_sequence
from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..orbits import solve
from ..orbits.flight_clearance import impact_free_flight
from ..orbits.orbit import Orbit, OrbitError
from ..orbits.solve import OrbitSolutions, OrbitStructure
from ..scene import check
from ..scene.codes import SolutionStatus
from ..scene.scene import Scene
from .located_point import require_same_wall_kinds
from .special_point_equations import complete_scene

QUANTITIES = ("multipliers", "speeds", "peak")


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class OrbitOfScene(OrbitSolutions):
    """Orbit in each scene of a batch.

    Extends `OrbitSolutions`. Times are measured from the phase of the orbit. The status is ``SolutionStatus.JUMPED`` if
    the continuation from the scene of the orbit failed and Newton's method may have converged to another orbit.

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

    Made by `located`. A call with a scene returns the quantity. A batch of scenes adds its shape as leading dimensions.
    The function can be transformed by jit, vmap and grad, in forward and reverse mode.

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
    _asked: OrbitStructure = field(repr=False)
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
        require_same_wall_kinds(scenes, self.orbit.scene)
        start_scene, path_scenes, scenes_shape = complete_scene(self.orbit.scene), complete_scene(scenes), scenes.shape
        scene_numbers = [
            jnp.broadcast_to(leaf, scenes_shape).reshape(-1, scenes_shape[-1]) for leaf in jax.tree.leaves(path_scenes)
        ]
        phase = jnp.asarray(self.orbit.state.phase, scenes.dtype)
        start_unknowns, start_scene_vector = jnp.asarray(self._start), jnp.stack(jax.tree.leaves(start_scene))
        orbits = _solve_orbits_on_paths(
            self._asked, start_unknowns, start_scene_vector, jnp.stack(scene_numbers, -1), phase
        )
        return jax.tree.map(lambda leaf: leaf.reshape(*scenes_shape, *leaf.shape[1:]), orbits)


@partial(jax.jit, static_argnums=0)
def _solve_orbits_on_paths(orbit_task, start_unknowns, start_scene_vector, scene_vectors, phase):
    """Solve for an orbit along paths of scenes; return an `OrbitOfScene`.

    `scene_vectors` holds the numbers of the scenes. Array of shape (paths, points, numbers).
    """
    phase_and_start = phase, start_unknowns
    follow_paths = jax.vmap(
        make_lane_loop_function(partial(_follow_orbit_along_path, orbit_task), call_as_kernel), (None, None, 0, None)
    )
    unknowns, continuation_outcomes = follow_paths(
        start_unknowns, start_scene_vector, lax.stop_gradient(scene_vectors), phase
    )
    unknowns, continuation_outcomes, scene_vectors = (
        unknowns.reshape(-1, len(start_unknowns)),
        continuation_outcomes.reshape(-1),
        scene_vectors.reshape(-1, scene_vectors.shape[-1]),
    )
    unknowns = jnp.where((continuation_outcomes == FAILED)[:, None], jnp.nan, unknowns)
    orbit_solutions = solve.solve_lanes(
        orbit_task, scene_vectors, jnp.broadcast_to(phase, continuation_outcomes.shape), unknowns
    )
    status = jnp.where(
        (continuation_outcomes == JUMPED) & (orbit_solutions.status == SolutionStatus.OK),
        SolutionStatus.JUMPED,
        orbit_solutions.status,
    )
    orbit_columns = (
        (orbit_solutions.times, orbit_solutions.speeds)
        if len(orbit_task.sides)
        else (orbit_solutions.state.x[:, None], orbit_solutions.state.v[:, None])
    )
    differentiable_peak = force_forward_mode(partial(_largest_position, orbit_task), call_as_kernel)
    peaks = jax.vmap(differentiable_peak, (0, None))(
        jnp.concatenate([*orbit_columns, scene_vectors], 1), phase_and_start
    )
    peaks = peaks * jnp.where(orbit_solutions.status == SolutionStatus.NONE, jnp.nan, 1.0)
    result_fields = {
        field_definition.name: getattr(orbit_solutions, field_definition.name)
        for field_definition in fields(orbit_solutions)
    } | {
        "status": status,
        "peak": peaks,
    }
    return OrbitOfScene(**result_fields)


def _follow_orbit_along_path(orbit_task, start_unknowns, start_scene_vector, scene_vectors, phase):
    """Continue an orbit from scene to scene; return its unknowns and the worst outcome up to each scene."""

    def continue_to_scene(carry, scene_vector):
        unknowns, previous_scene_vector, worst_outcome = carry
        solution = continue_root(
            partial(solve.orbit_residual, orbit_task),
            unknowns,
            previous_scene_vector,
            scene_vector,
            (phase, start_unknowns),
        )
        worst_outcome = jnp.maximum(worst_outcome, solution.kind)
        return (solution.u, scene_vector, worst_outcome), (solution.u, worst_outcome)

    initial_carry = start_unknowns, start_scene_vector, jnp.zeros((), start_unknowns.dtype)
    return lax.scan(continue_to_scene, initial_carry, scene_vectors)[1]


def _largest_position(orbit_task, unknowns_and_vector, phase_and_start):
    """Return the largest ``|x|`` on an orbit, from one vector of its unknowns and the numbers of its scene."""
    phase, start_unknowns = phase_and_start
    unknowns, scene = (
        unknowns_and_vector[: len(start_unknowns)],
        orbit_task.tree.unflatten(list(unknowns_and_vector[len(start_unknowns) :])),
    )
    coeffs = flow_coefficients(scene)
    if len(orbit_task.sides):
        return peak_of_sequence(coeffs, solve.sequence_of(orbit_task, unknowns, phase))
    return peak_of_flight(coeffs, impact_free_flight(coeffs, phase, orbit_task.periods, *unknowns))


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
    orbit_task = OrbitStructure(jax.tree.structure(complete_scene(orbit.scene)), tuple(orbit.itinerary))
    return LocatedOrbit(
        orbit, quantity, orbit_task, np.concatenate([np.asarray(column, float) for column in orbit_columns])
    )

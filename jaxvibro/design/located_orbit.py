"""What an orbit has as a function of its scene: what `located.located` gives of an orbit."""

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
    _asked: OrbitTask = field(repr=False)
    _start: Float[np.ndarray, " unknowns"] = field(repr=False)

    def __call__(self, scene: Scene) -> Array:
        """The quantity, nan where there is no such orbit. Raises ArgumentError for a scene with other walls."""
        return getattr(self.solve(scene), self.quantity)

    def solve(self, scene: Scene) -> OrbitOfScene:
        """The `OrbitOfScene` of the scene. Raises ArgumentError for a scene with other walls."""
        orbits = self.along(jax.tree.map(lambda leaf: jnp.asarray(leaf)[..., None], scene))
        return jax.tree.map(lambda leaf: jnp.take(leaf, 0, len(scene.shape)), orbits)

    def along(self, scenes: Scene) -> OrbitOfScene:
        """The `OrbitOfScene`s of scenes whose last axis is a way: each is followed from the one before, the first from
        the orbit's own. Raises ArgumentError for scenes with other walls."""
        require_same_walls(scenes, self.orbit.scene)
        start_scene, end_scenes, shape = complete_scene(self.orbit.scene), complete_scene(scenes), scenes.shape
        leaves = [jnp.broadcast_to(leaf, shape).reshape(-1, shape[-1]) for leaf in jax.tree.leaves(end_scenes)]
        phase = jnp.asarray(self.orbit.state.phase, scenes.dtype)
        start_unknowns, start_vector = jnp.asarray(self._start), jnp.stack(jax.tree.leaves(start_scene))
        orbits = _solve_orbits(self._asked, start_unknowns, start_vector, jnp.stack(leaves, -1), phase)
        return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), orbits)


@partial(jax.jit, static_argnums=0)
def _solve_orbits(itinerary, start_unknowns, start_vector, scene_vectors, phase):
    """The `OrbitOfScene`s, one row after the other, of scenes whose numbers are in rows, (ways, places, numbers)."""
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
    """(unknowns, how they were found at worst so far) from the numbers begin on straight ways from row to row."""

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
    """The largest abs x, of unknowns and numbers in one row."""
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
    """The `LocatedOrbit` of a quantity of an orbit. Raises ArgumentError, OrbitError for one that rests on a wall."""
    if quantity not in QUANTITIES:
        raise check.ArgumentError("name", f"must be one of an orbit's {', '.join(QUANTITIES)}", quantity)
    impacts, state, n_impacts = orbit.impacts, orbit.state, int(orbit.impacts.count)
    if orbit.unknowns == "state" and n_impacts:
        raise OrbitError("the orbit rests on a wall, or chatters", orbit.residual, "separate impacts are needed")
    orbit_columns = (impacts.time[:n_impacts], impacts.speed[:n_impacts]) if n_impacts else ([state.x], [state.v])
    itinerary = OrbitTask(jax.tree.structure(complete_scene(orbit.scene)), tuple(orbit.itinerary))
    return LocatedOrbit(
        orbit, quantity, itinerary, np.concatenate([np.asarray(column, float) for column in orbit_columns])
    )

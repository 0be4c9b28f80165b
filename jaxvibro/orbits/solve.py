"""Many periodic orbits at once, as functions of their scenes: `solve_orbits`."""

from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Complex, Float, Int

from continuation import newton
from continuation.array_type import Array
from continuation.implicit_function import forward_differentiable, implicit_root, loop_over_lanes

from ..compiled.kernels import call_as_kernel
from ..flight import flow_matrix
from ..flight.coefficients import flow_coefficients
from ..maps import itinerary as words
from ..maps.strobe import strobe
from ..scene import check
from ..scene.codes import SolutionStatus, Status
from ..scene.scene import Scene
from ..scene.state import State, state_arrays
from . import impact_equations
from .flight_clearance import impact_free_flight, is_admissible
from .impact_equations import ImpactSequence

STATIC_FIELD = {"static": True}


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class OrbitSolutions:
    """Periodic orbits, one of each scene. state: at the section's phase; times: of the impacts, since that phase, of
    the itinerary's order; speeds: abs(y- - v_b) before them; multipliers: Floquet's, the larger first; residual: the
    largest number left in the equations, before Newton's last step; status: a `SolutionStatus`, NONE where Newton's
    method does not converge, or where the guess is a state that hits other walls; itinerary: a word a period."""

    state: State
    times: Float[Array, "*shape impacts"]
    speeds: Float[Array, "*shape impacts"]
    multipliers: Complex[Array, "*shape 2"]
    residual: Float[Array, "*shape"]
    status: Int[Array, "*shape"]
    itinerary: tuple[str, ...] = field(metadata=STATIC_FIELD)


@check.check_types
def solve_orbits(
    scenes: Scene,
    guesses: State | tuple[Array, Array],
    itinerary: tuple[str, ...] | list[str],
    periods: int | None = None,
) -> OrbitSolutions:
    """The periodic orbits near guesses that hit given walls in turn: `OrbitSolutions` of the shape of both together.

    scenes: a `Scene`, single or a batch. guesses: a `State`, numbers or arrays, whose flight hits these walls, counted
    from any of its impacts; or (times, speeds) of the impacts, (..., impacts) each, since phase 0. itinerary: a word of
    "L" and "R" a period, as ("LR",) or ("LRL", "R"); all words empty: the motion that meets no wall. periods: their
    number, may be left out.

    Newton's method on the equations of the impacts; stable or not. Under jit, vmap and grad: derivatives by every
    number of the scenes are those of the orbit as a root of its equations (implicit function theorem), of any order,
    forward and reverse; by the guesses they are zero. A status of each lane says what was found; `find_orbit` confirms
    an orbit by certified flights, which is not done here: clearances are those at the turning points of its flights.

    Raises ArgumentError for arguments that cannot be.
    """
    valid_itinerary = words.validate_itinerary(itinerary, periods)
    if not isinstance(scenes, Scene):
        raise check.ArgumentError("scenes", "must be a Scene", scenes)
    leaves, tree = jax.tree.flatten(scenes)
    task = OrbitTask(tree, valid_itinerary)
    sides = task.sides
    if isinstance(guesses, State):
        phase, start = _guess_from_state(scenes, state_arrays(scenes, guesses), sides, len(valid_itinerary))
    else:
        phase, start = jnp.zeros((), scenes.dtype), _guess_rows(guesses, len(sides), scenes.dtype)
    shape = jnp.broadcast_shapes(scenes.shape, jnp.shape(phase), start.shape[:-1])
    leaf_rows = jnp.stack([jnp.broadcast_to(leaf, shape).reshape(-1) for leaf in leaves], 1)
    phase = jnp.broadcast_to(phase, shape).reshape(-1)
    start = jnp.broadcast_to(start, (*shape, start.shape[-1])).reshape(-1, start.shape[-1])
    solutions = solve_lanes(task, leaf_rows, phase, start)
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), solutions)


class OrbitTask(NamedTuple):
    """What is static of an orbit: the tree of its scene's numbers, and the walls that it hits, a word a period."""

    tree: jax.tree_util.PyTreeDef
    words: tuple[str, ...]

    @property
    def sides(self) -> Float[np.ndarray, " impacts"]:
        """-1 left, 1 right."""
        return words.wall_sides(self.words)

    @property
    def periods(self) -> int:
        """Of the drive."""
        return len(self.words)


def _guess_rows(guesses, n_impacts, dtype):
    """Times and speeds in rows. Raises ArgumentError."""
    if not isinstance(guesses, tuple | list) or len(guesses) != 2:
        raise check.ArgumentError("guesses", "must be a State, or (times, speeds)", guesses)
    rows = [
        check.real_array(f"guesses.{name}", array, dtype)
        for name, array in zip(("times", "speeds"), guesses, strict=True)
    ]
    for name, row in zip(("times", "speeds"), rows, strict=True):
        if np.ndim(row) == 0 or np.shape(row)[-1] != n_impacts:
            rule = f"must have an entry for each of the itinerary's {n_impacts} impacts, last"
            raise check.ArgumentError(f"guesses.{name}", rule, f"shape {np.shape(row)}")
    shape = jnp.broadcast_shapes(*map(np.shape, rows))
    if not n_impacts:
        return jnp.zeros((*shape[:-1], 2), dtype)
    return jnp.concatenate([jnp.broadcast_to(row, shape) for row in rows], -1)


def _guess_from_state(scenes, guesses, sides, periods):
    """(the section's phase, times and speeds of the impacts after states, begun with one that makes them those asked
    for, nan where none does); without impacts x and v."""
    scenes, guesses = lax.stop_gradient((scenes, guesses))
    if not len(sides):
        shape = jnp.broadcast_shapes(guesses.x.shape, guesses.v.shape)
        return guesses.phase, jnp.stack(
            [jnp.broadcast_to(component, shape) for component in (guesses.x, guesses.v)], -1
        )
    _, impacts = strobe(scenes, guesses, periods, len(sides))
    has_all_impacts = (impacts.count == len(sides)) & (impacts.status < Status.CAP)
    next_times = impacts.time + (2.0 * jnp.pi * periods / scenes.frequency)[..., None]
    two_rounds = (
        jnp.concatenate([impacts.time, next_times], -1),
        *(jnp.tile(component, 2) for component in (impacts.speed, impacts.side)),
    )
    start = jnp.full((*impacts.time.shape[:-1], 2 * len(sides)), jnp.nan, scenes.dtype)
    for shift in reversed(range(len(sides))):
        times, speeds, impact_sides = (component[..., shift : shift + len(sides)] for component in two_rounds)
        matches = has_all_impacts & (impact_sides == sides.astype(np.int8)).all(-1)
        start = jnp.where(matches[..., None], jnp.concatenate([times, speeds], -1), start)
    return guesses.phase, start


@partial(jax.jit, static_argnums=0)
def solve_lanes(task, leaf_rows, phases, starts):
    """The `OrbitSolutions` of lanes in one axis."""
    residual_of, find_root, test_admissible = (
        partial(function, task) for function in (orbit_residual, _solve_newton, _is_admissible)
    )
    find_root, test_admissible, measure = (
        implicit_root(residual_of, find_root, call_as_kernel),
        loop_over_lanes(test_admissible, call_as_kernel),
        forward_differentiable(partial(_section_and_invariants, task), call_as_kernel),
    )

    def solve_lane(leaf_row, phase, start):
        constants = phase, start
        unknowns, (residual, status) = find_root(leaf_row, constants)
        x, v, trace, determinant = measure(jnp.concatenate([unknowns, leaf_row]), constants)
        is_real = test_admissible(*lax.stop_gradient((leaf_row, phase, unknowns)))
        status = jnp.where(
            status == newton.OK, jnp.where(is_real, SolutionStatus.OK, SolutionStatus.VIRTUAL), SolutionStatus.NONE
        )
        nan_mask = jnp.where(status == SolutionStatus.NONE, jnp.nan, 1.0)
        times, speeds = jnp.split(unknowns * nan_mask, 2) if len(task.sides) else (unknowns[:0], unknowns[:0])
        state = State(x * nan_mask, v * nan_mask, phase, 0.0 * phase)
        multipliers = _multiplier_pair(trace, determinant) * nan_mask
        return OrbitSolutions(state, times, speeds, multipliers, residual, status, task.words)

    return jax.vmap(solve_lane)(leaf_rows, phases, starts)


def sequence_of(task, unknowns, phase):
    """The `ImpactSequence` with these times and speeds."""
    times, speeds = jnp.split(unknowns, 2)
    return ImpactSequence(times, speeds, jnp.asarray(task.sides), phase, jnp.asarray(float(task.periods)))


def orbit_residual(task, unknowns, scene_leaves, constants):
    """What is to be zero."""
    scene, (phase, _) = task.tree.unflatten(list(scene_leaves)), constants
    if len(task.sides):
        return impact_equations.residual_and_jacobian(flow_coefficients(scene), sequence_of(task, unknowns, phase))[0]
    return jnp.stack(_free_flight(task, scene, phase, unknowns)[0]) - unknowns


def _free_flight(task, scene, phase, state):
    """((x, v), the flight's matrix) after the periods, without walls."""
    return flow_matrix.fly_with_matrix(scene, state[0], state[1], phase, task.periods * 2.0 * jnp.pi / scene.frequency)


def _solve_newton(task, scene_leaves, constants):
    phase, start = constants
    if len(task.sides):
        scene = task.tree.unflatten(list(scene_leaves))
        newton_result = impact_equations.solve_sequence(scene, sequence_of(task, start, phase))
    else:
        residual_of = partial(orbit_residual, task)
        newton_result = newton.newton(
            lambda u: (residual_of(u, scene_leaves, constants), jax.jacfwd(residual_of)(u, scene_leaves, constants)),
            start,
        )
    return newton_result.unknowns, (newton_result.residual, newton_result.status.astype(scene_leaves.dtype))


def _is_admissible(task, scene_leaves, phase, unknowns):
    scene = task.tree.unflatten(list(scene_leaves))
    coeffs = flow_coefficients(scene)
    if len(task.sides):
        sequence = sequence_of(task, unknowns, phase)
        return is_admissible(coeffs, impact_equations.compute_flights(coeffs, sequence), sequence.speeds)
    return is_admissible(
        coeffs, impact_free_flight(coeffs, phase, task.periods, *unknowns), jnp.ones_like(unknowns[:1])
    )


def _section_and_invariants(task, unknowns_and_leaves, constants):
    """x and v at the section, trace and determinant of the monodromy matrix, of unknowns and numbers in one row."""
    phase, start = constants
    unknowns, scene = unknowns_and_leaves[: len(start)], task.tree.unflatten(list(unknowns_and_leaves[len(start) :]))
    if not len(task.sides):
        _, matrix = _free_flight(task, scene, phase, unknowns)
        p00, _, _, p11 = flow_matrix.matrix_by_rows(matrix)
        return jnp.stack([*unknowns, p00 + p11, flow_matrix.determinant(matrix)])
    coeffs, sequence = flow_coefficients(scene), sequence_of(task, unknowns, phase)
    flights = impact_equations.compute_flights(coeffs, sequence)
    x, v = impact_equations.states_at(coeffs, sequence, flights, jnp.zeros(1, unknowns.dtype))
    return jnp.stack([x[0], v[0], *impact_equations.monodromy_invariants(coeffs, flights, sequence.sides)])


def _multiplier_pair(trace, determinant):
    """The roots of a monodromy matrix, the larger first: (2,) complex; smooth but where they are one."""
    half_trace = 0.5 * trace
    discriminant = half_trace * half_trace - determinant
    root_size = jnp.sqrt(jnp.where(discriminant == 0, 1.0, abs(discriminant))) * jnp.where(discriminant == 0, 0.0, 1.0)
    larger = half_trace + jnp.where(half_trace < 0, -root_size, root_size)
    smaller = determinant / jnp.where(larger == 0, 1.0, larger)
    real_pair = jnp.stack([larger, smaller]) + 0j
    return jnp.where(discriminant < 0, half_trace + 1j * root_size * jnp.array([1.0, -1.0]), real_pair)

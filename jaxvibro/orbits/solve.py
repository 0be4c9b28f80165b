"""Solve for many periodic orbits at once, as differentiable functions of their scenes; also by deflation.

Find several solutions of the equations of the impacts from one guess: Newton's method with deflation. With known
solutions r, F is multiplied by ``prod (1 + 1 / |u - r|^2)``, which removes the zeros at all r. Newton's method from the
same guess then reaches another solution, or none (Farrell, Birkisson and Funke, SIAM J. Sci. Comput. 37, A2026, 2015).
The factor is a scalar function, so that deflation multiplies Newton's step by a scalar. The distance compares phases
and speeds, for all cyclic shifts of impacts and periods.
"""

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
from continuation.hostcall import persistent_jit
from continuation.implicit_function import force_forward_mode, make_implicit_root, make_lane_loop_function

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients, fly_with_matrix
from ..flight import flow_matrix
from ..maps import itinerary as words
from ..maps.strobe import strobe
from ..scene import check
from ..scene.scene import Scene
from ..scene.state import SolutionStatus, State, Status, make_state_arrays
from . import flight_clearance, impact_equations
from .flight_clearance import impact_free_clearances, impact_free_flight, is_admissible
from .impact_equations import ImpactSequence

N_SOLUTIONS = 3  # solutions from one guess
MAX_NEWTON_STEPS = 60
MIN_DENOMINATOR = 1e-3  # smallest denominator of a deflated step, which bounds the step


def solve_with_deflation(scenes, guesses, max_speed):
    """Find up to `N_SOLUTIONS` solutions from the guess of each lane.

    Parameters
    ----------
    scenes : Scene
        Scene with leaves of shape (lanes,).
    guesses : ImpactSequence
        Guesses of the lanes.
    max_speed : array
        Largest speed of the initial states of each lane, array of shape (lanes,). The distance between two solutions
        divides differences of speeds by this speed.

    Returns
    -------
    times, speeds : ndarray
        Times and speeds of the impacts, in order of time. Arrays of shape (solutions, lanes, rows), in order of
        discovery.
    is_admissible : ndarray of bool
        True if Newton's method has converged, the order of the walls is that of the guess, the speeds are positive, and
        the flights stay between the walls. Array of shape (solutions, lanes).
    """
    n_lanes, n_rows = guesses.times.shape
    known_solutions, is_solution_known = np.zeros((n_lanes, N_SOLUTIONS, 2, n_rows)), np.zeros((n_lanes, N_SOLUTIONS))
    solutions = []
    for solution_index in range(N_SOLUTIONS):
        times, speeds, is_admissible, converged = jax.device_get(
            _solve_lane(scenes, guesses, known_solutions, is_solution_known, max_speed)
        )
        solutions.append((times, speeds, is_admissible))
        known_solutions[:, solution_index, 0] = times
        known_solutions[:, solution_index, 1] = speeds
        is_solution_known[:, solution_index] = converged
    return tuple(np.stack(columns) for columns in zip(*solutions, strict=True))


@persistent_jit()
@jax.vmap
def _solve_lane(scene, guess, known_solutions, is_solution_known, max_speed):
    """Return (times, speeds, is admissible, True if Newton's method has converged) of one lane."""
    coeffs, n_rows = flow_coefficients(scene), len(guess.sides)
    max_change = jnp.repeat(
        jnp.array([impact_equations.MAX_TIME_CHANGE * coeffs.period, jnp.inf]), n_rows, total_repeat_length=2 * n_rows
    )
    deflation_gradient_of = jax.grad(
        partial(_log_deflation_factor, coeffs, guess.sides, known_solutions, is_solution_known, max_speed)
    )

    def equations_and_gradient(unknowns):
        return impact_equations.residual_and_jacobian(
            coeffs, guess._replace(times=unknowns[:n_rows], speeds=unknowns[n_rows:])
        ), deflation_gradient_of(unknowns)

    def solve_deflated_step(jacobian, residual):
        (jacobian, gradient) = jacobian
        change, pivot_ratio = impact_equations.solve_cyclic(jacobian, residual)
        denominator = 1.0 + jnp.sum(gradient * change)
        return change / jnp.where(
            abs(denominator) < MIN_DENOMINATOR,
            jnp.where(denominator < 0, -MIN_DENOMINATOR, MIN_DENOMINATOR),
            denominator,
        ), pivot_ratio

    def residual_and_derivatives(unknowns):
        (residual, jacobian), gradient = equations_and_gradient(unknowns)
        return residual, (jacobian, gradient)

    newton_result = newton.newton(
        residual_and_derivatives,
        jnp.concatenate([guess.times, guess.speeds]),
        max_change,
        MAX_NEWTON_STEPS,
        solve_deflated_step,
    )
    sequence = impact_equations.sort_sequence(scene, guess, newton_result.unknowns)
    flights, is_impact = impact_equations.compute_flights(coeffs, sequence), sequence.sides != 0
    clearances, _ = flight_clearance.turning_clearances(coeffs, flights, flight_clearance.sample_count(coeffs, flights))
    admissible = jnp.all(~is_impact | ((sequence.speeds > 0) & (flights.time > 0))) & jnp.all(
        ~is_impact[:, None] | (clearances >= 0)
    )
    converged = newton_result.status == newton.OK
    has_guessed_sides = jnp.all(sequence.sides == guess.sides)
    return sequence.times, sequence.speeds, converged & has_guessed_sides & admissible, converged


def _log_deflation_factor(coeffs, sides, known_solutions, is_solution_known, max_speed, unknowns):
    """Evaluate the logarithm of the deflation factor."""
    n_rows, is_impact = len(sides), sides != 0
    n_impacts, row_index = jnp.sum(is_impact), jnp.arange(len(sides))
    phase, speed = coeffs.frequency * unknowns[:n_rows], unknowns[n_rows:]
    log_factors = []
    for impact_shift in range(n_rows):
        shifted_index = (row_index + impact_shift) % n_impacts
        shifted_solutions = known_solutions[:, :, jnp.where(is_impact, shifted_index, row_index)]
        squared_impact_distance = (
            2.0
            - 2.0 * jnp.cos(phase - coeffs.frequency * shifted_solutions[:, 0])
            + ((speed - shifted_solutions[:, 1]) / max_speed) ** 2
        )
        squared_distance = jnp.sum(jnp.where(is_impact, squared_impact_distance, 0.0), axis=1)
        log_factors.append(
            jnp.where(
                (is_solution_known > 0) & (impact_shift < n_impacts),
                jnp.log1p(1.0 / jnp.maximum(squared_distance, 1e-30)),
                0.0,
            )
        )
    return jnp.sum(jnp.stack(log_factors))


STATIC_FIELD = {"static": True}


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class OrbitSolutions:
    """Periodic orbits, one for each scene, as `solve_orbits` returns them.

    Attributes
    ----------
    state : State
        State at the phase of the section, of shape (...).
    times : Array
        Times of the impacts since that phase, in t, in the order of the itinerary; of shape (..., impacts).
    speeds : Array
        Speeds ``|y- - v_b|`` before the impacts, in lengths per t; of shape (..., impacts).
    multipliers : Array of complex
        Floquet multipliers, the larger first; of shape (..., 2).
    residual : Array
        Largest residual of the equations before the last Newton step.
    status : Array of int
        A `SolutionStatus` for each lane. It is NONE if Newton's method does not converge, or if the guess is a state
        that hits other walls. It is VIRTUAL if the orbit is inadmissible.
    itinerary : tuple of str
        A word of "L" and "R" for each period.

    See Also
    --------
    solve_orbits : Solve for the orbits.

    Examples
    --------
    >>> solutions = jv.solve_orbits(scene, orbit.state, orbit.itinerary)
    >>> jv.SolutionStatus(int(solutions.status)).name
    'OK'
    """

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
    """Solve for the periodic orbits near guesses that hit given walls in turn.

    Newton's method solves the equations of the impacts, for stable and unstable orbits alike. The result is
    differentiable.

    Parameters
    ----------
    scenes : Scene
        Oscillator, drive and walls. A single scene or a batch.
    guesses : State or tuple of array
        Guesses that broadcast with `scenes`: a `State` whose motion hits these walls, in the given order from one of
        its impacts on, or (times, speeds) of the impacts since phase 0, each of shape (..., impacts).
    itinerary : sequence of str
        Walls to be hit: a word of "L" and "R" for each period, as ``("LR",)`` or ``("LRL", "R")``. Empty words mean the
        motion without impacts.
    periods : int, optional
        Number of periods. If given, it must be the number of words.

    Returns
    -------
    OrbitSolutions
        The orbits, of the broadcast shape of `scenes` and `guesses`, with a status for each lane.

    Raises
    ------
    ArgumentError
        If an argument is invalid.

    See Also
    --------
    find_orbit : One orbit, confirmed by certified flights.
    follow : Continue an orbit in a parameter.

    Notes
    -----
    The function works under ``jit``, ``vmap`` and ``grad``. Derivatives with respect to every number of the scenes are
    those of a root of the equations (implicit function theorem), of any order, in forward and reverse mode. Derivatives
    with respect to the guesses are zero.

    A solution is admissible if its flights stay between the walls at their turning points. Unlike in `find_orbit`,
    certified flights do not confirm this.

    Examples
    --------
    >>> scenes = scene.replace(amplitude=np.array([1.9, 2.0, 2.1]))
    >>> solutions = jv.solve_orbits(scenes, orbit.state, orbit.itinerary)
    >>> np.asarray(solutions.speeds[:, 0]).round(4)
    array([1.918 , 1.9561, 1.9941])
    """
    valid_itinerary = words.validate_itinerary(itinerary, periods)
    if not isinstance(scenes, Scene):
        raise check.ArgumentError("scenes", "must be a Scene", scenes)
    leaves, scene_tree = jax.tree.flatten(scenes)
    structure = OrbitStructure(scene_tree, valid_itinerary)
    sides = structure.sides
    if isinstance(guesses, State):
        phase, start_unknowns = _guess_from_state(
            scenes, make_state_arrays(scenes, guesses), sides, len(valid_itinerary)
        )
    else:
        phase, start_unknowns = jnp.zeros((), scenes.dtype), _join_guesses(guesses, len(sides), scenes.dtype)
    shape = jnp.broadcast_shapes(scenes.shape, jnp.shape(phase), start_unknowns.shape[:-1])
    scene_numbers = jnp.stack([jnp.broadcast_to(leaf, shape).reshape(-1) for leaf in leaves], 1)
    phase = jnp.broadcast_to(phase, shape).reshape(-1)
    start_unknowns = jnp.broadcast_to(start_unknowns, (*shape, start_unknowns.shape[-1])).reshape(
        -1, start_unknowns.shape[-1]
    )
    solutions = solve_lanes(structure, scene_numbers, phase, start_unknowns)
    return jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), solutions)


class OrbitStructure(NamedTuple):
    """Static description of an orbit: pytree structure of the scene, and itinerary.

    Attributes
    ----------
    tree : jax.tree_util.PyTreeDef
        Pytree structure of the numbers of a scene.
    itinerary : tuple of str
        Itinerary: a word of "L" and "R" for each period.
    """

    tree: jax.tree_util.PyTreeDef
    itinerary: tuple[str, ...]

    @property
    def sides(self) -> Float[np.ndarray, " impacts"]:
        """Sides of the impacts: -1 left, 1 right."""
        return words.sides_of_itinerary(self.itinerary)

    @property
    def periods(self) -> int:
        """Number of drive periods."""
        return len(self.itinerary)


def _join_guesses(guesses, n_impacts, dtype):
    """Validate guesses of times and speeds and join them in rows. Raises ArgumentError."""
    if not isinstance(guesses, tuple | list) or len(guesses) != 2:
        raise check.ArgumentError("guesses", "must be a State, or (times, speeds)", guesses)
    rows = [
        check.check_real_array(f"guesses.{name}", array, dtype)
        for name, array in zip(("times", "speeds"), guesses, strict=True)
    ]
    for name, row in zip(("times", "speeds"), rows, strict=True):
        if np.ndim(row) == 0 or np.shape(row)[-1] != n_impacts:
            rule = f"must have an entry for each of the itinerary's {n_impacts} impacts along the last axis"
            raise check.ArgumentError(f"guesses.{name}", rule, f"shape {np.shape(row)}")
    shape = jnp.broadcast_shapes(*map(np.shape, rows))
    if not n_impacts:
        return jnp.zeros((*shape[:-1], 2), dtype)
    return jnp.concatenate([jnp.broadcast_to(row, shape) for row in rows], -1)


def _guess_from_state(scenes, guesses, sides, periods):
    """Return the phase of the section and the initial unknowns.

    The unknowns are the times and speeds of the impacts after the states, or x and v without impacts. The first impact
    is the earliest from which the walls match the itinerary. The unknowns are nan if there is no such impact.
    """
    scenes, guesses = lax.stop_gradient((scenes, guesses))
    if not len(sides):
        shape = jnp.broadcast_shapes(guesses.x.shape, guesses.v.shape)
        return guesses.phase, jnp.stack(
            [jnp.broadcast_to(component, shape) for component in (guesses.x, guesses.v)], -1
        )
    _, impacts = strobe(scenes, guesses, periods, len(sides))
    has_all_impacts = (impacts.count == len(sides)) & (impacts.status < Status.CAP)
    next_times = impacts.time + (2.0 * jnp.pi * periods / scenes.frequency)[..., None]
    two_traversals = (
        jnp.concatenate([impacts.time, next_times], -1),
        *(jnp.tile(component, 2) for component in (impacts.speed, impacts.side)),
    )
    start_unknowns = jnp.full((*impacts.time.shape[:-1], 2 * len(sides)), jnp.nan, scenes.dtype)
    for first_impact_index in reversed(range(len(sides))):
        times, speeds, impact_sides = (
            component[..., first_impact_index : first_impact_index + len(sides)] for component in two_traversals
        )
        matches_itinerary = has_all_impacts & (impact_sides == sides.astype(np.int8)).all(-1)
        start_unknowns = jnp.where(matches_itinerary[..., None], jnp.concatenate([times, speeds], -1), start_unknowns)
    return guesses.phase, start_unknowns


@partial(jax.jit, static_argnums=0)
def solve_lanes(structure, scene_numbers, phases, start_unknowns):
    """Solve for the orbits of lanes along one axis.

    Parameters
    ----------
    structure : OrbitStructure
        Static description of the orbits.
    scene_numbers : array
        Numbers of the scenes, of shape (lanes, numbers).
    phases : array
        Phases of the sections, of shape (lanes,), in rad.
    start_unknowns : array
        Guesses of the unknowns, of shape (lanes, unknowns): times, then speeds; or x and v without impacts.

    Returns
    -------
    OrbitSolutions
        The orbits of the lanes.
    """
    residual_of, find_root, test_admissible = (
        partial(function_of_structure, structure)
        for function_of_structure in (orbit_residual, _solve_newton, _is_admissible)
    )
    find_root, test_admissible, measure_orbit = (
        make_implicit_root(residual_of, find_root, call_as_kernel),
        make_lane_loop_function(test_admissible, call_as_kernel),
        force_forward_mode(partial(_section_and_invariants, structure), call_as_kernel),
    )

    def solve_lane(lane_numbers, phase, guess_unknowns):
        phase_and_guess = phase, guess_unknowns
        unknowns, (residual, status) = find_root(lane_numbers, phase_and_guess)
        x, v, trace, determinant = measure_orbit(jnp.concatenate([unknowns, lane_numbers]), phase_and_guess)
        is_orbit_admissible = test_admissible(*lax.stop_gradient((lane_numbers, phase, unknowns)))
        status = jnp.where(
            status == newton.OK,
            jnp.where(is_orbit_admissible, SolutionStatus.OK, SolutionStatus.VIRTUAL),
            SolutionStatus.NONE,
        )
        nan_factor = jnp.where(status == SolutionStatus.NONE, jnp.nan, 1.0)
        times, speeds = jnp.split(unknowns * nan_factor, 2) if len(structure.sides) else (unknowns[:0], unknowns[:0])
        state = State(x * nan_factor, v * nan_factor, phase, 0.0 * phase)
        multipliers = _multiplier_pair(trace, determinant) * nan_factor
        return OrbitSolutions(state, times, speeds, multipliers, residual, status, structure.itinerary)

    return jax.vmap(solve_lane)(scene_numbers, phases, start_unknowns)


def sequence_of(structure, unknowns, phase):
    """Assemble the impact sequence of an orbit from the unknowns.

    Parameters
    ----------
    structure : OrbitStructure
        Static description of the orbit.
    unknowns : array
        Times, then speeds of the impacts.
    phase : array
        Phase of the section, in rad.

    Returns
    -------
    ImpactSequence
        The sequence of impacts.
    """
    times, speeds = jnp.split(unknowns, 2)
    return ImpactSequence(times, speeds, jnp.asarray(structure.sides), phase, jnp.asarray(float(structure.periods)))


def orbit_residual(structure, unknowns, scene_leaves, phase_and_guess):
    """Evaluate the residual of the equations of an orbit.

    Parameters
    ----------
    structure : OrbitStructure
        Static description of the orbit.
    unknowns : array
        Times, then speeds of the impacts; or x and v without impacts.
    scene_leaves : array
        Numbers of the scene in the order of ``structure.tree``.
    phase_and_guess : tuple
        (phase of the section, guess of the unknowns).

    Returns
    -------
    array
        Residual, of the shape of `unknowns`.
    """
    scene, (phase, _) = structure.tree.unflatten(list(scene_leaves)), phase_and_guess
    if len(structure.sides):
        return impact_equations.residual_and_jacobian(
            flow_coefficients(scene), sequence_of(structure, unknowns, phase)
        )[0]
    return jnp.stack(_fly_without_walls(structure, scene, phase, unknowns)[0]) - unknowns


def _fly_without_walls(structure, scene, phase, state):
    """Return ((x, v), flight matrix) after a flight over all periods of the orbit without walls."""
    return fly_with_matrix(scene, state[0], state[1], phase, structure.periods * 2.0 * jnp.pi / scene.frequency)


def _solve_newton(structure, scene_leaves, phase_and_guess):
    phase, guess_unknowns = phase_and_guess
    if len(structure.sides):
        scene = structure.tree.unflatten(list(scene_leaves))
        newton_result = impact_equations.solve_sequence(scene, sequence_of(structure, guess_unknowns, phase))
    else:
        residual_of = partial(orbit_residual, structure)
        newton_result = newton.newton(
            lambda u: (
                residual_of(u, scene_leaves, phase_and_guess),
                jax.jacfwd(residual_of)(u, scene_leaves, phase_and_guess),
            ),
            guess_unknowns,
        )
    return newton_result.unknowns, (newton_result.residual, newton_result.status.astype(scene_leaves.dtype))


def _is_admissible(structure, scene_leaves, phase, unknowns):
    scene = structure.tree.unflatten(list(scene_leaves))
    coeffs = flow_coefficients(scene)
    if len(structure.sides):
        sequence = sequence_of(structure, unknowns, phase)
        return is_admissible(coeffs, impact_equations.compute_flights(coeffs, sequence), sequence.speeds)
    clearances, _ = impact_free_clearances(coeffs, impact_free_flight(coeffs, phase, structure.periods, *unknowns))
    return jnp.all(clearances >= 0)


def _section_and_invariants(structure, unknowns_and_leaves, phase_and_guess):
    """Return x and v at the section, trace and determinant, from an array of the unknowns and the scene's numbers."""
    phase, guess_unknowns = phase_and_guess
    unknowns, scene = (
        unknowns_and_leaves[: len(guess_unknowns)],
        structure.tree.unflatten(list(unknowns_and_leaves[len(guess_unknowns) :])),
    )
    if not len(structure.sides):
        _, matrix = _fly_without_walls(structure, scene, phase, unknowns)
        p00, _, _, p11 = flow_matrix.matrix_by_rows(matrix)
        return jnp.stack([*unknowns, p00 + p11, flow_matrix.determinant(matrix)])
    coeffs, sequence = flow_coefficients(scene), sequence_of(structure, unknowns, phase)
    flights = impact_equations.compute_flights(coeffs, sequence)
    x, v = impact_equations.states_at(coeffs, sequence, flights, jnp.zeros(1, unknowns.dtype))
    return jnp.stack([x[0], v[0], *impact_equations.monodromy_invariants(coeffs, flights, sequence.sides)])


def _multiplier_pair(trace, determinant):
    """Compute the multipliers, the larger first, of shape (2,) and complex; smooth unless they coincide."""
    half_trace = 0.5 * trace
    discriminant = half_trace * half_trace - determinant
    discriminant_root = jnp.sqrt(jnp.where(discriminant == 0, 1.0, abs(discriminant))) * jnp.where(
        discriminant == 0, 0.0, 1.0
    )
    larger_multiplier = half_trace + jnp.where(half_trace < 0, -discriminant_root, discriminant_root)
    smaller_multiplier = determinant / jnp.where(larger_multiplier == 0, 1.0, larger_multiplier)
    real_pair = jnp.stack([larger_multiplier, smaller_multiplier]) + 0j
    return jnp.where(discriminant < 0, half_trace + 1j * discriminant_root * jnp.array([1.0, -1.0]), real_pair)

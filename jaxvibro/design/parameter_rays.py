"""Follow an orbit along straight paths in parameter space, and set up the special point that ends a path.

Newton's method continues the impacts of the orbit in steps along each path. After each step, test functions detect four
events: the equations become singular (fold), the period doubles (flip), a flight grazes a wall (touch), or an impact
has zero speed. A step that fails or in which an event occurs is repeated with half its length, until the end of the
path is known to `END_TOLERANCE`. If the last step fails, the path is considered to end in a fold.
"""

from enum import IntEnum
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import ArrayLike, Bool, Float

from continuation.array_type import Array
from continuation.implicit_function import make_lane_loop_function
from continuation.newton import OK, SINGULAR, NewtonSolution, newton, solve

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..flight import flow, further_drive_terms
from ..orbits import cyclic_system, flight_clearance, impact_equations
from ..orbits.impact_equations import MAX_TIME_CHANGE, ImpactSequence
from ..orbits.orbit import impacts_as_points, is_same_orbit, mirror_points
from ..problem import soft_wall_grazing
from ..scene.scene_properties import is_symmetric
from .special_point_equations import SpecialPointEquations, grazing_equations, null_vector_at

MIN_STEPS = 32.0  # smallest number of steps of a path
END_TOLERANCE = 2.0**-10  # accuracy of the end, relative to the path
MAX_CHANGE = 0.1  # relative to 1 + the largest unknown: largest change in a step


class RayEnd(IntEnum):
    """Event that ends a path; NONE if the orbit was continued to the end of the path."""

    NONE = 0
    FOLD = 1
    FLIP = 2
    TOUCH = 3
    ZERO_SPEED = 4


class RayResult(NamedTuple):
    """Result of continuing an orbit along a path.

    Attributes
    ----------
    fraction : array_like
        Fraction of the path up to which the orbit was continued.
    unknowns : array_like
        Times, then speeds, of the orbit at this fraction; x and v at the section if the orbit has no impacts.
    end : array_like
        `RayEnd` just beyond this fraction.
    row : array_like
        Row of the impact before the flight that grazes (TOUCH), or of the impact with zero speed.
    wall : array_like
        Index of the wall that the flight grazes.
    time : array_like
        Time of the grazing since the phase of the section.
    """

    fraction: Float[ArrayLike, "*ways"]
    unknowns: Float[ArrayLike, "*ways unknowns"]
    end: Float[ArrayLike, "*ways"]
    row: Float[ArrayLike, "*ways"]
    wall: Float[ArrayLike, "*ways"]
    time: Float[ArrayLike, "*ways"]


class _TestsAndEvent(NamedTuple):
    """Test functions of an orbit, and the event that they detect.

    Attributes
    ----------
    fold, flip : jax.Array
        Determinants that vanish at a fold and at a period doubling.
    min_clearance : jax.Array
        Smallest clearance of a flight from a wall.
    end : jax.Array
        `RayEnd` of the event; NONE if there is no event.
    row, wall, time : jax.Array
        Row, index of the wall and time of this event, as in `RayResult`.
    """

    fold: Float[Array, ""]
    flip: Float[Array, ""]
    min_clearance: Float[Array, ""]
    end: Float[Array, ""]
    row: Float[Array, ""]
    wall: Float[Array, ""]
    time: Float[Array, ""]


@partial(jax.jit, static_argnums=0)
def follow_rays(scene_treedef, sequence, scene_vector, scene_displacements):
    """Continue an orbit along straight paths; return the `RayResult` of each path.

    Parameters
    ----------
    scene_treedef : jax.tree_util.PyTreeDef
        Tree structure of the scene.
    sequence : ImpactSequence
        Impacts of the orbit without empty rows. With one orbit per path, the first axis is that of the paths.
    scene_vector : jax.Array
        Numbers of the scene of the orbit. Array of shape (numbers,), or (paths, numbers) with one orbit per path.
    scene_displacements : jax.Array
        Change of these numbers at the end of each path. Array of shape (paths, numbers).

    Returns
    -------
    RayResult
        Result for each path.
    """
    follow_path = make_lane_loop_function(partial(_follow_ray, scene_treedef), call_as_kernel)
    orbit_axis = 0 if jnp.ndim(scene_vector) > 1 else None
    return jax.vmap(follow_path, in_axes=(orbit_axis, orbit_axis, 0))(sequence, scene_vector, scene_displacements)


def _follow_ray(scene_treedef, sequence, scene_vector, scene_displacement):
    """Continue an orbit along one path; return the `RayResult`."""
    zero = jnp.zeros((), scene_vector.dtype)

    def coeffs_at(fraction):
        return flow_coefficients(scene_treedef.unflatten(list(scene_vector + fraction * scene_displacement)))

    if len(sequence.sides):
        start_unknowns = jnp.concatenate([sequence.times, sequence.speeds])
    else:
        start_unknowns = _solve_impact_free_orbit(coeffs_at(zero), sequence).unknowns
    start_tests = _evaluate_tests(coeffs_at(zero), sequence, start_unknowns)._replace(end=zero)
    ray_state = _RayState(
        zero, zero + 1.0 / MIN_STEPS, start_unknowns, 0.0 * start_unknowns, start_tests, is_done=zero > 0
    )
    ray_state = lax.while_loop(
        lambda ray_state: ~ray_state.is_done, partial(_advance_along_ray, coeffs_at, sequence), ray_state
    )
    tests = ray_state.tests
    ray_end = jnp.where(ray_state.fraction >= 1.0, 0.0, tests.end)
    return RayResult(ray_state.fraction, ray_state.unknowns, ray_end, tests.row, tests.wall, tests.time)


class _RayState(NamedTuple):
    """State of the continuation along a path.

    Attributes
    ----------
    fraction, fraction_step : array
        Fraction of the path, and its next step.
    unknowns, unknowns_rate : array
        Unknowns of the orbit, and their change per fraction of the path.
    tests : _TestsAndEvent
        Test functions at the fraction; the event is that of the last attempt at a step.
    is_done : array of bool
        True at the end of the path or at an event.
    """

    fraction: Float[jax.Array, ""]
    fraction_step: Float[jax.Array, ""]
    unknowns: Float[jax.Array, " unknowns"]
    unknowns_rate: Float[jax.Array, " unknowns"]
    tests: _TestsAndEvent
    is_done: Bool[jax.Array, ""]


def _advance_along_ray(coeffs_at, sequence, ray_state):
    """Take a step along the path, or halve it if there is an event within it."""
    fraction, fraction_step, unknowns, unknowns_rate, tests, _ = ray_state
    next_fraction = jnp.minimum(1.0, fraction + fraction_step)
    coeffs = coeffs_at(next_fraction)
    solution = _solve_orbit(coeffs, sequence, unknowns + (next_fraction - fraction) * unknowns_rate)
    next_tests = _evaluate_tests(coeffs, sequence, solution.unknowns)
    ray_end = _event_of_step(tests, next_tests, solution, unknowns)
    is_event_free = ray_end == RayEnd.NONE
    next_unknowns_rate = (solution.unknowns - unknowns) / jnp.where(
        next_fraction > fraction, next_fraction - fraction, 1.0
    )
    fraction_step = jnp.where(is_event_free, jnp.minimum(1.5 * fraction_step, 1.0 / MIN_STEPS), 0.5 * fraction_step)
    is_done = (~is_event_free & (fraction_step < END_TOLERANCE)) | (is_event_free & (next_fraction >= 1.0))
    values_after_step = (
        next_fraction,
        solution.unknowns,
        next_unknowns_rate,
        next_tests._replace(end=tests.end, row=tests.row, wall=tests.wall, time=tests.time),
    )
    values_at_event = (
        fraction,
        unknowns,
        unknowns_rate,
        tests._replace(end=ray_end, row=next_tests.row, wall=next_tests.wall, time=next_tests.time),
    )
    fraction, unknowns, unknowns_rate, tests = jax.tree.map(
        partial(jnp.where, is_event_free), values_after_step, values_at_event
    )
    return _RayState(fraction, fraction_step, unknowns, unknowns_rate, tests, is_done)


def _event_of_step(tests, next_tests, solution, unknowns):
    """Return the `RayEnd` within a step from `unknowns`; a step that is not accepted counts as a fold."""
    max_unknowns_change = jnp.max(abs(solution.unknowns - unknowns))
    is_step_accepted = (solution.status == OK) & (max_unknowns_change <= MAX_CHANGE * (1.0 + jnp.max(abs(unknowns))))
    ray_end = jnp.where(
        next_tests.fold * tests.fold < 0,
        RayEnd.FOLD,
        jnp.where(next_tests.flip * tests.flip < 0, RayEnd.FLIP, next_tests.end),
    )
    return jnp.where(is_step_accepted, ray_end, RayEnd.FOLD)


def _solve_orbit(coeffs, sequence, unknowns):
    """Solve for the orbit with the impacts of `sequence`, starting at `unknowns`; return a `NewtonSolution`."""
    n_impacts = len(sequence.sides)
    if not n_impacts:
        return _solve_impact_free_orbit(coeffs, sequence)

    def orbit_residual(unknowns):
        return impact_equations.residual_and_jacobian(coeffs, sequence_at(sequence, unknowns))

    max_newton_changes = jnp.where(jnp.arange(len(unknowns)) < n_impacts, MAX_TIME_CHANGE, jnp.inf)
    return newton(
        orbit_residual,
        unknowns,
        max_newton_changes * coeffs.period,
        max_steps=8,
        solve=impact_equations.solve_cyclic,
    )


def _evaluate_tests(coeffs, sequence, unknowns):
    """Return the `_TestsAndEvent` of the orbit with the impacts of `sequence` and these unknowns."""
    if len(sequence.sides):
        return _tests_with_impacts(coeffs, sequence_at(sequence, unknowns))
    return _tests_without_impacts(coeffs, sequence, unknowns)


def sequence_at(sequence, unknowns):
    """Return the `ImpactSequence` with these times and speeds."""
    return sequence._replace(times=unknowns[: len(sequence.sides)], speeds=unknowns[len(sequence.sides) :])


def bifurcation_test_values(coeffs, sequence, unknowns):
    """Return the values of the four test functions of an orbit. Array of shape (4,).

    The test functions are the determinants that vanish at a fold and at a period doubling, the smallest clearance, and
    the smallest impact speed. Without impacts, the values are 1, 1, the smallest clearance and infinity.
    """
    orbit_tests = _evaluate_tests(coeffs, sequence, unknowns)
    min_speed = jnp.min(sequence.speeds) if len(sequence.sides) else jnp.inf
    return jnp.stack(
        [orbit_tests.fold, orbit_tests.flip, orbit_tests.min_clearance, min_speed + 0.0 * orbit_tests.fold]
    )


def impact_free_state(coeffs, sequence):
    """Return x and v, at the section, of the periodic motion without impacts."""
    return _solve_impact_free_orbit(coeffs, sequence).unknowns


def _tests_with_impacts(coeffs, sequence):
    flights = impact_equations.compute_flights(coeffs, sequence)
    fold_test, flip_test = cyclic_system.closure_determinants(
        cyclic_system.assemble_block_matrix(impact_equations.residual_and_jacobian(coeffs, sequence, flights)[1])
    )
    start_times = (
        sequence.times
        if flights.contact_map.contact_time is None
        else sequence.times + flights.contact_map.contact_time
    )
    min_clearance, row, wall, time = _closest_approach(
        *flight_clearance.turning_clearances(coeffs, flights, flight_clearance.sample_count(coeffs, flights)),
        start_times,
    )
    has_zero_speed = jnp.any(sequence.speeds <= 0)
    ray_end = jnp.where(has_zero_speed, RayEnd.ZERO_SPEED, jnp.where(min_clearance < 0, RayEnd.TOUCH, RayEnd.NONE))
    return _TestsAndEvent(
        fold_test,
        flip_test,
        min_clearance,
        ray_end + 0.0 * fold_test,
        jnp.where(has_zero_speed, jnp.argmin(sequence.speeds), row) + 0.0 * fold_test,
        wall,
        time,
    )


def _closest_approach(min_clearances, time_to_turning_point, start_times):
    """Return (smallest clearance at a turning point or inf, row of the flight, index of the wall, time)."""
    closest_index = jnp.argmin(min_clearances.reshape(-1)).astype(int)
    row, wall = closest_index // min_clearances.shape[1], closest_index % min_clearances.shape[1]
    min_clearance, time_to_turning_point = (
        lax.dynamic_index_in_dim(array.reshape(-1), closest_index, keepdims=False)
        for array in (min_clearances, time_to_turning_point)
    )
    zero_scalar = 0.0 * time_to_turning_point
    return (
        min_clearance,
        row + zero_scalar,
        wall + zero_scalar,
        time_to_turning_point + lax.dynamic_index_in_dim(start_times, row, keepdims=False),
    )


def _solve_impact_free_orbit(coeffs, sequence):
    """Solve for x and v, at the section, of the periodic motion without impacts; return a `NewtonSolution`."""
    duration = sequence.periods * coeffs.period
    (x_by_x, x_by_v, v_by_v), unit_drive_responses = flow.flight_responses(coeffs.frequency, coeffs.damping, duration)
    drive_phasor = jnp.cos(sequence.phase), jnp.sin(sequence.phase)
    state_from_rest = coeffs.amplitude * (
        drive_phasor[0] * jnp.stack(unit_drive_responses[0]) - drive_phasor[1] * jnp.stack(unit_drive_responses[1])
    )
    if coeffs.drive_terms:
        responses_from_rest = further_drive_terms.term_responses(
            coeffs.drive_terms, coeffs.frequency, coeffs.damping, duration
        )
        state_from_rest = state_from_rest + jnp.stack(
            further_drive_terms.response_to_terms(
                coeffs.drive_terms, responses_from_rest, coeffs.frequency, *drive_phasor
            )
        )
    matrix = jnp.stack([jnp.stack([1.0 - x_by_x, -x_by_v]), jnp.stack([x_by_v, 1.0 - v_by_v])])
    solution = solve(matrix, state_from_rest)
    return NewtonSolution(
        solution.x,
        0.0 * duration,
        0.0 * duration,
        solution.pivot_ratio,
        jnp.where(solution.pivot_ratio > 0, OK, SINGULAR),
    )


def _tests_without_impacts(coeffs, sequence, unknowns):
    flight = flight_clearance.impact_free_flight(coeffs, sequence.phase, sequence.periods, *unknowns)
    min_clearance, row, wall, time = _closest_approach(
        *flight_clearance.impact_free_clearances(coeffs, flight), jnp.zeros(1, unknowns.dtype)
    )
    ones = jnp.ones_like(min_clearance)
    return _TestsAndEvent(
        ones, ones, min_clearance, jnp.where(min_clearance < 0, RayEnd.TOUCH, RayEnd.NONE) + 0.0 * ones, row, wall, time
    )


def impact_sequence_of(orbit):
    """Return the `ImpactSequence` of an orbit without empty rows, with times since phase 0."""
    impacts, scene = orbit.impacts, orbit.scene
    duration = orbit.periods * 2.0 * np.pi / float(scene.frequency)
    times = np.mod(np.asarray(impacts.time) + float(orbit.state.phase) / float(scene.frequency), duration)
    time_order = np.argsort(times)
    columns = (jnp.asarray(np.asarray(column, float)[time_order]) for column in (times, impacts.speed, impacts.side))
    return ImpactSequence(*columns, jnp.zeros(()), jnp.asarray(float(orbit.periods)))


def sample_unit_directions(n_params, n_directions, seed):
    """Return unit vectors of shape (directions, parameters): the positive and negative axes, then random vectors."""
    axis_directions = np.concatenate([np.eye(n_params), -np.eye(n_params)])
    random_normals = np.random.default_rng(seed).normal(size=(n_directions - len(axis_directions), n_params))
    return np.concatenate([axis_directions, random_normals / np.linalg.norm(random_normals, axis=1, keepdims=True)])


SAME_IMPACT_TOLERANCE = 1e-6  # relative to the largest speed: impacts closer than this coincide


def equations_at_ray_end(scene_treedef, sequence, scene_vector, ray):
    """Return (kind, `SpecialPointEquations`, approximate unknowns) of the special point that ends a `RayResult`.

    `sequence` is the `ImpactSequence` of the orbit at the start of the ray. `scene_vector` holds the numbers of the
    scene at the end of the ray. The unknown distance is set to 0. The caller must replace this value.
    """
    unknowns, n_impacts = np.asarray(ray.unknowns), len(sequence.sides)
    columns = [*np.split(unknowns, 2), np.asarray(sequence.sides)] if n_impacts else [np.zeros(0)] * 3
    sequence = sequence._replace(**dict(zip(("times", "speeds", "sides"), map(jnp.asarray, columns), strict=True)))
    if ray.end in (RayEnd.TOUCH, RayEnd.ZERO_SPEED):
        return _grazing_at_ray_end(scene_treedef, sequence, scene_vector, ray)
    kind = "SN" if ray.end == RayEnd.FOLD else "PD"
    if kind == "SN" and _is_symmetric_orbit(scene_treedef, sequence, scene_vector):
        null_vector = null_vector_at(SpecialPointEquations("SN", False, scene_treedef, sequence), scene_vector)
        null_vector_halves = null_vector.reshape(2, 2, -1)  # axes: times or speeds, first or second half, impact
        if np.sum(null_vector_halves[:, 0] * null_vector_halves[:, 1]) < 0:
            kind, n_half_impacts = "SB", n_impacts // 2
            half_columns = {
                "times": sequence.times[:n_half_impacts],
                "speeds": sequence.speeds[:n_half_impacts],
                "sides": sequence.sides[:n_half_impacts],
            }
            sequence = sequence._replace(**half_columns, periods=0.5 * sequence.periods, closure_sign=jnp.asarray(-1.0))
    equations = SpecialPointEquations(kind, False, scene_treedef, sequence)
    null_vector = null_vector_at(equations, scene_vector)
    start_unknowns = np.concatenate([np.asarray(sequence.times), np.asarray(sequence.speeds), [0.0], null_vector])
    return kind, equations, start_unknowns


def _is_symmetric_orbit(scene_treedef, sequence, scene_vector):
    """Check that the orbit is its own mirror image."""
    scene = scene_treedef.unflatten([np.asarray(scene_number) for scene_number in scene_vector])
    if len(sequence.sides) % 2 or not is_symmetric(scene):
        return False
    speeds = np.asarray(sequence.speeds)
    impact_points = impacts_as_points(
        float(scene.frequency), np.asarray(sequence.times), np.asarray(sequence.sides), speeds, speeds.max()
    )
    return is_same_orbit(impact_points, mirror_points(impact_points), SAME_IMPACT_TOLERANCE)


def _grazing_at_ray_end(scene_treedef, sequence, scene_vector, ray):
    """Return ("GR", `SpecialPointEquations`, unknowns) with the grazing contact as an impact with zero speed."""
    scene = scene_treedef.unflatten([np.asarray(number_or_column) for number_or_column in scene_vector])
    times, speeds, sides = (
        np.asarray(number_or_column) for number_or_column in (sequence.times, sequence.speeds, sequence.sides)
    )
    if ray.end == RayEnd.ZERO_SPEED:
        grazing_row, speeds = int(ray.row), np.where(np.arange(len(times)) == int(ray.row), 0.0, speeds)
    else:
        wall_side_codes = [side for side, wall in ((-1.0, scene.left), (1.0, scene.right)) if wall is not None]
        duration = float(sequence.periods) * 2.0 * np.pi / float(scene.frequency)
        grazing_time = float(ray.time) % duration
        grazing_row = int(np.searchsorted(times, grazing_time))
        times, speeds = np.insert(times, grazing_row, grazing_time), np.insert(speeds, grazing_row, 0.0)
        sides = np.insert(sides, grazing_row, wall_side_codes[int(ray.wall)])
    sequence = sequence._replace(times=times, speeds=speeds, sides=sides)
    if soft_wall_grazing.is_smooth_soft_wall(scene, sides[grazing_row]):
        sequence = sequence._replace(grazing=np.eye(len(times))[grazing_row])
    return "GR", *grazing_equations(scene_treedef, sequence, grazing_row, 0.0, float(scene.frequency))

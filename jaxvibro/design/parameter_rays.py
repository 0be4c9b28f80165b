"""Follow an orbit along straight paths in parameter space and detect the event that ends each path.

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
from jaxtyping import ArrayLike, Float

from continuation.array_type import Array
from continuation.implicit_function import make_lane_loop_function
from continuation.linear_solver import solve
from continuation.newton import OK, SINGULAR, NewtonSolution, newton

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..flight import flow, further_drive_terms
from ..orbits import cyclic_system, flight_clearance, impact_equations
from ..orbits.impact_equations import MAX_TIME_CHANGE, ImpactSequence

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
    has_impacts = bool(len(sequence.sides))
    start_unknowns = jnp.concatenate([sequence.times, sequence.speeds])
    max_newton_changes = jnp.where(jnp.arange(len(start_unknowns)) < len(sequence.sides), MAX_TIME_CHANGE, jnp.inf)

    def coeffs_at(fraction):
        return flow_coefficients(scene_treedef.unflatten(list(scene_vector + fraction * scene_displacement)))

    def solve_orbit(coeffs, unknowns):
        if not has_impacts:
            return _solve_impact_free_orbit(coeffs, sequence)

        def orbit_residual(unknowns):
            return impact_equations.residual_and_jacobian(coeffs, sequence_at(sequence, unknowns))

        return newton(
            orbit_residual,
            unknowns,
            max_newton_changes * coeffs.period,
            max_steps=8,
            solve=impact_equations.solve_cyclic,
        )

    def advance_along_path(ray_state):
        fraction, fraction_step, unknowns, unknowns_rate, current_tests, _ = ray_state
        next_fraction = jnp.minimum(1.0, fraction + fraction_step)
        coeffs = coeffs_at(next_fraction)
        solution = solve_orbit(coeffs, unknowns + (next_fraction - fraction) * unknowns_rate)
        max_unknowns_change = jnp.max(abs(solution.unknowns - unknowns))
        next_tests = evaluate_tests(
            coeffs, sequence_at(sequence, solution.unknowns) if has_impacts else sequence, solution.unknowns
        )
        is_step_accepted = (solution.status == OK) & (
            max_unknowns_change <= MAX_CHANGE * (1.0 + jnp.max(abs(unknowns)))
        )
        ray_end = jnp.where(
            next_tests.fold * current_tests.fold < 0,
            RayEnd.FOLD,
            jnp.where(next_tests.flip * current_tests.flip < 0, RayEnd.FLIP, next_tests.end),
        )
        ray_end = jnp.where(is_step_accepted, ray_end, RayEnd.FOLD)
        is_event_free = ray_end == RayEnd.NONE
        next_unknowns_rate = (solution.unknowns - unknowns) / jnp.where(
            next_fraction > fraction, next_fraction - fraction, 1.0
        )
        fraction_step = jnp.where(is_event_free, jnp.minimum(1.5 * fraction_step, 1.0 / MIN_STEPS), 0.5 * fraction_step)
        is_done = (~is_event_free & (fraction_step < END_TOLERANCE)) | (is_event_free & (next_fraction >= 1.0))
        tests_after_step = next_tests._replace(
            end=current_tests.end, row=current_tests.row, wall=current_tests.wall, time=current_tests.time
        )
        tests_at_event = current_tests._replace(
            end=ray_end, row=next_tests.row, wall=next_tests.wall, time=next_tests.time
        )
        current_tests = jax.tree.map(
            lambda value_after_step, value_at_event: jnp.where(is_event_free, value_after_step, value_at_event),
            tests_after_step,
            tests_at_event,
        )
        fraction, unknowns, unknowns_rate = (
            jnp.where(is_event_free, *next_and_current)
            for next_and_current in (
                (next_fraction, fraction),
                (solution.unknowns, unknowns),
                (next_unknowns_rate, unknowns_rate),
            )
        )
        return fraction, fraction_step, unknowns, unknowns_rate, current_tests, is_done

    zero_scalar, evaluate_tests = (
        jnp.zeros((), scene_vector.dtype),
        _tests_with_impacts if has_impacts else _tests_without_impacts,
    )
    start_unknowns = (
        start_unknowns if has_impacts else _solve_impact_free_orbit(coeffs_at(zero_scalar), sequence).unknowns
    )
    current_tests = evaluate_tests(coeffs_at(zero_scalar), sequence, start_unknowns)._replace(end=zero_scalar)
    initial_ray_state = (
        zero_scalar,
        zero_scalar + 1.0 / MIN_STEPS,
        start_unknowns,
        0.0 * start_unknowns,
        current_tests,
        zero_scalar > 0,
    )
    fraction, _, unknowns, _, current_tests, _ = lax.while_loop(
        lambda carry: ~carry[-1], advance_along_path, initial_ray_state
    )
    ray_end = jnp.where(fraction >= 1.0, 0.0, current_tests.end)
    return RayResult(fraction, unknowns, ray_end, current_tests.row, current_tests.wall, current_tests.time)


def sequence_at(sequence, unknowns):
    """Return the `ImpactSequence` with these times and speeds."""
    return sequence._replace(times=unknowns[: len(sequence.sides)], speeds=unknowns[len(sequence.sides) :])


def bifurcation_test_values(coeffs, sequence, unknowns):
    """Return the values of the four test functions of an orbit. Array of shape (4,).

    The test functions are the determinants that vanish at a fold and at a period doubling, the smallest clearance, and
    the smallest impact speed. Without impacts, the values are 1, 1, the smallest clearance and infinity.
    """
    if len(sequence.sides):
        orbit_tests, min_speed = _tests_with_impacts(coeffs, sequence, unknowns), jnp.min(sequence.speeds)
    else:
        orbit_tests, min_speed = _tests_without_impacts(coeffs, sequence, unknowns), jnp.inf
    return jnp.stack(
        [orbit_tests.fold, orbit_tests.flip, orbit_tests.min_clearance, min_speed + 0.0 * orbit_tests.fold]
    )


def impact_free_state(coeffs, sequence):
    """Return x and v, at the section, of the periodic motion without impacts."""
    return _solve_impact_free_orbit(coeffs, sequence).unknowns


def _tests_with_impacts(coeffs, sequence, _):
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

"""Follow an orbit along straight paths in parameter space and find what ends each path.

Newton's method follows the impacts of the orbit in steps along each path. After each step, four test functions are
evaluated: the equations become singular (fold), the period doubles (flip), a flight grazes a wall (touch), or an impact
loses its speed (zero speed). A step that fails is halved. If it becomes too short, the orbit has ended in a fold.
"""

from enum import IntEnum
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import ArrayLike, Float

from continuation.array_type import Array
from continuation.implicit_function import loop_over_lanes
from continuation.linear_solver import solve
from continuation.newton import OK, SINGULAR, NewtonSolution, newton

from ..compiled.kernels import call_as_kernel
from ..flight import drive, flow
from ..flight.coefficients import flow_coefficients
from ..orbits import cyclic_system, flight_clearance, impact_equations
from ..orbits.impact_equations import MAX_TIME_CHANGE

MIN_STEPS = 32.0  # smallest number of steps of a path
END_TOLERANCE = 2.0**-10  # accuracy of the end, relative to the path
MAX_CHANGE = 0.1  # relative to 1 + the largest unknown: largest change in a step


class RayEnd(IntEnum):
    """Event that ends a path; NONE if the orbit was followed along all of it."""

    NONE = 0
    FOLD = 1
    FLIP = 2
    TOUCH = 3
    ZERO_SPEED = 4


class Ray(NamedTuple):
    """Result of following a path.

    `fraction` of the path up to which the orbit is known, with its `unknowns` (times, then speeds). `end` is the
    `RayEnd` just beyond. For a grazing (TOUCH), `row` is the impact before the flight, `wall` the index of the wall,
    and `time` the time since the phase of the section. For an impact with zero speed, `row` is its row.
    """

    fraction: Float[ArrayLike, "*ways"]
    unknowns: Float[ArrayLike, "*ways unknowns"]
    end: Float[ArrayLike, "*ways"]
    row: Float[ArrayLike, "*ways"]
    wall: Float[ArrayLike, "*ways"]
    time: Float[ArrayLike, "*ways"]


class _OrbitTests(NamedTuple):
    """Test functions of an orbit, and the event that ends it."""

    fold: Float[Array, ""]
    flip: Float[Array, ""]
    min_clearance: Float[Array, ""]
    end: Float[Array, ""]
    row: Float[Array, ""]
    wall: Float[Array, ""]
    time: Float[Array, ""]


@partial(jax.jit, static_argnums=0)
def follow_rays(treedef, sequence, scene_vector, displacements):
    """Return the `Ray` of each path from an orbit.

    `sequence` is an `ImpactSequence` without empty rows, in the scene with the numbers `scene_vector`, (numbers,).
    `displacements` are added to these at the end of each path, (paths, numbers). If each path has its own orbit,
    `sequence` and `scene_vector` have the axis of the paths first.
    """
    follow = loop_over_lanes(partial(_follow_ray, treedef), call_as_kernel)
    batch_axis = 0 if jnp.ndim(scene_vector) > 1 else None
    return jax.vmap(follow, in_axes=(batch_axis, batch_axis, 0))(sequence, scene_vector, displacements)


def _follow_ray(treedef, sequence, scene_vector, displacement):
    """Return the `Ray` of one path; without impacts the unknowns are x and v at the section."""
    has_impacts = bool(len(sequence.sides))
    start_unknowns = jnp.concatenate([sequence.times, sequence.speeds])
    max_changes = jnp.where(jnp.arange(len(start_unknowns)) < len(sequence.sides), MAX_TIME_CHANGE, jnp.inf)

    def coeffs_at(fraction):
        return flow_coefficients(treedef.unflatten(list(scene_vector + fraction * displacement)))

    def solve_orbit(coeffs, unknowns):
        if not has_impacts:
            return _solve_free_orbit(coeffs, sequence)

        def residual(unknowns):
            return impact_equations.residual_and_jacobian(coeffs, sequence_at(sequence, unknowns))

        return newton(residual, unknowns, max_changes * coeffs.period, max_steps=8, solve=impact_equations.solve_cyclic)

    def advance(carry):
        fraction, step, unknowns, unknowns_rate, orbit_tests, _ = carry
        next_fraction = jnp.minimum(1.0, fraction + step)
        coeffs = coeffs_at(next_fraction)
        solution = solve_orbit(coeffs, unknowns + (next_fraction - fraction) * unknowns_rate)
        max_change = jnp.max(abs(solution.unknowns - unknowns))
        new_tests = evaluate_tests(
            coeffs, sequence_at(sequence, solution.unknowns) if has_impacts else sequence, solution.unknowns
        )
        is_good = (solution.status == OK) & (max_change <= MAX_CHANGE * (1.0 + jnp.max(abs(unknowns))))
        ray_end = jnp.where(
            new_tests.fold * orbit_tests.fold < 0,
            RayEnd.FOLD,
            jnp.where(new_tests.flip * orbit_tests.flip < 0, RayEnd.FLIP, new_tests.end),
        )
        ray_end = jnp.where(is_good, ray_end, RayEnd.FOLD)
        continues = ray_end == RayEnd.NONE
        new_rate = (solution.unknowns - unknowns) / jnp.where(next_fraction > fraction, next_fraction - fraction, 1.0)
        step = jnp.where(continues, jnp.minimum(1.5 * step, 1.0 / MIN_STEPS), 0.5 * step)
        is_done = (~continues & (step < END_TOLERANCE)) | (continues & (next_fraction >= 1.0))
        advanced_tests = new_tests._replace(
            end=orbit_tests.end, row=orbit_tests.row, wall=orbit_tests.wall, time=orbit_tests.time
        )
        end_tests = orbit_tests._replace(end=ray_end, row=new_tests.row, wall=new_tests.wall, time=new_tests.time)
        orbit_tests = jax.tree.map(lambda a, b: jnp.where(continues, a, b), advanced_tests, end_tests)
        fraction, unknowns, unknowns_rate = (
            jnp.where(continues, *candidates)
            for candidates in ((next_fraction, fraction), (solution.unknowns, unknowns), (new_rate, unknowns_rate))
        )
        return fraction, step, unknowns, unknowns_rate, orbit_tests, is_done

    zero_scalar, evaluate_tests = jnp.zeros((), scene_vector.dtype), _impact_tests if has_impacts else _free_tests
    start_unknowns = start_unknowns if has_impacts else _solve_free_orbit(coeffs_at(zero_scalar), sequence).unknowns
    orbit_tests = evaluate_tests(coeffs_at(zero_scalar), sequence, start_unknowns)._replace(end=zero_scalar)
    carry = (
        zero_scalar,
        zero_scalar + 1.0 / MIN_STEPS,
        start_unknowns,
        0.0 * start_unknowns,
        orbit_tests,
        zero_scalar > 0,
    )
    fraction, _, unknowns, _, orbit_tests, _ = lax.while_loop(lambda carry: ~carry[-1], advance, carry)
    ray_end = jnp.where(fraction >= 1.0, 0.0, orbit_tests.end)
    return Ray(fraction, unknowns, ray_end, orbit_tests.row, orbit_tests.wall, orbit_tests.time)


def sequence_at(sequence, unknowns):
    """Return the `ImpactSequence` with these times and speeds."""
    return sequence._replace(times=unknowns[: len(sequence.sides)], speeds=unknowns[len(sequence.sides) :])


def bifurcation_tests(coeffs, sequence, unknowns):
    """Return four test functions.

    They are the determinants that vanish at a fold and at a period doubling, the smallest clearance, and the smallest
    speed. Without impacts they are 1, 1, the clearance and infinity.
    """
    if len(sequence.sides):
        orbit_tests, min_speed = _impact_tests(coeffs, sequence, unknowns), jnp.min(sequence.speeds)
    else:
        orbit_tests, min_speed = _free_tests(coeffs, sequence, unknowns), jnp.inf
    return jnp.stack(
        [orbit_tests.fold, orbit_tests.flip, orbit_tests.min_clearance, min_speed + 0.0 * orbit_tests.fold]
    )


def free_response(coeffs, sequence):
    """Return x and v at the section of the motion without impacts."""
    return _solve_free_orbit(coeffs, sequence).unknowns


def _impact_tests(coeffs, sequence, _):
    flights = impact_equations.compute_flights(coeffs, sequence)
    fold_test, flip_test = cyclic_system.determinants(
        cyclic_system.assemble_matrix(impact_equations.residual_and_jacobian(coeffs, sequence, flights)[1])
    )
    start_times = (
        sequence.times
        if flights.contact_map.contact_time is None
        else sequence.times + flights.contact_map.contact_time
    )
    min_clearance, row, wall, time = _closest_approach(coeffs, flights, start_times)
    has_zero_speed = jnp.any(sequence.speeds <= 0)
    ray_end = jnp.where(has_zero_speed, RayEnd.ZERO_SPEED, jnp.where(min_clearance < 0, RayEnd.TOUCH, RayEnd.NONE))
    return _OrbitTests(
        fold_test,
        flip_test,
        min_clearance,
        ray_end + 0.0 * fold_test,
        jnp.where(has_zero_speed, jnp.argmin(sequence.speeds), row) + 0.0 * fold_test,
        wall,
        time,
    )


def _closest_approach(coeffs, flights, start_times):
    """Return (smallest clearance at a turning point or inf, row of the flight, index of the wall, time)."""
    min_clearances, turning_time = flight_clearance.turning_clearances(
        coeffs, flights, flight_clearance.sample_count(coeffs, flights)
    )
    flat_index = jnp.argmin(min_clearances.reshape(-1)).astype(int)
    row, wall = flat_index // min_clearances.shape[1], flat_index % min_clearances.shape[1]
    min_clearance, turning_time = (
        lax.dynamic_index_in_dim(array.reshape(-1), flat_index, keepdims=False)
        for array in (min_clearances, turning_time)
    )
    zero_scalar = 0.0 * turning_time
    return (
        min_clearance,
        row + zero_scalar,
        wall + zero_scalar,
        turning_time + lax.dynamic_index_in_dim(start_times, row, keepdims=False),
    )


def _solve_free_orbit(coeffs, sequence):
    """Return the `NewtonSolution` of the motion without impacts."""
    duration = sequence.periods * coeffs.period
    (p00, p01, p11), forced_response = flow.flight_responses(coeffs.frequency, coeffs.damping, duration)
    phasor = jnp.cos(sequence.phase), jnp.sin(sequence.phase)
    forced_state = coeffs.amplitude * (
        phasor[0] * jnp.stack(forced_response[0]) - phasor[1] * jnp.stack(forced_response[1])
    )
    if coeffs.drive_terms:
        term_responses = drive.term_responses(coeffs.drive_terms, coeffs.frequency, coeffs.damping, duration)
        forced_state = forced_state + jnp.stack(
            drive.forced_response(coeffs.drive_terms, term_responses, coeffs.frequency, *phasor)
        )
    matrix = jnp.stack([jnp.stack([1.0 - p00, -p01]), jnp.stack([p01, 1.0 - p11])])
    solution = solve(matrix, forced_state)
    return NewtonSolution(
        solution.x,
        0.0 * duration,
        0.0 * duration,
        solution.pivot_ratio,
        jnp.where(solution.pivot_ratio > 0, OK, SINGULAR),
    )


def _free_tests(coeffs, sequence, unknowns):
    flight = flight_clearance.impact_free_flight(coeffs, sequence.phase, sequence.periods, *unknowns)
    min_clearance, row, wall, time = _closest_approach(coeffs, flight, jnp.zeros(1, unknowns.dtype))
    ones = jnp.ones_like(min_clearance)
    return _OrbitTests(
        ones, ones, min_clearance, jnp.where(min_clearance < 0, RayEnd.TOUCH, RayEnd.NONE) + 0.0 * ones, row, wall, time
    )

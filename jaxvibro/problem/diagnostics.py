"""Compute diagnostics for each point of a branch: clearances, multipliers, test functions and states at the section."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation.array_type import Array
from continuation.persistent_jit import FAST_COMPILE, persistent_jit

from ..compiled.kernels import call_as_kernel
from ..flight import flow_matrix
from ..flight.coefficients import flow_coefficients
from ..flight.flows import flow_of
from ..orbits import chatter_and_release, cyclic_system, flight_clearance, impact_equations
from ..orbits.wall_at_contact import wall_derivatives
from .equations import scene_at, sequence_at

POINTS_PER_CALL = 144  # block size of the compiled call


class Diagnostics(NamedTuple):
    """Diagnostics of many points.

    Attributes
    ----------
    clearance : ndarray
        Least distance from each wall at the turning points of each flight, array of shape (points, flights, walls).
    turning_time : ndarray
        Time of that turning point since the start of the flight, array of shape (points, flights, walls).
    trace, determinant : ndarray
        Trace and determinant of the monodromy matrix, arrays of shape (points,).
    x, v : ndarray
        State at the phase of the section, arrays of shape (points, periods).
    fold_test, flip_test : ndarray
        Determinants that vanish where the branch folds and where the period doubles, arrays of shape (points,).
    sticking_time : ndarray
        Duration of the sticking phase, as in `chatter_and_release.ChatterOutcome`; inf where nothing sticks. Array of
        shape (points, rows).
    min_contact_force : ndarray
        Least contact force, as in `chatter_and_release.ChatterOutcome` and `chatter_and_release.lift_off_force`, array
        of shape (points, rows).
    hop_margin : ndarray
        As in `chatter_and_release.ChatterOutcome`, array of shape (points, rows).
    """

    clearance: Float[Array, "*points flights walls"]
    turning_time: Float[Array, "*points flights walls"]
    trace: Float[Array, "*points"]
    determinant: Float[Array, "*points"]
    x: Float[Array, "*points periods"]
    v: Float[Array, "*points periods"]
    fold_test: Float[Array, "*points"]
    flip_test: Float[Array, "*points"]
    sticking_time: Float[Array, "*points rows"]
    min_contact_force: Float[Array, "*points rows"]
    hop_margin: Float[Array, "*points rows"]


def diagnose(problem, zs):
    """Compute the diagnostics at many points.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbits.
    zs : ndarray
        Unknowns, array of shape (points, unknowns).

    Returns
    -------
    Diagnostics
        Diagnostics of each point.
    """
    n_periods = int(problem.sequence.periods)
    n_padded_periods = 1 << (n_periods - 1).bit_length()  # so that fewer sizes are compiled
    diagnostics = Diagnostics(*evaluate_points(_diagnostics_kernel(problem), problem, zs, n_padded_periods))
    return diagnostics._replace(x=diagnostics.x[:, :n_periods], v=diagnostics.v[:, :n_periods])


def _diagnostics_kernel(problem):
    """Choose the kernel for orbits without impacts, with impacts, or with sticking."""
    if not len(problem.sequence.sides):
        return _free_diagnostics
    return impact_diagnostics if problem.sequence.releases is None else sticking_diagnostics


def evaluate_points(kernel, problem, zs, n_periods):
    """Evaluate a kernel at many points, in compiled blocks.

    Parameters
    ----------
    kernel : callable
        Function of a module: (problem, z, n_periods) to a tuple of arrays.
    problem : OrbitEquations
        Equations of the orbits.
    zs : ndarray
        Unknowns, array of shape (points, unknowns).
    n_periods : int
        Number of periods passed to the kernel.

    Returns
    -------
    tuple of ndarray
        Results, each with the points along the first axis.
    """
    blocks = []
    for block_start in range(0, len(zs), POINTS_PER_CALL):
        block = zs[block_start : block_start + POINTS_PER_CALL]
        padded_block = np.concatenate([block, np.repeat(block[-1:], POINTS_PER_CALL - len(block), axis=0)])
        evaluate = _evaluate_sticking if kernel is sticking_diagnostics else _evaluate_compiled
        block_result = jax.device_get(evaluate(kernel, problem, padded_block, np.int32(len(block)), n_periods))
        blocks.append([values[: len(block)] for values in block_result])
    return tuple(np.concatenate(values) for values in zip(*blocks, strict=True))


def _evaluate_uncompiled(kernel, problem, zs, n_points, n_periods):
    return _loop_over_points(problem, zs, n_points, jax.jit(kernel, static_argnums=2), n_periods)


@persistent_jit(static_argnums=(0, 4), numpy_first=_evaluate_uncompiled)
def _evaluate_compiled(kernel, problem, zs, n_points, n_periods):
    """Evaluate point by point in one kernel.

    This is as fast as many lanes at once and compiles in half the time.
    """
    return call_as_kernel(_loop_over_points, problem, zs, n_points, kernel=kernel, n_periods=n_periods)


@persistent_jit(static_argnums=(0, 4), compiler_options=FAST_COMPILE)
def _evaluate_sticking(kernel, problem, zs, n_points, n_periods):
    """Evaluate after compilation, because a chatter has too many bounces for Python."""
    return call_as_kernel(_loop_over_points, problem, zs, n_points, kernel=kernel, n_periods=n_periods)


def _loop_over_points(problem, zs, n_points, kernel, n_periods):
    """Evaluate the kernel in a loop over the points."""

    def store_result(k, results):
        result = kernel(problem, lax.dynamic_index_in_dim(zs, k, keepdims=False), n_periods)
        return jax.tree.map(lambda array, entry: lax.dynamic_update_index_in_dim(array, entry, k, 0), results, result)

    result_shapes = jax.eval_shape(lambda problem, z: kernel(problem, z, n_periods), problem, zs[0])
    empty_results = jax.tree.map(lambda leaf: jnp.zeros((len(zs), *leaf.shape), leaf.dtype), result_shapes)
    return lax.fori_loop(0, n_points, store_result, empty_results)


def impact_diagnostics(problem, z, n_periods):
    """Compute the `Diagnostics` at one point of orbits with impacts."""
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    flights = impact_equations.compute_flights(coeffs, sequence)
    x, v = impact_equations.states_at(coeffs, sequence, flights, coeffs.period * jnp.arange(n_periods))
    clearances = flight_clearance.turning_clearances(coeffs, flights, flight_clearance.sample_count(coeffs, flights))
    test_determinants = cyclic_system.determinants(
        cyclic_system.assemble_matrix(impact_equations.residual_and_jacobian(coeffs, sequence, flights)[1])
    )
    trace_and_determinant = impact_equations.monodromy_invariants(coeffs, flights, sequence.sides)
    no_sticking = jnp.full_like(sequence.times, jnp.inf)
    return Diagnostics(
        *clearances,
        *trace_and_determinant,
        x,
        v,
        *test_determinants,
        no_sticking,
        chatter_and_release.lift_off_force(coeffs, sequence, flights),
        no_sticking,
    )


def sticking_diagnostics(problem, z, n_periods):
    """Compute the `Diagnostics` at one point of orbits that stick.

    Their multipliers are zero. A flight that leaves a wall at a release does not graze that wall.
    """
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    flights = impact_equations.compute_flights(coeffs, sequence)
    section_times = coeffs.period * jnp.arange(n_periods)
    chatter_tails = chatter_and_release.chatter_outcomes(coeffs, sequence, flights, section_times)
    n_samples = flight_clearance.sample_count(coeffs, flights)
    clearance, turning_time = flight_clearance.turning_clearances(coeffs, flights, n_samples)
    is_same_wall = jnp.array([wall.sign for wall in coeffs.walls]) == sequence.sides[:, None]
    is_leaving = (
        (sequence.releases[:, None] > 0) & is_same_wall & (turning_time <= 2.0 * (flights.time / n_samples)[:, None])
    )
    clearance = jnp.where(is_leaving, jnp.inf, clearance)
    cyclic_matrix = cyclic_system.assemble_matrix(impact_equations.residual_and_jacobian(coeffs, sequence, flights)[1])
    fold_test, zero = cyclic_system.determinants(cyclic_matrix)[0], jnp.zeros_like(z[0])
    section_state = _state_at_times(coeffs, sequence, flights, chatter_tails, section_times)
    min_contact_force = jnp.minimum(
        chatter_tails.min_contact_force, chatter_and_release.lift_off_force(coeffs, sequence, flights)
    )
    return Diagnostics(
        clearance,
        turning_time,
        zero,
        zero,
        *section_state,
        fold_test,
        1.0 + zero,
        chatter_tails.sticking_time,
        min_contact_force,
        chatter_tails.hop_margin,
    )


def _state_at_times(coeffs, sequence, flights, chatter_tails, section_times):
    """Return (x, v) at times since the phase of the section: in flight, during chatter, or while sticking."""
    x, v = impact_equations.states_at(coeffs, sequence, flights, section_times)
    orbit_duration = sequence.periods * coeffs.period
    elapsed_times = section_times[:, None] - sequence.times
    elapsed_times = jnp.where(
        sequence.sides != 0, elapsed_times - orbit_duration * jnp.floor(elapsed_times / orbit_duration), jnp.inf
    )
    row = jnp.argmin(elapsed_times, axis=1)
    row_tails, precedes_release = chatter_and_release.chatter_starts(coeffs, sequence, flights)
    elapsed_time = jnp.take_along_axis(elapsed_times, row[:, None], 1)[:, 0]
    is_in_chatter, side = precedes_release[row] & (elapsed_time < -row_tails.tau[row]), sequence.sides[row]
    drive_angle = sequence.phase + coeffs.frequency * section_times
    wall_position, wall_velocity, _ = wall_derivatives(coeffs, side, jnp.cos(drive_angle), jnp.sin(drive_angle))
    wall_distance, relative_velocity = (
        table[row, jnp.arange(len(section_times))] for table in (chatter_tails.height, chatter_tails.velocity)
    )
    return jnp.where(is_in_chatter, wall_position - side * wall_distance, x), jnp.where(
        is_in_chatter, wall_velocity - side * relative_velocity, v
    )


def _free_diagnostics(problem, z, n_periods):
    """Compute the `Diagnostics` at one point of orbits without impacts."""
    coeffs, flight = free_flight(problem, z)
    orbit_duration = flight.time / flight_clearance.OVERLAP_FACTOR
    _, monodromy = flow_of(coeffs).fly_with_matrix(
        coeffs, flight.x, flight.v, flight.cosine, flight.sine, orbit_duration
    )
    p00, _, _, p11 = flow_matrix.matrix_by_rows(monodromy)
    x, v = jnp.full(n_periods, z[0]), jnp.full(n_periods, z[1])
    clearances = flight_clearance.turning_clearances(coeffs, flight, flight_clearance.sample_count(coeffs, flight))
    test_determinants = [jnp.ones_like(z[0])] * 2
    no_rows = jnp.zeros(0, z.dtype)
    return Diagnostics(
        *clearances,
        (p00 + p11)[0],
        flow_matrix.determinant(monodromy)[0],
        x,
        v,
        *test_determinants,
        no_rows,
        no_rows,
        no_rows,
    )


def free_flight(problem, z):
    """Return the flow coefficients and the flight of an orbit without impacts.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : Array
        Unknowns (x, v, parameters).

    Returns
    -------
    coeffs : FlowCoefficients
        Coefficients of the flow.
    flight : Flight
        One flight, slightly longer than the periods of the orbit.
    """
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), problem.sequence
    return coeffs, flight_clearance.impact_free_flight(coeffs, sequence.phase, sequence.periods, z[0], z[1])

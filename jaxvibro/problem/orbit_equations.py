"""Equations of a periodic orbit with free parameters, and diagnostics for each point of a branch.

With impacts the unknowns are z = (times, speeds, parameters), see `impact_equations`. Without impacts the unknowns are
z = (x and v at the section, parameters). A branch has one free parameter. A locus (see `locus_equations`) has two.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation.arclength import solve_bordered
from continuation.array_type import Array
from continuation.hostcall import FAST_COMPILE, persistent_jit
from continuation.problem import Problem, TestFunction

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients, fly_with_matrix
from ..contact.wall_at_contact import wall_derivatives
from ..flight import flow_matrix
from ..orbits import chatter_and_release, cyclic_system, flight_clearance, impact_equations
from ..scene.state import Contact

MIN_SPEED_RATIO = 1e-10  # relative to the drive's amplitudes, per t; smaller speeds count as zero


def mark_impact_rows(sequence):
    """Mark the rows of a sequence that are impacts, neither empty nor releases.

    Parameters
    ----------
    sequence : ImpactSequence
        Sequence.

    Returns
    -------
    ndarray
        Boolean array of shape (rows,).
    """
    is_impact = np.asarray(sequence.sides != 0)
    return is_impact if sequence.releases is None else is_impact & (np.asarray(sequence.releases) == 0)


def sides_with_release_codes(sequence):
    """Return the sides of the rows, multiplied by 2 or 3 for releases.

    `OrbitProblem.with_impacts` takes sides in this form.

    Parameters
    ----------
    sequence : ImpactSequence
        Sequence.

    Returns
    -------
    ndarray
        Array of shape (rows,).
    """
    return sequence.sides if sequence.releases is None else sequence.sides * (1.0 + sequence.releases)


def are_releases(side_codes):
    """Mark the rows that are releases.

    Parameters
    ----------
    side_codes : array_like
        Sides from `sides_with_release_codes`.

    Returns
    -------
    ndarray
        Boolean array of the same shape.
    """
    return abs(np.asarray(side_codes)) >= Contact.STUCK


def scene_at(problem, z):
    """Return the scene with the free parameters from z.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : Array
        Unknowns.

    Returns
    -------
    Scene
        Scene.
    """
    parameter_values = z[2 * len(problem.sequence.sides) or 2 :]

    def substitute_parameter(leaf, parameter_number):
        for parameter_index in range(len(parameter_values)):
            leaf = jnp.where(parameter_number == parameter_index + 1, parameter_values[parameter_index], leaf)
        return leaf

    return jax.tree.map(substitute_parameter, problem.scene, problem.parameter_marks)


def free_or_fixed_value(problem, z, parameter_mark, fixed_value):
    """Return the entry of z for a free parameter, whose mark is positive, or else the fixed value."""
    mark_number = int(parameter_mark)
    return float(z[(2 * len(problem.sequence.sides) or 2) + mark_number - 1] if mark_number else fixed_value)


def sequence_at(problem, z):
    """Return the impact sequence with the times and speeds from z.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : Array
        Unknowns.

    Returns
    -------
    ImpactSequence
        Sequence.
    """
    n_rows = len(problem.sequence.sides)
    return problem.sequence._replace(times=z[:n_rows], speeds=z[n_rows : 2 * n_rows])


@jax.jit
def evaluate_impact_system(z, problem):
    """Evaluate the equations of an orbit with impacts.

    Parameters
    ----------
    z : Array
        Unknowns.
    problem : OrbitProblem
        Equations of the orbit.

    Returns
    -------
    residual : Array
        Residual F.
    matrix : cyclic_system.CyclicBlockMatrix
        Derivative of the residual with respect to z.
    """
    return evaluate_with_variations(z, problem)[:2]


def evaluate_with_variations(z, problem):
    """Evaluate the equations, and the derivatives of the Jacobian matrix with respect to the parameters.

    Parameters
    ----------
    z : Array
        Unknowns.
    problem : OrbitProblem
        Equations of the orbit.

    Returns
    -------
    residual : Array
        Residual F.
    matrix : cyclic_system.CyclicBlockMatrix
        Derivative of F with respect to z.
    variations : list of cyclic_system.CyclicBlockMatrix
        Derivatives of the diagonal and coupling blocks of `matrix` with respect to each parameter.
    """
    sequence, n_orbit_unknowns = sequence_at(problem, z), 2 * len(problem.sequence.sides)

    def evaluate_at_parameters(parameter_values):
        residual, impact_derivatives = impact_equations.residual_and_jacobian(
            flow_coefficients(scene_at(problem, jnp.concatenate([z[:n_orbit_unknowns], parameter_values]))), sequence
        )
        return residual, cyclic_system.assemble_block_matrix(impact_derivatives)

    parameter_columns, matrix_variations = [], []
    for parameter_direction in np.eye(len(z) - n_orbit_unknowns):
        (residual, cyclic_matrix), (residual_derivative, matrix_derivative) = jax.jvp(
            evaluate_at_parameters, (z[n_orbit_unknowns:],), (jnp.asarray(parameter_direction, z.dtype),)
        )
        parameter_columns.append(residual_derivative)
        matrix_variations.append(
            cyclic_matrix._replace(diagonal=matrix_derivative.diagonal, coupling=matrix_derivative.coupling)
        )
    return (
        residual,
        cyclic_matrix._replace(
            param_blocks=cyclic_system.pair_times_and_speeds(jnp.stack(parameter_columns, 1), len(sequence.sides))
        ),
        matrix_variations,
    )


def _dense_impact_system(z, problem):
    """Return F and dF/dz as dense arrays; the unknowns of empty rows must be zero."""
    residual, cyclic_matrix = evaluate_impact_system(z, problem)
    is_of_empty_row = jnp.tile(problem.sequence.sides == 0, 2)
    return jnp.where(is_of_empty_row, z[: len(residual)], residual), cyclic_system.dense_matrix(cyclic_matrix)


def _flip_matrix(z, problem):
    """Return the matrix that is singular where the period doubles."""
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    return cyclic_system.dense_matrix(
        cyclic_system.assemble_block_matrix(impact_equations.residual_and_jacobian(coeffs, sequence)[1]), -1.0
    )


def _has_positive_speeds(z, problem):
    """Test whether every impact has a positive speed; otherwise the equations are singular."""
    speeds, total_drive_amplitude = (
        z[len(problem.sequence.sides) :][problem.impact_rows],
        abs(problem.parameter_value(z, "amplitude")),
    )
    for term_marks, drive_term in zip(problem.parameter_marks.drive, problem.scene.drive, strict=True):
        total_drive_amplitude += abs(free_or_fixed_value(problem, z, term_marks.amplitude, drive_term.amplitude))
    return bool((speeds > MIN_SPEED_RATIO * total_drive_amplitude).all())


@jax.jit
def _impact_free_system(z, problem):
    """Return F and dF/dz for an orbit without impacts, whose flight over all periods must be periodic."""

    def periodicity_residual(z):
        scene, sequence = scene_at(problem, z), problem.sequence
        orbit_duration = sequence.periods * 2.0 * jnp.pi / scene.frequency
        x, v = fly_with_matrix(scene, z[0], z[1], sequence.phase, orbit_duration)[0]
        residual = jnp.stack([x - z[0], v - z[1]])
        return residual, residual

    jacobian, residual = jax.jacfwd(periodicity_residual, has_aux=True)(z)
    return residual, jacobian


def _impact_free_flip_matrix(z, problem):
    """Return M + I for an orbit without impacts, which is singular where the period doubles."""
    return _impact_free_system(z, problem)[1][:, :2] + 2.0 * jnp.eye(2, dtype=z.dtype)


IMPACT_PROBLEM = Problem(
    evaluate_impact_system,
    cyclic_system.solve_bordered,
    _dense_impact_system,
    (TestFunction("PD", _flip_matrix),),
    call_as_kernel,
    _has_positive_speeds,
)
STICKING_PROBLEM = Problem(
    _dense_impact_system, solve_bordered, _dense_impact_system, (), call_as_kernel, _has_positive_speeds
)  # an orbit that sticks has zero multipliers, so its period does not double
FREE_PROBLEM = Problem(
    _impact_free_system,
    solve_bordered,
    _impact_free_system,
    (TestFunction("PD", _impact_free_flip_matrix),),
    call_as_kernel,
)


POINTS_PER_CALL = 144  # block size of the compiled call


class Diagnostics(NamedTuple):
    """Diagnostics of many points.

    Attributes
    ----------
    clearance : ndarray
        Least distance from each wall at the turning points of each flight, array of shape (points, flights, walls).
    turning_time : ndarray
        Time from the start of the flight to the turning point with the least distance, array of shape (points,
        flights, walls).
    trace, determinant : ndarray
        Trace and determinant of the monodromy matrix, arrays of shape (points,).
    x, v : ndarray
        State at the phase of the section, arrays of shape (points, periods).
    fold_test, flip_test : ndarray
        Determinants that vanish where the branch folds and where the period doubles, arrays of shape (points,). Both
        are 1 for orbits without impacts, and `flip_test` is 1 for orbits that stick.
    sticking_time : ndarray
        Duration of the sticking phase, as in `chatter_and_release.ChatterOutcome`: negative if the mass does
        not stick, inf for rows that no release follows. Array of
        shape (points, rows).
    min_contact_force : ndarray
        Least contact force, as in `chatter_and_release.ChatterOutcome` and
        `chatter_and_release.impact_pull_off_forces`, array of shape (points, rows).
    hop_margin : ndarray
        Positive while all bounces before sticking are short and the contact force is positive, as in
        `chatter_and_release.ChatterOutcome`, array of shape (points, rows).
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
    """Compute the `Diagnostics` at many points.

    Parameters
    ----------
    problem : OrbitProblem
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
    diagnostics = Diagnostics(*evaluate_at_points(_diagnostics_kernel(problem), problem, zs, n_padded_periods))
    return diagnostics._replace(x=diagnostics.x[:, :n_periods], v=diagnostics.v[:, :n_periods])


def _diagnostics_kernel(problem):
    """Choose the kernel for orbits without impacts, with impacts, or with sticking."""
    if not len(problem.sequence.sides):
        return impact_free_diagnostics
    return impact_diagnostics if problem.sequence.releases is None else sticking_diagnostics


def evaluate_at_points(point_kernel, problem, zs, n_periods):
    """Evaluate a kernel at many points, in compiled blocks.

    Parameters
    ----------
    point_kernel : callable
        Module-level function that maps (problem, z, n_periods) to a tuple of arrays.
    problem : OrbitProblem
        Equations of the orbits.
    zs : ndarray
        Unknowns, array of shape (points, unknowns).
    n_periods : int
        Number of periods passed to the kernel.

    Returns
    -------
    tuple of ndarray
        Results with the points along the first axis.
    """
    evaluate_compiled = _evaluate_sticking if point_kernel is sticking_diagnostics else _evaluate_compiled

    def evaluate_block(z_block, n_points):
        return evaluate_compiled(point_kernel, problem, z_block, n_points, n_periods)

    return evaluate_in_blocks(evaluate_block, zs, POINTS_PER_CALL)


def evaluate_in_blocks(evaluate_block, zs, block_size):
    """Evaluate many points in blocks of one size, so that one shape is compiled.

    Parameters
    ----------
    evaluate_block : callable
        Function of (points, number of points) that returns a tuple of arrays with the points along the first axis. The
        further points of the last block are copies.
    zs : ndarray
        Unknowns, array of shape (points, unknowns).
    block_size : int
        Number of points in a block.

    Returns
    -------
    tuple of ndarray
        Results with the points along the first axis.
    """
    block_results = []
    for first_point_index in range(0, len(zs), block_size):
        z_block = zs[first_point_index : first_point_index + block_size]
        padded_block = np.concatenate([z_block, np.repeat(z_block[-1:], block_size - len(z_block), axis=0)])
        block_result = jax.device_get(evaluate_block(padded_block, np.int32(len(z_block))))
        block_results.append([result_arrays[: len(z_block)] for result_arrays in block_result])
    return tuple(np.concatenate(result_arrays) for result_arrays in zip(*block_results, strict=True))


@persistent_jit(static_argnums=(0, 4), numpy_first=True)
def _evaluate_compiled(point_kernel, problem, zs, n_points, n_periods):
    """Evaluate the points in a loop within one kernel.

    The loop is as fast as an evaluation of all points at once and compiles in half the time.
    """
    return call_as_kernel(_loop_over_points, problem, zs, n_points, point_kernel=point_kernel, n_periods=n_periods)


@persistent_jit(static_argnums=(0, 4), compiler_options=FAST_COMPILE)
def _evaluate_sticking(point_kernel, problem, zs, n_points, n_periods):
    """Evaluate orbits that stick; always compiled, because chatter has too many bounces for Python."""
    return call_as_kernel(_loop_over_points, problem, zs, n_points, point_kernel=point_kernel, n_periods=n_periods)


def _loop_over_points(problem, zs, n_points, point_kernel, n_periods):
    """Evaluate the kernel in a loop over the points."""

    def evaluate_point(problem, z):
        return point_kernel(problem, z, n_periods)

    return loop_over_points(evaluate_point, zs, n_points, problem)


def loop_over_points(evaluate_point, zs, n_points, *arguments):
    """Evaluate a traced function of (*arguments, z) at the first `n_points` points; the other results are 0."""
    evaluate_point = jax.jit(evaluate_point)  # traced once for the shapes and the loop

    def store_result(point_index, point_results):
        point_result = evaluate_point(*arguments, lax.dynamic_index_in_dim(zs, point_index, keepdims=False))
        return jax.tree.map(
            lambda array, entry: lax.dynamic_update_index_in_dim(array, entry, point_index, 0),
            point_results,
            point_result,
        )

    result_shapes = jax.eval_shape(evaluate_point, *arguments, zs[0])
    empty_results = jax.tree.map(lambda leaf: jnp.zeros((len(zs), *leaf.shape), leaf.dtype), result_shapes)
    return lax.fori_loop(0, n_points, store_result, empty_results)


def impact_diagnostics(problem, z, n_periods):
    """Compute the `Diagnostics` at one point of orbits with impacts."""
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    flights = impact_equations.compute_flights(coeffs, sequence)
    x, v = impact_equations.states_at(coeffs, sequence, flights, coeffs.period * jnp.arange(n_periods))
    clearances = flight_clearance.turning_clearances(coeffs, flights, flight_clearance.sample_count(coeffs, flights))
    test_determinants = cyclic_system.closure_determinants(
        cyclic_system.assemble_block_matrix(impact_equations.residual_and_jacobian(coeffs, sequence, flights)[1])
    )
    trace_and_determinant = impact_equations.monodromy_invariants(coeffs, flights, sequence.sides)
    infinite_times = jnp.full_like(sequence.times, jnp.inf)
    return Diagnostics(
        *clearances,
        *trace_and_determinant,
        x,
        v,
        *test_determinants,
        infinite_times,
        chatter_and_release.impact_pull_off_forces(coeffs, sequence, flights),
        infinite_times,
    )


def sticking_diagnostics(problem, z, n_periods):
    """Compute the `Diagnostics` at one point of orbits that stick.

    The multipliers of orbits that stick are zero. The start of a flight after a release does not count as a grazing of
    the wall that releases the mass.
    """
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    flights = impact_equations.compute_flights(coeffs, sequence)
    section_times = coeffs.period * jnp.arange(n_periods)
    chatter_outcomes = chatter_and_release.chatter_outcomes(coeffs, sequence, flights, section_times)
    n_samples = flight_clearance.sample_count(coeffs, flights)
    clearance, turning_time = flight_clearance.turning_clearances(coeffs, flights, n_samples)
    is_wall_of_row = jnp.array([wall.sign for wall in coeffs.walls]) == sequence.sides[:, None]
    is_leaving = (
        (sequence.releases[:, None] > 0) & is_wall_of_row & (turning_time <= 2.0 * (flights.time / n_samples)[:, None])
    )
    clearance = jnp.where(is_leaving, jnp.inf, clearance)
    cyclic_matrix = cyclic_system.assemble_block_matrix(
        impact_equations.residual_and_jacobian(coeffs, sequence, flights)[1]
    )
    fold_test, zero_multiplier = cyclic_system.closure_determinants(cyclic_matrix)[0], jnp.zeros_like(z[0])
    section_states = _states_at_sections(coeffs, sequence, flights, chatter_outcomes, section_times)
    min_contact_force = jnp.minimum(
        chatter_outcomes.min_contact_force, chatter_and_release.impact_pull_off_forces(coeffs, sequence, flights)
    )
    return Diagnostics(
        clearance,
        turning_time,
        zero_multiplier,
        zero_multiplier,
        *section_states,
        fold_test,
        1.0 + zero_multiplier,
        chatter_outcomes.sticking_time,
        min_contact_force,
        chatter_outcomes.hop_margin,
    )


def _states_at_sections(coeffs, sequence, flights, chatter_outcomes, section_times):
    """Return (x, v) at times since the phase of the section: in flight, during chatter, or while sticking."""
    x, v = impact_equations.states_at(coeffs, sequence, flights, section_times)
    orbit_duration = sequence.periods * coeffs.period
    times_since_rows = section_times[:, None] - sequence.times
    times_since_rows = jnp.where(
        sequence.sides != 0, times_since_rows - orbit_duration * jnp.floor(times_since_rows / orbit_duration), jnp.inf
    )
    latest_row = jnp.argmin(times_since_rows, axis=1)
    chatter_start, precedes_release = chatter_and_release.chatter_starts(coeffs, sequence, flights)
    time_since_row = jnp.take_along_axis(times_since_rows, latest_row[:, None], 1)[:, 0]
    is_in_chatter, wall_side = (
        precedes_release[latest_row] & (time_since_row < -chatter_start.tau[latest_row]),
        sequence.sides[latest_row],
    )
    drive_angle = sequence.phase + coeffs.frequency * section_times
    wall_position, wall_velocity, _ = wall_derivatives(coeffs, wall_side, jnp.cos(drive_angle), jnp.sin(drive_angle))
    wall_distance, relative_velocity = (
        section_table[latest_row, jnp.arange(len(section_times))]
        for section_table in (chatter_outcomes.height, chatter_outcomes.velocity)
    )
    return jnp.where(is_in_chatter, wall_position - wall_side * wall_distance, x), jnp.where(
        is_in_chatter, wall_velocity - wall_side * relative_velocity, v
    )


def impact_free_diagnostics(problem, z, n_periods):
    """Compute the `Diagnostics` at one point of orbits without impacts."""
    coeffs, flight = flight_without_impacts(problem, z)
    orbit_duration = flight.time / flight_clearance.OVERLAP_FACTOR
    _, monodromy = coeffs.flow.fly_with_matrix(coeffs, flight.x, flight.v, flight.cosine, flight.sine, orbit_duration)
    p00, _, _, p11 = flow_matrix.matrix_by_rows(monodromy)
    x, v = jnp.full(n_periods, z[0]), jnp.full(n_periods, z[1])
    clearances = flight_clearance.impact_free_clearances(coeffs, flight)
    test_determinants = [jnp.ones_like(z[0])] * 2
    empty_rows = jnp.zeros(0, z.dtype)
    return Diagnostics(
        *clearances,
        (p00 + p11)[0],
        flow_matrix.determinant(monodromy)[0],
        x,
        v,
        *test_determinants,
        empty_rows,
        empty_rows,
        empty_rows,
    )


def flight_without_impacts(problem, z):
    """Return the flow coefficients and the flight of an orbit without impacts.

    Parameters
    ----------
    problem : OrbitProblem
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

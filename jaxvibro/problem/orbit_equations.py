"""Equations of a periodic orbit with free parameters of the scene, in the form of `continuation`.

With impacts the unknowns are z = (times, speeds, parameters), see `impact_equations`. Without impacts the unknowns are
z = (x and v at the section, parameters). A branch has one free parameter. A locus (see `locus_equations`) has two.
"""

import jax
import jax.numpy as jnp
import numpy as np

from continuation.arclength import solve_bordered
from continuation.problem import Problem, TestFunction

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients, fly_with_matrix
from ..orbits import cyclic_system, impact_equations
from ..scene.codes import Contact

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

"""Equations of a periodic orbit with free parameters of the scene, as `continuation` takes them.

With impacts the unknowns are z = (times, speeds, parameters), see `impact_equations`. Without impacts they are z = (x,
v at the section, parameters). A branch has one free parameter, a locus (see `extended_system`) has two.
"""

from functools import singledispatch
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from continuation.arclength import solve_bordered
from continuation.problem import Problem, TestFunction

from ..compiled.kernels import call_as_kernel
from ..flight import flow_matrix
from ..flight.coefficients import flow_coefficients
from ..orbits import cyclic_system, impact_equations
from ..orbits.impact_equations import ImpactSequence
from ..scene.codes import Contact
from ..scene.scene import Scene

MIN_SPEED_RATIO = 1e-10  # relative to the drive's amplitudes, per t; smaller speeds count as zero


class OrbitEquations(NamedTuple):
    """Parameters and itinerary that define a branch.

    Attributes
    ----------
    scene : Scene
        Scene; the values of the free parameters are ignored.
    parameter_marks : Scene
        Tree of the scene with 1 at the first free parameter, 2 at the second, and 0 elsewhere.
    sequence : ImpactSequence
        Sides, phase and periods; its times and speeds are ignored.
    """

    scene: Scene
    parameter_marks: Scene
    sequence: ImpactSequence

    @property
    def impact_rows(self) -> Int[np.ndarray, " impacts"]:
        """Rows of impacts, whose speeds must be positive."""
        return np.flatnonzero(are_impacts(self.sequence))

    @property
    def slack(self) -> float:
        """Depth behind a wall that a flight may have where a grazing is intended and located up to rounding."""
        return 0.0


def are_impacts(sequence):
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


def side_codes(sequence):
    """Return the sides of the rows, multiplied by 2 or 3 for releases, as `grazing.padded_sequence` takes them.

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
        Codes from `side_codes`.

    Returns
    -------
    ndarray
        Boolean array of the same shape.
    """
    return abs(np.asarray(side_codes)) >= Contact.STUCK


def scene_at(problem, z):
    """Return the scene with the parameters of z.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : Array
        Unknowns.

    Returns
    -------
    Scene
        Scene.
    """
    values = z[2 * len(problem.sequence.sides) or 2 :]

    def substitute_value(leaf, parameter_number):
        for k in range(len(values)):
            leaf = jnp.where(parameter_number == k + 1, values[k], leaf)
        return leaf

    return jax.tree.map(substitute_value, problem.scene, problem.parameter_marks)


def parameter_at(problem, z, name):
    """Return a parameter of the scene at z as a float.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns.
    name : str
        Name of a field of the scene.

    Returns
    -------
    float
        Value, evaluated on the host.
    """
    return _marked_value(problem, z, getattr(problem.parameter_marks, name), getattr(problem.scene, name))


def _marked_value(problem, z, parameter_number, fixed_value):
    """Return the free parameter of z if the mark names one, else the fixed value."""
    index = int(parameter_number)
    return float(z[(2 * len(problem.sequence.sides) or 2) + index - 1] if index else fixed_value)


def sequence_at(problem, z):
    """Return the impact sequence with the times and speeds of z.

    Parameters
    ----------
    problem : OrbitEquations
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
    problem : OrbitEquations
        Equations of the orbit.

    Returns
    -------
    residual : Array
        Residual F.
    matrix : cyclic_system.CyclicBlockMatrix
        Its derivative with respect to z.
    """
    return evaluate_with_variations(z, problem)[:2]


def evaluate_with_variations(z, problem):
    """Evaluate the equations and the derivatives of their matrix with respect to the parameters.

    Parameters
    ----------
    z : Array
        Unknowns.
    problem : OrbitEquations
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

    def evaluate_at(parameter_values):
        residual, derivatives = impact_equations.residual_and_jacobian(
            flow_coefficients(scene_at(problem, jnp.concatenate([z[:n_orbit_unknowns], parameter_values]))), sequence
        )
        return residual, cyclic_system.assemble_matrix(derivatives)

    parameter_columns, variations = [], []
    for direction in np.eye(len(z) - n_orbit_unknowns):
        (residual, cyclic_matrix), (residual_change, matrix_change) = jax.jvp(
            evaluate_at, (z[n_orbit_unknowns:],), (jnp.asarray(direction, z.dtype),)
        )
        parameter_columns.append(residual_change)
        variations.append(cyclic_matrix._replace(diagonal=matrix_change.diagonal, coupling=matrix_change.coupling))
    return (
        residual,
        cyclic_matrix._replace(
            param_blocks=cyclic_system.pair_rows(jnp.stack(parameter_columns, 1), len(sequence.sides))
        ),
        variations,
    )


def _dense_impact_system(z, problem):
    """Return F and dF/dz as dense arrays; the unknowns of empty rows must be zero."""
    residual, cyclic_matrix = evaluate_impact_system(z, problem)
    is_empty = jnp.tile(problem.sequence.sides == 0, 2)
    return jnp.where(is_empty, z[: len(residual)], residual), cyclic_system.dense_matrix(cyclic_matrix)


def _flip_matrix(z, problem):
    """Return the matrix that is singular where the period doubles."""
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    return cyclic_system.dense_matrix(
        cyclic_system.assemble_matrix(impact_equations.residual_and_jacobian(coeffs, sequence)[1]), -1.0
    )


def _has_positive_speeds(z, problem):
    """Test whether every impact has a speed; else the equations are singular and every test function vanishes."""
    speeds, drive_strength = (
        z[len(problem.sequence.sides) :][problem.impact_rows],
        abs(parameter_at(problem, z, "amplitude")),
    )
    for term_marks, term in zip(problem.parameter_marks.drive, problem.scene.drive, strict=True):
        drive_strength += abs(_marked_value(problem, z, term_marks.amplitude, term.amplitude))
    return bool((speeds > MIN_SPEED_RATIO * drive_strength).all())


@jax.jit
def _free_system(z, problem):
    """Return F and dF/dz for the periodicity of a flight over the periods."""

    def evaluate_residual(z):
        scene, sequence = scene_at(problem, z), problem.sequence
        orbit_duration = sequence.periods * 2.0 * jnp.pi / scene.frequency
        x, v = flow_matrix.fly_with_matrix(scene, z[0], z[1], sequence.phase, orbit_duration)[0]
        residual = jnp.stack([x - z[0], v - z[1]])
        return residual, residual

    jacobian, residual = jax.jacfwd(evaluate_residual, has_aux=True)(z)
    return residual, jacobian


def _free_flip_matrix(z, problem):
    """Return M + I, which is singular where the period doubles."""
    return _free_system(z, problem)[1][:, :2] + 2.0 * jnp.eye(2, dtype=z.dtype)


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
    _free_system, solve_bordered, _free_system, (TestFunction("PD", _free_flip_matrix),), call_as_kernel
)


@singledispatch
def continuation_problem(problem):
    """Return the continuation problem of some equations.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbits; other classes are registered.

    Returns
    -------
    continuation.problem.Problem
        Problem of orbits without impacts, with impacts, or with sticking.
    """
    if not len(problem.sequence.sides):
        return FREE_PROBLEM
    return IMPACT_PROBLEM if problem.sequence.releases is None else STICKING_PROBLEM

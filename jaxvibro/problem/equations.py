"""The equations of a periodic orbit along parameters of the scene, as `continuation` takes them.

An orbit with impacts: z = (times, speeds, parameters), see `impact_equations`. One without: z = (x, v at the section,
parameters). A branch has one parameter, a locus (see `crossing`) two.
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

MIN_SPEED_RATIO = 1e-10  # of the drive's amplitudes, per t: as small a speed is none


class OrbitEquations(NamedTuple):
    """What a branch is of. scene: its numbers but for the parameters; parameter_marks: the scene's tree with 1 where
    the first parameter stands, 2 the second, else 0; sequence: sides, phase and periods; its times and speeds are not
    used."""

    scene: Scene
    parameter_marks: Scene
    sequence: ImpactSequence

    @property
    def impact_rows(self) -> Int[np.ndarray, " impacts"]:
        """The rows of impacts, whose speeds are to be positive."""
        return np.flatnonzero(are_impacts(self.sequence))

    @property
    def slack(self) -> float:
        """How deep behind a wall a flight may be, as a touch that is meant is found with a rounding."""
        return 0.0


def are_impacts(sequence):
    """Which rows of a cycle are impacts, and neither empty nor releases: (rows,)."""
    is_impact = np.asarray(sequence.sides != 0)
    return is_impact if sequence.releases is None else is_impact & (np.asarray(sequence.releases) == 0)


def side_codes(sequence):
    """The sides of a cycle's rows, +-2 or +-3 of releases, as `grazing.padded` takes them: (rows,)."""
    return sequence.sides if sequence.releases is None else sequence.sides * (1.0 + sequence.releases)


def are_releases(side_codes):
    """Which of some rows with these `side_codes` are releases."""
    return abs(np.asarray(side_codes)) >= Contact.STUCK


def scene_at(problem, z):
    """The scene at z."""
    values = z[2 * len(problem.sequence.sides) or 2 :]

    def substitute_value(leaf, parameter_number):
        for k in range(len(values)):
            leaf = jnp.where(parameter_number == k + 1, values[k], leaf)
        return leaf

    return jax.tree.map(substitute_value, problem.scene, problem.parameter_marks)


def parameter_at(problem, z, name):
    """A number of the scene at z, of the scene itself, as the host asks for it: a float."""
    return _marked_value(problem, z, getattr(problem.parameter_marks, name), getattr(problem.scene, name))


def _marked_value(problem, z, parameter_number, fixed_value):
    """A number at z: its own, or the parameter that it is marked as."""
    index = int(parameter_number)
    return float(z[(2 * len(problem.sequence.sides) or 2) + index - 1] if index else fixed_value)


def sequence_at(problem, z):
    """The `ImpactSequence` with these unknowns."""
    n_rows = len(problem.sequence.sides)
    return problem.sequence._replace(times=z[:n_rows], speeds=z[n_rows : 2 * n_rows])


@jax.jit
def evaluate_impact_system(z, problem):
    """(F, its `cyclic_system.Ring`)."""
    return evaluate_with_variations(z, problem)[:2]


def evaluate_with_variations(z, problem):
    """(F, its `cyclic_system.Ring`, how the ring's own and following change with each parameter)."""
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
    """(F, dF/dz); an empty row's unknowns are to be zero."""
    residual, cyclic_matrix = evaluate_impact_system(z, problem)
    is_empty = jnp.tile(problem.sequence.sides == 0, 2)
    return jnp.where(is_empty, z[: len(residual)], residual), cyclic_system.dense_matrix(cyclic_matrix)


def _flip_matrix(z, problem):
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    return cyclic_system.dense_matrix(
        cyclic_system.assemble_matrix(impact_equations.residual_and_jacobian(coeffs, sequence)[1]), -1.0
    )


def _has_positive_speeds(z, problem):
    """Whether each impact has a speed: where one has none, the equations are singular, and every test is zero."""
    speeds, drive_strength = (
        z[len(problem.sequence.sides) :][problem.impact_rows],
        abs(parameter_at(problem, z, "amplitude")),
    )
    for term_marks, term in zip(problem.parameter_marks.drive, problem.scene.drive, strict=True):
        drive_strength += abs(_marked_value(problem, z, term_marks.amplitude, term.amplitude))
    return bool((speeds > MIN_SPEED_RATIO * drive_strength).all())


@jax.jit
def _free_system(z, problem):
    """(F, dF/dz): what a flight over the periods leaves to be periodic."""

    def evaluate_residual(z):
        scene, sequence = scene_at(problem, z), problem.sequence
        orbit_duration = sequence.periods * 2.0 * jnp.pi / scene.frequency
        x, v = flow_matrix.fly_with_matrix(scene, z[0], z[1], sequence.phase, orbit_duration)[0]
        residual = jnp.stack([x - z[0], v - z[1]])
        return residual, residual

    jacobian, residual = jax.jacfwd(evaluate_residual, has_aux=True)(z)
    return residual, jacobian


def _free_flip_matrix(z, problem):
    """M + I, singular where the period doubles."""
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
)  # what forgets does not double
FREE_PROBLEM = Problem(
    _free_system, solve_bordered, _free_system, (TestFunction("PD", _free_flip_matrix),), call_as_kernel
)


@singledispatch
def continuation_problem(problem):
    """The `Problem` of what is followed: of the orbits of an `OrbitEquations`."""
    if not len(problem.sequence.sides):
        return FREE_PROBLEM
    return IMPACT_PROBLEM if problem.sequence.releases is None else STICKING_PROBLEM

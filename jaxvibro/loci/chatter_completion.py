"""The equations of an orbit whose rest just is one, along two parameters: of a CH, or of a release within a rest (RL).

To the orbit's equations comes how far the hops before a release are from those that just end in rest, or how hard the
wall presses where it does least. Both are known by numbers alone, the one by halving: their slopes are differences, by
the times of the row and of its release, its speed and the parameters, as nothing else matters to them.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from continuation.arclength import solve_bordered
from continuation.array_type import Array
from continuation.problem import Problem

from ..compiled.kernels import call_as_kernel
from ..flight.coefficients import flow_coefficients
from ..orbits import chatter_and_release, cyclic_system, impact_equations
from ..orbits.impact_equations import ImpactSequence
from ..problem import grazing_contact
from ..problem.equations import are_impacts, continuation_problem, evaluate_impact_system, scene_at, sequence_at
from ..scene.scene import Scene
from .extended_system import evaluate_by_differences

DIFFERENCE_STEP = 1e-5  # of 1 + abs z: the points of a difference


class ChatterEquations(NamedTuple):
    """What a locus of CH or RL is of. scene, parameter_marks, sequence: as of `OrbitEquations`; row_mask: (rows,), 1 at
    the row whose rest just is one; is_release: 1 where its wall just holds, 0 where its hops just end; slack: as of
    `Grazing`."""

    scene: Scene
    parameter_marks: Scene
    sequence: ImpactSequence
    row_mask: Float[Array, " rows"]
    is_release: Float[Array, ""]
    slack: Float[Array, ""]

    @property
    def impact_rows(self) -> Int[np.ndarray, " impacts"]:
        """The rows of impacts, whose speeds are to be positive."""
        return np.flatnonzero(are_impacts(self.sequence))


def _evaluate_measure(measure, problem, z):
    """What is zero there."""
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    flights = impact_equations.compute_flights(coeffs, sequence)
    tails, _ = chatter_and_release.chatter_starts(coeffs, sequence, flights)
    row = jnp.argmax(problem.row_mask)
    return measure(coeffs, jax.tree.map(lambda leaf: leaf[row], tails))


def _relevant_directions(problem, z):
    """The directions of z that change it: (directions, unknowns)."""
    n_rows = len(problem.row_mask)
    last_row = jnp.sum(problem.sequence.sides != 0) - 1
    row = jnp.argmax(problem.row_mask)
    next_row = jnp.where(row == last_row, 0, row + 1)
    unknown_indices = jnp.stack([row, next_row, n_rows + row, *range(2 * n_rows, len(z))])
    return jnp.eye(len(z), dtype=z.dtype)[unknown_indices]


def _chatter_system(measure, has_soft_walls, z, problem):
    """(F, dF/dz); an empty row's unknowns are to be zero."""
    residual, jacobian = (
        evaluate_by_differences(z, problem)[:2] if has_soft_walls else evaluate_impact_system(z, problem)
    )
    is_empty = jnp.tile(problem.sequence.sides == 0, 2)
    orbit_residual = jnp.where(is_empty, z[: len(is_empty)], residual)
    directions = _relevant_directions(problem, z)
    increments = DIFFERENCE_STEP * (1.0 + abs(directions @ z))
    shifts = increments[:, None] * directions
    measures = jax.vmap(partial(_evaluate_measure, measure, problem))(
        jnp.concatenate([z[None], z + shifts, z - shifts])
    )
    forward_measures, backward_measures = jnp.split(measures[1:], 2)
    measure_gradient = ((forward_measures - backward_measures) / (2.0 * increments)) @ directions
    return jnp.append(orbit_residual, measures[0]), jnp.concatenate(
        [cyclic_system.dense_matrix(jacobian), measure_gradient[None]]
    )


def _make_problem(measure, has_soft_walls):
    system = partial(_chatter_system, measure, has_soft_walls)
    return Problem(system, solve_bordered, system, (), call_as_kernel, compile_at_once=True)


PROBLEMS = {
    (is_release, has_soft_walls): _make_problem(
        chatter_and_release.min_contact_force if is_release else chatter_and_release.excess_speed, has_soft_walls
    )
    for is_release in (False, True)
    for has_soft_walls in (False, True)
}


@continuation_problem.register
def _(problem: ChatterEquations):
    return PROBLEMS[bool(problem.is_release), bool(problem.scene.soft_sides)]


@grazing_contact.sticking_margins.register
def _(problem: ChatterEquations, diagnostics):
    sticking_times, min_contact_forces = (
        np.where(problem.row_mask > 0, np.inf, values)
        for values in (diagnostics.sticking_time, diagnostics.min_contact_force)
    )
    return (
        (diagnostics.sticking_time, min_contact_forces)
        if bool(problem.is_release)
        else (sticking_times, diagnostics.min_contact_force)
    )

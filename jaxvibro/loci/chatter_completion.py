"""Define the equations of an orbit at a limit of its sticking phase (CH or RL) in two parameters.

One equation is added to those of the orbit. At CH, where the mass just comes to rest, it is the excess speed of the
hops before the release. At RL, a release within a sticking phase, it is the minimum of the contact force. Both are
computed as values only, the excess speed by bisection. Their gradients are central differences in the times of the row
and of its release, its speed and the parameters; no other unknown affects them.
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

DIFFERENCE_STEP = 1e-5  # relative to 1 + |z|: step of central differences


class ChatterEquations(NamedTuple):
    """Equations of a locus of CH or RL.

    `scene`, `parameter_marks` and `sequence` are those of `OrbitEquations`. `row_mask` (rows,) is 1 at the row whose
    sticking phase is at its limit. `is_release` is 1 at RL, where the contact force vanishes, and 0 at CH, where the
    hops just end. `slack` is that of `GrazingEquations`.
    """

    scene: Scene
    parameter_marks: Scene
    sequence: ImpactSequence
    row_mask: Float[Array, " rows"]
    is_release: Float[Array, ""]
    slack: Float[Array, ""]

    @property
    def impact_rows(self) -> Int[np.ndarray, " impacts"]:
        """Rows of impacts, whose speeds must be positive."""
        return np.flatnonzero(are_impacts(self.sequence))


def _evaluate_measure(measure, problem, z):
    """Evaluate the measure that vanishes at the limit of the sticking phase."""
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    flights = impact_equations.compute_flights(coeffs, sequence)
    tails, _ = chatter_and_release.chatter_starts(coeffs, sequence, flights)
    row = jnp.argmax(problem.row_mask)
    return measure(coeffs, jax.tree.map(lambda leaf: leaf[row], tails))


def _relevant_directions(problem, z):
    """Return the unit vectors of z that affect the measure. Array of shape (directions, unknowns)."""
    n_rows = len(problem.row_mask)
    last_row = jnp.sum(problem.sequence.sides != 0) - 1
    row = jnp.argmax(problem.row_mask)
    next_row = jnp.where(row == last_row, 0, row + 1)
    unknown_indices = jnp.stack([row, next_row, n_rows + row, *range(2 * n_rows, len(z))])
    return jnp.eye(len(z), dtype=z.dtype)[unknown_indices]


def _chatter_system(measure, has_soft_walls, z, problem):
    """Return (F, dF/dz); the unknowns of an empty row must be zero."""
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

"""The equations of a special point along two parameters of the scene, as `continuation` takes them.

z = (times, speeds, first parameter, second). To the orbit's equations comes one more: an impact has no speed (GR), or
the equations, or those of a change that is the opposite each time round, are singular in times and speeds (SN; PD). A
symmetric orbit is followed by half of it, whose change then closes as itself at SN, as its opposite at SB: both are
regular there, while for the whole orbit a pitchfork is not.

Between soft walls the derivatives by the parameters, and of the slopes, are differences (`evaluate_by_differences`):
the equations are compiled once in place of many times. They only point the way: where a locus lies is decided by the
equations and their first derivatives by times and speeds, which are exact. A touch of a soft wall that is smooth
(`soft_grazing.is_smooth`) is an impact that does nothing, as at speed zero the equations with a stay are singular.

An orbit that rests has no ring: before a release nothing hangs on what was before, and beside a grazing a row alone has
no pivot. Its equations are solved as one matrix.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from continuation.arclength import solve_bordered
from continuation.array_type import Array
from continuation.problem import Problem

from ..compiled.kernels import call_as_kernel
from ..flight.coefficients import flow_coefficients
from ..orbits import cyclic_system, impact_equations
from ..orbits.impact_equations import ImpactSequence
from ..problem import grazing, grazing_contact
from ..problem.equations import (
    OrbitEquations,
    are_impacts,
    continuation_problem,
    evaluate_impact_system,
    evaluate_with_variations,
    scene_at,
    sequence_at,
)
from ..scene.scene import Scene

DIFFERENCE_STEP = 1e-5  # of 1 + abs z: the points of a difference


class GrazingEquations(NamedTuple):
    """What a locus of GR is of. scene, parameter_marks, sequence: as of `OrbitEquations`, the touch being an impact;
    row_mask: (rows,), 1 at the impact without speed; slack: how deep behind a wall a flight may be, as the touch has a
    rounding."""

    scene: Scene
    parameter_marks: Scene
    sequence: ImpactSequence
    row_mask: Float[Array, " rows"]
    slack: Float[Array, ""]

    @property
    def impact_rows(self) -> Int[np.ndarray, " impacts"]:
        """The rows of impacts whose speeds are to be positive."""
        return np.flatnonzero(are_impacts(self.sequence) & (self.row_mask == 0))


@grazing_contact.sticking_margins.register
def _(problem: GrazingEquations, diagnostics):
    return diagnostics.sticking_time, np.where(
        problem.row_mask > 0, np.inf, diagnostics.min_contact_force
    )  # at the touch the wall may begin to press: a DG


class SingularEquations(NamedTuple):
    """What a locus of SN, PD or SB is of. scene, parameter_marks, sequence: as of `OrbitEquations`; multiplier: 1 where
    a change of the orbit comes back as itself, -1 where as its opposite."""

    scene: Scene
    parameter_marks: Scene
    sequence: ImpactSequence
    multiplier: Float[Array, ""]

    impact_rows = OrbitEquations.impact_rows  # type: ignore[misc]  # properties that both have
    slack = OrbitEquations.slack  # type: ignore[misc]  # so too


def _grazing_system(z, problem):
    residual, jacobian = evaluate_impact_system(z, problem)
    speed_selector = _speed_selector(z, problem)
    return _append_value(residual, jnp.sum(speed_selector * z)), (jacobian, speed_selector)


def _speed_selector(z, problem):
    n_rows = len(problem.row_mask)
    return jnp.concatenate([jnp.zeros(n_rows), problem.row_mask, jnp.zeros(len(z) - 2 * n_rows)])


def _singular_system(z, problem):
    """w J v, w and v being J's null vectors where it is singular, over the length of its gradient w J' v: it is then
    about the distance from its zero. As second derivatives commute, that by times and speeds is w times the derivative
    of the equations' slopes along v (Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria, 4.1.2)."""
    residual, jacobian, jacobian_derivatives = evaluate_with_variations(z, problem)
    left_null, right_null = cyclic_system.null_vectors(jacobian, problem.multiplier)
    coeffs, n_unknowns = flow_coefficients(scene_at(problem, z)), len(left_null)

    def jacobian_at(unknowns):
        sequence = sequence_at(problem, unknowns)._replace(multiplier=problem.multiplier)
        return cyclic_system.assemble_matrix(impact_equations.residual_and_jacobian(coeffs, sequence)[1])

    primal, curvature = jax.jvp(jacobian_at, (z[:n_unknowns],), (right_null,))
    curvature = primal._replace(diagonal=curvature.diagonal, coupling=curvature.coupling)
    return _append_singularity(problem, residual, jacobian, jacobian_derivatives, curvature, left_null, right_null)


def _append_singularity(problem, residual, jacobian, jacobian_derivatives, curvature, left_null, right_null):
    """(F with w J v, over the length of its gradient, at its end; their slopes)."""
    parameter_gradient = jnp.stack(
        [
            cyclic_system.bilinear_form(left_null, derivative, right_null, problem.multiplier)
            for derivative in jacobian_derivatives
        ]
    )
    gradient = jnp.concatenate([cyclic_system.left_product(left_null, curvature), parameter_gradient])
    gradient_norm = jnp.sqrt(jnp.sum(gradient * gradient))
    return _append_value(
        residual, cyclic_system.bilinear_form(left_null, jacobian, right_null, problem.multiplier) / gradient_norm
    ), (jacobian, gradient / gradient_norm)


def _soft_grazing_system(z, problem):
    residual, jacobian, _ = evaluate_by_differences(z, problem)
    return _append_value(residual, jnp.sum(_speed_selector(z, problem) * z)), (jacobian, _speed_selector(z, problem))


def _soft_singular_system(z, problem):
    residual, jacobian, (*jacobian_derivatives, curvature) = evaluate_by_differences(z, problem, problem.multiplier)
    return _append_singularity(
        problem,
        residual,
        jacobian,
        jacobian_derivatives,
        curvature,
        *cyclic_system.null_vectors(jacobian, problem.multiplier),
    )


def evaluate_by_differences(z, problem, multiplier=None):
    """(F, its `cyclic_system.Ring`, how the ring's own and following change with each parameter and, where a closing is
    given, along its right null vector), by central differences."""
    n_rows, n_orbit_unknowns = len(problem.sequence.sides), 2 * len(problem.sequence.sides)
    n_null_directions, last_row = int(multiplier is not None), jnp.sum(problem.sequence.sides != 0) - 1
    spacing = DIFFERENCE_STEP * (
        1.0 + jnp.append(abs(z[n_orbit_unknowns:]), jnp.full(n_null_directions, jnp.max(abs(z[:n_orbit_unknowns]))))
    )
    directions = np.concatenate([[[0.0] * len(spacing)], np.eye(len(spacing)), -np.eye(len(spacing))])

    def evaluate_shifted(k, results):
        step = lax.dynamic_index_in_dim(jnp.asarray(directions, z.dtype), k, keepdims=False) * spacing
        shifted_z = jnp.concatenate([z[:n_orbit_unknowns], z[n_orbit_unknowns:] + step[: len(z) - n_orbit_unknowns]])
        coeffs, sequence = flow_coefficients(scene_at(problem, shifted_z)), sequence_at(problem, z)
        if n_null_directions:  # none at the first turn, at z itself, before the null vector is known
            right_null = _normalise(cyclic_system.null_vectors(_cyclic_matrix(results, 0, last_row), multiplier)[1])
            null_shift = jnp.where(step[-1] == 0, 0.0, step[-1] * right_null)
            sequence = impact_equations.unroll_sequence(sequence, coeffs.period, ((null_shift, multiplier),))
        residual, derivatives = impact_equations.residual_and_jacobian(coeffs, sequence)
        matrix, n_extended_rows = cyclic_system.assemble_matrix(derivatives), len(sequence.sides)
        block = matrix._replace(param_blocks=cyclic_system.pair_rows(residual[:, None], n_extended_rows))[:3]
        return [
            lax.dynamic_update_index_in_dim(storage, block[:n_rows], k, 0)
            for storage, block in zip(results, block, strict=True)
        ]

    empty_results = [jnp.zeros((len(directions), n_rows, 2, width), z.dtype) for width in (2, 2, 1)]
    results = lax.fori_loop(0, len(directions), evaluate_shifted, empty_results)
    matrix = _cyclic_matrix(results, 0, last_row)
    residual = jnp.where(jnp.arange(n_rows) <= last_row, matrix.param_blocks[:, :, 0].T, 0.0).reshape(-1)
    matrix_derivatives = [_matrix_derivative(results, k, spacing, last_row) for k in range(len(spacing))]
    parameter_columns = jnp.concatenate(
        [derivative.param_blocks for derivative in matrix_derivatives[: len(z) - n_orbit_unknowns]], 2
    )
    if n_null_directions:
        null_scale = jnp.max(abs(cyclic_system.null_vectors(matrix, multiplier)[1]))
        matrix_derivatives[-1] = jax.tree.map(
            lambda leaf: leaf * null_scale, matrix_derivatives[-1]._replace(last_row=1.0)
        )._replace(last_row=last_row)
    return (
        residual,
        matrix._replace(param_blocks=parameter_columns),
        [derivative._replace(param_blocks=parameter_columns) for derivative in matrix_derivatives],
    )


def _normalise(vector):
    return vector / jnp.max(abs(vector))


def _cyclic_matrix(results, k, last_row):
    """The `Ring` of a turn of `evaluate_by_differences`, by: F."""
    return cyclic_system.CyclicBlockMatrix(*(blocks[k] for blocks in results), last_row)


def _matrix_derivative(results, k, spacing, last_row):
    """How the same change along a way."""
    n_directions = len(spacing)
    return cyclic_system.CyclicBlockMatrix(
        *((blocks[1 + k] - blocks[1 + n_directions + k]) / (2.0 * spacing[k]) for blocks in results), last_row
    )


def _append_value(residual, extra_value):
    return jnp.concatenate([residual, extra_value[None]])


def _solve_bordered(jacobian, border_row, right_sides):
    cyclic_matrix, extra_row = jacobian
    return cyclic_system.solve_bordered(cyclic_matrix, jnp.stack([extra_row, border_row]), right_sides)


def _dense_system(system, z, problem):
    """(F, dF/dz) of one of these systems; an empty row's unknowns are to be zero."""
    residual, (cyclic_matrix, extra_row) = system(z, problem)
    is_empty = jnp.tile(problem.sequence.sides == 0, 2)
    orbit_residual = jnp.where(is_empty, z[: len(is_empty)], residual[:-1])
    return _append_value(orbit_residual, residual[-1]), jnp.concatenate(
        [cyclic_system.dense_matrix(cyclic_matrix), extra_row[None]]
    )


def _make_problem(system):
    return Problem(system, _solve_bordered, partial(_dense_system, system), (), call_as_kernel)


GRAZING, SINGULAR = _make_problem(_grazing_system), _make_problem(_singular_system)
SOFT_GRAZING, SOFT_SINGULAR = _make_problem(_soft_grazing_system), _make_problem(_soft_singular_system)
STICKING_PROBLEMS = {
    has_soft_walls: Problem(
        partial(_dense_system, system), solve_bordered, partial(_dense_system, system), (), call_as_kernel
    )
    for has_soft_walls, system in ((False, _grazing_system), (True, _soft_grazing_system))
}


@grazing.replace_sequence.register
def _(problem: GrazingEquations, sequence, rows):
    row_mask = np.zeros(len(sequence.sides))
    row_mask[: len(rows)] = problem.row_mask[list(rows)]
    has_smooth_grazing = problem.sequence.grazing is not None
    return problem._replace(
        sequence=sequence._replace(grazing=row_mask if has_smooth_grazing else None), row_mask=row_mask
    )


@continuation_problem.register
def _(problem: GrazingEquations):
    has_soft_walls = bool(problem.scene.soft_sides)
    if problem.sequence.releases is not None:
        return STICKING_PROBLEMS[has_soft_walls]
    return SOFT_GRAZING if has_soft_walls else GRAZING


continuation_problem.register(
    SingularEquations, lambda problem: SOFT_SINGULAR if problem.scene.soft_sides else SINGULAR
)

"""Define the equations of a special point in two parameters of the scene as a `continuation` problem.

The unknowns are z = (times, speeds, first parameter, second parameter). One equation is added to those of the orbit: an
impact has zero speed (GR), or the equations are singular in times and speeds for a perturbation that returns as itself
(SN) or as its opposite (PD). A symmetric orbit is represented by one half, whose perturbation returns as itself at SN
and as its opposite at SB. Both are regular points of these equations, while a pitchfork is a singular point of the
equations of the whole orbit.

With soft walls, the derivatives with respect to the parameters, and those of the Jacobian, are central differences
(`evaluate_by_differences`), so that the equations are compiled once instead of many times. They only determine the
search direction: the position of a locus follows from the equations and their first derivatives with respect to times
and speeds, which are exact. A smooth grazing contact with a soft wall (`soft_grazing.is_smooth`) is an impact without
effect, because the equations with a contact phase are singular at zero speed.

The equations of a sticking orbit have no cyclic structure: a release does not depend on what precedes it, and next to a
grazing a single row has no pivot. They are solved as one dense matrix.
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

DIFFERENCE_STEP = 1e-5  # relative to 1 + |z|: step of central differences


class GrazingEquations(NamedTuple):
    """Equations of a locus of GR.

    `scene`, `parameter_marks` and `sequence` are those of `OrbitEquations`, with the grazing contact as an impact.
    `row_mask` (rows,) is 1 at the impact with zero speed. `slack` is the admissible penetration of a flight, which
    allows for rounding at the contact.
    """

    scene: Scene
    parameter_marks: Scene
    sequence: ImpactSequence
    row_mask: Float[Array, " rows"]
    slack: Float[Array, ""]

    @property
    def impact_rows(self) -> Int[np.ndarray, " impacts"]:
        """Rows of impacts, except the grazing contact, whose speeds must be positive."""
        return np.flatnonzero(are_impacts(self.sequence) & (self.row_mask == 0))


@grazing_contact.sticking_margins.register
def _(problem: GrazingEquations, diagnostics):
    return diagnostics.sticking_time, np.where(
        problem.row_mask > 0, np.inf, diagnostics.min_contact_force
    )  # at the grazing contact the contact force may become positive: a DG


class SingularEquations(NamedTuple):
    """Equations of a locus of SN, PD or SB.

    `scene`, `parameter_marks` and `sequence` are those of `OrbitEquations`. `multiplier` is 1 if a perturbation of the
    orbit returns as itself, -1 if it returns as its opposite.
    """

    scene: Scene
    parameter_marks: Scene
    sequence: ImpactSequence
    multiplier: Float[Array, ""]

    impact_rows = OrbitEquations.impact_rows  # type: ignore[misc]  # shared property
    slack = OrbitEquations.slack  # type: ignore[misc]  # shared property


def _grazing_system(z, problem):
    residual, jacobian = evaluate_impact_system(z, problem)
    speed_selector = _speed_selector(z, problem)
    return _append_value(residual, jnp.sum(speed_selector * z)), (jacobian, speed_selector)


def _speed_selector(z, problem):
    n_rows = len(problem.row_mask)
    return jnp.concatenate([jnp.zeros(n_rows), problem.row_mask, jnp.zeros(len(z) - 2 * n_rows)])


def _singular_system(z, problem):
    """Append w J v, divided by the length of its gradient w J' v, to the equations of the orbit.

    w and v are the null vectors of J where it is singular. The appended value is approximately the distance from its
    zero. Second derivatives commute, so that the gradient with respect to times and speeds is w times the derivative of
    the Jacobian along v (Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria, 4.1.2).
    """
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
    """Return F with the normalised w J v appended, and their derivatives."""
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
    """Evaluate the equations and their derivatives by central differences.

    Returns F, its `CyclicBlockMatrix`, and the derivatives of this matrix with respect to each parameter and, if a
    multiplier is given, along its right null vector.
    """
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
        if n_null_directions:  # zero at k = 0, at z itself, where the null vector is not known yet
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
    """Return the `CyclicBlockMatrix` of evaluation k; its parameter block holds F."""
    return cyclic_system.CyclicBlockMatrix(*(blocks[k] for blocks in results), last_row)


def _matrix_derivative(results, k, spacing, last_row):
    """Return the central difference of the matrix along direction k."""
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
    """Return (F, dF/dz) of one of these systems; the unknowns of an empty row must be zero."""
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

"""Equations of loci: special points with two free parameters.

The unknowns are z = (times, speeds, first parameter, second parameter). One equation is added to those of the orbit:

- GR: an impact has zero speed.
- SN: the Jacobian with respect to times and speeds is singular, for a perturbation that returns unchanged.
- PD: the Jacobian is singular, for a perturbation that returns with the opposite sign.

A symmetric orbit is represented by one half. A perturbation of the half returns unchanged at SN and with the opposite
sign at SB. Both are regular points of these equations, whereas an SB is a singular point of the equations of the whole
orbit.

With soft walls, the derivatives with respect to the parameters and the derivatives of the Jacobian are central
differences (`evaluate_by_differences`). The equations are then compiled once instead of many times. These differences
only determine the search direction. The position of a locus follows from the equations and from their exact first
derivatives with respect to times and speeds. A smooth grazing contact with a soft wall
(`soft_wall_grazing.is_smooth_soft_wall`) is an impact without effect, because the equations with a contact phase are
singular at zero speed.

The equations of a sticking orbit have no cyclic structure, because a release does not depend on the preceding impacts.
Next to a grazing, the block of a single row is singular. The equations are therefore solved as one dense matrix.

Define the equations of an orbit at a limit of its sticking phase (CH or RL) in two parameters. One equation is added to
those of the orbit: a measure of the distance from the limit is zero. At CH, where the chatter just completes, the
measure is the excess of the speed of the bounces before the release over the critical speed for sticking, which is
computed by bisection (a time if the restitution is 0; see `excess_speed`). At RL, a release within a sticking phase,
the measure is the minimum of the contact force. Neither measure has exact derivatives. Their gradients are central
differences with respect to the time and speed of the last impact before sticking, the time of the release, and the
parameters. No other unknown affects the measures.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from continuation.arclength import solve_bordered
from continuation.array_type import Array
from continuation.problem import Problem

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..orbits import chatter_and_release, cyclic_system, impact_equations
from ..orbits.flight_clearance import GRAZING_TOLERANCE
from ..orbits.impact_equations import ImpactSequence
from ..problem.orbit_equations import (
    evaluate_impact_system,
    evaluate_with_variations,
    mark_impact_rows,
    scene_at,
    sequence_at,
)
from ..problem.orbit_problem import Condition, OrbitProblem, Rows, select_rows

DIFFERENCE_STEP = 1e-5  # relative to 1 + |z|: step of central differences


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class RowCondition(Condition):
    """Condition on one row of the sequence.

    Attributes
    ----------
    row_mask : Array
        1 at the row, else 0, array of shape (rows,).
    """

    row_mask: Float[Array, " rows"]

    relative_slack = GRAZING_TOLERANCE

    def select_rows(self, rows: Rows, n_rows: int) -> "RowCondition":
        """Return the condition on a sequence that consists of some rows of the present one."""
        return replace(self, row_mask=select_rows(self.row_mask, rows, n_rows))


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class GrazingCondition(RowCondition):
    """Condition of a locus of GR: the impact of one row, the grazing contact, has zero speed."""

    def equations(self, problem: OrbitProblem) -> Problem:
        """Return the equations of the orbits, with the speed of the grazing contact as the last residual."""
        return GRAZING if problem.sequence.releases is None else STICKING_GRAZING

    def impact_rows(self, sequence: ImpactSequence) -> Int[np.ndarray, " impacts"]:
        """Return the rows of the impacts other than the grazing contact. Their speeds must be positive."""
        return np.flatnonzero(mark_impact_rows(sequence) & (self.row_mask == 0))

    def sticking_margins(self, diagnostics: Any) -> tuple[Float[np.ndarray, "*points rows"], ...]:
        """Return the margins; at the grazing contact the contact force may become positive, which is a DG."""
        return diagnostics.sticking_time, np.where(self.row_mask > 0, np.inf, diagnostics.min_contact_force)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class SingularCondition(Condition):
    """Condition of a locus of SN, PD or SB: the Jacobian with respect to times and speeds is singular.

    Attributes
    ----------
    multiplier : Array
        1 if the critical perturbation returns unchanged (SN), -1 if it returns with the opposite sign (PD, SB).
    """

    multiplier: Float[Array, ""]

    def equations(self, problem: OrbitProblem) -> Problem:
        """Return the equations of the orbits, with the distance from the special point as the last residual."""
        return SINGULAR


def evaluate_orbit(z, problem):
    """Evaluate the equations of an orbit; with soft walls the derivatives by the parameters are differences.

    Parameters
    ----------
    z : Array
        Unknowns.
    problem : OrbitProblem
        Problem of the orbit.

    Returns
    -------
    residual : Array
        Residual F.
    matrix : cyclic_system.CyclicBlockMatrix
        Derivative of F with respect to z.
    """
    return evaluate_by_differences(z, problem)[:2] if problem.scene.soft_sides else evaluate_impact_system(z, problem)


def _grazing_system(z, problem):
    residual, jacobian = evaluate_orbit(z, problem)
    zero_speed_selector = _zero_speed_selector(z, problem)
    return _append_value(residual, jnp.sum(zero_speed_selector * z)), (jacobian, zero_speed_selector)


def _zero_speed_selector(z, problem):
    n_rows = len(problem.condition.row_mask)
    return jnp.concatenate([jnp.zeros(n_rows), problem.condition.row_mask, jnp.zeros(len(z) - 2 * n_rows)])


def _singular_system(z, problem):
    """Append w J v, divided by the length of its gradient w J' v, to the equations of the orbit.

    J is the Jacobian with respect to times and speeds. w and v are its left and right null vectors at the special
    point, and approximate them elsewhere. The appended value is approximately the distance from the special point.
    Second derivatives commute. The gradient with respect to times and speeds is therefore w times the derivative of J
    along v (Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria, 4.1.2).
    """
    multiplier = problem.condition.multiplier
    if problem.scene.soft_sides:
        residual, jacobian, (*jacobian_param_slopes, jacobian_along_null) = evaluate_by_differences(
            z, problem, multiplier
        )
        left_null, right_null = cyclic_system.null_vectors(jacobian, multiplier)
    else:
        residual, jacobian, jacobian_param_slopes = evaluate_with_variations(z, problem)
        left_null, right_null = cyclic_system.null_vectors(jacobian, multiplier)
        jacobian_along_null = _derivative_along(z, problem, right_null)
    parameter_gradient = jnp.stack(
        [
            cyclic_system.bilinear_form(left_null, jacobian_param_slope, right_null, multiplier)
            for jacobian_param_slope in jacobian_param_slopes
        ]
    )
    singularity_gradient = jnp.concatenate(
        [cyclic_system.left_product(left_null, jacobian_along_null), parameter_gradient]
    )
    gradient_norm = jnp.sqrt(jnp.sum(singularity_gradient * singularity_gradient))
    return _append_value(
        residual, cyclic_system.bilinear_form(left_null, jacobian, right_null, multiplier) / gradient_norm
    ), (jacobian, singularity_gradient / gradient_norm)


def _derivative_along(z, problem, direction):
    """Return the derivative of the Jacobian with respect to times and speeds along a direction of these."""
    coeffs, n_unknowns = flow_coefficients(scene_at(problem, z)), len(direction)

    def jacobian_at(unknowns):
        sequence = sequence_at(problem, unknowns)._replace(multiplier=problem.condition.multiplier)
        return cyclic_system.assemble_block_matrix(impact_equations.residual_and_jacobian(coeffs, sequence)[1])

    cyclic_jacobian, jacobian_derivative = jax.jvp(jacobian_at, (z[:n_unknowns],), (direction,))
    return cyclic_jacobian._replace(diagonal=jacobian_derivative.diagonal, coupling=jacobian_derivative.coupling)


def evaluate_by_differences(z, problem, multiplier=None):
    """Evaluate the equations, and differentiate them and their Jacobian by central differences.

    Returns F, its Jacobian as a `CyclicBlockMatrix`, and a list of derivatives of this matrix. The list holds the
    derivative with respect to each parameter. If a multiplier is given, the last entry is the derivative along the
    right null vector.
    """
    n_rows, n_orbit_unknowns = len(problem.sequence.sides), 2 * len(problem.sequence.sides)
    n_null_directions, last_row = int(multiplier is not None), jnp.sum(problem.sequence.sides != 0) - 1
    difference_steps = DIFFERENCE_STEP * (
        1.0 + jnp.append(abs(z[n_orbit_unknowns:]), jnp.full(n_null_directions, jnp.max(abs(z[:n_orbit_unknowns]))))
    )
    shift_directions = np.concatenate(
        [[[0.0] * len(difference_steps)], np.eye(len(difference_steps)), -np.eye(len(difference_steps))]
    )

    def evaluate_shifted(shift_index, block_arrays):
        signed_steps = (
            lax.dynamic_index_in_dim(jnp.asarray(shift_directions, z.dtype), shift_index, keepdims=False)
            * difference_steps
        )
        shifted_z = jnp.concatenate(
            [z[:n_orbit_unknowns], z[n_orbit_unknowns:] + signed_steps[: len(z) - n_orbit_unknowns]]
        )
        coeffs, sequence = flow_coefficients(scene_at(problem, shifted_z)), sequence_at(problem, z)
        if n_null_directions:  # zero at k = 0, at z itself, where the null vector is not known yet
            right_null = cyclic_system.null_vectors(_cyclic_matrix_at(block_arrays, last_row), multiplier)[1]
            unit_null = right_null / jnp.max(abs(right_null))
            null_shift = jnp.where(signed_steps[-1] == 0, 0.0, signed_steps[-1] * unit_null)
            sequence = impact_equations.append_first_impact(sequence, coeffs.period, ((null_shift, multiplier),))
        residual, residual_derivatives = impact_equations.residual_and_jacobian(coeffs, sequence)
        cyclic_matrix, n_unrolled_rows = cyclic_system.assemble_block_matrix(residual_derivatives), len(sequence.sides)
        block = cyclic_matrix._replace(
            param_blocks=cyclic_system.pair_times_and_speeds(residual[:, None], n_unrolled_rows)
        )[:3]
        return [
            lax.dynamic_update_index_in_dim(block_array, block[:n_rows], shift_index, 0)
            for block_array, block in zip(block_arrays, block, strict=True)
        ]

    empty_block_arrays = [
        jnp.zeros((len(shift_directions), n_rows, 2, block_width), z.dtype) for block_width in (2, 2, 1)
    ]
    block_arrays = lax.fori_loop(0, len(shift_directions), evaluate_shifted, empty_block_arrays)
    cyclic_matrix = _cyclic_matrix_at(block_arrays, last_row)
    residual = jnp.where(jnp.arange(n_rows) <= last_row, cyclic_matrix.param_blocks[:, :, 0].T, 0.0).reshape(-1)
    cyclic_derivatives = [
        _cyclic_derivative(block_arrays, direction_index, difference_steps, last_row)
        for direction_index in range(len(difference_steps))
    ]
    parameter_columns = jnp.concatenate(
        [derivative.param_blocks for derivative in cyclic_derivatives[: len(z) - n_orbit_unknowns]], 2
    )
    if n_null_directions:
        largest_null_component = jnp.max(abs(cyclic_system.null_vectors(cyclic_matrix, multiplier)[1]))
        cyclic_derivatives[-1] = jax.tree.map(
            lambda leaf: leaf * largest_null_component, cyclic_derivatives[-1]._replace(last_row=1.0)
        )._replace(last_row=last_row)
    return (
        residual,
        cyclic_matrix._replace(param_blocks=parameter_columns),
        [derivative._replace(param_blocks=parameter_columns) for derivative in cyclic_derivatives],
    )


def _cyclic_matrix_at(block_arrays, last_row):
    """Return the `CyclicBlockMatrix` of one evaluation. Its parameter block holds F."""
    return cyclic_system.CyclicBlockMatrix(*(blocks[0] for blocks in block_arrays), last_row)


def _cyclic_derivative(block_arrays, direction_index, difference_steps, last_row):
    """Return the central difference of the matrix along one direction."""
    n_directions = len(difference_steps)
    return cyclic_system.CyclicBlockMatrix(
        *(
            (blocks[1 + direction_index] - blocks[1 + n_directions + direction_index])
            / (2.0 * difference_steps[direction_index])
            for blocks in block_arrays
        ),
        last_row,
    )


def _append_value(residual, appended_value):
    return jnp.concatenate([residual, appended_value[None]])


def _solve_bordered(jacobian, border_row, right_sides):
    cyclic_matrix, appended_row = jacobian
    return cyclic_system.solve_bordered(cyclic_matrix, jnp.stack([appended_row, border_row]), right_sides)


def _dense_system(cyclic_system_function, z, problem):
    """Return (F, dF/dz) of a grazing or singular system, with dF/dz as a dense matrix.

    For an empty row, F holds its unknowns, which must vanish.
    """
    residual, (cyclic_matrix, appended_row) = cyclic_system_function(z, problem)
    is_empty_unknown = jnp.tile(problem.sequence.sides == 0, 2)
    orbit_residual = jnp.where(is_empty_unknown, z[: len(is_empty_unknown)], residual[:-1])
    return _append_value(orbit_residual, residual[-1]), jnp.concatenate(
        [cyclic_system.dense_matrix(cyclic_matrix), appended_row[None]]
    )


def _make_problem(cyclic_system_function):
    return Problem(
        cyclic_system_function, _solve_bordered, partial(_dense_system, cyclic_system_function), (), call_as_kernel
    )


GRAZING, SINGULAR = _make_problem(_grazing_system), _make_problem(_singular_system)
STICKING_GRAZING = Problem(GRAZING.dense_function, solve_bordered, GRAZING.dense_function, (), call_as_kernel)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class StickingLimitCondition(RowCondition):
    """Condition of a locus of CH or RL: the sticking phase of one row is at its limit.

    Attributes
    ----------
    is_release : Array
        1 at RL, where the contact force vanishes; 0 at CH, where the mass only just sticks.
    """

    is_release: Float[Array, ""]

    def equations(self, problem: OrbitProblem) -> Problem:
        """Return the equations of the orbits, with the distance from the limit as the last residual."""
        return RELEASE if bool(self.is_release) else CHATTER

    def sticking_margins(self, diagnostics: Any) -> tuple[Float[np.ndarray, "*points rows"], ...]:
        """Return the margins other than the one that vanishes along the locus."""
        sticking_times, min_contact_forces = (
            np.where(self.row_mask > 0, np.inf, values)
            for values in (diagnostics.sticking_time, diagnostics.min_contact_force)
        )
        return (
            (diagnostics.sticking_time, min_contact_forces)
            if bool(self.is_release)
            else (sticking_times, diagnostics.min_contact_force)
        )


def _evaluate_limit_measure(limit_measure, problem, z):
    """Evaluate the measure that vanishes at the limit of the sticking phase."""
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    flights = impact_equations.compute_flights(coeffs, sequence)
    chatter_starts_by_row, _ = chatter_and_release.chatter_starts(coeffs, sequence, flights)
    limit_row = jnp.argmax(problem.condition.row_mask)
    return limit_measure(coeffs, jax.tree.map(lambda leaf: leaf[limit_row], chatter_starts_by_row))


def _unit_vectors_of_measure(problem, z):
    """Return the unit vectors of the unknowns that affect the measure. Array of shape (directions, unknowns)."""
    n_rows = len(problem.condition.row_mask)
    last_row = jnp.sum(problem.sequence.sides != 0) - 1
    limit_row = jnp.argmax(problem.condition.row_mask)
    next_row = jnp.where(limit_row == last_row, 0, limit_row + 1)
    unknown_indices = jnp.stack([limit_row, next_row, n_rows + limit_row, *range(2 * n_rows, len(z))])
    return jnp.eye(len(z), dtype=z.dtype)[unknown_indices]


def _sticking_limit_system(limit_measure, z, problem):
    """Return (F, dF/dz) of the orbit equations and the measure.

    For an empty row, F holds its unknowns, which must vanish.
    """
    residual, jacobian = evaluate_orbit(z, problem)
    is_empty_unknown = jnp.tile(problem.sequence.sides == 0, 2)
    orbit_residual = jnp.where(is_empty_unknown, z[: len(is_empty_unknown)], residual)
    measure_directions = _unit_vectors_of_measure(problem, z)
    difference_steps = DIFFERENCE_STEP * (1.0 + abs(measure_directions @ z))
    z_shifts = difference_steps[:, None] * measure_directions
    measures = jax.vmap(partial(_evaluate_limit_measure, limit_measure, problem))(
        jnp.concatenate([z[None], z + z_shifts, z - z_shifts])
    )
    forward_measures, backward_measures = jnp.split(measures[1:], 2)
    measure_gradient = ((forward_measures - backward_measures) / (2.0 * difference_steps)) @ measure_directions
    return jnp.append(orbit_residual, measures[0]), jnp.concatenate(
        [cyclic_system.dense_matrix(jacobian), measure_gradient[None]]
    )


def _make_sticking_problem(limit_measure):
    limit_system = partial(_sticking_limit_system, limit_measure)
    return Problem(limit_system, solve_bordered, limit_system, (), call_as_kernel, compile_at_once=True)


RELEASE = _make_sticking_problem(chatter_and_release.min_contact_force)
CHATTER = _make_sticking_problem(chatter_and_release.excess_speed)

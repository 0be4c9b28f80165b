"""Locate points of codimension two on a locus.

At a point of codimension two the locus meets another locus, or the normal form of its bifurcation degenerates.

F are the equations of the orbit in the unknowns u, its times and speeds. The right and left null vectors of F_u are v
and w. The locus has these points:

- SN: a cusp (CP), where ``w F_uu v v = 0``.
- PD or SB: a generalized period doubling (GPD) or degenerate symmetry breaking (DSB), where
  ``w (F_uuu v v v + 3 F_uu v h) = 0`` with ``F_u h = -F_uu v v`` (Kuznetsov, Elements of Applied Bifurcation Theory,
  5.4).
- GR: a resonant grazing (RG), where the equations with the grazing contact as an impact are singular, both as at an SN
  and as at a PD.
- GR: a nonhyperbolic grazing (SN, PD, SB), where the equations without the grazing contact are singular.

Under a spring and a damper, F is an analytic function of u while all impact speeds are positive, and an entire function
if all walls are rigid. Central differences over many points then give its derivatives to rounding.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation import augmented_systems
from continuation.array_type import Array
from continuation.branch_segment import row_at
from continuation.event_search import make_event, point_at_length
from continuation.hostcall import persistent_jit
from continuation.newton import solve

from ..compiled.kernel_calls import call_as_kernel
from ..contact.kinds import flow_coefficients
from ..flight import flow, further_drive_terms
from ..orbits import cyclic_system, impact_equations
from ..problem.orbit_equations import diagnose, evaluate_in_blocks, loop_over_points, scene_at, sequence_at
from .locus_equations import GrazingCondition

NODE_SPACING = 0.03  # distance of neighbouring nodes of a difference, times the fastest rate
STENCIL_NODES = np.array([-8, -6, -4, -3, -2, -1, 0, 1, 2, 3, 4, 6, 8])


def _richardson_weights(nine_point_weights, derivative_order, error_order):
    """Return Richardson-extrapolated weights at `STENCIL_NODES`.

    The weights combine a nine-point difference with the same difference at twice the spacing, so that the leading error
    cancels.
    """
    narrow_weights, wide_weights = (
        np.array(
            [
                nine_point_weights[k // spacing_factor + 4]
                if k % spacing_factor == 0 and abs(k) <= 4 * spacing_factor
                else 0.0
                for k in STENCIL_NODES
            ]
        )
        for spacing_factor in (1, 2)
    )
    return (2.0**error_order * narrow_weights - wide_weights / 2.0**derivative_order) / (2.0**error_order - 1.0)


# Nodes and weights of the second and third derivative: accurate to rounding, and accurate enough for a sign.
FINE_STENCIL = (
    STENCIL_NODES,
    _richardson_weights([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560], 2, 8),
    _richardson_weights([-7 / 240, 3 / 10, -169 / 120, 61 / 30, 0, -61 / 30, 169 / 120, -3 / 10, 7 / 240], 3, 6),
)
COARSE_STENCIL = (
    np.arange(-3, 4),
    np.array([1 / 90, -3 / 20, 3 / 2, -49 / 18, 3 / 2, -3 / 20, 1 / 90]),
    np.array([1 / 8, -1, 13 / 8, 0, -13 / 8, 1, -1 / 8]),
)
DERIVATIVE_ORDERS = {"CP": 2, "GPD": 3, "DSB": 3}  # order of the derivative that vanishes
DIFFERENCE_STEP = 1e-5  # relative to 1 + |z|: step of central differences for Newton's method
# Below this `multiplier_derivative` an impact has zero speed, and the third derivative is undefined.
MIN_MULTIPLIER_SLOPE = 1e-10
SAME_POINT_TOLERANCE = 1e-7  # in scaled z: points closer than this coincide
LANES = 132  # points per compiled call


def locate_codim2_events(task, points, diagnostics):
    """Locate the points of codimension two between consecutive points of a locus; return their `Event` records.

    `task` is the `ContinuationTask` of the locus, and `diagnostics` are the `Diagnostics` of the points.
    """
    problem, events = task.args, []
    if problem.sequence.releases is not None:  # a sticking orbit neither folds nor doubles its period
        return events
    for kind, test_values in _test_values_by_kind(problem, points, diagnostics).items():
        for row_index in np.flatnonzero(test_values[:-1] * test_values[1:] < 0):
            event = _locate_event(task, kind, points, int(row_index), test_values)
            if (
                event is not None
                and np.linalg.norm(task.control.scale * (event.z - points.z[0])) > SAME_POINT_TOLERANCE
            ):
                events.append(event)
    return sorted(events, key=lambda event: (event.row_before, event.length))


def _test_values_by_kind(problem, points, diagnostics):
    """Return the values of the test function of each kind at the points."""
    if not isinstance(problem.condition, GrazingCondition):
        if float(problem.condition.multiplier) > 0:
            plane_tangent_products = np.sum(points.tangent[1:, -2:] * points.tangent[:-1, -2:], axis=1)
            return {"CP": np.cumprod(np.append(1.0, np.sign(plane_tangent_products)))}
        normal_forms = _normal_forms(problem, points.z, 3, False)
        return {
            _doubling_kind(problem, "GPD", "DSB"): np.where(
                normal_forms.multiplier_derivative > MIN_MULTIPLIER_SLOPE, normal_forms.value, np.nan
            )
        }
    test_values = {"RG": diagnostics.fold_test} if problem.sequence.grazing is None else {}
    tests_without_contact = _tests_without_contact(problem, points.z, diagnostics)
    if tests_without_contact is None:
        return test_values
    return test_values | dict(zip(("SN", _doubling_kind(problem, "PD", "SB")), tests_without_contact, strict=True))


def _tests_without_contact(problem, zs, diagnostics):
    """Return the fold and flip test functions of the orbit without the grazing contact, at points of a GR.

    The first vanishes where this orbit is an SN, the second where it is a PD or SB. Returns None if this orbit has no
    impacts and the contact is not smooth. At a smooth contact the equations of the impacts are always singular. The
    test functions are then the determinants of the monodromy matrix minus and plus the identity.
    """
    if problem.sequence.grazing is not None:
        closure_sign = -1.0 if float(problem.sequence.closure_sign) < 0 else 1.0
        return tuple(
            1.0 + diagnostics.determinant - critical_multiplier * closure_sign * diagnostics.trace
            for critical_multiplier in (1.0, -1.0)
        )
    if not len(problem.impact_rows):
        return None
    n_rows, impact_rows = problem.n_rows, problem.impact_rows
    reduced_problem, _ = problem.with_rows(zs[0], impact_rows)
    n_padded_rows, n_impacts = reduced_problem.n_rows, len(impact_rows)
    zs_without_contact = np.zeros((len(zs), 2 * n_padded_rows + 2))
    zs_without_contact[:, :n_impacts] = zs[:, impact_rows]
    zs_without_contact[:, n_padded_rows : n_padded_rows + n_impacts] = zs[:, n_rows + impact_rows]
    zs_without_contact[:, -2:] = zs[:, -2:]
    reduced_diagnostics = diagnose(reduced_problem, zs_without_contact)
    return reduced_diagnostics.fold_test, reduced_diagnostics.flip_test


def _doubling_kind(problem, whole_orbit_kind, half_orbit_kind):
    return half_orbit_kind if float(problem.sequence.closure_sign) < 0 else whole_orbit_kind


def _locate_event(task, kind, points, row_index, test_values):
    z_before, step_length = points.z[row_index], float(points.step[row_index + 1])
    zero_fraction = test_values[row_index] / (test_values[row_index] - test_values[row_index + 1])
    for fraction_guess in (zero_fraction, 0.5):
        trial_point = point_at_length(task, points, row_index, fraction_guess * step_length)
        z = (
            z_before + fraction_guess * step_length * points.tangent[row_index]
            if trial_point is None
            else trial_point.z
        )
        solution = _solve_event_equations(task.args, kind, z)
        base_point = row_at(points, row_index)
        event = make_event(kind, base_point, row_index, (0.0, step_length), solution, task.control)
        if event is not None:
            return event
    return None


def _solve_event_equations(problem, kind, z):
    """Solve the equations of the locus and of the event by Newton's method; return a `RootAndResidual`."""
    start_test_values, null_vectors = _event_test_values(problem, kind, z[None])
    test_scale = abs(start_test_values[0]) or 1.0

    def event_system(z):
        residual, jacobian = problem.evaluate(z)
        difference_steps = DIFFERENCE_STEP * (1.0 + abs(z))
        shifted_zs = np.concatenate([z + np.diag(difference_steps), z - np.diag(difference_steps), z[None]])
        test_values = _event_test_values(problem, kind, shifted_zs, null_vectors)[0] / test_scale
        n_unknowns = len(z)
        test_gradient = (test_values[:n_unknowns] - test_values[n_unknowns : 2 * n_unknowns]) / (2.0 * difference_steps)
        return np.append(residual, test_values[-1]), np.vstack([jacobian, test_gradient])

    return augmented_systems.solve_newton(event_system, z)


def _event_test_values(problem, kind, zs, reference_null_vectors=None):
    """Return (values of the test function of an event at points, null vectors).

    The null vectors are the pair (v, w) at the first point, which fixes the sign of the test function of a CP, GPD or
    DSB. For other events they are None.
    """
    if kind in DERIVATIVE_ORDERS:
        normal_forms = _normal_forms(problem, zs, DERIVATIVE_ORDERS[kind], True, reference_null_vectors)
        return normal_forms.value, (normal_forms.right_null[0], normal_forms.left_null[0])
    diagnostics = diagnose(problem, zs)
    if kind == "RG":
        return diagnostics.fold_test, None
    fold_test, flip_test = _tests_without_contact(problem, zs, diagnostics)
    return fold_test if kind == "SN" else flip_test, None


class _NormalFormCoefficient(NamedTuple):
    """Coefficient of the normal form: second or third derivative of F along the null vectors.

    Near an impact with zero speed, h and the third derivative grow like 1 / speed. Therefore F is differentiated along
    h scaled to length 1.

    Attributes
    ----------
    value : jax.Array
        ``w F_uu v v``, or ``w (F_uuu v v v + 3 F_uu v h)``.
    right_null, left_null : jax.Array
        Right and left null vectors v and w of F_u, of length 1.
    multiplier_derivative : jax.Array
        Derivative of w F_u v with respect to the multiplier of the closure. The sign of `value` is that of the normal
        form only where this derivative is positive.
    """

    value: Float[Array, "*points"]
    right_null: Float[Array, "*points unknowns"]
    left_null: Float[Array, "*points unknowns"]
    multiplier_derivative: Float[Array, "*points"]


def _normal_forms(problem, zs, order, high_accuracy, reference_null_vectors=None):
    """Return the `_NormalFormCoefficient` at each point.

    With `high_accuracy` the derivatives are accurate to rounding, otherwise to about seven digits.
    `reference_null_vectors` are a pair (v, w) that fixes the signs of the null vectors."""
    reference_null_vectors = (
        tuple(np.zeros((2, 2 * len(problem.sequence.sides))))
        if reference_null_vectors is None
        else reference_null_vectors
    )

    def evaluate_block(z_block, n_points):
        return _evaluate_normal_forms(problem, z_block, reference_null_vectors, n_points, order, high_accuracy)

    return _NormalFormCoefficient(*evaluate_in_blocks(evaluate_block, zs, LANES))


@persistent_jit(static_argnums=(4, 5))
def _evaluate_normal_forms(problem, zs, reference_null_vectors, n_points, order, high_accuracy):
    return call_as_kernel(
        _normal_form_kernel, problem, zs, reference_null_vectors, n_points, order=order, high_accuracy=high_accuracy
    )


def _normal_form_kernel(problem, zs, reference_null_vectors, n_points, order, high_accuracy):
    def evaluate_point(problem, reference_null_vectors, z):
        return _normal_form_at(problem, z, reference_null_vectors, order, high_accuracy)

    return loop_over_points(evaluate_point, zs, n_points, problem, reference_null_vectors)


def _normal_form_at(problem, z, reference_null_vectors, order, high_accuracy):
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    flights = impact_equations.compute_flights(coeffs, sequence)
    jacobian = cyclic_system.assemble_block_matrix(impact_equations.residual_and_jacobian(coeffs, sequence, flights)[1])
    left_null, right_null = (
        null_vector / jnp.sqrt(jnp.sum(null_vector * null_vector))
        for null_vector in cyclic_system.null_vectors(jacobian, problem.condition.multiplier)
    )
    right_null, left_null = (
        jnp.where(jnp.sum(null_vector * reference_vector) < 0, -null_vector, null_vector)
        for null_vector, reference_vector in zip((right_null, left_null), reference_null_vectors, strict=True)
    )
    derivative_by_multiplier = cyclic_system.derivative_by_multiplier(left_null, jacobian, right_null)
    node_spacing = NODE_SPACING / _fastest_rate(coeffs, flights.contact_map, sequence.sides)
    stencil_nodes, *stencil_weights = FINE_STENCIL if high_accuracy else COARSE_STENCIL

    def directional_derivatives(direction_correction):
        """Return the second and the third derivative along v + h."""
        shifted_residuals = jax.vmap(
            lambda node: _residual_along_null(problem, coeffs, z, right_null, direction_correction, node * node_spacing)
        )(jnp.array(stencil_nodes, z.dtype))
        return [
            jnp.array(order_weights, z.dtype) @ shifted_residuals / node_spacing**derivative_order
            for derivative_order, order_weights in zip((2, 3), stencil_weights, strict=True)
        ]

    def accumulate_derivatives(pass_index, derivative_sums):  # along v, then v + h and v - h with h of length 1
        second_derivative, third_derivative, mixed_derivative, _ = derivative_sums
        direction_correction = jnp.where(
            pass_index > 0, -solve(cyclic_system.dense_matrix(jacobian), second_derivative).x, 0.0
        )
        correction_norm = jnp.sqrt(jnp.sum(direction_correction * direction_correction))
        correction_norm = jnp.where(correction_norm > 0, correction_norm, 1.0)
        second_along_direction, third_along_direction = directional_derivatives(
            jnp.where(pass_index > 1, -direction_correction, direction_correction) / correction_norm
        )
        is_first_pass = pass_index == 0
        mixed_derivative = jnp.where(
            is_first_pass,
            mixed_derivative,
            mixed_derivative + jnp.where(pass_index > 1, -0.25, 0.25) * second_along_direction,
        )
        return (
            jnp.where(is_first_pass, second_along_direction, second_derivative),
            jnp.where(is_first_pass, third_along_direction, third_derivative),
            mixed_derivative,
            correction_norm,
        )

    zero_vector = jnp.zeros_like(right_null)
    if order == 2:
        residual_derivative = directional_derivatives(zero_vector)[0]
    else:
        _, third_derivative, mixed_derivative, correction_norm = lax.fori_loop(
            0, 3, accumulate_derivatives, (zero_vector, zero_vector, zero_vector, jnp.ones(()))
        )
        residual_derivative = third_derivative + 3.0 * correction_norm * mixed_derivative
    return _NormalFormCoefficient(
        jnp.sum(left_null * residual_derivative), right_null, left_null, derivative_by_multiplier
    )


def _fastest_rate(coeffs, contact_map, sides):
    """Return an upper bound on the rates of the drive, of the free motion and of the motion inside soft walls."""
    max_rate = flow.max_angular_rate(coeffs.frequency, coeffs.damping)
    if coeffs.drive_terms:
        max_rate = jnp.maximum(
            max_rate, coeffs.frequency * float(further_drive_terms.highest_harmonic(coeffs.drive_terms))
        )
    return (
        max_rate
        if contact_map.contact_time is None
        else jnp.maximum(max_rate, coeffs.contact.max_oscillation_rate(coeffs, contact_map, sides))
    )


def _residual_along_null(problem, coeffs, z, right_null, direction_correction, shift_length):
    """Return F with the impacts moved by `shift_length` times (v + h).

    After one cycle, the displacement along v is multiplied by the multiplier of the closure. The displacement along h
    is unchanged.
    """
    n_rows, impact_shifts = (
        len(problem.sequence.sides),
        ((shift_length * right_null, problem.condition.multiplier), (shift_length * direction_correction, 1.0)),
    )
    residual = impact_equations.residual_and_jacobian(
        coeffs, impact_equations.append_first_impact(sequence_at(problem, z), coeffs.period, impact_shifts)
    )[0]
    is_used_row = jnp.arange(n_rows) < jnp.sum(problem.sequence.sides != 0)
    return jnp.concatenate(
        [
            jnp.where(is_used_row, residual[:n_rows], 0.0),
            jnp.where(is_used_row, residual[n_rows + 1 : 2 * n_rows + 1], 0.0),
        ]
    )

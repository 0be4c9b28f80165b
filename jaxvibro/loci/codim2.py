"""Locate points of codimension two on a locus.

At these points the locus meets another, or its normal form degenerates.

- SN: a cusp (CP), where ``w F_uu v v = 0``, with the right and left null vectors v and w of F_u.
- PD or SB: a generalized period doubling (GPD) or degenerate symmetry breaking (DSB), where
  ``w (F_uuu v v v + 3 F_uu v h) = 0`` with ``F_u h = -F_uu v v`` (Kuznetsov, Elements of Applied Bifurcation Theory,
  5.4).
- GR: a resonant grazing (RG), where the equations with the grazing contact as an impact are singular, those of SN and
  of PD at once; and a nonhyperbolic grazing (SN, PD, SB), where the equations without the contact are singular.

F is an entire function of times and speeds. Central differences over many points give these derivatives to rounding.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation import augmented_systems
from continuation.array_type import Array
from continuation.event_search import Event
from continuation.intermediate_points import point_at_length
from continuation.linear_solver import solve
from continuation.persistent_jit import persistent_jit

from ..compiled.kernels import call_as_kernel
from ..flight import drive, flow
from ..flight.coefficients import flow_coefficients
from ..orbits import cyclic_system, impact_equations, saltation
from ..problem import grazing
from ..problem.diagnostics import diagnose
from ..problem.equations import continuation_problem, scene_at, sequence_at
from .extended_system import GrazingEquations

NODE_SPACING = 0.03  # distance of neighbouring nodes of a difference, times the fastest rate
STENCIL_NODES = np.array([-8, -6, -4, -3, -2, -1, 0, 1, 2, 3, 4, 6, 8])


def _richardson_weights(nine_point_weights, order, error_order):
    """Return Richardson-extrapolated weights at `STENCIL_NODES`.

    They combine nine points with nine points twice as far apart, so that the leading error cancels.
    """
    near_weights, far_weights = (
        np.array([nine_point_weights[k // n + 4] if k % n == 0 and abs(k) <= 4 * n else 0.0 for k in STENCIL_NODES])
        for n in (1, 2)
    )
    return (2.0**error_order * near_weights - far_weights / 2.0**order) / (2.0**error_order - 1.0)


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


def locate_events(task, points, diagnostics):
    """Return the `Event` records between consecutive points with known `Diagnostics`; `task` is that of the locus."""
    problem, events = task.args, []
    if problem.sequence.releases is not None:  # a sticking orbit neither folds nor doubles its period
        return events
    for kind, values in _test_functions(problem, points, diagnostics).items():
        for index in np.flatnonzero(values[:-1] * values[1:] < 0):
            event = _locate_event(task, kind, points, int(index), values)
            if (
                event is not None
                and np.linalg.norm(task.control.scale * (event.z - points.z[0])) > SAME_POINT_TOLERANCE
            ):
                events.append(event)
    return sorted(events, key=lambda event: (event.row_before, event.length))


def _test_functions(problem, points, diagnostics):
    """Return the values of the test function of each kind at the points."""
    if not isinstance(problem, GrazingEquations):
        if float(problem.multiplier) > 0:
            tangent_products = np.sum(points.tangent[1:, -2:] * points.tangent[:-1, -2:], axis=1)
            return {"CP": np.cumprod(np.append(1.0, np.sign(tangent_products)))}
        normal_forms = _normal_forms(problem, points.z, 3, False)
        return {
            _doubling_kind(problem, "GPD", "DSB"): np.where(
                normal_forms.multiplier_derivative > MIN_MULTIPLIER_SLOPE, normal_forms.value, np.nan
            )
        }
    test_values = {"RG": diagnostics.fold_test} if problem.sequence.grazing is None else {}
    reduced_tests = _tests_without_grazing(problem, points.z, diagnostics)
    if reduced_tests is None:
        return test_values
    return test_values | dict(zip(("SN", _doubling_kind(problem, "PD", "SB")), reduced_tests, strict=True))


def _tests_without_grazing(problem, zs, diagnostics):
    """Return test functions of a GR that vanish where the orbit without the grazing contact is an SN, and a PD or SB.

    Returns None if that orbit has no impacts and the contact is not smooth. At a smooth contact the equations of the
    impacts are always singular. The test functions are then the determinants of the monodromy matrix minus and plus the
    identity.
    """
    if problem.sequence.grazing is not None:
        closure_sign = -1.0 if float(problem.sequence.closure_sign) < 0 else 1.0
        return tuple(1.0 + diagnostics.determinant - sign * closure_sign * diagnostics.trace for sign in (1.0, -1.0))
    if not len(problem.impact_rows):
        return None
    n_rows, impact_rows = len(problem.sequence.sides), problem.impact_rows
    sequence = grazing.padded_sequence(problem, [(0.0, 0.0, problem.sequence.sides[k]) for k in impact_rows])
    n_padded_rows, n_impacts = len(sequence.sides), len(impact_rows)
    reduced_zs = np.zeros((len(zs), 2 * n_padded_rows + 2))
    reduced_zs[:, :n_impacts], reduced_zs[:, n_padded_rows : n_padded_rows + n_impacts], reduced_zs[:, -2:] = (
        zs[:, impact_rows],
        zs[:, n_rows + impact_rows],
        zs[:, -2:],
    )
    reduced_diagnostics = diagnose(grazing.replace_sequence(problem, sequence, impact_rows), reduced_zs)
    return reduced_diagnostics.fold_test, reduced_diagnostics.flip_test


def _doubling_kind(problem, whole_orbit_kind, half_orbit_kind):
    return half_orbit_kind if float(problem.sequence.closure_sign) < 0 else whole_orbit_kind


def _locate_event(task, kind, points, index, values):
    z_before, length = points.z[index], float(points.step[index + 1])
    fraction = values[index] / (values[index] - values[index + 1])
    for guess in (fraction, 0.5):
        trial_point = point_at_length(task, points, index, guess * length)
        z = z_before + guess * length * points.tangent[index] if trial_point is None else trial_point.z
        solution = _solve_event(task.args, kind, z)
        if solution.z is None:
            continue
        arclength = float(np.sum(task.control.scale**2 * points.tangent[index] * (solution.z - z_before)))
        if -0.05 * length <= arclength <= 1.05 * length:
            return Event(kind, index, min(max(arclength, 0.0), length), solution.z, solution.residual)
    return None


def _solve_event(problem, kind, z):
    """Apply Newton's method to the equations of the locus and of the event; return a `PointSolution`."""
    start_values, null_vectors = _event_values(problem, kind, z[None])
    normalisation = abs(start_values[0]) or 1.0

    def system(z):
        residual, jacobian = (
            np.asarray(array) for array in augmented_systems.evaluate(continuation_problem(problem), z, problem)
        )
        increments = DIFFERENCE_STEP * (1.0 + abs(z))
        stencil_points = np.concatenate([z + np.diag(increments), z - np.diag(increments), z[None]])
        event_values = _event_values(problem, kind, stencil_points, null_vectors)[0] / normalisation
        n_unknowns = len(z)
        event_gradient = (event_values[:n_unknowns] - event_values[n_unknowns : 2 * n_unknowns]) / (2.0 * increments)
        return np.append(residual, event_values[-1]), np.vstack([jacobian, event_gradient])

    return augmented_systems.solve_newton(system, z)


def _event_values(problem, kind, zs, reference_vectors=None):
    """Return the test function of an event at points, and the null vectors that fix its sign."""
    if kind in DERIVATIVE_ORDERS:
        normal_forms = _normal_forms(problem, zs, DERIVATIVE_ORDERS[kind], True, reference_vectors)
        return normal_forms.value, (normal_forms.right_null[0], normal_forms.left_null[0])
    diagnostics = diagnose(problem, zs)
    if kind == "RG":
        return diagnostics.fold_test, None
    fold_test, flip_test = _tests_without_grazing(problem, zs, diagnostics)
    return fold_test if kind == "SN" else flip_test, None


class _NormalFormTerm(NamedTuple):
    """Derivative of second or third order along the null vectors v and w.

    `multiplier_derivative` is the derivative of w F_u v with respect to the multiplier of the closure. If it is
    positive, the sign of the third derivative is that of a normal form. Near an impact with zero speed, h and the third
    derivative grow like 1 / speed. Therefore h is treated as a direction of length 1.
    """

    value: Float[Array, "*points"]
    right_null: Float[Array, "*points unknowns"]
    left_null: Float[Array, "*points unknowns"]
    multiplier_derivative: Float[Array, "*points"]


def _normal_forms(problem, zs, order, high_accuracy, reference_vectors=None):
    """Return the `_NormalFormTerm` at each point.

    With `high_accuracy` the derivatives are accurate to rounding, else to about seven digits. `reference_vectors` are
    the (v, w) that fix the signs.
    """
    reference_vectors = (
        tuple(np.zeros((2, 2 * len(problem.sequence.sides)))) if reference_vectors is None else reference_vectors
    )
    blocks = []
    for block_start in range(0, len(zs), LANES):
        block = zs[block_start : block_start + LANES]
        padded_block = np.concatenate([block, np.repeat(block[-1:], LANES - len(block), axis=0)])
        block_result = jax.tree.map(
            np.asarray,
            _evaluate_normal_forms(
                problem, padded_block, reference_vectors, np.int32(len(block)), order, high_accuracy
            ),
        )
        blocks.append([component[: len(block)] for component in block_result])
    return _NormalFormTerm(*(np.concatenate(component) for component in zip(*blocks, strict=True)))


@persistent_jit(static_argnums=(4, 5))
def _evaluate_normal_forms(problem, zs, reference_vectors, n_points, order, high_accuracy):
    return call_as_kernel(
        _normal_form_kernel, problem, zs, reference_vectors, n_points, order=order, high_accuracy=high_accuracy
    )


def _normal_form_kernel(problem, zs, reference_vectors, n_points, order, high_accuracy):
    def evaluate_point(k, results):
        result = _normal_form_at(
            problem, lax.dynamic_index_in_dim(zs, k, keepdims=False), reference_vectors, order, high_accuracy
        )
        return jax.tree.map(lambda array, entry: lax.dynamic_update_index_in_dim(array, entry, k, 0), results, result)

    zero_scalars, zero_vectors = (jnp.zeros((len(zs), *shape), zs.dtype) for shape in ((), reference_vectors[0].shape))
    return lax.fori_loop(
        0, n_points, evaluate_point, _NormalFormTerm(zero_scalars, zero_vectors, zero_vectors, zero_scalars)
    )


def _normal_form_at(problem, z, reference_vectors, order, high_accuracy):
    coeffs, sequence = flow_coefficients(scene_at(problem, z)), sequence_at(problem, z)
    flights = impact_equations.compute_flights(coeffs, sequence)
    jacobian = cyclic_system.assemble_matrix(impact_equations.residual_and_jacobian(coeffs, sequence, flights)[1])
    left_null, right_null = (
        vector / jnp.sqrt(jnp.sum(vector * vector))
        for vector in cyclic_system.null_vectors(jacobian, problem.multiplier)
    )
    right_null, left_null = (
        jnp.where(jnp.sum(vector * reference_vector) < 0, -vector, vector)
        for vector, reference_vector in zip((right_null, left_null), reference_vectors, strict=True)
    )
    multiplier_derivative = cyclic_system.multiplier_derivative(left_null, jacobian, right_null)
    node_spacing = NODE_SPACING / _fastest_rate(coeffs, flights.contact_map, sequence.sides)
    nodes, *weights = FINE_STENCIL if high_accuracy else COARSE_STENCIL

    def differentiate(correction):
        """Return the second and the third derivative along v + h."""
        residuals = jax.vmap(
            lambda node: _shifted_residual(problem, coeffs, z, right_null, correction, node * node_spacing)
        )(jnp.array(nodes, z.dtype))
        return [
            jnp.array(order_weights, z.dtype) @ residuals / node_spacing**derivative_order
            for derivative_order, order_weights in zip((2, 3), weights, strict=True)
        ]

    def accumulate(k, carry):  # along v, then v + h and v - h with h of length 1
        second_derivative, third_derivative, mixed_derivative, _ = carry
        correction = jnp.where(k > 0, -solve(cyclic_system.dense_matrix(jacobian), second_derivative).x, 0.0)
        correction_norm = jnp.sqrt(jnp.sum(correction * correction))
        correction_norm = jnp.where(correction_norm > 0, correction_norm, 1.0)
        new_second, new_third = differentiate(jnp.where(k > 1, -correction, correction) / correction_norm)
        is_first = k == 0
        mixed_derivative = jnp.where(
            is_first, mixed_derivative, mixed_derivative + jnp.where(k > 1, -0.25, 0.25) * new_second
        )
        return (
            jnp.where(is_first, new_second, second_derivative),
            jnp.where(is_first, new_third, third_derivative),
            mixed_derivative,
            correction_norm,
        )

    zero_vector = jnp.zeros_like(right_null)
    if order == 2:
        derivative = differentiate(zero_vector)[0]
    else:
        _, third_derivative, mixed_derivative, correction_norm = lax.fori_loop(
            0, 3, accumulate, (zero_vector, zero_vector, zero_vector, jnp.ones(()))
        )
        derivative = third_derivative + 3.0 * correction_norm * mixed_derivative
    return _NormalFormTerm(jnp.sum(left_null * derivative), right_null, left_null, multiplier_derivative)


def _fastest_rate(coeffs, contact_map, sides):
    """Return the fastest rate of the flights and of the oscillations inside soft walls."""
    max_rate = flow.max_rate(coeffs.frequency, coeffs.damping)
    if coeffs.drive_terms:
        max_rate = jnp.maximum(max_rate, coeffs.frequency * float(drive.highest_harmonic(coeffs.drive_terms)))
    return (
        max_rate
        if contact_map.contact_time is None
        else jnp.maximum(max_rate, saltation.max_oscillation_rate(coeffs, contact_map, sides))
    )


def _shifted_residual(problem, coeffs, z, right_null, correction, distance):
    """Return F of the impacts moved by s (v + h).

    In the next cycle, the first impact moves by v times the multiplier of the closure.
    """
    n_rows, shifts = (
        len(problem.sequence.sides),
        ((distance * right_null, problem.multiplier), (distance * correction, 1.0)),
    )
    residual = impact_equations.residual_and_jacobian(
        coeffs, impact_equations.unroll_sequence(sequence_at(problem, z), coeffs.period, shifts)
    )[0]
    is_used_row = jnp.arange(n_rows) < jnp.sum(problem.sequence.sides != 0)
    return jnp.concatenate(
        [
            jnp.where(is_used_row, residual[:n_rows], 0.0),
            jnp.where(is_used_row, residual[n_rows + 1 : 2 * n_rows + 1], 0.0),
        ]
    )

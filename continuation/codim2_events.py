"""Compute normal forms of special points, and locate codimension-two points on curves of special points.

Compute the leading normal-form coefficient at a special point. At HB, NS, PD and SB the sign of the coefficient
determines the criticality. At SN the coefficient is zero at a cusp. The formulas are those of Kuznetsov, Elements of
Applied Bifurcation Theory (SN: 5.24 and 5.4; HB, PD and NS: 5.4). B and C are the second and third derivatives of the
function with respect to u. q and p are null vectors of the matrix and of its transpose.

The located points are intersections with curves of other kinds, double Hopf and double Neimark-Sacker points, zeros of
normal-form coefficients, and the resonances R3 and R4.
"""

from functools import partial
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np

from . import augmented_systems, event_search
from .branch_closure import SystemEventDetector
from .branch_segment import row_at
from .continuation_loop import End
from .event_search import point_at_length
from .hostcall import FAST_COMPILE, persistent_jit
from .problem import (
    EQUILIBRIA,
    FIXED_POINTS,
    ORBITS,
    distance_from_criticality,
    eigenvalues_at,
    has_critical_pair,
    matrix_of_kind,
    residual_at,
)


def _derivative_along(function, direction, u):
    return jax.jvp(function, (u,), (direction,))[1]


@persistent_jit(static_argnums=(0, 1), compiler_options=FAST_COMPILE, numpy_first=True)
def directional_derivatives(system, param_names, z, constants, direction_sets):
    """Compute derivatives of F with respect to u along sets of directions.

    `direction_sets` has shape (count, order, n). Each derivative has the given order, with one direction for each
    differentiation. The result has shape (count, n).
    """
    n_unknowns = len(z) - len(param_names)

    def differentiate(directions):
        def function(u):
            return residual_at(system, param_names, jnp.concatenate([u, z[n_unknowns:]]), constants)

        for direction in directions:
            function = partial(_derivative_along, function, direction)
        return function(z[:n_unknowns])

    return jax.vmap(differentiate)(direction_sets)


def normal_form_coefficient(system, kind, param_names, z, constants, reference_borders):
    """Compute the leading coefficient at SN, PD or SB.

    The coefficient is ``p B(q, q)`` at SN and ``p (C(q, q, q) - 3 B(q, A^-1 B(q, q))) / (6 p q)`` at PD and SB. A is
    the derivative of F, at SB the symmetric block of this derivative. Systems bordered by the reference vectors (b, c)
    define (p, q), so that the coefficient is a smooth function of z.
    """
    matrix = matrix_of_kind(system, kind, param_names, z, constants)
    left_null_vector, _, right_null_vector, _ = augmented_systems.bordered_null_vectors(matrix, reference_borders)
    # At PD the matrix is A + 2, so that the operator is -A.
    unrestricted_system, minus_jacobian = system._replace(within=False), 2.0 * np.eye(len(right_null_vector)) - matrix
    (quadratic_term,) = directional_derivatives(
        unrestricted_system, param_names, z, constants, np.array([[right_null_vector, right_null_vector]])
    )
    if kind == "SN":
        return float(left_null_vector @ quadratic_term)
    if kind == "SB":
        minus_jacobian = -matrix_of_kind(system._replace(within=True), "SN", param_names, z, constants)
    quadratic_response = np.linalg.solve(minus_jacobian, quadratic_term)
    (mixed_term,), (cubic_term,) = (
        directional_derivatives(unrestricted_system, param_names, z, constants, np.array([directions]))
        for directions in (
            [right_null_vector, quadratic_response],
            [right_null_vector, right_null_vector, right_null_vector],
        )
    )
    return float(left_null_vector @ (cubic_term + 3.0 * mixed_term) / (6.0 * (left_null_vector @ right_null_vector)))


def critical_eigenvalue(system, eigenvalues):
    """Return the eigenvalue with positive imaginary part that is closest to criticality (HB or NS), or nan."""
    complex_eigenvalues = eigenvalues[eigenvalues.imag > 0]
    if not len(complex_eigenvalues):
        return complex(np.nan, np.nan)
    return complex_eigenvalues[int(np.argmin(distance_from_criticality(system, complex_eigenvalues)))]


def lyapunov_coefficient(system, param_names, z, constants):
    """Compute the first Lyapunov coefficient of a Hopf or Neimark-Sacker point.

    Parameters
    ----------
    system : System
        The system; the point is an HB of equilibria or an NS of fixed points.
    param_names : tuple of str
        Continuation parameters.
    z : ndarray
        The point.
    constants : SystemConstants
        Values of the other parameters, and args.

    Returns
    -------
    float
        Coefficient, negative if the bifurcation is supercritical; nan if no eigenvalue is complex.

    Notes
    -----
    The critical eigenvalue mu is i omega at HB and a multiplier at NS. The coefficient is ``Re(g) / (2 omega)`` at HB
    and ``Re(conj(mu) g) / 2`` at NS. q is the right null vector, of length 1, and p the left one, with ``p q = 1``;
    ``*`` denotes the conjugate and A the matrix with the eigenvalue mu::

        g = p (C(q, q, q*) + 2 B(q, (s - A)^-1 B(q, q*)) + B(q*, (r - A)^-1 B(q, q)))

    with s = 0 and r = 2 mu at HB, s = 1 and r = mu^2 at NS.
    """
    jacobian = matrix_of_kind(system, "", param_names, z, constants)
    critical_value = critical_eigenvalue(system, np.linalg.eigvals(jacobian).astype(complex))
    if not np.isfinite(critical_value):
        return np.nan
    is_hopf, identity_matrix = system.kind == EQUILIBRIA, np.eye(len(jacobian))
    left_singular_vectors, _, right_singular_vectors = np.linalg.svd(jacobian - critical_value * identity_matrix)
    right_null_vector = right_singular_vectors[-1].conj()
    left_null_vector = left_singular_vectors[:, -1].conj()
    conjugate_vector = right_null_vector.conj()
    form = partial(_multilinear_form, system, param_names, z, constants)
    mean_shift = 0.0 if is_hopf else 1.0
    double_shift = 2.0 * critical_value if is_hopf else critical_value * critical_value
    mean_response = np.linalg.solve(
        mean_shift * identity_matrix - jacobian, form(right_null_vector, conjugate_vector).real
    )
    double_response = np.linalg.solve(
        double_shift * identity_matrix - jacobian, form(right_null_vector, right_null_vector)
    )
    cubic_vector = (
        form(right_null_vector, right_null_vector, conjugate_vector)
        + 2.0 * form(right_null_vector, mean_response)
        + form(conjugate_vector, double_response)
    )
    cubic_coefficient = left_null_vector @ cubic_vector / (left_null_vector @ right_null_vector)
    if is_hopf:
        return float(cubic_coefficient.real / (2.0 * critical_value.imag))
    return float(0.5 * (critical_value.conjugate() * cubic_coefficient).real)


def _multilinear_form(system, param_names, z, constants, *vectors):
    """Compute the derivative of F along complex vectors from the derivatives along their real and imaginary parts."""
    direction_sets = np.array(list(product(*((vector.real, vector.imag) for vector in vectors))))
    factors = [np.prod(parts) for parts in product((1.0, 1.0j), repeat=len(vectors))]
    return factors @ directional_derivatives(system, param_names, z, constants, direction_sets)


# Tolerance of a double eigenvalue, relative to 1 + the largest: its error is the square root of a rounding error.
DOUBLE_TOLERANCE = 1e-4
CRITICAL_TOLERANCE = 1e-7  # tolerance of a critical pair of eigenvalues, relative to 1 + the largest
# Further matrices that become singular on a curve of each kind: {kind: {label: kind of the matrix}}
_MAP_INTERSECTIONS = {"SN": {"FF": "PD", "R1": "NS"}, "PD": {"FF": "SN", "R2": "NS"}, "NS": {"R1": "SN", "R2": "PD"}}
INTERSECTIONS = {
    EQUILIBRIA: {"SN": {"BT": "HB"}, "HB": {"BT": "SN"}},
    FIXED_POINTS: _MAP_INTERSECTIONS,
    ORBITS: _MAP_INTERSECTIONS,
}
# {label: (double eigenvalue, kind of the point if it is simple and another pair of eigenvalues is critical)}
DOUBLE_EIGENVALUES = {"BT": (0.0, "ZH"), "R1": (1.0, "FN"), "R2": (-1.0, "PN")}
# Labels of the zeros of the leading normal-form coefficient on a curve of each kind.
LEADING_LABELS = {"SN": "CP", "PD": "GPD", "SB": "DSB", "HB": "GH", "NS": "CH"}
ZERO_COEFFICIENT = 1e-12  # largest absolute value of a vanishing coefficient
SELF_CROSSINGS = {"HB": "HH", "NS": "NN"}  # kinds of points where two pairs of eigenvalues are critical
RESONANCE_ANGLES = {"R3": 0.5, "R4": 0.0}  # negative cosine of the angle of the multipliers on a curve of NS


class CurveEventDetector(SystemEventDetector):
    """Detector of codimension-two points on a curve of special points of one kind."""

    def __init__(self, base_system, kind, param_names):
        super().__init__(base_system, param_names)
        self.kind = kind

    def find_events(self, task, points, diagnostics, known_branch_points, termination):
        test_values = event_search.test_function_values(task.problem, points, task.args)
        events = event_search.locate_events(
            task.problem, points, test_values, task.control, task.args, known_branch_points
        )
        classified_events = [
            self.classify_event(event, task.args) for event in events if event.kind in test_values or event.kind == "BP"
        ]
        return [*(event for event in classified_events if event), *self.locate_codim2_events(task, points)]

    def end_at_special_point(self, z, kind):
        """Return the `End` of a curve of HB or NS if its critical eigenvalues coincide at the special point, else None.

        Beyond this point the two eigenvalues are real.
        """
        return End.STOPPED if self.kind in SELF_CROSSINGS and kind in DOUBLE_EIGENVALUES else None

    def classify_event(self, event, constants):
        """Return the event with the kind that the eigenvalues determine; None if there is no codimension-two point."""
        if event.kind == "BP":
            return self.classify_self_crossing(event, constants)
        if event.kind not in DOUBLE_EIGENVALUES:
            return event
        double_eigenvalue, kind_if_simple = DOUBLE_EIGENVALUES[event.kind]
        eigenvalues = eigenvalues_at(self.system, self.names, event.z, constants)
        if np.sum(abs(eigenvalues - double_eigenvalue) < DOUBLE_TOLERANCE * (1.0 + abs(eigenvalues).max())) > 1:
            return event
        return (
            event._replace(kind=kind_if_simple)
            if has_critical_pair(self.system, self.names, event.z, constants)
            else None
        )

    def classify_self_crossing(self, event, constants):
        """Return an HH or NN event if two pairs of eigenvalues are critical, else None."""
        eigenvalues = eigenvalues_at(self.system, self.names, event.z, constants)
        complex_eigenvalues = eigenvalues[eigenvalues.imag > CRITICAL_TOLERANCE]
        distances = distance_from_criticality(self.system, complex_eigenvalues)
        n_critical = np.sum(distances < CRITICAL_TOLERANCE * (1.0 + abs(eigenvalues).max()))
        has_two_pairs = self.kind in SELF_CROSSINGS and n_critical > 1
        return event._replace(kind=SELF_CROSSINGS[self.kind]) if has_two_pairs else None

    def locate_codim2_events(self, task, points):
        """Yield an `Event` at each zero of the leading normal-form coefficient and at each resonance R3 or R4."""
        for label, codim2_function in self.codim2_functions(task.args).items():
            if label == "CP":
                tangent_products = np.sum(points.tangent[1:, -2:] * points.tangent[:-1, -2:], axis=1)
                function_values = np.cumprod(np.append(1.0, np.sign(tangent_products)))
            else:
                function_values = np.array([codim2_function(z, z) for z in points.z])
            # The coefficient vanishes along the curve in area-preserving systems.
            if abs(function_values).max() <= ZERO_COEFFICIENT:
                continue
            for row_before in np.flatnonzero(function_values[:-1] * function_values[1:] < 0):
                event = self.locate_codim2_event(label, codim2_function, task, points, int(row_before))
                if event is not None:
                    yield event

    def codim2_functions(self, constants):
        """Return {label: function of (z, nearby z)}; each function is zero at codimension-two points of its label.

        Functions that need third derivatives are omitted for periodic orbits.
        """
        arguments = self.system, self.kind, self.names

        def leading_coefficient(z, reference_z):
            borders = augmented_systems.singular_borders(matrix_of_kind(*arguments, reference_z, constants))
            return normal_form_coefficient(*arguments, z, constants, borders)

        def first_lyapunov(z, reference_z):
            return lyapunov_coefficient(self.system, self.names, z, constants)

        def cosine_difference(minus_cosine, z, reference_z):
            eigenvalues = eigenvalues_at(self.system, self.names, z, constants)
            return critical_eigenvalue(self.system, eigenvalues).real + minus_cosine

        functions = {LEADING_LABELS[self.kind]: first_lyapunov if self.kind in SELF_CROSSINGS else leading_coefficient}
        if self.system.kind == ORBITS and self.kind != "SN":
            functions = {}
        if self.kind == "NS":
            functions |= {label: partial(cosine_difference, number) for label, number in RESONANCE_ANGLES.items()}
        return functions

    def locate_codim2_event(self, label, codim2_function, task, points, row_before):
        """Locate the zero of a function on the curve by Newton's method.

        Returns None if the method does not converge or the zero lies outside the step.
        """
        z_before, step_length = points.z[row_before], float(points.step[row_before + 1])
        halfway_point = point_at_length(task, points, row_before, 0.5 * step_length)
        z_guess = (
            z_before + 0.5 * step_length * points.tangent[row_before] if halfway_point is None else halfway_point.z
        )

        def zero_function(z):
            return codim2_function(z, z_guess)

        solution = augmented_systems.locate_zero(task.problem, z_guess, task.args, zero_function)
        base_point = row_at(points, row_before)
        return event_search.make_event(label, base_point, row_before, (0.0, step_length), solution, task.control)

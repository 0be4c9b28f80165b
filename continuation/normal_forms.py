"""Compute the leading normal-form coefficient at a special point.

At HB, NS, PD and SB the sign of the coefficient determines the criticality. At SN the coefficient is zero at a cusp.
The formulas are those of Kuznetsov, Elements of Applied Bifurcation Theory (SN: 5.24 and 5.4; HB, PD and NS: 5.4). B
and C are the second and third derivatives of the function with respect to u. q and p are null vectors of the matrix and
of its transpose.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from .persistent_jit import FAST_COMPILE, persistent_jit
from .problem import matrix_of_kind, residual_at


def _derivative_along(function, direction, u):
    return jax.jvp(function, (u,), (direction,))[1]


def _directional_derivatives(system, param_names, z, constants, direction_sets):
    n_unknowns = len(z) - len(param_names)

    def differentiate(directions):
        def function(u):
            return residual_at(system, param_names, jnp.concatenate([u, z[n_unknowns:]]), constants)

        for direction in directions:
            function = partial(_derivative_along, function, direction)
        return function(z[:n_unknowns])

    return jax.vmap(differentiate)(direction_sets)


@persistent_jit(static_argnums=(0, 1), compiler_options=FAST_COMPILE, numpy_first=True)
def directional_derivatives(system, param_names, z, constants, direction_sets):
    """Compute derivatives of F with respect to u along sets of directions.

    `direction_sets` has shape (count, order, n). Each derivative has the given order, with one direction for each
    differentiation. The result has shape (count, n).
    """
    return _directional_derivatives(system, param_names, z, constants, direction_sets)


def border_vectors(matrix):
    """Return (b, c), the left and right singular vectors of the smallest singular value of a matrix."""
    left_singular_vectors, _, right_singular_vectors = np.linalg.svd(np.asarray(matrix))
    return left_singular_vectors[:, -1], right_singular_vectors[-1]


def normal_form_coefficient(system, kind, param_names, z, constants, reference_borders):
    """Compute the leading coefficient at SN, PD or SB.

    The coefficient is ``p B(q, q)`` at SN and ``p (C(q, q, q) - 3 B(q, A^-1 B(q, q))) / (6 p q)`` at PD and SB. A is
    the derivative of F, at SB the symmetric block of this derivative. Systems bordered by the reference vectors (b, c)
    define (p, q), so that the coefficient is a smooth function of z.
    """
    matrix = matrix_of_kind(system, kind, param_names, z, constants)
    left_border, right_border = reference_borders
    bordered_matrix = np.block([[matrix, left_border[:, None]], [right_border[None], np.zeros((1, 1))]])
    unit_rhs = np.append(np.zeros(len(right_border)), 1.0)
    right_null_vector, left_null_vector = (
        np.linalg.solve(bordered_matrix, unit_rhs)[:-1],
        np.linalg.solve(bordered_matrix.T, unit_rhs)[:-1],
    )
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


def critical_eigenvalue(kind, eigenvalues):
    """Return the eigenvalue with positive imaginary part that is closest to criticality (HB or NS), or nan."""
    complex_eigenvalues = eigenvalues[eigenvalues.imag > 0]
    critical_distances = abs(complex_eigenvalues.real) if kind == "HB" else abs(abs(complex_eigenvalues) - 1.0)
    return (
        complex_eigenvalues[int(np.argmin(critical_distances))] if len(complex_eigenvalues) else complex(np.nan, np.nan)
    )


def lyapunov_coefficient(system, kind, param_names, z, constants):
    """Compute the first Lyapunov coefficient of a Hopf or Neimark-Sacker point.

    Parameters
    ----------
    system : System
        The system.
    kind : {"HB", "NS"}
        Kind of the point.
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
    and ``Re(conj(mu) g) / 2`` at NS. q has length 1 and ``p q = 1``; ``*`` denotes the conjugate and A the matrix with
    the eigenvalue mu::

        g = p (C(q, q, q*) + 2 B(q, (s - A)^-1 B(q, q*)) + B(q*, (r - A)^-1 B(q, q)))

    with s = 0 and r = 2 mu at HB, s = 1 and r = mu^2 at NS.
    """
    jacobian = matrix_of_kind(system, "", param_names, z, constants)
    critical_value, identity_matrix = (
        critical_eigenvalue(kind, np.linalg.eigvals(jacobian).astype(complex)),
        np.eye(len(jacobian)),
    )
    if not np.isfinite(critical_value):
        return np.nan
    left_singular_vectors, _, right_singular_vectors = np.linalg.svd(jacobian - critical_value * identity_matrix)
    right_null_vector, left_null_vector = right_singular_vectors[-1].conj(), left_singular_vectors[:, -1].conj()
    null_vector_real, null_vector_imag = right_null_vector.real, right_null_vector.imag
    quadratic_rr, quadratic_ri, quadratic_ii = directional_derivatives(
        system,
        param_names,
        z,
        constants,
        np.array(
            [
                [null_vector_real, null_vector_real],
                [null_vector_real, null_vector_imag],
                [null_vector_imag, null_vector_imag],
            ]
        ),
    )
    mean_resolvent_shift, double_resolvent_shift = (
        (0.0, 2.0 * critical_value) if kind == "HB" else (1.0, critical_value * critical_value)
    )
    mean_response = np.linalg.solve(mean_resolvent_shift * identity_matrix - jacobian, quadratic_rr + quadratic_ii)
    double_response = np.linalg.solve(
        double_resolvent_shift * identity_matrix - jacobian, quadratic_rr - quadratic_ii + 2j * quadratic_ri
    )
    direction_pairs = [
        (null_vector_real, mean_response),
        (null_vector_imag, mean_response),
        (null_vector_real, double_response.real),
        (null_vector_imag, double_response.imag),
        (null_vector_real, double_response.imag),
        (null_vector_imag, double_response.real),
    ]
    mixed_real_mean, mixed_imag_mean, *mixed_double_terms = directional_derivatives(
        system, param_names, z, constants, np.array(direction_pairs)
    )
    cubic_rrr, cubic_rri, cubic_rii, cubic_iii = directional_derivatives(
        system,
        param_names,
        z,
        constants,
        np.array(
            [
                [null_vector_real, null_vector_real, null_vector_real],
                [null_vector_real, null_vector_real, null_vector_imag],
                [null_vector_real, null_vector_imag, null_vector_imag],
                [null_vector_imag, null_vector_imag, null_vector_imag],
            ]
        ),
    )
    cubic_term, mixed_term = (
        cubic_rrr + cubic_rii + 1j * (cubic_rri + cubic_iii),
        2.0 * (mixed_real_mean + 1j * mixed_imag_mean),
    )
    cubic_coefficient = (
        left_null_vector
        @ (
            cubic_term
            + mixed_term
            + mixed_double_terms[0]
            + mixed_double_terms[1]
            + 1j * (mixed_double_terms[2] - mixed_double_terms[3])
        )
        / (left_null_vector @ right_null_vector)
    )
    return float(
        cubic_coefficient.real / (2.0 * critical_value.imag)
        if kind == "HB"
        else 0.5 * (critical_value.conjugate() * cubic_coefficient).real
    )

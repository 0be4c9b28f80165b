"""Compute the leading normal-form coefficient at a special point.

At HB, NS, PD and SB the sign of the coefficient determines the criticality. At SN the coefficient is zero at a cusp.
The formulas are those of Kuznetsov, Elements of Applied Bifurcation Theory (SN: 5.24 and 5.4; HB, PD and NS: 5.4). B
and C are the second and third derivatives of the function with respect to u. q and p are null vectors of the matrix and
of its transpose.
"""

from functools import partial
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np

from . import augmented_systems
from .hostcall import FAST_COMPILE, persistent_jit
from .problem import EQUILIBRIA, distance_from_criticality, matrix_of_kind, residual_at


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

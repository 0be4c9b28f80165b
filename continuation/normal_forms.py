"""Compute the leading normal-form coefficient at a special point; its sign decides the criticality.

(Kuznetsov, Elements of Applied Bifurcation Theory: SN 5.24 and 5.4, HB 5.4, PD and NS 5.4.) B and C are the second and
third derivatives of the function with respect to u; q and p are the null vectors of the matrix and its transpose, with
``p q = 1``.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from .persistent_jit import FAST_COMPILE, persistent_jit
from .problem import matrix_at, residual_at


def _directional_derivative(function, direction, u):
    return jax.jvp(function, (u,), (direction,))[1]


def _mixed_derivatives(system, names, z, constants, directions):
    n_unknowns = len(z) - len(names)

    def differentiate(direction_list):
        function = lambda u: residual_at(system, names, jnp.concatenate([u, z[n_unknowns:]]), constants)  # noqa: E731
        for direction in direction_list:
            function = partial(_directional_derivative, function, direction)
        return function(z[:n_unknowns])

    return jax.vmap(differentiate)(directions)


@persistent_jit(static_argnums=(0, 1), compiler_options=FAST_COMPILE, numpy_first=True)
def mixed_derivatives(system, names, z, constants, directions):
    """Compute derivatives of F with respect to u along directions, an array of shape (count, order, n)."""
    return _mixed_derivatives(system, names, z, constants, directions)


def border_vectors(matrix):
    """Return (b, c), the nearly null vectors of a matrix's transpose and of the matrix."""
    left_vectors, _, right_vectors = np.linalg.svd(np.asarray(matrix))
    return left_vectors[:, -1], right_vectors[-1]


def normal_form_coefficient(system, kind, names, z, constants, border_reference):
    """Compute the leading coefficient at SN, PD or SB.

    It is ``p B(q, q)`` at SN and ``p (C(q, q, q) - 3 B(q, A^-1 B(q, q))) / (6 p q)`` at PD and SB, where A is the
    derivative of F, at SB its symmetric block. The bordered systems with a reference (b, c) define (p, q), so that the
    coefficient is a smooth function of z.
    """
    matrix = matrix_at(system, kind, names, z, constants)
    left_border, right_border = border_reference
    bordered = np.block([[matrix, left_border[:, None]], [right_border[None], np.zeros((1, 1))]])
    unit_rhs = np.append(np.zeros(len(right_border)), 1.0)
    q, p = np.linalg.solve(bordered, unit_rhs)[:-1], np.linalg.solve(bordered.T, unit_rhs)[:-1]
    # At PD the matrix is A + 2, so that the operator is -A.
    full_system, operator = system._replace(within=False), 2.0 * np.eye(len(q)) - matrix
    (quadratic_term,) = mixed_derivatives(full_system, names, z, constants, np.array([[q, q]]))
    if kind == "SN":
        return float(p @ quadratic_term)
    if kind == "SB":
        operator = -matrix_at(system._replace(within=True), "SN", names, z, constants)
    h = np.linalg.solve(operator, quadratic_term)
    (mixed_term,), (cubic_term,) = (
        mixed_derivatives(full_system, names, z, constants, np.array([directions]))
        for directions in ([q, h], [q, q, q])
    )
    return float(p @ (cubic_term + 3.0 * mixed_term) / (6.0 * (p @ q)))


def critical_eigenvalue(kind, eigenvalues):
    """Return the eigenvalue closest to criticality, HB or NS, with positive imaginary part; nan if none is complex."""
    pairs = eigenvalues[eigenvalues.imag > 0]
    critical_distances = abs(pairs.real) if kind == "HB" else abs(abs(pairs) - 1.0)
    return pairs[int(np.argmin(critical_distances))] if len(pairs) else complex(np.nan, np.nan)


def lyapunov_coefficient(system, kind, names, z, constants):
    """Compute the first Lyapunov coefficient of a Hopf or Neimark-Sacker point.

    Parameters
    ----------
    system : System
        The system.
    kind : {"HB", "NS"}
        Kind of the point.
    names : tuple of str
        Continuation parameters.
    z : ndarray
        The point.
    constants : Constants
        Other parameters and args.

    Returns
    -------
    float
        Coefficient, negative if the emanating solutions are stable; nan if no eigenvalue is complex.

    Notes
    -----
    The coefficient is ``Re(g) / (2 omega)`` at HB, with the frequency omega, and ``Re(conj(mu) g) / 2`` at NS, with the
    multiplier mu. q has length 1 and ``p q = 1``; ``*`` denotes the conjugate and A the matrix with the eigenvalue mu::

        g = p (C(q, q, q*) + 2 B(q, (s - A)^-1 B(q, q*)) + B(q*, (r - A)^-1 B(q, q)))

    with s = 0 and r = 2 mu at HB, s = 1 and r = mu^2 at NS.
    """
    matrix = matrix_at(system, "", names, z, constants)
    eigenvalue, identity = critical_eigenvalue(kind, np.linalg.eigvals(matrix).astype(complex)), np.eye(len(matrix))
    if not np.isfinite(eigenvalue):
        return np.nan
    left_vectors, _, right_vectors = np.linalg.svd(matrix - eigenvalue * identity)
    q, p = right_vectors[-1].conj(), left_vectors[:, -1].conj()
    q_real, q_imag = q.real, q.imag
    b_rr, b_ri, b_ii = mixed_derivatives(
        system, names, z, constants, np.array([[q_real, q_real], [q_real, q_imag], [q_imag, q_imag]])
    )
    mean_shift, double_shift = (0.0, 2.0 * eigenvalue) if kind == "HB" else (1.0, eigenvalue * eigenvalue)
    h_mean = np.linalg.solve(mean_shift * identity - matrix, b_rr + b_ii)
    h_double = np.linalg.solve(double_shift * identity - matrix, b_rr - b_ii + 2j * b_ri)
    direction_pairs = [
        (q_real, h_mean),
        (q_imag, h_mean),
        (q_real, h_double.real),
        (q_imag, h_double.imag),
        (q_real, h_double.imag),
        (q_imag, h_double.real),
    ]
    b_real_mean, b_imag_mean, *b_double = mixed_derivatives(system, names, z, constants, np.array(direction_pairs))
    c_rrr, c_rri, c_rii, c_iii = mixed_derivatives(
        system,
        names,
        z,
        constants,
        np.array(
            [[q_real, q_real, q_real], [q_real, q_real, q_imag], [q_real, q_imag, q_imag], [q_imag, q_imag, q_imag]]
        ),
    )
    cubic_term, mixed_term = c_rrr + c_rii + 1j * (c_rri + c_iii), 2.0 * (b_real_mean + 1j * b_imag_mean)
    g = p @ (cubic_term + mixed_term + b_double[0] + b_double[1] + 1j * (b_double[2] - b_double[3])) / (p @ q)
    return float(g.real / (2.0 * eigenvalue.imag) if kind == "HB" else 0.5 * (eigenvalue.conjugate() * g).real)

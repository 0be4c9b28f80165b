"""Locate special points to rounding by Newton's method on minimally augmented systems.

If a matrix A is singular, the g of ``(A, b; c, 0) (v; g) = (0; 1)`` is zero, for any b and c that make the bordered
matrix regular. Its gradient is ``-w (A') v``, with (w, g) from the transposed system (Govaerts, Numerical Methods for
Bifurcations of Dynamical Equilibria, 3.3). A branch has few special points, so the linear algebra uses NumPy, gradients
use finite differences, and only the functions of the problem are compiled.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from .persistent_jit import FAST_COMPILE, persistent_jit

MAX_NEWTON_STEPS = 12  # largest number of Newton steps
DIFFERENCE_STEP = 1e-5  # step of central differences, relative to 1 + abs(z)
FOUR_POINT_STEP = 3e-4  # step of four-point differences, relative to 1 + abs(z)
JACOBIAN_BATCH = 8  # number of points at which one call computes derivatives
STEP_TOLERANCE = 1e-9  # Newton step, relative to 1 + abs(z), after which the next step leaves only rounding errors


class PointSolution(NamedTuple):
    """Result of locating a special point.

    Attributes
    ----------
    z : ndarray or None
        The point; None if Newton's method does not converge.
    residual : float
        Largest residual of its equations.
    """

    z: Float[np.ndarray, " unknowns"] | None
    residual: float


def _evaluate_uncompiled(problem, z, args):
    return problem.dense_function(z, args)


@persistent_jit(static_argnums=0, compiler_options=FAST_COMPILE, numpy_first=_evaluate_uncompiled)
def evaluate(problem, z, args):
    """Evaluate a problem.

    Parameters
    ----------
    problem : Problem
        The problem.
    z : array_like
        Point of shape (n + 1,).
    args : Any
        Further argument of its functions.

    Returns
    -------
    tuple
        F and dF/dz.
    """
    return problem.runner(problem.dense_function, z, args)


def jacobian_at(problem, z, args):
    """Compute dF/dz of a problem as a NumPy array."""
    return np.asarray(evaluate(problem, z, args)[1])


@persistent_jit(static_argnums=0, compiler_options=FAST_COMPILE, numpy_first=True)
def _compute_jacobians(problem, zs, n_points, args):
    return problem.runner(_loop_jacobians, zs, n_points, args, problem=problem)


def _loop_jacobians(zs, n_points, args, problem):
    """Compute dF/dz at the first `n_points` points."""

    def store_jacobian(index, jacobians):
        jacobian = problem.dense_function(lax.dynamic_index_in_dim(zs, index, keepdims=False), args)[1]
        return lax.dynamic_update_index_in_dim(jacobians, jacobian, index, 0)

    shape = len(zs), zs.shape[1] - 1, zs.shape[1]
    return lax.fori_loop(0, n_points, store_jacobian, jnp.zeros(shape, zs.dtype))


def bilinear_gradients(problem, z, args, left_vector, right_vectors):
    """Compute the gradients of ``left_vector @ F'(z) @ right`` for one or two right vectors.

    They equal the derivatives of ``left_vector @ F'`` in the direction of `right`, because second derivatives commute.
    Differences over four points each approximate them, all in one call.
    """
    steps = [FOUR_POINT_STEP * (1.0 + abs(z).max()) / abs(right).max() for right in right_vectors]
    offsets = [
        multiple * step * right
        for step, right in zip(steps, right_vectors, strict=True)
        for multiple in (1.0, -1.0, 2.0, -2.0)
    ]
    projections = left_vector @ jacobians_at(problem, z + np.stack(offsets), args)
    samples = zip(steps, projections.reshape(-1, 4, len(z)), strict=True)
    return [
        (8.0 * (plus - minus) - (double_plus - double_minus)) / (12.0 * step)
        for step, (plus, minus, double_plus, double_minus) in samples
    ]


def jacobians_at(problem, zs, args):
    """Compute dF/dz at up to `JACOBIAN_BATCH` points in one call.

    Parameters
    ----------
    problem : Problem
        The problem.
    zs : array_like
        Points of shape (points, n + 1).
    args : Any
        Further argument of its functions.

    Returns
    -------
    ndarray
        Derivatives of shape (points, n, n + 1).
    """
    zs = np.asarray(zs)
    padded = np.concatenate([zs, np.repeat(zs[-1:], JACOBIAN_BATCH - len(zs), axis=0)])
    return np.asarray(_compute_jacobians(problem, padded, np.int32(len(zs)), args))[: len(zs)]


def central_differences(function, z, indices=None):
    """Differentiate a function of z by central differences.

    Parameters
    ----------
    function : callable
        Function of z that returns a number or an array.
    z : ndarray
        Point of shape (n,).
    indices : sequence of int, optional
        Indices of the entries of z on which the function depends. None stands for all.

    Returns
    -------
    ndarray
        Derivative of shape (..., n), accurate to about nine digits. Newton's method still reaches rounding, with one
        additional step.
    """
    indices = range(len(z)) if indices is None else indices

    def partial_derivative(index):
        step = np.zeros(len(z))
        step[index] = DIFFERENCE_STEP * (1.0 + abs(z[index]))
        return (function(z + step) - function(z - step)) / (2.0 * step[index])

    partials = [partial_derivative(index) for index in indices]
    derivative = np.zeros((*np.shape(partials[0]), len(z)))
    derivative[..., list(indices)] = np.stack(partials, axis=-1)
    return derivative


def _map_test_matrix_direct(problem, test, zs, args):
    return _map_test_matrix(zs, args, test)


@persistent_jit(static_argnums=(0, 1), compiler_options=FAST_COMPILE, numpy_first=_map_test_matrix_direct)
def _compute_test_matrices(problem, test, zs, args):
    return problem.runner(_map_test_matrix, zs, args, test=test)


def _map_test_matrix(zs, args, test):
    return lax.map(lambda z: test.matrix(z, args), zs)


def matrix_and_derivative(problem, test, z, args):
    """Compute the matrix of a `TestFunction` and its z-derivative, shape (..., len(z)), by central differences."""
    steps = np.diag(DIFFERENCE_STEP * (1.0 + abs(z)))
    samples = np.asarray(_compute_test_matrices(problem, test, np.concatenate([z[None], z + steps, z - steps]), args))
    n_unknowns = len(z)
    return samples[0], np.moveaxis(samples[1 : n_unknowns + 1] - samples[n_unknowns + 1 :], 0, -1) / (
        2.0 * np.diag(steps)
    )


def locate_fold(problem, z, args, max_distance=np.inf):
    """Locate the fold near a point, where the branch turns back in the parameter.

    Parameters
    ----------
    problem : Problem
        The problem.
    z : ndarray
        Approximate fold.
    args : Any
        Further argument of its functions.
    max_distance : float or array_like, optional
        Largest distance of each unknown from `z`.

    Returns
    -------
    PointSolution
        The fold.
    """

    def system(z):
        residual, jacobian = _evaluate_numpy(problem, z, args)
        left_null, bordered_value, right_null, _ = _bordered_null_vectors(jacobian[:, :-1], border)
        (gradient,) = bilinear_gradients(problem, z, args, left_null, [np.append(right_null, 0.0)])
        return np.append(residual, bordered_value), np.vstack([jacobian, -gradient])

    border = _border_vectors(_evaluate_numpy(problem, z, args)[1][:, :-1])
    return solve_newton(system, z, max_distance)


def locate_branch_point(problem, z, args, max_distance=np.inf):
    """Locate the branch point near a point.

    Parameters
    ----------
    problem : Problem
        The problem.
    z : ndarray
        Approximate branch point.
    args : Any
        Further argument of its functions.
    max_distance : float or array_like, optional
        Largest distance of each unknown from `z`.

    Returns
    -------
    PointSolution
        The branch point.

    Notes
    -----
    Unknowns are z and an unfolding parameter mu that vanishes at the solution of ``F + mu b = 0``, g = 0 and
    ``w F_p = 0``. This system is regular at pitchforks too.
    """
    n_unknowns = len(z) - 1

    def system(y):
        z = y[:-1]
        residual, jacobian = _evaluate_numpy(problem, z, args)
        left_null, bordered_value, right_null, solve_bordered = _bordered_null_vectors(jacobian[:, :-1], border)
        transversal = np.append(-solve_bordered(jacobian[:, -1]), 1.0)
        null_gradient, transversal_gradient = bilinear_gradients(
            problem, z, args, left_null, [np.append(right_null, 0.0), transversal]
        )
        matrix = np.zeros((n_unknowns + 2, n_unknowns + 2))
        matrix[:n_unknowns, :-1], matrix[:n_unknowns, -1], matrix[n_unknowns:, :-1] = (
            jacobian,
            border[0],
            [-null_gradient, transversal_gradient],
        )
        return np.concatenate([residual + y[-1] * border[0], [bordered_value, left_null @ jacobian[:, -1]]]), matrix

    border = _border_vectors(_evaluate_numpy(problem, z, args)[1][:, :-1])
    solution = solve_newton(system, np.append(z, 0.0), np.append(np.broadcast_to(max_distance, z.shape), np.inf))
    is_branch_point = solution.z is not None and abs(solution.z[-1]) <= STEP_TOLERANCE * (1.0 + abs(solution.z).max())
    return PointSolution(solution.z[:-1], solution.residual) if is_branch_point else PointSolution(None, np.nan)


def locate_singularity(problem, test, z, args, max_distance=np.inf):
    """Locate the point near z where the matrix of a `TestFunction` is singular.

    Parameters
    ----------
    problem : Problem
        The problem.
    test : TestFunction
        Test function.
    z : ndarray
        Approximate point.
    args : Any
        Further argument of its functions.
    max_distance : float or array_like, optional
        Largest distance of each unknown from `z`.

    Returns
    -------
    PointSolution
        The point.
    """

    def system(z):
        residual, jacobian = _evaluate_numpy(problem, z, args)
        matrix, matrix_derivative = matrix_and_derivative(problem, test, z, args)
        left_null, bordered_value, right_null, _ = _bordered_null_vectors(matrix, border)
        return np.append(residual, bordered_value), np.vstack(
            [jacobian, -np.einsum("i,ijk,j->k", left_null, matrix_derivative, right_null)]
        )

    border = _border_vectors(matrix_and_derivative(problem, test, z, args)[0])
    return solve_newton(system, z, max_distance)


def solve_newton(system, start, max_distance=np.inf):
    """Solve a small system by Newton's method in NumPy.

    Parameters
    ----------
    system : callable
        Function of y that returns (value, derivative).
    start : ndarray
        Initial guess.
    max_distance : float or array_like, optional
        Largest distance of each unknown from the start; the iteration fails beyond.

    Returns
    -------
    PointSolution
        The zero near the start.
    """
    y, previous_step = start, np.inf
    for _ in range(MAX_NEWTON_STEPS):
        try:
            value, jacobian = system(y)
            change = np.linalg.solve(jacobian, value)
        except np.linalg.LinAlgError:  # a singular matrix, possibly inside `system`
            break
        y, step = y - change, abs(change).max()
        if not np.isfinite(step) or (abs(y - start) > max_distance).any():
            break
        if previous_step <= STEP_TOLERANCE * (1.0 + abs(y).max()):
            return PointSolution(y, float(abs(value).max()))
        previous_step = step
    return PointSolution(None, np.nan)


def _evaluate_numpy(problem, z, args):
    return tuple(np.asarray(array) for array in evaluate(problem, z, args))


def _border_vectors(matrix):
    """Return (b, c), the nearly null vectors of a matrix's transpose and of the matrix; nan if it is not finite."""
    if not np.isfinite(matrix).all():
        return 2 * (np.full(len(matrix), np.nan),)
    left_vectors, _, right_vectors = np.linalg.svd(matrix)
    return left_vectors[:, -1], right_vectors[-1]


def _bordered_null_vectors(matrix, border):
    """Return (w, g, v) and a function of y that solves ``A x + b s = y``, ``c x = 0`` for x."""
    size = len(matrix)
    bordered = np.zeros((size + 1, size + 1))
    bordered[:size, :size], (bordered[:size, -1], bordered[-1, :size]) = matrix, border
    unit_rhs = np.zeros(size + 1)
    unit_rhs[-1] = 1.0
    right_null, left_null = np.linalg.solve(bordered, unit_rhs), np.linalg.solve(bordered.T, unit_rhs)
    return left_null[:-1], left_null[-1], right_null[:-1], lambda y: np.linalg.solve(bordered, np.append(y, 0.0))[:-1]


def null_vector(matrix):
    """Return the unit null vector of a singular matrix."""
    return _border_vectors(matrix)[1]

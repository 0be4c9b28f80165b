"""Locate special points on minimally augmented systems by Newton's method, and the tangents at branch points.

Let (v, g) solve ``(A, b; c, 0) (v; g) = (0; 1)``, with vectors b and c that make the bordered matrix regular. g is zero
where the matrix A is singular. The gradient of g is ``-w (A') v``, where (w, g) solves the transposed system (Govaerts,
Numerical Methods for Bifurcations of Dynamical Equilibria, 3.3). A branch has few special points. Linear algebra
therefore uses NumPy, gradients use finite differences, and only the functions of the problem are compiled.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from .hostcall import FAST_COMPILE, persistent_jit

MAX_NEWTON_STEPS = 12  # largest number of Newton steps
DIFFERENCE_STEP = 1e-5  # step of central differences, relative to 1 + abs(z)
FOUR_POINT_STEP = 3e-4  # step of four-point differences, relative to 1 + abs(z)
JACOBIAN_BATCH = 8  # number of points at which one call computes derivatives
STEP_TOLERANCE = 1e-9  # Newton step, relative to 1 + abs(z), after which the next step leaves only rounding errors


class RootAndResidual(NamedTuple):
    """Result of locating a special point.

    Attributes
    ----------
    z : ndarray or None
        The point; None if Newton's method does not converge or the root is not valid.
    residual : float
        Largest magnitude of the residuals before the last Newton step; nan if `z` is None.
    """

    z: Float[np.ndarray, " unknowns"] | None
    residual: float


@persistent_jit(static_argnums=0, compiler_options=FAST_COMPILE, numpy_first=True)
def evaluate_problem(problem, z, constants):
    """Evaluate a problem.

    Parameters
    ----------
    problem : Problem
        The problem.
    z : array_like
        Point of shape (n + 1,).
    constants : Any
        Further argument of the functions of the problem.

    Returns
    -------
    tuple
        F and dF/dz.
    """
    return problem.runner(problem.dense_function, z, constants)


@persistent_jit(static_argnums=0, compiler_options=FAST_COMPILE, numpy_first=True)
def _compute_jacobians(problem, zs, n_points, constants):
    return problem.runner(_loop_jacobians, zs, n_points, constants, problem=problem)


def _loop_jacobians(zs, n_points, constants, problem):
    """Compute dF/dz at the first `n_points` points."""

    def store_jacobian(index, jacobians):
        jacobian = problem.dense_function(lax.dynamic_index_in_dim(zs, index, keepdims=False), constants)[1]
        return lax.dynamic_update_index_in_dim(jacobians, jacobian, index, 0)

    shape = len(zs), zs.shape[1] - 1, zs.shape[1]
    return lax.fori_loop(0, n_points, store_jacobian, jnp.zeros(shape, zs.dtype))


def bilinear_gradients(problem, z, constants, left_vector, right_vectors):
    """Compute the gradients of ``left_vector @ F'(z) @ right`` for one or two right vectors.

    Each gradient equals the derivative of ``left_vector @ F'`` in the direction of a right vector, because second
    derivatives commute. Four-point differences approximate the derivatives. One call evaluates all points.
    """
    difference_steps = [
        FOUR_POINT_STEP * (1.0 + abs(z).max()) / abs(right_vector).max() for right_vector in right_vectors
    ]
    z_offsets = [
        step_multiple * difference_step * right_vector
        for difference_step, right_vector in zip(difference_steps, right_vectors, strict=True)
        for step_multiple in (1.0, -1.0, 2.0, -2.0)
    ]
    projected_jacobians = left_vector @ jacobians_at(problem, z + np.stack(z_offsets), constants)
    steps_and_samples = zip(difference_steps, projected_jacobians.reshape(-1, 4, len(z)), strict=True)
    return [
        (8.0 * (sample_plus - sample_minus) - (sample_double_plus - sample_double_minus)) / (12.0 * difference_step)
        for difference_step, (sample_plus, sample_minus, sample_double_plus, sample_double_minus) in steps_and_samples
    ]


def jacobians_at(problem, zs, constants):
    """Compute dF/dz at up to `JACOBIAN_BATCH` points in one call.

    Parameters
    ----------
    problem : Problem
        The problem.
    zs : array_like
        Points of shape (points, n + 1).
    constants : Any
        Further argument of the functions of the problem.

    Returns
    -------
    ndarray
        Derivatives of shape (points, n, n + 1).
    """
    zs = np.asarray(zs)
    padded_zs = np.concatenate([zs, np.repeat(zs[-1:], JACOBIAN_BATCH - len(zs), axis=0)])
    return np.asarray(_compute_jacobians(problem, padded_zs, np.int32(len(zs)), constants))[: len(zs)]


def two_point_derivative(function, z, entry_indices=None):
    """Differentiate a function of z by central differences.

    Parameters
    ----------
    function : callable
        Function of z that returns a number or an array.
    z : ndarray
        Point of shape (n,).
    entry_indices : sequence of int, optional
        Indices of the entries of z on which the function depends. None stands for all.

    Returns
    -------
    ndarray
        Derivative of shape (..., n), accurate to about nine digits. With this derivative, Newton's method needs one
        additional step to reach rounding accuracy.
    """
    indices = list(range(len(z)) if entry_indices is None else entry_indices)
    steps = np.diag(DIFFERENCE_STEP * (1.0 + abs(z)))[indices]
    partial_derivatives = [(function(z + step) - function(z - step)) / (2.0 * step.max()) for step in steps]
    full_derivative = np.zeros((*np.shape(partial_derivatives[0]), len(z)))
    full_derivative[..., indices] = np.stack(partial_derivatives, axis=-1)
    return full_derivative


@persistent_jit(static_argnums=(0, 1), compiler_options=FAST_COMPILE, numpy_first=True)
def _compute_test_matrices(problem, test_function, zs, constants):
    return problem.runner(_evaluate_test_matrices, zs, constants, test_function=test_function)


def _evaluate_test_matrices(zs, constants, test_function):
    return lax.map(lambda z: test_function.matrix(z, constants), zs)


def matrix_and_derivative(problem, test_function, z, constants):
    """Compute the matrix of a `TestFunction` and, by central differences, its derivative of shape (..., len(z))."""
    difference_steps = np.diag(DIFFERENCE_STEP * (1.0 + abs(z)))
    matrix_samples = np.asarray(
        _compute_test_matrices(
            problem, test_function, np.concatenate([z[None], z + difference_steps, z - difference_steps]), constants
        )
    )
    z_size = len(z)
    return matrix_samples[0], np.moveaxis(matrix_samples[1 : z_size + 1] - matrix_samples[z_size + 1 :], 0, -1) / (
        2.0 * np.diag(difference_steps)
    )


def locate_fold(problem, z, constants, max_distance=np.inf):
    """Locate the fold near a point. At a fold the branch turns back in the parameter.

    Parameters
    ----------
    problem : Problem
        The problem.
    z : ndarray
        Approximate fold.
    constants : Any
        Further argument of the functions of the problem.
    max_distance : float or array_like, optional
        Largest distance of each unknown from `z`.

    Returns
    -------
    RootAndResidual
        The fold.
    """

    def augmented_system(z):
        residual, jacobian = evaluate_problem(problem, z, constants)
        left_null_vector, singularity_measure, right_null_vector, _ = bordered_null_vectors(
            jacobian[:, :-1], border_vectors
        )
        (minus_measure_gradient,) = bilinear_gradients(
            problem, z, constants, left_null_vector, [np.append(right_null_vector, 0.0)]
        )
        return np.append(residual, singularity_measure), np.vstack([jacobian, -minus_measure_gradient])

    border_vectors = singular_borders(evaluate_problem(problem, z, constants)[1][:, :-1])
    return solve_newton(augmented_system, z, max_distance)


def locate_branch_point(problem, z, constants, max_distance=np.inf):
    """Locate the branch point near a point.

    Parameters
    ----------
    problem : Problem
        The problem.
    z : ndarray
        Approximate branch point.
    constants : Any
        Further argument of the functions of the problem.
    max_distance : float or array_like, optional
        Largest distance of each unknown from `z`.

    Returns
    -------
    RootAndResidual
        The branch point.

    Notes
    -----
    The unknowns are z and an unfolding parameter mu. The equations are ``F + mu b = 0``, ``g = 0`` and ``w F_p = 0``,
    with b, g and w of the bordered matrix of dF/du. mu is zero at a branch point. The system is also regular at
    pitchforks.
    """
    n_unknowns = len(z) - 1

    def augmented_system(z_and_unfolding):
        z = z_and_unfolding[:-1]
        residual, jacobian = evaluate_problem(problem, z, constants)
        left_null_vector, singularity_measure, right_null_vector, solve_bordered = bordered_null_vectors(
            jacobian[:, :-1], border_vectors
        )
        transversal_vector = np.append(-solve_bordered(jacobian[:, -1]), 1.0)
        minus_measure_gradient, transversal_gradient = bilinear_gradients(
            problem, z, constants, left_null_vector, [np.append(right_null_vector, 0.0), transversal_vector]
        )
        augmented_jacobian = np.zeros((n_unknowns + 2, n_unknowns + 2))
        (
            augmented_jacobian[:n_unknowns, :-1],
            augmented_jacobian[:n_unknowns, -1],
            augmented_jacobian[n_unknowns:, :-1],
        ) = (
            jacobian,
            border_vectors[0],
            [-minus_measure_gradient, transversal_gradient],
        )
        return np.concatenate(
            [
                residual + z_and_unfolding[-1] * border_vectors[0],
                [singularity_measure, left_null_vector @ jacobian[:, -1]],
            ]
        ), augmented_jacobian

    border_vectors = singular_borders(evaluate_problem(problem, z, constants)[1][:, :-1])
    solution = solve_newton(
        augmented_system, np.append(z, 0.0), np.append(np.broadcast_to(max_distance, z.shape), np.inf)
    )
    is_branch_point = solution.z is not None and abs(solution.z[-1]) <= STEP_TOLERANCE * (1.0 + abs(solution.z).max())
    return RootAndResidual(solution.z[:-1], solution.residual) if is_branch_point else RootAndResidual(None, np.nan)


def locate_singularity(problem, test_function, z, constants, max_distance=np.inf):
    """Locate the point near z where the matrix of a `TestFunction` is singular.

    Parameters
    ----------
    problem : Problem
        The problem.
    test_function : TestFunction
        Test function.
    z : ndarray
        Approximate point.
    constants : Any
        Further argument of the functions of the problem.
    max_distance : float or array_like, optional
        Largest distance of each unknown from `z`.

    Returns
    -------
    RootAndResidual
        The point.
    """

    def augmented_system(z):
        residual, jacobian = evaluate_problem(problem, z, constants)
        matrix, matrix_derivative = matrix_and_derivative(problem, test_function, z, constants)
        left_null_vector, singularity_measure, right_null_vector, _ = bordered_null_vectors(matrix, border_vectors)
        return np.append(residual, singularity_measure), np.vstack(
            [jacobian, -np.einsum("i,ijk,j->k", left_null_vector, matrix_derivative, right_null_vector)]
        )

    border_vectors = singular_borders(matrix_and_derivative(problem, test_function, z, constants)[0])
    return solve_newton(augmented_system, z, max_distance)


def directional_derivative(function, z, direction):
    """Return the derivative of a function of z, whose values are numbers, in a direction, by a central difference."""
    z_change = DIFFERENCE_STEP * direction
    return float((function(z + z_change) - function(z - z_change)) / (2.0 * DIFFERENCE_STEP))


def locate_zero(problem, z, constants, zero_functions, entry_indices=None, n_extra=0):
    """Locate the point near z at which F and further functions vanish.

    Parameters
    ----------
    problem : Problem
        The problem.
    z : ndarray
        Guess of shape (n + 1 + n_extra,).
    constants : Any
        Further argument of the functions of the problem.
    zero_functions : callable
        Function of z that returns 1 + n_extra numbers.
    entry_indices : sequence of int, optional
        Entries of z on which `zero_functions` depends. By default all.
    n_extra : int, optional
        Number of last entries of z on which F does not depend.

    Returns
    -------
    RootAndResidual
        The point and the residual.
    """

    def extended_system(z):
        residual, jacobian = evaluate_problem(problem, z[: len(z) - n_extra], constants)
        gradients = two_point_derivative(zero_functions, z, entry_indices)
        return np.append(residual, zero_functions(z)), np.vstack([np.pad(jacobian, ((0, 0), (0, n_extra))), gradients])

    return solve_newton(extended_system, z)


def solve_newton(residual_and_jacobian, initial_guess, max_distance=np.inf):
    """Solve a small system by Newton's method in NumPy.

    Parameters
    ----------
    residual_and_jacobian : callable
        Function of y that returns (value, derivative).
    initial_guess : ndarray
        Initial guess.
    max_distance : float or array_like, optional
        Largest distance of each unknown from the initial guess. The iteration fails beyond this distance.

    Returns
    -------
    RootAndResidual
        The root near the initial guess.
    """
    unknowns, previous_step_size = initial_guess, np.inf
    for _ in range(MAX_NEWTON_STEPS):
        try:
            residual_vector, jacobian = residual_and_jacobian(unknowns)
            minus_change = np.linalg.solve(jacobian, residual_vector)
        except np.linalg.LinAlgError:  # a singular matrix, possibly inside `system`
            break
        unknowns, step_size = unknowns - minus_change, abs(minus_change).max()
        if not np.isfinite(step_size) or (abs(unknowns - initial_guess) > max_distance).any():
            break
        if previous_step_size <= STEP_TOLERANCE * (1.0 + abs(unknowns).max()):
            return RootAndResidual(unknowns, float(abs(residual_vector).max()))
        previous_step_size = step_size
    return RootAndResidual(None, np.nan)


def singular_borders(matrix):
    """Return (b, c), the left and right singular vectors of the smallest singular value of a matrix.

    The entries are nan if the matrix is not finite.
    """
    if not np.isfinite(matrix).all():
        return 2 * (np.full(len(matrix), np.nan),)
    left_singular_vectors, _, right_singular_vectors = np.linalg.svd(matrix)
    return left_singular_vectors[:, -1], right_singular_vectors[-1]


def bordered_null_vectors(matrix, border_vectors):
    """Return (w, g, v) of the bordered matrix, and a function of y that solves ``A x + b s = y``, ``c x = 0`` for x."""
    matrix_size = len(matrix)
    bordered_matrix = np.zeros((matrix_size + 1, matrix_size + 1))
    (
        bordered_matrix[:matrix_size, :matrix_size],
        (bordered_matrix[:matrix_size, -1], bordered_matrix[-1, :matrix_size]),
    ) = matrix, border_vectors
    unit_rhs = np.zeros(matrix_size + 1)
    unit_rhs[-1] = 1.0
    right_null_vector, left_null_vector = (
        np.linalg.solve(bordered_matrix, unit_rhs),
        np.linalg.solve(bordered_matrix.T, unit_rhs),
    )
    return (
        left_null_vector[:-1],
        left_null_vector[-1],
        right_null_vector[:-1],
        lambda y: np.linalg.solve(bordered_matrix, np.append(y, 0.0))[:-1],
    )


def null_vector(matrix):
    """Return the unit null vector of a singular matrix."""
    return singular_borders(matrix)[1]


def branch_tangents(problem, z, scale, constants):
    """Compute the unit tangents of the two branches that cross at a branch point.

    Parameters
    ----------
    problem : Problem
        The problem.
    z : ndarray
        Branch point of shape (n + 1,).
    scale : ndarray
        Weights of the length. Entries with weight 0 are excluded.
    constants : Any
        Further argument of the functions of the problem.

    Returns
    -------
    ndarray
        Tangents of shape (2, n + 1).

    Raises
    ------
    ValueError
        If the algebraic branching equation does not have two distinct real roots, so that no branches cross.

    Notes
    -----
    The tangents lie in the null space of dF/dz. Along them the quadratic form of the left null vector and F'' is zero
    (algebraic branching equation; Keller, Lectures on Numerical Methods in Bifurcation Problems, 5.20).
    """
    jacobian = np.asarray(evaluate_problem(problem, z, constants)[1])
    has_weight = scale > 0
    left_singular_vectors, _, right_singular_vectors = np.linalg.svd(jacobian[:, has_weight] / scale[has_weight])
    null_vectors = np.zeros((2, len(z)))
    null_vectors[:, has_weight] = right_singular_vectors[-2:] / scale[has_weight]
    form_gradients = bilinear_gradients(
        problem, z, constants, left_singular_vectors[:, has_weight.sum() - 2], list(null_vectors)
    )
    quadratic_form = np.stack(form_gradients) @ null_vectors.T
    (form_11, form_12), (_, form_22) = 0.5 * (quadratic_form + quadratic_form.T)
    discriminant = form_12 * form_12 - form_11 * form_22
    if not discriminant > 0:
        raise ValueError("no branches cross: the algebraic branching equation has no real root")
    discriminant_root = np.sqrt(discriminant)
    root_numerator = -form_12 - np.copysign(
        discriminant_root, form_12
    )  # roots s of a s^2 + 2 b s + c = 0, as (s, 1) or (1, 1 / s)
    tangent_coordinates = np.array([[root_numerator, form_11], [form_22, root_numerator]])
    tangents = tangent_coordinates @ null_vectors
    return tangents / np.linalg.norm(scale * tangents, axis=1)[:, None]


def less_aligned_tangent(tangents, known_tangent, scale):
    """Select the tangent, out of two, that is less aligned with a known tangent."""
    alignments = abs((scale * scale * tangents) @ known_tangent)
    return tangents[int(np.argmin(alignments))]


def tangent_through_point(problem, z, scale, constants, tangent_before):
    """Compute the unit tangent of a branch where it passes through a branch point.

    The result is the tangent of `branch_tangents` that is better aligned with `tangent_before`, the tangent before the
    branch point. A continuation step does not give this tangent, because its matrix is singular at the branch point. If
    no branches cross, the result is `tangent_before`.
    """
    try:
        tangents = branch_tangents(problem, z, scale, constants)
    except ValueError:
        return tangent_before
    alignments = (scale * scale * tangents) @ tangent_before
    nearest_index = int(np.argmax(abs(alignments)))
    return np.sign(alignments[nearest_index]) * tangents[nearest_index]

"""Compute the tangents of branches at branch points."""

import numpy as np

from . import augmented_systems


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
    jacobian = np.asarray(augmented_systems.evaluate_problem(problem, z, constants)[1])
    has_weight = scale > 0
    left_singular_vectors, _, right_singular_vectors = np.linalg.svd(jacobian[:, has_weight] / scale[has_weight])
    null_vectors = np.zeros((2, len(z)))
    null_vectors[:, has_weight] = right_singular_vectors[-2:] / scale[has_weight]
    form_gradients = augmented_systems.bilinear_gradients(
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

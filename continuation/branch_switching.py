"""Compute the tangents of branches at branch points."""

import numpy as np

from . import augmented_systems


def branch_tangents(problem, z, scale, args):
    """Compute the unit tangents of the two branches that cross at a branch point.

    Parameters
    ----------
    problem : Problem
        The problem.
    z : ndarray
        Branch point of shape (n + 1,).
    scale : ndarray
        Weights of the length. Entries of weight 0 are left out.
    args : Any
        Further argument of its functions.

    Returns
    -------
    ndarray
        Tangents of shape (2, n + 1).

    Raises
    ------
    ValueError
        If the algebraic branching equation has no real root, so that no branches cross.

    Notes
    -----
    The tangents lie in the plane of null vectors of dF/dz, where the quadratic form of the left null vector and F'' is
    zero (algebraic branching equation; Keller, Lectures on Numerical Methods in Bifurcation Problems, 5.20).
    """
    jacobian = np.asarray(augmented_systems.evaluate(problem, z, args)[1])
    is_used = scale > 0
    left_vectors, _, right_vectors = np.linalg.svd(jacobian[:, is_used] / scale[is_used])
    null_vectors = np.zeros((2, len(z)))
    null_vectors[:, is_used] = right_vectors[-2:] / scale[is_used]
    form_rows = augmented_systems.bilinear_gradients(
        problem, z, args, left_vectors[:, is_used.sum() - 2], list(null_vectors)
    )
    quadratic_form = np.stack(form_rows) @ null_vectors.T
    (a, b), (_, c) = 0.5 * (quadratic_form + quadratic_form.T)
    discriminant = b * b - a * c
    if not discriminant > 0:
        raise ValueError("no branches cross: the algebraic branching equation has no real root")
    discriminant_root = np.sqrt(discriminant)
    root_numerator = -b - np.copysign(discriminant_root, b)  # roots s of a s^2 + 2 b s + c = 0, as (s, 1) or (1, 1 / s)
    null_coordinates = np.array([[root_numerator, a], [c, root_numerator]])
    tangents = null_coordinates @ null_vectors
    return tangents / np.linalg.norm(scale * tangents, axis=1)[:, None]


def farther_tangent(tangents, known_tangent, scale):
    """Return the one of two tangents that is less aligned with a known tangent."""
    alignment = abs((scale * scale * tangents) @ known_tangent)
    return tangents[int(np.argmin(alignment))]


def continued_tangent(problem, z, scale, args, tangent_before):
    """Compute the unit tangent at a branch point of the branch that approaches it.

    It is the one of the two `branch_tangents` that is better aligned with the tangent before the point; the matrix of a
    step is singular there. If no branches cross, it is the tangent before.
    """
    try:
        tangents = branch_tangents(problem, z, scale, args)
    except ValueError:
        return tangent_before
    alignment = (scale * scale * tangents) @ tangent_before
    nearest = int(np.argmax(abs(alignment)))
    return np.sign(alignment[nearest]) * tangents[nearest]

"""Where branches meet: the directions in which they leave."""

import numpy as np

from . import augmented_systems


def branch_tangents(problem, z, scale, args):
    """The unit tangents of the two branches that cross at a branch point, shape (2, n + 1).

    They lie in the plane of null vectors of dF/dz, where the quadratic form left @ F'' is zero (the algebraic branching
    equation; Keller, Lectures on Numerical Methods in Bifurcation Problems, 5.20). Raises ValueError where it has no
    real zero: no branches cross.
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
        raise ValueError("no branches cross here")
    discriminant_root = np.sqrt(discriminant)
    root_numerator = -b - np.copysign(discriminant_root, b)  # a s^2 + 2 b s + c = 0 for (s, 1), or (1, 1 / s)
    null_coordinates = np.array([[root_numerator, a], [c, root_numerator]])
    tangents = null_coordinates @ null_vectors
    return tangents / np.linalg.norm(scale * tangents, axis=1)[:, None]


def farther_tangent(tangents, known_tangent, scale):
    """Of two tangents that which is further from a known one."""
    alignment = abs((scale * scale * tangents) @ known_tangent)
    return tangents[int(np.argmin(alignment))]


def continued_tangent(problem, z, scale, args, tangent_before):
    """The unit tangent at a branch point of the branch that comes there with a tangent before it: of the two
    `branch_tangents` the nearer. Steps have none there, as their matrix is singular; it is that before where none
    cross."""
    try:
        tangents = branch_tangents(problem, z, scale, args)
    except ValueError:
        return tangent_before
    alignment = (scale * scale * tangents) @ tangent_before
    nearest = int(np.argmax(abs(alignment)))
    return np.sign(alignment[nearest]) * tangents[nearest]

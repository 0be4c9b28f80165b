"""Where branches meet: the directions in which they leave."""

import numpy as np

from . import locate


def directions(problem, z, scale, args):
    """The unit tangents of the two branches that cross at a branch point, shape (2, n + 1).

    They lie in the plane of null vectors of dF/dz, where the quadratic form left @ F'' is zero (the algebraic branching
    equation; Keller, Lectures on Numerical Methods in Bifurcation Problems, 5.20). Raises ValueError where it has no
    real zero: no branches cross.
    """
    slopes = np.asarray(locate.evaluated(problem, z, args)[1])
    used = scale > 0
    left, _, right = np.linalg.svd(slopes[:, used] / scale[used])
    plane = np.zeros((2, len(z)))
    plane[:, used] = right[-2:] / scale[used]
    rows = locate.bends(problem, z, args, left[:, used.sum() - 2], list(plane))
    form = np.stack(rows) @ plane.T
    (a, b), (_, c) = 0.5 * (form + form.T)
    inside = b * b - a * c
    if not inside > 0:
        raise ValueError("no branches cross here")
    root = np.sqrt(inside)
    first = -b - np.copysign(root, b)  # a s^2 + 2 b s + c = 0 for (s, 1), or (1, 1 / s)
    pairs = np.array([[first, a], [c, first]])
    found = pairs @ plane
    return found / np.linalg.norm(scale * found, axis=1)[:, None]


def other(tangents, known, scale):
    """Of two tangents that which is further from a known one."""
    alike = abs((scale * scale * tangents) @ known)
    return tangents[int(np.argmin(alike))]


def through(problem, z, scale, args, before):
    """The unit tangent at a branch point of the branch that comes there with a tangent before it: of the two
    `directions` the nearer. Steps have none there, as their matrix is singular; it is that before where none cross.
    """
    try:
        tangents = directions(problem, z, scale, args)
    except ValueError:
        return before
    alike = (scale * scale * tangents) @ before
    nearest = int(np.argmax(abs(alike)))
    return np.sign(alike[nearest]) * tangents[nearest]

"""Special points to rounding: Newton's method on F(z) = 0 and equations of the point, minimally augmented.

Where a matrix A is singular, the g of (A, b; c, 0) (v; g) = (0; 1) is zero, for any b and c that keep the whole from
being so; its gradient is -w (A') v, (w, g) of the transposed system (Govaerts, Numerical Methods for Bifurcations of
Dynamical Equilibria, 3.3). A handful of points of a branch are special: the linear algebra is NumPy's, the gradient
is by differences, and nothing is compiled but the problem's own functions.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from .persistent_jit import SOON, persistent_jit

ROUNDS = 12  # of Newton's steps
APART = 1e-5  # of 1 + abs z: the points of a difference
WIDE = 3e-4  # the same where the points are four
MANY = 8  # points at which slopes are asked for at once
SMALL = 1e-9  # of 1 + abs z: a step from which the next leaves rounding alone


class Located(NamedTuple):
    """z: the point, None where Newton's method led to none; residual: the largest error left in its equations."""

    z: Float[np.ndarray, " unknowns"] | None
    residual: float


def _evaluated(problem, z, args):
    return problem.plain(z, args)


@persistent_jit(static_argnums=0, compiler_options=SOON, numpy_first=_evaluated)
def evaluated(problem, z, args):
    """(F, dF/dz) of a `problem.Problem`."""
    return problem.run(problem.plain, z, args)


def slopes_of(problem, z, args):
    """dF/dz."""
    return np.asarray(evaluated(problem, z, args)[1])


@persistent_jit(static_argnums=0, compiler_options=SOON, numpy_first=True)
def _several(problem, zs, count, args):
    return problem.run(_in_turn, zs, count, args, problem=problem)


def _in_turn(zs, count, args, problem):
    """dF/dz at the first so many of some points."""

    def look(k, found):
        slopes = problem.plain(lax.dynamic_index_in_dim(zs, k, keepdims=False), args)[1]
        return lax.dynamic_update_index_in_dim(found, slopes, k, 0)

    shape = len(zs), zs.shape[1] - 1, zs.shape[1]
    return lax.fori_loop(0, count, look, jnp.zeros(shape, zs.dtype))


def bends(problem, z, args, left, rights):
    """The gradients of left @ F'(z) @ right, F' a derivative, of one or two rights: those of left @ F' in the direction
    of right, as second derivatives commute; by differences over four points each, all in one call."""
    steps = [WIDE * (1.0 + abs(z).max()) / abs(right).max() for right in rights]
    aside = [k * step * right for step, right in zip(steps, rights, strict=True) for k in (1.0, -1.0, 2.0, -2.0)]
    each = left @ slopes_at(problem, z + np.stack(aside), args)
    parts = zip(steps, each.reshape(-1, 4, len(z)), strict=True)
    return [(8.0 * (a - b) - (c - d)) / (12.0 * step) for step, (a, b, c, d) in parts]


def slopes_at(problem, zs, args):
    """dF/dz at some points, `MANY` at most, in one call."""
    zs = np.asarray(zs)
    padded = np.concatenate([zs, np.repeat(zs[-1:], MANY - len(zs), axis=0)])
    return np.asarray(_several(problem, padded, np.int32(len(zs)), args))[: len(zs)]


def differences(function, z, places=None):
    """The derivative of a function of z, a number or some, by central differences: (..., len(z)). places: those in z of
    the numbers that the function depends on, None: all.

    It is right to nine digits or so: Newton's method needs no more to come to rounding, in a step more.
    """
    places = range(len(z)) if places is None else places

    def along(k):
        step = np.zeros(len(z))
        step[k] = APART * (1.0 + abs(z[k]))
        return (function(z + step) - function(z - step)) / (2.0 * step[k])

    slopes = [along(k) for k in places]
    found = np.zeros((*np.shape(slopes[0]), len(z)))
    found[..., list(places)] = np.stack(slopes, axis=-1)
    return found


def _of_each(problem, test, zs, args):
    return _each(zs, args, test)


@persistent_jit(static_argnums=(0, 1), compiler_options=SOON, numpy_first=_of_each)
def _matrices(problem, test, zs, args):
    return problem.run(_each, zs, args, test=test)


def _each(zs, args, test):
    return lax.map(lambda z: test.matrix(z, args), zs)


def matrices(problem, test, z, args):
    """A `problem.Test`'s matrix A at a point, and its derivative by z, by central differences: (A, (..., len(z)))."""
    steps = np.diag(APART * (1.0 + abs(z)))
    found = np.asarray(_matrices(problem, test, np.concatenate([z[None], z + steps, z - steps]), args))
    size = len(z)
    return found[0], np.moveaxis(found[1 : size + 1] - found[size + 1 :], 0, -1) / (2.0 * np.diag(steps))


def fold(problem, z, args, reach=np.inf):
    """The fold near a point, where the branch turns back in the parameter: `Located`. reach: as of `newton`, of z."""

    def system(z):
        value, slopes = _plain(problem, z, args)
        left, gap, right, _ = _nulls(slopes[:, :-1], border)
        (more,) = bends(problem, z, args, left, [np.append(right, 0.0)])
        return np.append(value, gap), np.vstack([slopes, -more])

    border = _border(_plain(problem, z, args)[1][:, :-1])
    return newton(system, z, reach)


def branch_point(problem, z, args, reach=np.inf):
    """The point near where two branches meet: `Located`. reach: as of `newton`, of z.

    Unknowns are z and a misfit mu, zero at the end: F + mu b, g and w F_p are zero. This is regular at pitchforks too.
    """
    size = len(z) - 1

    def system(y):
        z = y[:-1]
        value, slopes = _plain(problem, z, args)
        left, gap, right, solve = _nulls(slopes[:, :-1], border)
        across = np.append(-solve(slopes[:, -1]), 1.0)
        bend, other = bends(problem, z, args, left, [np.append(right, 0.0), across])
        matrix = np.zeros((size + 2, size + 2))
        matrix[:size, :-1], matrix[:size, -1], matrix[size:, :-1] = slopes, border[0], [-bend, other]
        return np.concatenate([value + y[-1] * border[0], [gap, left @ slopes[:, -1]]]), matrix

    border = _border(_plain(problem, z, args)[1][:, :-1])
    found = newton(system, np.append(z, 0.0), np.append(np.broadcast_to(reach, z.shape), np.inf))
    met = found.z is not None and abs(found.z[-1]) <= SMALL * (1.0 + abs(found.z).max())
    return Located(found.z[:-1], found.residual) if met else Located(None, np.nan)


def singular(problem, test, z, args, reach=np.inf):
    """The point near where the matrix of a `problem.Test` is singular: `Located`. reach: as of `newton`, of z."""

    def system(z):
        value, slopes = _plain(problem, z, args)
        matrix, changes = matrices(problem, test, z, args)
        left, gap, right, _ = _nulls(matrix, border)
        return np.append(value, gap), np.vstack([slopes, -np.einsum("i,ijk,j->k", left, changes, right)])

    border = _border(matrices(problem, test, z, args)[0])
    return newton(system, z, reach)


def newton(system, start, reach=np.inf):
    """The zero near a start of a function y -> (value, its derivative): `Located`. reach: how far from the start each
    unknown may come; a zero beyond is not looked for."""
    y, before = start, np.inf
    for _ in range(ROUNDS):
        try:
            value, slopes = system(y)
            change = np.linalg.solve(slopes, value)
        except np.linalg.LinAlgError:  # singular, be it within the system's own equations
            break
        y, step = y - change, abs(change).max()
        if not np.isfinite(step) or (abs(y - start) > reach).any():
            break
        if before <= SMALL * (1.0 + abs(y).max()):
            return Located(y, float(abs(value).max()))
        before = step
    return Located(None, np.nan)


def _plain(problem, z, args):
    return tuple(np.asarray(each) for each in evaluated(problem, z, args))


def _border(matrix):
    """(b, c): the nearly null vectors of a matrix's transpose and of the matrix; nan where it is not finite."""
    if not np.isfinite(matrix).all():
        return 2 * (np.full(len(matrix), np.nan),)
    left, _, right = np.linalg.svd(matrix)
    return left[:, -1], right[-1]


def _nulls(matrix, border):
    """(w, g, v, y -> the solution x of A x + b s = y, c x = 0)."""
    size = len(matrix)
    whole = np.zeros((size + 1, size + 1))
    whole[:size, :size], (whole[:size, -1], whole[-1, :size]) = matrix, border
    unit = np.zeros(size + 1)
    unit[-1] = 1.0
    right, left = np.linalg.solve(whole, unit), np.linalg.solve(whole.T, unit)
    return left[:-1], left[-1], right[:-1], lambda y: np.linalg.solve(whole, np.append(y, 0.0))[:-1]


def null(matrix):
    """The unit null vector of a singular matrix."""
    return _border(matrix)[1]

"""What is continued: F(z) = 0 with z = (u, p), n equations, n unknowns u and one parameter p, and what is watched."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .arclength import bordered

ON_CIRCLE = 1e-6  # so far from the unit circle, or from the real line, is a multiplier not on it


def always(*_):
    """True."""
    return True


class Test(NamedTuple):
    """An event where a square matrix becomes singular. label: of the event; matrix: of (z, args); holds: (dF/du) ->
    whether it is one, where the matrix may be singular for another reason."""

    label: str
    matrix: Callable
    holds: Callable = always


def plainly(function, *arrays, **static):
    """function(*arrays, **static)."""
    return function(*arrays, **static)


class Problem(NamedTuple):
    """Functions of (z, args), of a module or made once: they are what compiled code is kept by.

    function: F and its slopes; solve: (slopes, row, right) -> x, worst, determinant of the slopes and one row more, as
    `arclength.bordered`; plain: F and dF/dz, an (n, n + 1) matrix; tests: what is watched besides folds and branch
    points; run: (function, *arrays, **static) -> its result, within a jit, as the compiler likes it; holds: of (z,
    args), whether a special point that Newton's method comes to is one.
    """

    function: Callable
    solve: Callable
    plain: Callable
    tests: tuple[Test, ...] = ()
    run: Callable = plainly
    holds: Callable = always


def equilibria(residual):
    """The `Problem` of F(u, p, args) = 0."""

    def function(z, args):
        def values(z):
            return residual(z[:-1], z[-1], args)

        return values(z), jax.jacfwd(values)(z)

    return Problem(function, bordered, function)


def fixed_points(move):
    """The `Problem` of the fixed points of a map (u, p, args) -> u: with flips, PD, and Neimark-Sacker points, NS."""

    def function(z, args):
        def values(z):
            return move(z[:-1], z[-1], args) - z[:-1]

        return values(z), jax.jacfwd(values)(z)

    def flip(z, args):
        return function(z, args)[1][:, :-1] + 2.0 * jnp.eye(len(z) - 1)

    def pair(z, args):
        return pairs(function(z, args)[1][:, :-1] + jnp.eye(len(z) - 1))

    return Problem(function, bordered, function, (Test("PD", flip), Test("NS", pair, is_pair)))


def is_pair(slopes):
    """Whether a map less its point has derivative slopes with two complex multipliers on the unit circle: two real ones
    whose product is 1 are none (a neutral saddle)."""
    roots = np.linalg.eigvals(slopes) + 1.0
    return bool(np.any((abs(abs(roots) - 1.0) < ON_CIRCLE) & (abs(roots.imag) > ON_CIRCLE)))


def pairs(matrix):
    """The products of two different eigenvalues less 1 are this matrix's eigenvalues: the bialternate product of the
    matrix with itself, less the identity (Kuznetsov, Elements of Applied Bifurcation Theory, 10.2)."""
    rows, columns = jnp.triu_indices(len(matrix), 1)
    straight = matrix[rows][:, rows] * matrix[columns][:, columns]
    crossed = matrix[rows][:, columns] * matrix[columns][:, rows]
    return straight - crossed - jnp.eye(len(rows))

"""What is continued: F(z) = 0 with z = (u, p), n equations, n unknowns u and one parameter p, and what is watched."""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from . import cycles
from .arclength import bordered
from .errors import typed
from .linear import Eliminated
from .persistent_jit import SOON, persistent_jit

ON_CIRCLE = 1e-6  # so far from the unit circle, or from the real line, is a multiplier not on it


def always(*_):
    """True."""
    return True


class Test(NamedTuple):
    """An event where a square matrix becomes singular. label: of the event; matrix: of (z, args); holds: of (z,
    args), whether it is one, where the matrix may be singular for another reason."""

    label: str
    matrix: Callable[[Any, Any], Float[jax.Array, "size size"]]
    holds: Callable[..., bool] = always


def plainly(function, *arrays, **static):
    """function(*arrays, **static)."""
    return function(*arrays, **static)


class Problem(NamedTuple):
    """Functions of (z, args), of a module or made once: they are what compiled code is kept by.

    function: F and its slopes; solve: (slopes, row, right) -> x, worst, determinant of the slopes and one row more, as
    `arclength.bordered`; plain: F and dF/dz, an (n, n + 1) matrix; tests: what is watched besides folds and branch
    points; run: (function, *arrays, **static) -> its result, within a jit, as the compiler likes it; holds: of (z,
    args), whether a special point that Newton's method comes to is one; at_once: whether it is compiled before its
    first answer, as its loops are too long for Python; noise: the length below which Newton's steps do not
    shrink, as an integrator's steps change.
    """

    function: Callable[[Any, Any], tuple[Float[jax.Array, " unknowns"], Any]]
    solve: Callable[[Any, Float[jax.Array, " z"], Float[jax.Array, " z *sides"]], Eliminated]
    plain: Callable[[Any, Any], tuple[Float[jax.Array, " unknowns"], Float[jax.Array, "unknowns z"]]]
    tests: tuple[Test, ...] = ()
    run: Callable[..., Any] = plainly
    holds: Callable[..., bool] = always
    at_once: bool = False
    noise: float = 0.0


Function = Callable[
    [Float[jax.Array, " unknowns"], dict[str, Any], Any], Float[ArrayLike, " unknowns"]
]  # of (u, p, args)


class System(NamedTuple):
    """Equations with parameters by name. function: of (u, p, args) -> (n,), u of shape (n,), p {name: number}; kind:
    EQUILIBRIA, where the function is to be zero, FIXED_POINTS, where it gives u back after so many times, or ORBITS,
    where u' = function is to be periodic. fly, segments: of ORBITS, (u, time, p, args) -> u that much later, and of
    how many flights a period is. symmetry: S, linear, with S S u = u and function(S u) = S function(u), or None;
    within: whether only solutions with S u = u are looked for."""

    function: Function
    kind: str
    times: int = 1
    fly: Callable[..., Any] | None = None
    segments: int = 1
    symmetry: Callable[[Any], Any] | None = None
    within: bool = False


EQUILIBRIA, FIXED_POINTS, ORBITS = "equilibria", "fixed points", "periodic orbits"
NOISE = 10.0  # times the tolerance of an integrator: Newton's steps on its results become as short


def noise_of(system: System) -> float:
    """The length below which Newton's steps do not shrink: that of an integrator's error; 0 without an integrator."""
    return NOISE * getattr(system.fly, "tolerance", 0.0)


@typed
def equilibria(function: Function, symmetry: Callable[[Any], Any] | None = None) -> System:
    """The `System` of function(u, p, args) = 0: of the equilibria of u' = function. Besides folds (SN) and branch
    points (BP), Hopf points (HB) are watched.

    u: (n,) unknowns; p: {name: number}, the parameters; args: a pytree, whatever the function needs besides, or None.
    symmetry: a linear function S of u, its own inverse, with function(S u) = S function(u). A branch that begins with
    S u = u keeps to that, and where one leaves it with another is a symmetry breaking (SB).

    Raises ContinuationError for what is no function.
    """
    return System(function, EQUILIBRIA, symmetry=symmetry)


@typed
def fixed_points(move: Function, times: int = 1, symmetry: Callable[[Any], Any] | None = None) -> System:
    """The `System` of the fixed points of a map, move(u, p, args) = u, or of the map taken so many times. Besides folds
    (SN) and branch points (BP), period doublings (PD) and Neimark-Sacker points (NS) are watched. Arguments as in
    `equilibria`.

    Raises ContinuationError for what is no function, and times that are no whole number.
    """
    return System(move, FIXED_POINTS, times, symmetry=symmetry)


class Given(NamedTuple):
    """Numbers of a `System` that stay along a branch. others: {name: number}, the other parameters; args."""

    others: dict[str, float]
    args: Any


@lru_cache
def problem_of(system, names):
    """The `Problem` of a `System` along parameters: z = (u, values of the names), args a `Given`."""

    def test(kind, holds=always):
        return Test(kind, partial(singular_matrix, system, kind, names), holds)

    function = partial(equations_at, system, names)
    pair = test("NS", partial(is_pair, system, names))
    tests = (test("HB", partial(is_oscillation, system, names)),) if system.kind == EQUILIBRIA else (test("PD"), pair)
    tests += (test("SB"),) if system.within else ()
    return Problem(function, bordered, function, tests, at_once=system.kind == ORBITS, noise=noise_of(system))


def split(names, z, given):
    """(u, all parameters by name) at z = (u, values of the names)."""
    size = len(z) - len(names)
    return z[:size], {**given.others, **{name: z[size + k] for k, name in enumerate(names)}}


def equations_at(system, names, z, given):
    """(F, dF/dz) at z = (u, values of the names): (n,) and (n, n + names)."""
    if system.kind == ORBITS:
        return cycles.equations(system, names, z, given)
    return residual_at(system, names, z, given), jax.jacfwd(partial(residual_at, system, names))(z, given)


def residual_at(system, names, z, given):
    """What is zero at z."""
    if system.kind == ORBITS:
        return cycles.equations(system, names, z, given)[0]
    start, p = split(names, z, given)
    if system.kind == EQUILIBRIA:
        value = system.function(start, p, given.args)
    else:
        u = start
        for _ in range(system.times):
            u = system.function(u, p, given.args)
        value = u - start
    return halves(system, value)[0] + halves(system, start)[1] if system.within else value


def halves(system, u):
    """(the part of u that the symmetry keeps, that which it reverses)."""
    image = system.symmetry(u)
    return 0.5 * (u + image), 0.5 * (u - image)


def slopes_at(system, names, z, given):
    """Its derivative, (n, n + names)."""
    return equations_at(system, names, z, given)[1]


def linearised(system, names, z, given):
    """The matrix whose eigenvalues say of what kind a solution is: of equilibria the derivative by u, of a map too, of
    periodic orbits the monodromy's, but for the direction of the field."""
    slopes = slopes_at(system._replace(within=False), names, z, given)
    if system.kind == ORBITS:
        u, p = split(names, z, given)
        first = cycles.points_of(u, system.segments * system.times)[0][0]
        return cycles.multiplied(system, slopes, jnp.asarray(system.function(first, p, given.args)))
    square = slopes[:, : -len(names)]
    return square if system.kind == EQUILIBRIA else square + jnp.eye(len(square))


def singular_matrix(system, kind, names, z, given):
    """The matrix that is singular at a special point of a kind, SN, PD, HB, NS or SB. The symmetry splits dF/du in two
    blocks, of what it keeps and what it reverses: the second alone is singular at SB (Werner and Spence, SIAM J. Numer.
    Anal. 21, 388, 1984)."""
    if kind in ("HB", "NS"):
        return (sums if kind == "HB" else products)(linearised(system, names, z, given))
    if kind == "SB":
        slopes = slopes_at(system._replace(within=False), names, z, given)[:, : -len(names)]
        even, odd = jax.vmap(partial(halves, system), 1, 1)(jnp.eye(len(slopes)))
        return odd @ slopes @ odd + even
    slopes = slopes_at(system._replace(within=system.within and kind != "PD"), names, z, given)[:, : -len(names)]
    if kind == "SN":
        return slopes
    return cycles.flipped(system, slopes) if system.kind == ORBITS else slopes + 2.0 * jnp.eye(len(slopes))


@persistent_jit(static_argnums=(0, 1, 2), compiler_options=SOON, numpy_first=True)
def _matrix(system, kind, names, z, given):
    return singular_matrix(system, kind, names, z, given) if kind else linearised(system, names, z, given)


def matrix_at(system, kind, names, z, given):
    """The `singular_matrix` of a kind at one point, of none the `linearised`, for the host."""
    return np.asarray(_matrix(system, kind, names, z, given))


def eigenvalues_at(system, names, z, given):
    """The eigenvalues of the `linearised` at one point."""
    return np.linalg.eigvals(matrix_at(system, "", names, z, given)).astype(complex)


def is_oscillation(system, names, z, given):
    """Whether two complex eigenvalues are on the imaginary axis: two real ones whose sum is 0 are none (a neutral
    saddle)."""
    roots = eigenvalues_at(system, names, z, given)
    size = max(1.0, abs(roots).max())
    return bool(np.any((abs(roots.real) < ON_CIRCLE * size) & (abs(roots.imag) > ON_CIRCLE * size)))


def is_pair(system, names, z, given):
    """Whether two complex multipliers are on the unit circle: two real ones whose product is 1 are none (a neutral
    saddle)."""
    roots = eigenvalues_at(system, names, z, given)
    return bool(np.any((abs(abs(roots) - 1.0) < ON_CIRCLE) & (abs(roots.imag) > ON_CIRCLE)))


def products(matrix):
    """The products of two different eigenvalues less 1 are this matrix's eigenvalues: the bialternate product of the
    matrix with itself, less the identity (Kuznetsov, Elements of Applied Bifurcation Theory, 10.2)."""
    rows, columns = jnp.triu_indices(len(matrix), 1)
    straight = matrix[rows][:, rows] * matrix[columns][:, columns]
    crossed = matrix[rows][:, columns] * matrix[columns][:, rows]
    return straight - crossed - jnp.eye(len(rows))


def sums(matrix):
    """The sums of two different eigenvalues are this matrix's eigenvalues: twice the bialternate product of the matrix
    with the identity (the same place)."""
    rows, columns = jnp.triu_indices(len(matrix), 1)
    unit = jnp.eye(len(matrix))

    def half(i, j, k, m):
        return matrix[i][:, k] * unit[j][:, m]

    straight = half(rows, columns, rows, columns) + half(columns, rows, columns, rows)
    return straight - half(rows, columns, columns, rows) - half(columns, rows, rows, columns)

"""What is continued: F(z) = 0 with z = (u, p), n equations, n unknowns u and one parameter p, and what is watched."""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from . import multiple_shooting
from .arclength import solve_bordered
from .errors import check_types
from .linear_solver import LinearSolution
from .persistent_jit import FAST_COMPILE, persistent_jit

CIRCLE_TOLERANCE = 1e-6  # so far from the unit circle, or from the real line, is a multiplier not on it


def always_true(*_):
    """True."""
    return True


class TestFunction(NamedTuple):
    """An event where a square matrix becomes singular. label: of the event; matrix: of (z, args); is_valid: of (z,
    args), whether it is one, where the matrix may be singular for another reason."""

    label: str
    matrix: Callable[[Any, Any], Float[jax.Array, "size size"]]
    is_valid: Callable[..., bool] = always_true


def call_directly(function, *arguments, **static_arguments):
    """function(*arrays, **static)."""
    return function(*arguments, **static_arguments)


class Problem(NamedTuple):
    """Functions of (z, args), of a module or made once: they are what compiled code is kept by.

    function: F and its slopes; solve: (slopes, row, right) -> x, worst, determinant of the slopes and one row more, as
    `arclength.bordered`; dense_function: F and dF/dz, an (n, n + 1) matrix; test_functions: what is watched besides
    folds and branch points; runner: (function, *arrays, **static) -> its result, within a jit, as the compiler likes
    it; is_valid: of (z, args), whether a special point that Newton's method comes to is one; compile_at_once: whether
    it is compiled before its first answer, as its loops are too long for Python; noise_floor: the length below which
    Newton's steps do not shrink, as an integrator's steps change."""

    function: Callable[[Any, Any], tuple[Float[jax.Array, " unknowns"], Any]]
    solve: Callable[[Any, Float[jax.Array, " z"], Float[jax.Array, " z *sides"]], LinearSolution]
    dense_function: Callable[[Any, Any], tuple[Float[jax.Array, " unknowns"], Float[jax.Array, "unknowns z"]]]
    test_functions: tuple[TestFunction, ...] = ()
    runner: Callable[..., Any] = call_directly
    is_valid: Callable[..., bool] = always_true
    compile_at_once: bool = False
    noise_floor: float = 0.0


SystemFunction = Callable[
    [Float[jax.Array, " unknowns"], dict[str, Any], Any], Float[ArrayLike, " unknowns"]
]  # of (u, p, args)


class System(NamedTuple):
    """Equations with parameters by name. function: of (u, p, args) -> (n,), u of shape (n,), p {name: number}; kind:
    EQUILIBRIA, where the function is to be zero, FIXED_POINTS, where it gives u back after so many times, or ORBITS,
    where u' = function is to be periodic. fly, segments: of ORBITS, (u, time, p, args) -> u that much later, and of
    how many flights a period is. symmetry: S, linear, with S S u = u and function(S u) = S function(u), or None;
    within: whether only solutions with S u = u are looked for."""

    function: SystemFunction
    kind: str
    times: int = 1
    fly: Callable[..., Any] | None = None
    segments: int = 1
    symmetry: Callable[[Any], Any] | None = None
    within: bool = False


EQUILIBRIA, FIXED_POINTS, ORBITS = "equilibria", "fixed points", "periodic orbits"
NOISE_FACTOR = 10.0  # times the tolerance of an integrator: Newton's steps on its results become as short


def noise_floor(system: System) -> float:
    """The length below which Newton's steps do not shrink: that of an integrator's error; 0 without an integrator."""
    return NOISE_FACTOR * getattr(system.fly, "tolerance", 0.0)


@check_types
def equilibria(function: SystemFunction, symmetry: Callable[[Any], Any] | None = None) -> System:
    """The `System` of function(u, p, args) = 0: of the equilibria of u' = function. Besides folds (SN) and branch
    points (BP), Hopf points (HB) are watched.

    u: (n,) unknowns; p: {name: number}, the parameters; args: a pytree, whatever the function needs besides, or None.
    symmetry: a linear function S of u, its own inverse, with function(S u) = S function(u). A branch that begins with
    S u = u keeps to that, and where one leaves it with another is a symmetry breaking (SB).

    Raises ContinuationError for what is no function.
    """
    return System(function, EQUILIBRIA, symmetry=symmetry)


@check_types
def fixed_points(move: SystemFunction, times: int = 1, symmetry: Callable[[Any], Any] | None = None) -> System:
    """The `System` of the fixed points of a map, move(u, p, args) = u, or of the map taken so many times. Besides folds
    (SN) and branch points (BP), period doublings (PD) and Neimark-Sacker points (NS) are watched. Arguments as in
    `equilibria`.

    Raises ContinuationError for what is no function, and times that are no whole number.
    """
    return System(move, FIXED_POINTS, times, symmetry=symmetry)


class Constants(NamedTuple):
    """Numbers of a `System` that stay along a branch. fixed_params: {name: number}, the other parameters; args."""

    fixed_params: dict[str, float]
    args: Any


@lru_cache
def problem_of(system, names):
    """The `Problem` of a `System` along parameters: z = (u, values of the names), args a `Constants`."""

    def make_test(kind, is_valid=always_true):
        return TestFunction(kind, partial(singular_matrix, system, kind, names), is_valid)

    function = partial(residual_and_jacobian, system, names)
    ns_test = make_test("NS", partial(is_neimark_sacker, system, names))
    test_functions = (
        (make_test("HB", partial(is_hopf, system, names)),) if system.kind == EQUILIBRIA else (make_test("PD"), ns_test)
    )
    test_functions += (make_test("SB"),) if system.within else ()
    return Problem(
        function,
        solve_bordered,
        function,
        test_functions,
        compile_at_once=system.kind == ORBITS,
        noise_floor=noise_floor(system),
    )


def split_unknowns(names, z, constants):
    """(u, all parameters by name) at z = (u, values of the names)."""
    n_unknowns = len(z) - len(names)
    return z[:n_unknowns], {**constants.fixed_params, **{name: z[n_unknowns + k] for k, name in enumerate(names)}}


def residual_and_jacobian(system, names, z, constants):
    """(F, dF/dz) at z = (u, values of the names): (n,) and (n, n + names)."""
    if system.kind == ORBITS:
        return multiple_shooting.shooting_equations(system, names, z, constants)
    return residual_at(system, names, z, constants), jax.jacfwd(partial(residual_at, system, names))(z, constants)


def residual_at(system, names, z, constants):
    """What is zero at z."""
    if system.kind == ORBITS:
        return multiple_shooting.shooting_equations(system, names, z, constants)[0]
    u_start, p = split_unknowns(names, z, constants)
    if system.kind == EQUILIBRIA:
        residual = system.function(u_start, p, constants.args)
    else:
        u = u_start
        for _ in range(system.times):
            u = system.function(u, p, constants.args)
        residual = u - u_start
    return symmetric_parts(system, residual)[0] + symmetric_parts(system, u_start)[1] if system.within else residual


def symmetric_parts(system, u):
    """(the part of u that the symmetry keeps, that which it reverses)."""
    image = system.symmetry(u)
    return 0.5 * (u + image), 0.5 * (u - image)


def jacobian_at(system, names, z, constants):
    """Its derivative, (n, n + names)."""
    return residual_and_jacobian(system, names, z, constants)[1]


def stability_matrix(system, names, z, constants):
    """The matrix whose eigenvalues say of what kind a solution is: of equilibria the derivative by u, of a map too, of
    periodic orbits the monodromy's, but for the direction of the field."""
    jacobian = jacobian_at(system._replace(within=False), names, z, constants)
    if system.kind == ORBITS:
        u, p = split_unknowns(names, z, constants)
        first_point = multiple_shooting.points_and_period(u, system.segments * system.times)[0][0]
        return multiple_shooting.transverse_monodromy(
            system, jacobian, jnp.asarray(system.function(first_point, p, constants.args))
        )
    u_jacobian = jacobian[:, : -len(names)]
    return u_jacobian if system.kind == EQUILIBRIA else u_jacobian + jnp.eye(len(u_jacobian))


def singular_matrix(system, kind, names, z, constants):
    """The matrix that is singular at a special point of a kind, SN, PD, HB, NS or SB. The symmetry splits dF/du in two
    blocks, of what it keeps and what it reverses: the second alone is singular at SB (Werner and Spence, SIAM J. Numer.
    Anal. 21, 388, 1984)."""
    if kind in ("HB", "NS"):
        return (bialternate_sum if kind == "HB" else bialternate_product)(stability_matrix(system, names, z, constants))
    if kind == "SB":
        jacobian = jacobian_at(system._replace(within=False), names, z, constants)[:, : -len(names)]
        even_projector, odd_projector = jax.vmap(partial(symmetric_parts, system), 1, 1)(jnp.eye(len(jacobian)))
        return odd_projector @ jacobian @ odd_projector + even_projector
    jacobian = jacobian_at(system._replace(within=system.within and kind != "PD"), names, z, constants)[
        :, : -len(names)
    ]
    if kind == "SN":
        return jacobian
    return (
        multiple_shooting.antiperiodic_jacobian(system, jacobian)
        if system.kind == ORBITS
        else jacobian + 2.0 * jnp.eye(len(jacobian))
    )


@persistent_jit(static_argnums=(0, 1, 2), compiler_options=FAST_COMPILE, numpy_first=True)
def _compute_matrix(system, kind, names, z, constants):
    return singular_matrix(system, kind, names, z, constants) if kind else stability_matrix(system, names, z, constants)


def matrix_at(system, kind, names, z, constants):
    """The `singular_matrix` of a kind at one point, of none the `stability_matrix`, for the host."""
    return np.asarray(_compute_matrix(system, kind, names, z, constants))


def eigenvalues_at(system, names, z, constants):
    """The eigenvalues of the `stability_matrix` at one point."""
    return np.linalg.eigvals(matrix_at(system, "", names, z, constants)).astype(complex)


def is_hopf(system, names, z, constants):
    """Whether two complex eigenvalues are on the imaginary axis: two real ones whose sum is 0 are none (a neutral
    saddle)."""
    eigenvalues = eigenvalues_at(system, names, z, constants)
    scale = max(1.0, abs(eigenvalues).max())
    return bool(
        np.any((abs(eigenvalues.real) < CIRCLE_TOLERANCE * scale) & (abs(eigenvalues.imag) > CIRCLE_TOLERANCE * scale))
    )


def is_neimark_sacker(system, names, z, constants):
    """Whether two complex multipliers are on the unit circle: two real ones whose product is 1 are none (a neutral
    saddle)."""
    eigenvalues = eigenvalues_at(system, names, z, constants)
    return bool(np.any((abs(abs(eigenvalues) - 1.0) < CIRCLE_TOLERANCE) & (abs(eigenvalues.imag) > CIRCLE_TOLERANCE)))


def bialternate_product(matrix):
    """The products of two different eigenvalues less 1 are this matrix's eigenvalues: the bialternate product of the
    matrix with itself, less the identity (Kuznetsov, Elements of Applied Bifurcation Theory, 10.2)."""
    rows, columns = jnp.triu_indices(len(matrix), 1)
    direct_terms = matrix[rows][:, rows] * matrix[columns][:, columns]
    crossed_terms = matrix[rows][:, columns] * matrix[columns][:, rows]
    return direct_terms - crossed_terms - jnp.eye(len(rows))


def bialternate_sum(matrix):
    """The sums of two different eigenvalues are this matrix's eigenvalues: twice the bialternate product of the matrix
    with the identity (the same place)."""
    rows, columns = jnp.triu_indices(len(matrix), 1)
    identity = jnp.eye(len(matrix))

    def kronecker_entries(i, j, k, m):
        return matrix[i][:, k] * identity[j][:, m]

    direct_terms = kronecker_entries(rows, columns, rows, columns) + kronecker_entries(columns, rows, columns, rows)
    return (
        direct_terms - kronecker_entries(rows, columns, columns, rows) - kronecker_entries(columns, rows, rows, columns)
    )

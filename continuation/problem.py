"""Define systems and the problems that are continued: F(z) = 0 with z = (u, p), and their test functions.

A problem has n equations, n unknowns u and one parameter p.
"""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from . import multiple_shooting
from .arclength import solve_bordered
from .errors import ContinuationError, check_types
from .linear_solver import LinearSolution
from .persistent_jit import FAST_COMPILE, persistent_jit

CIRCLE_TOLERANCE = 1e-6  # largest distance from the unit circle or the real line at which a multiplier lies on it


def always_true(*_):
    """Return True for any arguments."""
    return True


class TestFunction(NamedTuple):
    """Test function: a special point lies where a square matrix is singular.

    Attributes
    ----------
    label : str
        Kind of the special point.
    matrix : callable
        Matrix as a function of (z, args).
    is_valid : callable
        Function of (z, args) that returns False if the matrix is singular for another reason.
    """

    label: str
    matrix: Callable[[Any, Any], Float[jax.Array, "size size"]]
    is_valid: Callable[..., bool] = always_true


def call_directly(function, *arguments, **static_arguments):
    """Call a function with the given arguments.

    Parameters
    ----------
    function : callable
        Function to call.
    *arguments : Any
        Its positional arguments.
    **static_arguments : Any
        Its keyword arguments.

    Returns
    -------
    Any
        Result of the function.
    """
    return function(*arguments, **static_arguments)


class Problem(NamedTuple):
    """Equations of a continuation as functions of (z, args).

    Compiled code is cached by these functions, so they must be module-level or created once.

    Attributes
    ----------
    function : callable
        Residual F and its derivative, in a form that `solve` takes.
    solve : callable
        Solver of the system bordered by one row: (derivative, row, right-hand side) -> `LinearSolution`, as
        `arclength.solve_bordered`.
    dense_function : callable
        Residual F and dF/dz as a matrix of shape (n, n + 1).
    test_functions : tuple of TestFunction
        Test functions besides those for folds and branch points.
    runner : callable
        Takes ``(function, *arrays, **static)`` and calls the function inside a jit, in a form that suits the compiler.
    is_valid : callable
        Function of (z, args) that accepts or rejects a located special point.
    compile_at_once : bool
        True if the functions are compiled before the first evaluation, because their loops are too long for Python.
    noise_floor : float
        Length below which Newton's steps do not shrink, because the adaptive steps of an integrator cause noise.
    """

    function: Callable[[Any, Any], tuple[Float[jax.Array, " unknowns"], Any]]
    solve: Callable[[Any, Float[jax.Array, " z"], Float[jax.Array, " z *sides"]], LinearSolution]
    dense_function: Callable[[Any, Any], tuple[Float[jax.Array, " unknowns"], Float[jax.Array, "unknowns z"]]]
    test_functions: tuple[TestFunction, ...] = ()
    runner: Callable[..., Any] = call_directly
    is_valid: Callable[..., bool] = always_true
    compile_at_once: bool = False
    noise_floor: float = 0.0


# Function of (u, p, args).
SystemFunction = Callable[[Float[jax.Array, " unknowns"], dict[str, Any], Any], Float[ArrayLike, " unknowns"]]


class System(NamedTuple):
    """Equations with named parameters.

    Attributes
    ----------
    function : callable
        Function of (u, p, args) that returns an array of shape (n,), with u of shape (n,) and p {name: number}.
    kind : {"equilibria", "fixed points", "periodic orbits"}
        Equilibria are zeros of the function. Fixed points are mapped to themselves by `times` iterations of the
        function. Periodic orbits solve ``u' = function``.
    times : int
        Number of iterations of a map, or of traversals of a periodic orbit.
    fly : callable or None
        Flow of the field of periodic orbits: (u, time, p, args) -> u after this time.
    segments : int
        Number of shooting segments in a period.
    symmetry : callable or None
        Linear symmetry S with S(S(u)) = u and function(S(u)) = S(function(u)).
    within : bool
        True if the solutions are restricted to symmetric solutions, S(u) = u.
    """

    function: SystemFunction
    kind: str
    times: int = 1
    fly: Callable[..., Any] | None = None
    segments: int = 1
    symmetry: Callable[[Any], Any] | None = None
    within: bool = False


EQUILIBRIA, FIXED_POINTS, ORBITS = "equilibria", "fixed points", "periodic orbits"
NOISE_FACTOR = 10.0  # Newton's steps shrink to this multiple of the tolerance of an integrator


def newton_step_floor(system: System) -> float:
    """Return the length below which Newton's steps do not shrink, set by the integrator; 0 if there is none."""
    return NOISE_FACTOR * getattr(system.fly, "tolerance", 0.0)


@check_types
def equilibria(function: SystemFunction, symmetry: Callable[[Any], Any] | None = None) -> System:
    """Define the equilibria of a vector field.

    Solutions satisfy ``function(u, p, args) = 0``. Hopf points (HB) are located besides folds (SN) and branch points
    (BP).

    Parameters
    ----------
    function : callable
        Vector field, a JAX function of (u, p, args): u is an array of shape (n,), p maps names to numbers, args is a
        pytree or None. It returns an array of shape (n,).
    symmetry : callable, optional
        Linear function S of u with S(S(u)) = u and function(S(u)) = S(function(u)). A branch that starts with S(u) = u
        keeps this symmetry. Points at which asymmetric branches emanate are symmetry breakings (SB).

    Returns
    -------
    System
        System for `trace`.

    Raises
    ------
    ContinuationError
        If an argument is not a function.

    See Also
    --------
    fixed_points : Fixed points of a map.

    Examples
    --------
    >>> system = co.equilibria(lambda u, p, args: p["a"] - 0.5 - u * u)
    >>> branch = co.trace(system, [1.0], {"a": 1.5}, "a", bounds=(0.0, 2.0))
    >>> [round(special.p["a"], 6) for special in branch.points("SN")]
    [0.5]
    """
    return System(function, EQUILIBRIA, symmetry=symmetry)


@check_types
def fixed_points(move: SystemFunction, times: int = 1, symmetry: Callable[[Any], Any] | None = None) -> System:
    """Define the fixed points of a map, or of an iterate of it.

    Solutions u return to u after `times` iterations of ``u -> move(u, p, args)``. Period doublings (PD) and
    Neimark-Sacker points (NS) are located besides folds (SN) and branch points (BP).

    Parameters
    ----------
    move : callable
        Map, a JAX function of (u, p, args): u is an array of shape (n,), p maps names to numbers, args is a pytree or
        None. It returns an array of shape (n,).
    times : int, optional
        Number of iterations.
    symmetry : callable, optional
        Linear function S of u with S(S(u)) = u and move(S(u)) = S(move(u)), as in `equilibria`.

    Returns
    -------
    System
        System for `trace`.

    Raises
    ------
    ContinuationError
        If `move` or `symmetry` is not a function, or `times` is not a whole number of at least 1.

    See Also
    --------
    equilibria : Equilibria of a vector field.

    Examples
    --------
    >>> system = co.fixed_points(lambda u, p, args: p["r"] * u * (1 - u))
    >>> branch = co.trace(system, [0.5], {"r": 2.0}, "r", bounds=(1.5, 3.5))
    >>> [round(special.p["r"], 6) for special in branch.points("PD")]
    [3.0]
    """
    if times < 1:
        raise ContinuationError("times", "must be a whole number of at least 1", times)
    return System(move, FIXED_POINTS, times, symmetry=symmetry)


class SystemConstants(NamedTuple):
    """Constants of a `System` along a branch.

    Attributes
    ----------
    fixed_params : dict of str to float
        Values of the other parameters.
    args : Any
        Further argument of the function.
    """

    fixed_params: dict[str, float]
    args: Any


@lru_cache
def make_problem(system, param_names):
    """Make the `Problem` of a `System` in the given parameters.

    Parameters
    ----------
    system : System
        The system.
    param_names : tuple of str
        Continuation parameters.

    Returns
    -------
    Problem
        Problem with z = (u, values of the named parameters); its args are `SystemConstants`.
    """

    def make_test(kind, is_genuine=always_true):
        return TestFunction(kind, partial(singular_matrix, system, kind, param_names), is_genuine)

    function = partial(residual_and_jacobian, system, param_names)
    neimark_sacker_test = make_test("NS", partial(is_neimark_sacker, system, param_names))
    test_functions = (
        (make_test("HB", partial(is_hopf, system, param_names)),)
        if system.kind == EQUILIBRIA
        else (make_test("PD"), neimark_sacker_test)
    )
    test_functions += (make_test("SB"),) if system.within else ()
    return Problem(
        function,
        solve_bordered,
        function,
        test_functions,
        compile_at_once=system.kind == ORBITS,
        noise_floor=newton_step_floor(system),
    )


def split_unknowns(param_names, z, constants):
    """Return u and all parameters by name at z = (u, values of the named parameters)."""
    n_unknowns = len(z) - len(param_names)
    return z[:n_unknowns], {
        **constants.fixed_params,
        **{name: z[n_unknowns + param_index] for param_index, name in enumerate(param_names)},
    }


def residual_and_jacobian(system, param_names, z, constants):
    """Compute F and dF/dz at z = (u, values of the named parameters), shapes (n,) and (n, n + names)."""
    if system.kind == ORBITS:
        return multiple_shooting.shooting_equations(system, param_names, z, constants)
    return residual_at(system, param_names, z, constants), jax.jacfwd(partial(residual_at, system, param_names))(
        z, constants
    )


def residual_at(system, param_names, z, constants):
    """Compute the residual F at z = (u, values of the named parameters), shape (n,).

    For a system that is restricted to symmetric solutions, F is the symmetric part of the residual plus the
    antisymmetric part of u.
    """
    if system.kind == ORBITS:
        return multiple_shooting.shooting_equations(system, param_names, z, constants)[0]
    initial_u, p = split_unknowns(param_names, z, constants)
    if system.kind == EQUILIBRIA:
        residual = system.function(initial_u, p, constants.args)
    else:
        u = initial_u
        for _ in range(system.times):
            u = system.function(u, p, constants.args)
        residual = u - initial_u
    return (
        split_by_symmetry(system, residual)[0] + split_by_symmetry(system, initial_u)[1] if system.within else residual
    )


def split_by_symmetry(system, u):
    """Split u into its symmetric and its antisymmetric part."""
    image = system.symmetry(u)
    return 0.5 * (u + image), 0.5 * (u - image)


def jacobian_at(system, param_names, z, constants):
    """Compute dF/dz, shape (n, n + names)."""
    return residual_and_jacobian(system, param_names, z, constants)[1]


def stability_matrix(system, param_names, z, constants):
    """Compute the matrix whose eigenvalues determine stability.

    The matrix is the derivative of the field or of the map with respect to u. For periodic orbits it is the block of
    the monodromy matrix that is transverse to the field.
    """
    jacobian = jacobian_at(system._replace(within=False), param_names, z, constants)
    if system.kind == ORBITS:
        u, p = split_unknowns(param_names, z, constants)
        first_point = multiple_shooting.points_and_period(u, system.segments * system.times)[0][0]
        return multiple_shooting.transverse_monodromy(
            system, jacobian, jnp.asarray(system.function(first_point, p, constants.args))
        )
    u_jacobian = jacobian[:, : -len(param_names)]
    return u_jacobian if system.kind == EQUILIBRIA else u_jacobian + jnp.eye(len(u_jacobian))


def singular_matrix(system, kind, param_names, z, constants):
    """Compute the matrix that is singular at special points of a kind, SN, PD, HB, NS or SB.

    The symmetry splits dF/du into a symmetric and an antisymmetric block. At SB only the antisymmetric block is
    singular (Werner and Spence, SIAM J. Numer. Anal. 21, 388, 1984).
    """
    if kind in ("HB", "NS"):
        return (bialternate_sum if kind == "HB" else bialternate_product)(
            stability_matrix(system, param_names, z, constants)
        )
    if kind == "SB":
        jacobian = jacobian_at(system._replace(within=False), param_names, z, constants)[:, : -len(param_names)]
        symmetric_projector, antisymmetric_projector = jax.vmap(partial(split_by_symmetry, system), 1, 1)(
            jnp.eye(len(jacobian))
        )
        return antisymmetric_projector @ jacobian @ antisymmetric_projector + symmetric_projector
    jacobian = jacobian_at(system._replace(within=system.within and kind != "PD"), param_names, z, constants)[
        :, : -len(param_names)
    ]
    if kind == "SN":
        return jacobian
    return (
        multiple_shooting.period_doubling_matrix(system, jacobian)
        if system.kind == ORBITS
        else jacobian + 2.0 * jnp.eye(len(jacobian))
    )


@persistent_jit(static_argnums=(0, 1, 2), compiler_options=FAST_COMPILE, numpy_first=True)
def _compute_matrix_of_kind(system, kind, param_names, z, constants):
    return (
        singular_matrix(system, kind, param_names, z, constants)
        if kind
        else stability_matrix(system, param_names, z, constants)
    )


def matrix_of_kind(system, kind, param_names, z, constants):
    """Compute the `singular_matrix` of a kind at one point on the host; the `stability_matrix` if the kind is empty."""
    return np.asarray(_compute_matrix_of_kind(system, kind, param_names, z, constants))


def eigenvalues_at(system, param_names, z, constants):
    """Compute the eigenvalues of the `stability_matrix` at one point."""
    return np.linalg.eigvals(matrix_of_kind(system, "", param_names, z, constants)).astype(complex)


def is_hopf(system, param_names, z, constants):
    """Return True if two complex eigenvalues lie on the imaginary axis.

    The result is False for a neutral saddle: two real eigenvalues with sum 0.
    """
    eigenvalues = eigenvalues_at(system, param_names, z, constants)
    eigenvalue_scale = max(1.0, abs(eigenvalues).max())
    return bool(
        np.any(
            (abs(eigenvalues.real) < CIRCLE_TOLERANCE * eigenvalue_scale)
            & (abs(eigenvalues.imag) > CIRCLE_TOLERANCE * eigenvalue_scale)
        )
    )


def is_neimark_sacker(system, param_names, z, constants):
    """Return True if two complex multipliers lie on the unit circle.

    The result is False for a neutral saddle: two real multipliers with product 1.
    """
    eigenvalues = eigenvalues_at(system, param_names, z, constants)
    return bool(np.any((abs(abs(eigenvalues) - 1.0) < CIRCLE_TOLERANCE) & (abs(eigenvalues.imag) > CIRCLE_TOLERANCE)))


def bialternate_product(matrix):
    """Return the bialternate product of a matrix with itself, less the identity.

    The eigenvalues of the result are the products of all pairs of eigenvalues of the matrix, less 1 (Kuznetsov,
    Elements of Applied Bifurcation Theory, 10.2).
    """
    first_indices, second_indices = jnp.triu_indices(len(matrix), 1)
    direct_terms = matrix[first_indices][:, first_indices] * matrix[second_indices][:, second_indices]
    crossed_terms = matrix[first_indices][:, second_indices] * matrix[second_indices][:, first_indices]
    return direct_terms - crossed_terms - jnp.eye(len(first_indices))


def bialternate_sum(matrix):
    """Return twice the bialternate product of a matrix with the identity.

    The eigenvalues of the result are the sums of all pairs of eigenvalues of the matrix (Kuznetsov, Elements of Applied
    Bifurcation Theory, 10.2).
    """
    first_indices, second_indices = jnp.triu_indices(len(matrix), 1)
    identity = jnp.eye(len(matrix))

    def kronecker_entries(matrix_rows, identity_rows, matrix_columns, identity_columns):
        return matrix[matrix_rows][:, matrix_columns] * identity[identity_rows][:, identity_columns]

    direct_terms = kronecker_entries(first_indices, second_indices, first_indices, second_indices) + kronecker_entries(
        second_indices, first_indices, second_indices, first_indices
    )
    return (
        direct_terms
        - kronecker_entries(first_indices, second_indices, second_indices, first_indices)
        - kronecker_entries(second_indices, first_indices, first_indices, second_indices)
    )

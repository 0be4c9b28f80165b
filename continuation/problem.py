"""Define systems, multiple shooting, and the problems that are continued, F(z) = 0 with z = (u, p).

Compute the equations of periodic orbits of u' = f(u, p) by multiple shooting, for any integrator. The unknowns are m
points x_1 to x_m, evenly spaced in time, and the period T. The flow over T/m maps each point to the next point and the
last point to the first. The phase is arbitrary. The last equation therefore has the value zero, and its gradient is the
normalised field at the points. This equation keeps Newton's changes and tangents orthogonal to the flow, like a
Poincare section through each iterate, and requires no reference orbit. Where dF/du is singular, the left null vector of
dF/du has no component in the last equation, because the field is a null vector of all other equations.

A problem has n equations, n unknowns u and one parameter p.
"""

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from .arclength import solve_bordered
from .errors import ContinuationError, check_types
from .hostcall import FAST_COMPILE, persistent_jit
from .newton import LinearSolution


def points_and_period(u, n_segments):
    """Split unknowns into points of shape (n_segments, n) and the period."""
    return u[:-1].reshape(n_segments, -1), u[-1]


def shooting_equations(system, param_names, z, constants) -> tuple[Any, Any]:
    """Compute (F, dF/dz) at z = (points, period, values of the named parameters)."""
    n_unknowns, n_segments = len(z) - len(param_names), system.segments * system.times
    points = points_and_period(z[:n_unknowns], n_segments)[0]

    def segment_end(segment_inputs):
        p = {
            **constants.fixed_params,
            **{name: segment_inputs[k - len(param_names)] for k, name in enumerate(param_names)},
        }
        end_point = system.fly(
            segment_inputs[: -1 - len(param_names)],
            segment_inputs[-1 - len(param_names)] / n_segments,
            p,
            constants.args,
        )
        return end_point, end_point

    all_segment_inputs = jnp.concatenate([points, jnp.tile(z[n_unknowns - 1 :], (n_segments, 1))], axis=1)
    segment_jacobians, segment_ends = jax.vmap(jax.jacfwd(segment_end, has_aux=True))(all_segment_inputs)
    state_size, shooting_gaps = points.shape[1], segment_ends - jnp.roll(points, -1, axis=0)
    p = {**constants.fixed_params, **{name: z[n_unknowns + k] for k, name in enumerate(param_names)}}
    field_vectors = jax.vmap(lambda x: jnp.asarray(system.function(x, p, constants.args)))(points).reshape(-1)
    jacobian = jnp.zeros((n_unknowns, len(z)), z.dtype)
    for k in range(n_segments):
        segment_slice, next_point_column = (
            slice(state_size * k, state_size * (k + 1)),
            state_size * ((k + 1) % n_segments),
        )
        jacobian = (
            jacobian.at[segment_slice, segment_slice]
            .set(segment_jacobians[k, :, :state_size])
            .at[segment_slice, n_unknowns - 1 :]
            .set(segment_jacobians[k, :, state_size:])
        )
        jacobian = jacobian.at[segment_slice, next_point_column : next_point_column + state_size].add(
            -jnp.eye(state_size)
        )
    jacobian = jacobian.at[-1, : n_unknowns - 1].set(field_vectors / jnp.linalg.norm(field_vectors))
    return jnp.append(shooting_gaps.reshape(-1), 0.0), jacobian


def period_doubling_matrix(system, jacobian):
    """Return the block of dF/dz for antiperiodically closed points; the block is singular if a multiplier is -1."""
    n_coordinates, n_segments = len(jacobian) - 1, system.segments * system.times
    state_size = n_coordinates // n_segments
    return (
        jacobian[:n_coordinates, :n_coordinates]
        .at[n_coordinates - state_size :, :state_size]
        .add(2.0 * jnp.eye(state_size))
    )


def transverse_monodromy(system, jacobian, field_vector):
    """Compute the monodromy matrix transverse to the field, shape (n - 1, n - 1).

    `jacobian` is dF/dz, `field_vector` the field at the first point. The eigenvalues of the result are the multipliers
    without the trivial multiplier. The monodromy matrix maps the direction of the field to itself, so that its
    transverse block is sufficient.
    """
    n_segments = system.segments * system.times
    state_size = (len(jacobian) - 1) // n_segments
    monodromy = jnp.eye(state_size)
    for segment_index in range(n_segments):
        segment_jacobian = jacobian[
            state_size * segment_index : state_size * (segment_index + 1),
            state_size * segment_index : state_size * (segment_index + 1),
        ]
        monodromy = (segment_jacobian + jnp.eye(state_size) if n_segments == 1 else segment_jacobian) @ monodromy
    field_norm = jnp.linalg.norm(field_vector)
    field_direction = field_vector / jnp.where(field_norm > 0, field_norm, 1.0)  # the field vanishes at a Hopf point
    householder_vector = field_direction.at[0].add(jnp.where(field_direction[0] < 0, -1.0, 1.0))
    transverse_basis = (
        jnp.eye(state_size)
        - 2.0 * jnp.outer(householder_vector, householder_vector) / (householder_vector @ householder_vector)
    )[:, 1:]  # Householder reflection
    return transverse_basis.T @ monodromy @ transverse_basis


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

    def test_function(self, label: str) -> TestFunction:
        """Return the test function of a label."""
        return next(test_function for test_function in self.test_functions if test_function.label == label)


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
    values : tuple of float
        Values of the functions that are held constant along the branch.
    """

    fixed_params: dict[str, float]
    args: Any
    values: tuple[float, ...] = ()


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

    kinds = ("HB",) if system.kind == EQUILIBRIA else ("PD", "NS")
    kinds += ("SB",) if system.within else ()
    test_functions = [make_test_function(system, kind, kind, param_names) for kind in kinds]
    function = partial(residual_and_jacobian, system, param_names)
    return make_dense_problem(system, function, test_functions, compile_at_once=system.kind == ORBITS)


def make_test_function(system, label, kind, param_names):
    """Make the `TestFunction` of the `singular_matrix` of a kind; HB and NS must have complex eigenvalues."""
    is_valid = partial(has_critical_pair, system, param_names) if label in ("HB", "NS") else always_true
    return TestFunction(label, partial(singular_matrix, system, kind, param_names), is_valid)


def make_dense_problem(system, function, test_functions, compile_at_once=False):
    """Make the `Problem` of a function of (z, constants) that returns F and dF/dz of a `System`."""
    return Problem(
        function,
        solve_bordered,
        function,
        tuple(test_functions),
        compile_at_once=compile_at_once,
        noise_floor=newton_step_floor(system),
    )


def extend_function(system, param_names, further_function):
    """Return a function of (z, constants): F and dF/dz of a `System` with one or more further equations appended."""

    def extended_function(z, constants):
        residual, jacobian = residual_and_jacobian(system, param_names, z, constants)
        gradients = jnp.atleast_2d(jax.jacfwd(further_function)(z, constants))
        return jnp.append(residual, further_function(z, constants)), jnp.concatenate([jacobian, gradients])

    return extended_function


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
        return shooting_equations(system, param_names, z, constants)
    return residual_at(system, param_names, z, constants), jax.jacfwd(partial(residual_at, system, param_names))(
        z, constants
    )


def residual_at(system, param_names, z, constants):
    """Compute the residual F at z = (u, values of the named parameters), shape (n,).

    For a system that is restricted to symmetric solutions, F is the symmetric part of the residual plus the
    antisymmetric part of u.
    """
    if system.kind == ORBITS:
        return shooting_equations(system, param_names, z, constants)[0]
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


def stability_matrix(system, param_names, z, constants):
    """Compute the matrix whose eigenvalues determine stability.

    The matrix is the derivative of the field or of the map with respect to u. For periodic orbits it is the block of
    the monodromy matrix that is transverse to the field.
    """
    _, jacobian = residual_and_jacobian(system._replace(within=False), param_names, z, constants)
    if system.kind == ORBITS:
        u, p = split_unknowns(param_names, z, constants)
        first_point = points_and_period(u, system.segments * system.times)[0][0]
        return transverse_monodromy(system, jacobian, jnp.asarray(system.function(first_point, p, constants.args)))
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
        _, derivative = residual_and_jacobian(system._replace(within=False), param_names, z, constants)
        jacobian = derivative[:, : -len(param_names)]
        symmetric_projector, antisymmetric_projector = jax.vmap(partial(split_by_symmetry, system), 1, 1)(
            jnp.eye(len(jacobian))
        )
        return antisymmetric_projector @ jacobian @ antisymmetric_projector + symmetric_projector
    restricted_system = system._replace(within=system.within and kind != "PD")
    jacobian = residual_and_jacobian(restricted_system, param_names, z, constants)[1][:, : -len(param_names)]
    if kind == "SN":
        return jacobian
    return (
        period_doubling_matrix(system, jacobian) if system.kind == ORBITS else jacobian + 2.0 * jnp.eye(len(jacobian))
    )


@persistent_jit(static_argnums=(0, 1, 2), compiler_options=FAST_COMPILE, numpy_first=True)
def matrix_of_kind(system, kind, param_names, z, constants):
    """Compute the `singular_matrix` of a kind at one point on the host; the `stability_matrix` if the kind is empty."""
    if kind:
        return singular_matrix(system, kind, param_names, z, constants)
    return stability_matrix(system, param_names, z, constants)


def eigenvalues_at(system, param_names, z, constants):
    """Compute the eigenvalues of the `stability_matrix` at one point."""
    return np.linalg.eigvals(matrix_of_kind(system, "", param_names, z, constants)).astype(complex)


def distance_from_criticality(system, eigenvalues):
    """Return the distances of eigenvalues from the imaginary axis, or of multipliers from the unit circle."""
    return abs(eigenvalues.real) if system.kind == EQUILIBRIA else abs(abs(eigenvalues) - 1.0)


def has_critical_pair(system, param_names, z, constants):
    """Return True if two complex eigenvalues lie on the imaginary axis, or two complex multipliers on the unit circle.

    The result is False for a neutral saddle: two real eigenvalues with sum 0, or two real multipliers with product 1.
    """
    eigenvalues = eigenvalues_at(system, param_names, z, constants)
    eigenvalue_scale = max(1.0, abs(eigenvalues).max()) if system.kind == EQUILIBRIA else 1.0
    is_critical = distance_from_criticality(system, eigenvalues) < CIRCLE_TOLERANCE * eigenvalue_scale
    return bool(np.any(is_critical & (abs(eigenvalues.imag) > CIRCLE_TOLERANCE * eigenvalue_scale)))


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

    It is the derivative of `bialternate_product` at the identity. The eigenvalues of the result are the sums of all
    pairs of eigenvalues of the matrix (Kuznetsov, Elements of Applied Bifurcation Theory, 10.2).
    """
    return jax.jvp(bialternate_product, (jnp.eye(len(matrix)),), (matrix,))[1]

"""Differentiate roots of F(u, p, constants) = 0 as functions of p by the implicit function theorem.

Any algorithm may compute the root, because only F is differentiated: ``u' = -F_u^-1 F_p``. Repeated differentiation
gives derivatives of any order. Derivatives are computed in forward mode (`force_forward_mode`), so that F may
contain loops of data-dependent length. The constants are a pytree.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import sequential_vmap
from jaxtyping import Float

from .array_type import Array
from .newton import solve
from .problem import call_directly

Unknowns = Float[Array, " unknowns"]
Parameters = Float[Array, " numbers"]
Runner = Callable[..., Any]  # calls (function, *arrays), as `problem.Problem.runner`


def root_derivatives(jacobian, parameter_jacobian, solve_system=np.linalg.solve):
    """Return du/dp of a root u of F(u, p) = 0.

    Parameters
    ----------
    jacobian : array
        Derivative of F with respect to u, array of shape (unknowns, unknowns).
    parameter_jacobian : array
        Derivative of F with respect to p, array of shape (unknowns, numbers).
    solve_system : callable, optional
        Function of (matrix, right sides). By default that of NumPy, which raises LinAlgError for a singular matrix.

    Returns
    -------
    array
        Derivatives, array of shape (unknowns, numbers).
    """
    return -solve_system(jacobian, parameter_jacobian)


def _solve_traced(matrix, right_sides):
    return solve(matrix, right_sides).x


def make_lane_loop_function(function: Callable[..., Any], runner: Runner = call_directly) -> Callable[..., Any]:
    """Make a function whose vmap is a loop over lanes.

    Lanes are the elements of a batch. They do not wait for each other, and the compiled program is small.

    Parameters
    ----------
    function : callable
        Function of arrays of one lane.
    runner : callable, optional
        Calls (function, arrays), as `problem.Problem.runner`.

    Returns
    -------
    callable
        Function with the same arguments and result.
    """
    return sequential_vmap(lambda *arrays: runner(function, *arrays))


def force_forward_mode(
    function: Callable[[Parameters, Any], Any], runner: Runner = call_directly
) -> Callable[[Parameters, Any], Any]:
    """Make a function of (vector, constants) whose derivatives by the vector are computed in forward mode.

    Parameters
    ----------
    function : callable
        Function of (vector, constants).
    runner : callable, optional
        Calls (function, arrays), as `problem.Problem.runner`.

    Returns
    -------
    callable
        Function of (vector, constants). Derivatives of any order, also in reverse mode, use the full Jacobian from
        forward mode.
    """
    primal_function = jax.custom_jvp(make_lane_loop_function(function, runner))

    @primal_function.defjvp
    def jvp_rule(primals, tangents):
        (vector, constants), (vector_tangent, _) = primals, tangents
        forward_jacobians = force_forward_mode(jax.jacfwd(function), runner)(vector, constants)
        return primal_function(vector, constants), jax.tree.map(
            lambda derivative: derivative @ vector_tangent, forward_jacobians
        )

    return primal_function


def make_implicit_root(
    function: Callable[[Unknowns, Parameters, Any], Unknowns],
    find_root: Callable[[Parameters, Any], tuple[Unknowns, Any]],
    runner: Runner = call_directly,
) -> Callable[[Parameters, Any], tuple[Unknowns, Any]]:
    """Make a differentiable root function of (p, constants).

    Parameters
    ----------
    function : callable
        F of (u, p, constants), with as many entries as u.
    find_root : callable
        Function of (p, constants) that returns (u, aux): a root u of F, if one exists, and a pytree of real numbers.
    runner : callable, optional
        Calls (function, arrays), as `problem.Problem.runner`.

    Returns
    -------
    callable
        Function of (p, constants) that returns (u, aux). u has derivatives with respect to p of any order, in forward
        and reverse mode; aux counts as constant.
    """
    primal_root_function = jax.custom_jvp(make_lane_loop_function(find_root, runner))

    @primal_root_function.defjvp
    def jvp_rule(primals, tangents):
        (p, constants), (tangent, _) = primals, tangents
        u, aux = primal_root_function(p, constants)

        def root_jacobian(root_and_params, constants):
            n_unknowns = len(u)
            jacobian = jax.jacfwd(lambda z: function(z[:n_unknowns], z[n_unknowns:], constants))(root_and_params)
            return root_derivatives(jacobian[:, :n_unknowns], jacobian[:, n_unknowns:], _solve_traced)

        tangent = force_forward_mode(root_jacobian, runner)(jnp.concatenate([u, p]), constants) @ tangent
        return (u, aux), (tangent, jax.tree.map(jnp.zeros_like, aux))

    return primal_root_function


class RootContinuation(NamedTuple):
    """Result of the continuation of a root.

    Attributes
    ----------
    u : Array
        Root at the end of the line, of shape (n,). If no root was found there, u is the last root along the line.
    residual : Array
        Largest magnitude of the entries of F before the last Newton step.
    kind : Array
        CONTINUED if the path is complete. JUMPED if the path is interrupted and Newton's method converged from its last
        point, so that u may be another root. FAILED if no root was found.
    """

    u: Unknowns
    residual: Float[Array, ""]
    kind: Float[Array, ""]


TRACKING, RESTARTED, CONTINUED, JUMPED, FAILED = range(5)
MIN_STRIDE = 1.0 / 64.0  # smallest stride, as a fraction of the line
CORRECTION_FACTOR = 0.5  # largest correction, relative to the predicted change
CORRECTION_OFFSET = 1e-2  # correction, relative to 1 + the largest unknown, that is always accepted
MAX_NEWTON_STEPS = 12  # Newton steps after a stride; three times as many after a restart


class _PathState(NamedTuple):
    """State of the loop in `continue_root`.

    Attributes
    ----------
    u : Array
        Newton iterate at `trial_fraction`. Array of shape (n,).
    guess : Array
        Initial guess of Newton's method at `trial_fraction`.
    trial_fraction : Array
        Fraction of the line at which a root is computed.
    n_steps : Array
        Number of Newton steps from the guess.
    step : Array
        Largest magnitude of the entries of the last Newton step.
    root : Array
        Last accepted root.
    tangent : Array
        Derivative of the root with respect to the fraction, at the last accepted root.
    last_fraction : Array
        Fraction of the line at the last accepted root.
    residual : Array
        Largest magnitude of the entries of F before the last step of the last completed Newton iteration.
    kind : Array
        TRACKING, RESTARTED, CONTINUED, JUMPED or FAILED.
    """

    u: Unknowns
    guess: Unknowns
    trial_fraction: Float[Array, ""]
    n_steps: Float[Array, ""]
    step: Float[Array, ""]
    root: Unknowns
    tangent: Unknowns
    last_fraction: Float[Array, ""]
    residual: Float[Array, ""]
    kind: Float[Array, ""]


def continue_root(
    function: Callable[[Unknowns, Parameters, Any], Unknowns],
    start_root: Unknowns,
    start_params: Parameters,
    end_params: Parameters,
    constants: Any,
) -> RootContinuation:
    """Continue a root along the straight line from `start_params` to `end_params`.

    Parameters
    ----------
    function : callable
        F of (u, p, constants).
    start_root : Array
        Root at `start_params`. Array of shape (n,).
    start_params : Array
        Parameters at the start.
    end_params : Array
        Parameters at the end.
    constants : Any
        Pytree of constants.

    Returns
    -------
    RootContinuation
        The root at `end_params`.

    Notes
    -----
    The first stride covers the whole line. A stride is halved if Newton's method fails or its correction exceeds a
    bound that depends on the predicted change. Otherwise the next stride is twice as long. If the stride becomes too
    short, Newton's method is applied at the end of the line, starting at the last root. F occurs once in a single loop,
    so that it is compiled once and lanes do not wait for each other.
    """
    n_unknowns = len(start_root)

    def residual_at_fraction(root_and_fraction):
        residual_vector = function(
            root_and_fraction[:n_unknowns],
            start_params + root_and_fraction[n_unknowns] * (end_params - start_params),
            constants,
        )
        return residual_vector, residual_vector

    def advance_path(state):
        jacobian, residual_vector = jax.jacfwd(residual_at_fraction, has_aux=True)(
            jnp.append(state.u, state.trial_fraction)
        )
        solution = solve(jacobian[:, :n_unknowns], jnp.stack([residual_vector, jacobian[:, n_unknowns]], 1)).x
        return _next_path_state(state, residual_vector, solution)

    zero = jnp.zeros((), start_root.dtype)
    initial_state = _PathState(
        start_root,
        start_root,
        zero,
        zero,
        zero + jnp.inf,
        start_root,
        0.0 * start_root,
        zero,
        zero + jnp.nan,
        zero + TRACKING,
    )
    final_state = lax.while_loop(lambda state: state.kind < CONTINUED, advance_path, initial_state)
    return RootContinuation(final_state.root, final_state.residual, final_state.kind)


def _next_path_state(state, residual_vector, solution):
    """Return the `_PathState` after a step of Newton's method.

    `solution` contains the negative Newton step and the negative derivative of the root with respect to the fraction.
    """
    eps = jnp.finfo(state.root.dtype).eps
    u, step_size, root_scale = (
        state.u - solution[:, 0],
        jnp.max(abs(solution[:, 0])),
        1.0 + jnp.max(abs(state.root)),
    )
    is_tracking, converged, n_steps = (
        state.kind == TRACKING,
        state.step <= eps**0.7 * root_scale,
        state.n_steps + 1.0,
    )
    max_correction = CORRECTION_FACTOR * jnp.max(abs(state.guess - state.root)) + CORRECTION_OFFSET * root_scale
    is_newton_finished = (
        ~jnp.isfinite(step_size)
        | converged
        | (n_steps >= jnp.where(is_tracking, MAX_NEWTON_STEPS, 3 * MAX_NEWTON_STEPS))
    )
    is_acceptable = (
        converged & jnp.isfinite(step_size) & (~is_tracking | (jnp.max(abs(u - state.guess)) <= max_correction))
    )
    next_stride = jnp.where(
        is_acceptable,
        jnp.where(state.trial_fraction > 0, 2.0 * (state.trial_fraction - state.last_fraction), 1.0),
        0.5 * (state.trial_fraction - state.last_fraction),
    )
    root, tangent = (
        jnp.where(is_acceptable, *new_and_old_value)
        for new_and_old_value in ((u, state.root), (-solution[:, 1], state.tangent))
    )
    fraction = jnp.where(is_acceptable, state.trial_fraction, state.last_fraction)
    kind_if_path_ends = jnp.where(
        is_tracking, jnp.where(is_acceptable, CONTINUED, RESTARTED), jnp.where(is_acceptable, JUMPED, FAILED)
    )
    keeps_tracking = is_tracking & jnp.where(is_acceptable, fraction < 1.0, next_stride >= MIN_STRIDE)
    kind = jnp.where(is_newton_finished & ~keeps_tracking, kind_if_path_ends, state.kind)
    trial_fraction = jnp.where(keeps_tracking, jnp.minimum(1.0, fraction + next_stride), 1.0)
    guess = root + jnp.where(keeps_tracking, trial_fraction - fraction, 0.0) * tangent
    next_stride_state = _PathState(
        guess,
        guess,
        trial_fraction,
        0.0 * n_steps,
        jnp.inf * n_steps,
        root,
        tangent,
        fraction,
        jnp.max(abs(residual_vector)),
        kind,
    )
    next_newton_state = state._replace(u=u, n_steps=n_steps, step=step_size)
    return jax.tree.map(
        lambda restarted_leaf, advanced_leaf: jnp.where(is_newton_finished, restarted_leaf, advanced_leaf),
        next_stride_state,
        next_newton_state,
    )

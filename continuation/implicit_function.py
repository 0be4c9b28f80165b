"""Differentiate roots of F(u, p, fixed) = 0 as functions of p by the implicit function theorem.

Any algorithm may compute the root; only F is differentiated: ``u' = -F_u^-1 F_p``. Repeated differentiation gives
derivatives of any order. They are computed in forward mode (`forward_differentiable`), so that F may contain loops of
data-dependent length. `fixed` is a pytree of constants.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import sequential_vmap
from jaxtyping import Float

from .array_type import Array
from .linear_solver import solve
from .problem import call_directly

Unknowns = Float[Array, " unknowns"]
Parameters = Float[Array, " numbers"]
Runner = Callable[..., Any]  # calls (function, *arrays), as `problem.Problem.runner`


def loop_over_lanes(function: Callable[..., Any], runner: Runner = call_directly) -> Callable[..., Any]:
    """Make a function whose vmap is a loop over lanes.

    Lanes do not wait for each other, and the compiled program is small.

    Parameters
    ----------
    function : callable
        Function of arrays of one lane.
    runner : callable, optional
        Calls (function, arrays), as `problem.Problem.runner`.

    Returns
    -------
    callable
        The function.
    """
    return sequential_vmap(lambda *arrays: runner(function, *arrays))


def forward_differentiable(
    function: Callable[[Parameters, Any], Any], runner: Runner = call_directly
) -> Callable[[Parameters, Any], Any]:
    """Make a function of (vector, fixed) whose derivatives with respect to the vector are computed in forward mode.

    Parameters
    ----------
    function : callable
        Function of (vector, fixed).
    runner : callable, optional
        Calls (function, arrays), as `problem.Problem.runner`.

    Returns
    -------
    callable
        The function. Derivatives of any order, in reverse mode too, use the full Jacobian from forward mode.
    """
    primal_function = jax.custom_jvp(loop_over_lanes(function, runner))

    @primal_function.defjvp
    def _(primals, tangents):
        (z, constants), (z_tangent, _) = primals, tangents
        derivatives = forward_differentiable(jax.jacfwd(function), runner)(z, constants)
        return primal_function(z, constants), jax.tree.map(lambda derivative: derivative @ z_tangent, derivatives)

    return primal_function


def implicit_root(
    function: Callable[[Unknowns, Parameters, Any], Unknowns],
    find_root: Callable[[Parameters, Any], tuple[Unknowns, Any]],
    runner: Runner = call_directly,
) -> Callable[[Parameters, Any], tuple[Unknowns, Any]]:
    """Make a differentiable root function of (p, fixed).

    Parameters
    ----------
    function : callable
        F of (u, p, fixed), with as many entries as u.
    find_root : callable
        Function of (p, fixed) that returns (u, aux): a root u of F, if there is one, and a pytree of real numbers.
    runner : callable, optional
        Calls (function, arrays), as `problem.Problem.runner`.

    Returns
    -------
    callable
        Function of (p, fixed) that returns (u, aux). u has derivatives with respect to p of any order, in forward and
        reverse mode; aux counts as constant.
    """
    primal_root = jax.custom_jvp(loop_over_lanes(find_root, runner))

    @primal_root.defjvp
    def _(primals, tangents):
        (p, constants), (tangent, _) = primals, tangents
        u, aux = primal_root(p, constants)

        def implicit_derivative(z, constants):
            n_unknowns = len(u)
            jacobian = jax.jacfwd(lambda z: function(z[:n_unknowns], z[n_unknowns:], constants))(z)
            return -solve(jacobian[:, :n_unknowns], jacobian[:, n_unknowns:]).x

        tangent = forward_differentiable(implicit_derivative, runner)(jnp.concatenate([u, p]), constants) @ tangent
        return (u, aux), (tangent, jax.tree.map(jnp.zeros_like, aux))

    return primal_root


class RootContinuation(NamedTuple):
    """Result of the continuation of a root.

    Attributes
    ----------
    u : Array
        Root of shape (n,).
    residual : Array
        Largest entry of F.
    kind : Array
        CONTINUED; JUMPED if Newton's method converged from the last point of an interrupted path, so that u may be
        another root; FAILED if no root was found.
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
    """State of the loop: Newton iterate `u` from `guess` at `trial_fraction`; last root, its tangent and fraction."""

    u: Unknowns
    guess: Unknowns
    trial_fraction: Float[Array, ""]
    n_steps: Float[Array, ""]
    step: Float[Array, ""]
    root: Unknowns
    tangent: Unknowns
    fraction: Float[Array, ""]
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
    The first stride covers the whole line. A stride is halved if Newton's method fails or its correction is larger than
    the tangent predicts. If the stride becomes too short, Newton's method starts from the last root at the end of the
    line. F occurs once in one loop: it is compiled once, and lanes do not wait for each other.
    """
    n_unknowns, eps = len(start_root), jnp.finfo(start_root.dtype).eps

    def residual_with_aux(z):
        value = function(z[:n_unknowns], start_params + z[n_unknowns] * (end_params - start_params), constants)
        return value, value

    def advance(state):
        jacobian, value = jax.jacfwd(residual_with_aux, has_aux=True)(jnp.append(state.u, state.trial_fraction))
        solution = solve(jacobian[:, :n_unknowns], jnp.stack([value, jacobian[:, n_unknowns]], 1)).x
        u, step, scale = state.u - solution[:, 0], jnp.max(abs(solution[:, 0])), 1.0 + jnp.max(abs(state.root))
        is_tracking, converged, n_steps = state.kind == TRACKING, state.step <= eps**0.7 * scale, state.n_steps + 1.0
        max_correction = CORRECTION_FACTOR * jnp.max(abs(state.guess - state.root)) + CORRECTION_OFFSET * scale
        is_finished = (
            ~jnp.isfinite(step)
            | converged
            | (n_steps >= jnp.where(is_tracking, MAX_NEWTON_STEPS, 3 * MAX_NEWTON_STEPS))
        )
        is_acceptable = (
            converged & jnp.isfinite(step) & (~is_tracking | (jnp.max(abs(u - state.guess)) <= max_correction))
        )
        stride = jnp.where(
            is_acceptable,
            jnp.where(state.trial_fraction > 0, 2.0 * (state.trial_fraction - state.fraction), 1.0),
            0.5 * (state.trial_fraction - state.fraction),
        )
        root, tangent = (
            jnp.where(is_acceptable, *new_and_old)
            for new_and_old in ((u, state.root), (-solution[:, 1], state.tangent))
        )
        fraction = jnp.where(is_acceptable, state.trial_fraction, state.fraction)
        end_kind = jnp.where(
            is_tracking, jnp.where(is_acceptable, CONTINUED, RESTARTED), jnp.where(is_acceptable, JUMPED, FAILED)
        )
        keeps_tracking = is_tracking & jnp.where(is_acceptable, fraction < 1.0, stride >= MIN_STRIDE)
        kind = jnp.where(is_finished & ~keeps_tracking, end_kind, state.kind)
        trial_fraction = jnp.where(keeps_tracking, jnp.minimum(1.0, fraction + stride), 1.0)
        guess = root + jnp.where(keeps_tracking, trial_fraction - fraction, 0.0) * tangent
        restarted_state = _PathState(
            guess,
            guess,
            trial_fraction,
            0.0 * n_steps,
            jnp.inf * n_steps,
            root,
            tangent,
            fraction,
            jnp.max(abs(value)),
            kind,
        )
        advanced_state = state._replace(u=u, n_steps=n_steps, step=step)
        return jax.tree.map(
            lambda restarted_leaf, advanced_leaf: jnp.where(is_finished, restarted_leaf, advanced_leaf),
            restarted_state,
            advanced_state,
        )

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
    final_state = lax.while_loop(lambda state: state.kind < CONTINUED, advance, initial_state)
    return RootContinuation(final_state.root, final_state.residual, final_state.kind)

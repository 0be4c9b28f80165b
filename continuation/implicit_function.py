"""Solutions of F(u, p, fixed) = 0 as functions of p: found in whatever way, differentiated as roots, not as iterations.

Of u(p) only F is known: u' = -F_u^-1 F_p (implicit function theorem). Differentiated again this gives the derivatives
of any order. They are taken forward alone (`forward_differentiable`), so that F may hold loops whose length its numbers
decide. fixed is a pytree of what is not differentiated by."""

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
Runner = Callable[..., Any]  # of (function, *arrays): its result, as the compiler likes it (`problem.Problem.run`)


def loop_over_lanes(function: Callable[..., Any], runner: Runner = call_directly) -> Callable[..., Any]:
    """The function of one lane, of which a vmap is a loop over lanes: none waits for another, and what is compiled is
    small."""
    return sequential_vmap(lambda *arrays: runner(function, *arrays))


def forward_differentiable(
    function: Callable[[Parameters, Any], Any], runner: Runner = call_directly
) -> Callable[[Parameters, Any], Any]:
    """The function of (vector, fixed) whose derivatives by the vector are whole arrays, of any order: whatever asks for
    them, and be it in reverse mode, goes through the function forward."""
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
    """(p, fixed) -> (u, told), u with its derivatives by p of any order, forward and reverse.

    function: F of (u, p, fixed), as many numbers as u has; find_root: (p, fixed) -> (u, told), u a root of F where it
    is one at all, told a pytree of real numbers, which count as constants."""
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
    """u; residual: the largest number left in F there; kind: FOLLOWED, JUMPED: Newton's method has led to u from where
    the way was lost, so that it may be another root, or LOST: none was found."""

    u: Unknowns
    residual: Float[Array, ""]
    kind: Float[Array, ""]


TRACKING, RESTARTED, CONTINUED, JUMPED, FAILED = range(5)
MIN_STRIDE = 1.0 / 64.0  # of the way: a stride as short that fails is its end
CORRECTION_FACTOR = 0.5  # of the change that the tangent foretells: a larger correction is not followed
CORRECTION_OFFSET = 1e-2  # of 1 + the largest unknown: but one as small is
MAX_NEWTON_STEPS = 12  # of Newton's steps after a stride; three times as many from afar


class _PathState(NamedTuple):
    """u: where Newton's method is, from a guess, at the place ahead; n_steps, step: of its steps, the last one's size;
    root, tangent: the root at the place share, and its derivative by the place; residual, kind: as of
    `RootContinuation`."""

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
    """The root of F at p = end that the root start at p = begin becomes on the straight way there.

    Where one stride along the tangent is enough it is one; it is halved where Newton's method does not follow, or only
    with a correction that the tangent did not foretell; where it becomes too short Newton's method begins there and
    looks for a root at the end of the way. F stands once in one loop: it is compiled once, and lanes do not wait.
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

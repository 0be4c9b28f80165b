"""Pseudo-arclength continuation: many steps along a branch of F(z) = 0 in one compiled call.

z = (u, p): n unknowns and the parameter, n equations. A step goes along the tangent and comes back to the branch within
the plane across it. Lengths are weighted: the length of dz is that of scale * dz.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import ArrayLike, Bool, Float, Int

from .array_type import Array
from .linear_solver import solve as dense

RUNNING, OUTSIDE, UNDERFLOW, NONFINITE = range(4)
STATUS_TEXTS = ("on", "out of bounds", "step underflow", "not finite")
MAX_NEWTON_STEPS = 8  # of Newton's method in a step
TARGET_ANGLE, MAX_ANGLE = 0.12, 0.3  # angle between tangents that steps aim at; beyond which a step is refused
MAX_STEP_GROWTH, MIN_STEP_GROWTH = 2.0, 0.25  # the most that one step is longer or shorter than the last
ROUNDOFF_FACTOR = (
    16.0  # roundings of 1 + the largest unknown: F as small is zero, and Newton's last change is a rounding's
)
LOOSE_TOLERANCE = (
    5e-10  # largest change accepted where F is zero to rounding: ill-conditioned systems amplify rounding errors
)
MAX_DEVIATION = 0.15  # of a step: so far may the branch lie from its tangent
DISTANCE_FACTOR, DISTANCE_OFFSET = (
    2.0,
    1e-6,
)  # of a step, and a length: Newton's method ends where it is farther than both from its guess


class StepControl(NamedTuple):
    """scale: (n + 1,), weights of a length; min_step, max_step: step; tolerance: of Newton's method, as a length;
    lower, upper: where the parameter ends the branch."""

    scale: Float[Array, "*lanes unknowns"]
    min_step: Float[ArrayLike, "*lanes"]
    max_step: Float[ArrayLike, "*lanes"]
    tolerance: Float[ArrayLike, "*lanes"]
    lower: Float[ArrayLike, "*lanes"]
    upper: Float[ArrayLike, "*lanes"]


class TrackState(NamedTuple):
    """A point of a branch, its unit tangent, the step to try next, and a status: on from here, or why not."""

    z: Float[Array, "*lanes unknowns"]
    tangent: Float[Array, "*lanes unknowns"]
    step: Float[ArrayLike, "*lanes"]
    status: Int[ArrayLike, "*lanes"]


class Point(NamedTuple):
    """A point met. z, tangent: (n + 1,); step: from the last one; residual: the largest entry of F before Newton's last
    step; determinant: of the system with the last tangent as its last row; converged: whether Newton's method came
    there; accepted: whether the step was taken, not too far round a bend."""

    z: Float[Array, "*points unknowns"]
    tangent: Float[Array, "*points unknowns"]
    step: Float[Array, "*points"]
    residual: Float[Array, "*points"]
    determinant: Float[Array, "*points"]
    converged: Bool[ArrayLike, "*points"]
    accepted: Bool[ArrayLike, "*points"]


def solve_bordered(jacobian, last_row, rhs):
    """The system whose rows are an n by n + 1 matrix and one row more, solved: `linear.Eliminated`."""
    return dense(jnp.concatenate([jacobian, last_row[None]]), rhs)


def normalise_tangent(tangent, scale):
    """The tangent with length 1."""
    return tangent / jnp.linalg.norm(scale * tangent)


def correct_step(function, solve, state, step, control, args, allow_far=False):
    """The branch's point a step away along the tangent: (`Point`, cosine of the angle that the tangent has turned by,
    length of Newton's changes).

    function: (z, args) -> (F, slopes); solve: (slopes, row, right) -> x, worst, determinant, as `solve_bordered`.
    """
    tangent_row = control.scale * control.scale * state.tangent
    guess = state.z + step * state.tangent
    tangent_rhs = jnp.zeros_like(guess).at[-1].set(1.0)

    # Beyond `far` a step would be refused, and an evaluation there may take very long: flights of any length.
    max_distance = jnp.where(allow_far | (step == 0), jnp.inf, DISTANCE_FACTOR * abs(step) + DISTANCE_OFFSET)

    def is_unfinished(carry):
        _, _, change, _, _, n_steps = carry
        return (change > control.tolerance) & (n_steps < MAX_NEWTON_STEPS)

    def newton_step(carry):
        z, _, _, _, _, n_steps = carry
        residual_vector, jacobian = function(z, args)
        extended_residual = jnp.concatenate([residual_vector, jnp.sum(tangent_row * (z - guess))[None]])
        solution = solve(jacobian, tangent_row, jnp.stack([extended_residual, tangent_rhs], 1))
        change, tangent = solution.x[:, 0], solution.x[:, 1]
        change_length = jnp.linalg.norm(control.scale * change)
        z = z - change
        is_near = jnp.isfinite(change_length) & (jnp.linalg.norm(control.scale * (z - guess)) <= max_distance)
        change_length, n_steps = (
            jnp.where(is_near, change_length, jnp.inf),
            jnp.where(is_near, n_steps + 1, MAX_NEWTON_STEPS),
        )
        return z, tangent, change_length, jnp.max(abs(residual_vector)), solution.determinant, n_steps

    zero = jnp.zeros_like(step)
    initial = (guess, state.tangent, zero + jnp.inf, zero, zero, 0)
    z, tangent, change, residual, determinant, _ = lax.while_loop(is_unfinished, newton_step, initial)
    at_roundoff = residual <= ROUNDOFF_FACTOR * jnp.finfo(z.dtype).eps * (1.0 + jnp.max(abs(z)))
    converged = (change <= control.tolerance) | (at_roundoff & (change <= LOOSE_TOLERANCE))
    point = Point(z, normalise_tangent(tangent, control.scale), step, residual, determinant, converged, converged)
    return point, jnp.sum(tangent_row * point.tangent), jnp.linalg.norm(control.scale * (z - guess))


def track(function, solve, state, control, args, capacity, max_steps=None):
    """(the `TrackState` reached, the `Point` of each of so many attempted steps); after its end nothing is attempted,
    and the rest is blank. max_steps: the number of steps to attempt, where that is less than the count."""
    max_steps = capacity if max_steps is None else max_steps

    def attempt_step(state):
        is_running = state.status == RUNNING  # of lanes under vmap, one may have ended before the others
        step = jnp.where(is_running, state.step, 0.0)
        point, cosine, correction_length = correct_step(
            function, solve, state, step, control, args, allow_far=jnp.equal(max_steps, 1)
        )
        angle = jnp.sqrt(jnp.maximum(2.0 * (1.0 - cosine), 0.0))  # nan where the tangent is not finite
        is_acceptable = point.converged & (angle < MAX_ANGLE) & (correction_length < MAX_DEVIATION * abs(step))
        accepted = is_running & is_acceptable
        step_factor = jnp.where(
            is_acceptable,
            jnp.minimum(jnp.maximum(TARGET_ANGLE / angle, MIN_STEP_GROWTH), MAX_STEP_GROWTH),
            MIN_STEP_GROWTH,
        )
        next_step = jnp.minimum(state.step * step_factor, control.max_step)
        is_out_of_bounds = (point.z[-1] < control.lower) | (point.z[-1] > control.upper)
        failure_status = jnp.where(jnp.isfinite(point.residual), UNDERFLOW, NONFINITE)
        status = jnp.where(
            accepted & is_out_of_bounds, OUTSIDE, jnp.where(next_step < control.min_step, failure_status, RUNNING)
        )
        status = jnp.where(is_running, status, state.status)
        next_state = TrackState(
            jnp.where(accepted, point.z, state.z),
            jnp.where(accepted, point.tangent, state.tangent),
            jnp.where(is_running, next_step, state.step),
            status,
        )
        return next_state, point._replace(accepted=accepted)

    def advance(carry):
        k, state, points = carry
        state, point = attempt_step(state)
        updated_fields = [
            lax.dynamic_update_index_in_dim(*array_and_entry, k, 0)
            for array_and_entry in zip(points, point, strict=True)
        ]
        return k + 1, state, Point(*updated_fields)

    def is_unfinished(carry):
        k, state, _ = carry
        return (k < max_steps) & (state.status == RUNNING)

    blank_vectors, blank_scalars = (jnp.zeros((capacity, *shape), state.z.dtype) for shape in (state.z.shape, ()))
    blank_points = Point(
        blank_vectors, blank_vectors, blank_scalars, blank_scalars, blank_scalars, blank_scalars > 0, blank_scalars > 0
    )
    return lax.while_loop(is_unfinished, advance, (0, state, blank_points))[1:]

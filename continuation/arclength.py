"""Take many pseudo-arclength steps along a branch of F(z) = 0 in one compiled call.

z = (u, p) consists of n unknowns and the parameter; F has n equations. A step predicts a point along the tangent and
corrects it in the hyperplane perpendicular to the tangent. Lengths are weighted: the length of dz is the norm of
``scale*dz``.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import ArrayLike, Bool, Float, Int

from .array_type import Array
from .newton import solve as dense

RUNNING, OUTSIDE, UNDERFLOW, NONFINITE = range(4)
MIN_STEP = 1e-8  # smallest step length, unless the first step is smaller
MAX_NEWTON_STEPS = 8  # Newton steps per continuation step
TARGET_ANGLE, MAX_ANGLE = 0.12, 0.3  # target and largest angle between successive tangents, in rad
MAX_STEP_GROWTH, MIN_STEP_GROWTH = 2.0, 0.25  # bounds on the ratio of successive step lengths
# F is zero to rounding if it is below this multiple of eps*(1 + the largest unknown).
ROUNDOFF_FACTOR = 16.0
# Largest last Newton step that is accepted if F is zero to rounding: ill-conditioned systems amplify rounding errors.
LOOSE_TOLERANCE = 5e-10
MAX_DEVIATION = 0.15  # largest distance of the branch from its tangent, relative to the step
# Newton's method ends beyond this distance from its guess: a multiple of the step, and a length.
DISTANCE_FACTOR, DISTANCE_OFFSET = 2.0, 1e-6


class StepControl(NamedTuple):
    """Step sizes, tolerance and bounds of a continuation.

    Parameters
    ----------
    scale : array_like
        Weights of the length. Array of shape (n + 1,).
    min_step : float
        Smallest step length.
    max_step : float
        Largest step length.
    tolerance : float
        Tolerance of Newton's method, a length.
    lower : float
        Lower bound of the parameter.
    upper : float
        Upper bound of the parameter.
    """

    scale: Float[Array, "*lanes unknowns"]
    min_step: Float[ArrayLike, "*lanes"]
    max_step: Float[ArrayLike, "*lanes"]
    tolerance: Float[ArrayLike, "*lanes"]
    lower: Float[ArrayLike, "*lanes"]
    upper: Float[ArrayLike, "*lanes"]


class TrackState(NamedTuple):
    """State of the continuation loop.

    Parameters
    ----------
    z : array_like
        Last point. Array of shape (n + 1,).
    tangent : array_like
        Unit tangent at z. Array of shape (n + 1,).
    step : float
        Length of the next step.
    status : int
        RUNNING, OUTSIDE, UNDERFLOW or NONFINITE.
    """

    z: Float[Array, "*lanes unknowns"]
    tangent: Float[Array, "*lanes unknowns"]
    step: Float[ArrayLike, "*lanes"]
    status: Int[ArrayLike, "*lanes"]


class Point(NamedTuple):
    """Computed point of a branch, or arrays of points with one row each.

    Attributes
    ----------
    z : ndarray
        The point. Array of shape (n + 1,).
    tangent : ndarray
        Unit tangent. Array of shape (n + 1,).
    step : ndarray
        Step length from the previous point.
    residual : ndarray
        Largest magnitude of the entries of F before the last Newton step.
    determinant : ndarray
        Determinant of dF/dz with the additional last row ``scale**2`` times the previous tangent, before the last
        Newton step.
    converged : ndarray
        True if Newton's method converged.
    accepted : ndarray
        True if the step is accepted: Newton's method converged, and the turn of the tangent and the correction are
        within their limits.
    """

    z: Float[Array, "*points unknowns"]
    tangent: Float[Array, "*points unknowns"]
    step: Float[Array, "*points"]
    residual: Float[Array, "*points"]
    determinant: Float[Array, "*points"]
    converged: Bool[ArrayLike, "*points"]
    accepted: Bool[ArrayLike, "*points"]


def make_start_point(z, tangent):
    """Make the starting `Point` of a continuation.

    Parameters
    ----------
    z : ndarray
        Point of shape (n + 1,).
    tangent : ndarray
        Unit tangent of shape (n + 1,).

    Returns
    -------
    Point
        The point, with step length 0.
    """
    zero = np.zeros(())
    return Point(z, tangent, zero, zero, zero, np.True_, np.True_)


def make_track_state(point, step_length):
    """Make the `TrackState` of a step from a point."""
    return TrackState(point.z, point.tangent, np.float64(step_length), np.int32(RUNNING))


def make_control(scale, first_step, largest_step, tolerance, bounds):
    """Make the `StepControl` of a continuation from the bounds of its last parameter and the lengths of steps."""
    numbers = (min(MIN_STEP, first_step), largest_step, tolerance, *bounds)
    return StepControl(scale, *map(np.float64, numbers))


def solve_bordered(jacobian, last_row, rhs):
    """Solve a linear system whose matrix consists of an n by n + 1 matrix and one additional row.

    Parameters
    ----------
    jacobian : array_like
        Matrix of shape (n, n + 1).
    last_row : array_like
        Additional row of shape (n + 1,).
    rhs : array_like
        Right-hand sides of shape (n + 1,) or (n + 1, k).

    Returns
    -------
    LinearSolution
        Solution, pivot ratio and determinant.
    """
    return dense(jnp.concatenate([jacobian, last_row[None]]), rhs)


def correct_step(
    residual_and_jacobian, solve_bordered_system, state, step, control, constants, ignore_max_distance=False
):
    """Compute the point of the branch one step away along the tangent.

    `residual_and_jacobian` maps (z, constants) to (F, derivative); `solve_bordered_system` has the signature of
    `solve_bordered`. Returns the `Point`, the cosine of the angle between the old and the new tangent, and the length
    of the correction. `ignore_max_distance` removes the limit of the distance between the point and the guess.
    """
    tangent_row = control.scale * control.scale * state.tangent
    guess = state.z + step * state.tangent
    tangent_rhs = jnp.zeros_like(guess).at[-1].set(1.0)

    # A step beyond this distance would be rejected, and an evaluation there may take very long.
    max_distance = jnp.where(ignore_max_distance | (step == 0), jnp.inf, DISTANCE_FACTOR * abs(step) + DISTANCE_OFFSET)

    def is_unfinished(carry):
        _, _, change_length, _, _, n_steps = carry
        return (change_length > control.tolerance) & (n_steps < MAX_NEWTON_STEPS)

    def newton_step(carry):
        z, _, _, _, _, n_steps = carry
        residual_vector, jacobian = residual_and_jacobian(z, constants)
        extended_residual = jnp.concatenate([residual_vector, jnp.sum(tangent_row * (z - guess))[None]])
        solution = solve_bordered_system(jacobian, tangent_row, jnp.stack([extended_residual, tangent_rhs], 1))
        minus_change, tangent = solution.x[:, 0], solution.x[:, 1]
        change_length = jnp.linalg.norm(control.scale * minus_change)
        z = z - minus_change
        is_within_distance = jnp.isfinite(change_length) & (
            jnp.linalg.norm(control.scale * (z - guess)) <= max_distance
        )
        change_length, n_steps = (
            jnp.where(is_within_distance, change_length, jnp.inf),
            jnp.where(is_within_distance, n_steps + 1, MAX_NEWTON_STEPS),
        )
        return z, tangent, change_length, jnp.max(abs(residual_vector)), solution.determinant, n_steps

    zero = jnp.zeros_like(step)
    initial_carry = (guess, state.tangent, zero + jnp.inf, zero, zero, 0)
    z, tangent, change_length, residual, determinant, _ = lax.while_loop(is_unfinished, newton_step, initial_carry)
    is_residual_roundoff = residual <= ROUNDOFF_FACTOR * jnp.finfo(z.dtype).eps * (1.0 + jnp.max(abs(z)))
    converged = (change_length <= control.tolerance) | (is_residual_roundoff & (change_length <= LOOSE_TOLERANCE))
    unit_tangent = tangent / jnp.linalg.norm(control.scale * tangent)
    point = Point(z, unit_tangent, step, residual, determinant, converged, converged)
    return point, jnp.sum(tangent_row * point.tangent), jnp.linalg.norm(control.scale * (z - guess))


def track_branch(residual_and_jacobian, solve_bordered_system, state, control, constants, max_rows, max_steps=None):
    """Attempt up to `max_rows` steps along a branch.

    Parameters
    ----------
    residual_and_jacobian : callable
        Function of (z, args) that returns F and its derivative.
    solve_bordered_system : callable
        Solver of bordered systems, as `solve_bordered`.
    state : TrackState
        State to start from.
    control : StepControl
        Step sizes, tolerance and bounds.
    constants : Any
        Further argument of `residual_and_jacobian`.
    max_rows : int
        Number of rows of the result.
    max_steps : int, optional
        Largest number of attempted steps. None stands for `max_rows`. If it is 1, the distance between the point and
        its guess is not limited.

    Returns
    -------
    state : TrackState
        Final state.
    points : Point
        One row per attempted step, followed by rows of zeros.
    """
    max_steps = max_rows if max_steps is None else max_steps

    def attempt_step(state):
        is_running = state.status == RUNNING  # under vmap one lane may end before the others
        step = jnp.where(is_running, state.step, 0.0)
        point, tangent_cosine, correction_length = correct_step(
            residual_and_jacobian,
            solve_bordered_system,
            state,
            step,
            control,
            constants,
            ignore_max_distance=jnp.equal(max_steps, 1),
        )
        tangent_angle = jnp.sqrt(jnp.maximum(2.0 * (1.0 - tangent_cosine), 0.0))  # nan where the tangent is not finite
        is_acceptable = point.converged & (tangent_angle < MAX_ANGLE) & (correction_length < MAX_DEVIATION * abs(step))
        accepted = is_running & is_acceptable
        step_growth = jnp.where(
            is_acceptable,
            jnp.minimum(jnp.maximum(TARGET_ANGLE / tangent_angle, MIN_STEP_GROWTH), MAX_STEP_GROWTH),
            MIN_STEP_GROWTH,
        )
        next_step_length = jnp.minimum(state.step * step_growth, control.max_step)
        is_out_of_bounds = (point.z[-1] < control.lower) | (point.z[-1] > control.upper)
        failure_status = jnp.where(jnp.isfinite(point.residual), UNDERFLOW, NONFINITE)
        status = jnp.where(
            accepted & is_out_of_bounds,
            OUTSIDE,
            jnp.where(next_step_length < control.min_step, failure_status, RUNNING),
        )
        status = jnp.where(is_running, status, state.status)
        next_state = TrackState(
            jnp.where(accepted, point.z, state.z),
            jnp.where(accepted, point.tangent, state.tangent),
            jnp.where(is_running, next_step_length, state.step),
            status,
        )
        return next_state, point._replace(accepted=accepted)

    def attempt_and_store(carry):
        row, state, points = carry
        state, point = attempt_step(state)
        updated_fields = [
            lax.dynamic_update_index_in_dim(*array_and_row, row, 0) for array_and_row in zip(points, point, strict=True)
        ]
        return row + 1, state, Point(*updated_fields)

    def is_unfinished(carry):
        row, state, _ = carry
        return (row < max_steps) & (state.status == RUNNING)

    blank_vectors, blank_scalars = (jnp.zeros((max_rows, *shape), state.z.dtype) for shape in (state.z.shape, ()))
    blank_points = Point(
        blank_vectors, blank_vectors, blank_scalars, blank_scalars, blank_scalars, blank_scalars > 0, blank_scalars > 0
    )
    return lax.while_loop(is_unfinished, attempt_and_store, (0, state, blank_points))[1:]

"""Numbers of a scene fitted to values of special points: by gradient to come close, by Gauss and Newton to finish."""

from typing import NamedTuple

import numpy as np
import optax
from jaxtyping import Float

from ..loci.point_continuation import ContinuedPoint, continue_point, parameter_gradient

LEARNING_RATE, ADAM_TOLERANCE, MAX_ADAM_STEPS = (
    0.02,
    0.03,
    80,
)  # of Adam's steps; a misfit so small ends them; so many at most
MAX_NEWTON_STEPS, NEWTON_TOLERANCE = 20, 1e-13  # of Newton's steps; one as short is the last
EXISTENCE_FRACTION = 0.5  # of the way to where a point ends: nearer, its Newton's method may find another


class Fit(NamedTuple):
    """values: the numbers fitted; misfits: value less target of each point; jacobian: d value / d number, (points,
    numbers); converged: whether the last step was rounding; points: the `held_point.HeldPoint` there."""

    values: Float[np.ndarray, " numbers"]
    misfits: Float[np.ndarray, " points"]
    jacobian: Float[np.ndarray, "points numbers"]
    converged: bool
    points: tuple[ContinuedPoint, ...]

    @property
    def condition(self) -> float:
        """Of the derivative: how much more one direction of the numbers is felt than another."""
        return float(np.linalg.cond(self.jacobian))


def fit_values(points, targets, start, lower, upper):
    """The `Fit` of the least squares, from a start, within (low, high) of each number.

    points: `held_point.HeldPoint`, with the same numbers kept; targets: their values as they should be. Where a point
    does not exist with the start's numbers, it starts on the way there, from the points' own.
    """
    points, values = move_points(points, start)
    optimiser = optax.adam(LEARNING_RATE)
    optimiser_state = optimiser.init(values)
    for _ in range(MAX_ADAM_STEPS):
        misfits, jacobian = _misfits_and_jacobian(points, targets)
        if abs(misfits).max() < ADAM_TOLERANCE:
            break
        step, optimiser_state = optimiser.update(np.asarray(2.0 * jacobian.T @ misfits), optimiser_state)
        points, values = move_points(points, np.clip(values + np.asarray(step), lower, upper))
    return _newton_fit(points, targets, lower, upper)


def move_points(points, values):
    """(points, numbers): the points where their numbers are these, or as near on the way as all of them exist."""
    start, values = np.array(points[0].parameter_values), np.asarray(values, float)
    moves = [continue_point(point, values) for point in points]
    fraction = min(move_fraction for _, move_fraction in moves)
    if fraction < 1.0:
        values = start + EXISTENCE_FRACTION * fraction * (values - start)
        moves = [continue_point(point, values) for point in points]
    return tuple(point for point, _ in moves), values


def _misfits_and_jacobian(points, targets):
    """(misfits, their derivatives)."""
    values = np.array([point.value for point in points])
    return values - np.asarray(targets), np.stack([parameter_gradient(point) for point in points])


def _newton_fit(points, targets, lower, upper):
    converged = False
    for _ in range(MAX_NEWTON_STEPS):
        misfits, jacobian = _misfits_and_jacobian(points, targets)
        values = np.array(points[0].parameter_values)
        step = -np.linalg.lstsq(jacobian, misfits, rcond=None)[0]
        if converged:
            break
        points, _ = move_points(points, np.clip(values + step, lower, upper))
        converged = abs(step).max() < NEWTON_TOLERANCE * (1.0 + abs(values).max())
    return Fit(values, misfits, jacobian, bool(converged), points)

"""Fit parameters of a scene to values of special points, by Adam and then by Gauss-Newton steps."""

from typing import NamedTuple

import numpy as np
import optax
from jaxtyping import Float

from ..loci.point_continuation import ContinuedPoint, continue_point, parameter_gradient

LEARNING_RATE, MAX_ADAM_STEPS = 0.02, 80
ADAM_TOLERANCE = 0.03  # largest misfit at which Gauss-Newton steps begin
MAX_NEWTON_STEPS, NEWTON_TOLERANCE = 20, 1e-13  # relative length of the last step
EXISTENCE_FRACTION = 0.5  # of the distance to the end of a point, near which Newton's method may find another one


class Fit(NamedTuple):
    """Fit of parameters to special points.

    Attributes
    ----------
    values : ndarray of shape (numbers,)
        Fitted parameters.
    misfits : ndarray of shape (points,)
        Value minus target of each point.
    jacobian : ndarray of shape (points, numbers)
        Derivatives of the values with respect to the parameters.
    converged : bool
        True if the last step was rounding.
    points : tuple of ContinuedPoint
        Special points at the fitted parameters.
    """

    values: Float[np.ndarray, " numbers"]
    misfits: Float[np.ndarray, " points"]
    jacobian: Float[np.ndarray, "points numbers"]
    converged: bool
    points: tuple[ContinuedPoint, ...]

    @property
    def condition(self) -> float:
        """Condition number of the Jacobian."""
        return float(np.linalg.cond(self.jacobian))


def fit_values(points, targets, start, lower, upper):
    """Return the `Fit` of least squares from initial parameters, within bounds of each parameter.

    `points` are `ContinuedPoint` records with the same parameters, and `targets` their desired values. If a point does
    not exist at the initial parameters, the fit starts on the way there from the parameters of the points.
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
    """Return (points, parameters), continued to these parameters, or as far as all points exist."""
    start, values = np.array(points[0].parameter_values), np.asarray(values, float)
    moves = [continue_point(point, values) for point in points]
    fraction = min(move_fraction for _, move_fraction in moves)
    if fraction < 1.0:
        values = start + EXISTENCE_FRACTION * fraction * (values - start)
        moves = [continue_point(point, values) for point in points]
    return tuple(point for point, _ in moves), values


def _misfits_and_jacobian(points, targets):
    """Return the misfits and their derivatives."""
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

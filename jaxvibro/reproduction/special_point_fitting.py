"""Fit scene parameters to prescribed values of special points: Adam steps, then Gauss-Newton steps."""

from typing import NamedTuple

import numpy as np
import optax
from jaxtyping import Float

from ..loci.point_continuation import ContinuedPoint, continue_to_values, value_gradient

LEARNING_RATE, MAX_ADAM_STEPS = 0.02, 80
ADAM_TOLERANCE = 0.03  # largest misfit at which Gauss-Newton steps begin
MAX_NEWTON_STEPS, NEWTON_TOLERANCE = 20, 1e-13  # relative length of the last step
EXISTENCE_FRACTION = 0.5  # of the distance to the end of a point, near which Newton's method may find another one


class ParameterFit(NamedTuple):
    """Result of a fit of scene parameters to values of special points.

    Attributes
    ----------
    values : ndarray of shape (numbers,)
        Fitted parameters.
    misfits : ndarray of shape (points,)
        Value minus target of each point.
    jacobian : ndarray of shape (points, numbers)
        Derivatives of the values of the points with respect to the parameters.
    converged : bool
        True if the last step was at the level of rounding errors.
    points : tuple of ContinuedPoint
        Special points at the fitted parameters.
    """

    values: Float[np.ndarray, " numbers"]
    misfits: Float[np.ndarray, " points"]
    jacobian: Float[np.ndarray, "points numbers"]
    converged: bool
    points: tuple[ContinuedPoint, ...]

    @property
    def condition_number(self) -> float:
        """Condition number of the Jacobian."""
        return float(np.linalg.cond(self.jacobian))


def fit_parameters(continued_points, target_values, initial_parameters, lower_bounds, upper_bounds):
    """Fit parameters within bounds by least squares; return the `ParameterFit`.

    `continued_points` are `ContinuedPoint` records with the same parameters, and `target_values` are their desired
    values. The fit starts at the parameters `initial_parameters`. If a point does not exist there, the fit starts on
    the line from the parameters of the points to `initial_parameters`."""
    continued_points, parameters = move_continued_points(continued_points, initial_parameters)
    adam_optimiser = optax.adam(LEARNING_RATE)
    adam_state = adam_optimiser.init(parameters)
    for _ in range(MAX_ADAM_STEPS):
        misfits, jacobian = _misfits_and_jacobian(continued_points, target_values)
        if abs(misfits).max() < ADAM_TOLERANCE:
            break
        parameter_step, adam_state = adam_optimiser.update(np.asarray(2.0 * jacobian.T @ misfits), adam_state)
        continued_points, parameters = move_continued_points(
            continued_points, np.clip(parameters + np.asarray(parameter_step), lower_bounds, upper_bounds)
        )
    return _gauss_newton_fit(continued_points, target_values, lower_bounds, upper_bounds)


def move_continued_points(continued_points, parameters):
    """Continue special points to other parameters; return (points, parameters reached).

    If a point ceases to exist on the way, all points move by `EXISTENCE_FRACTION` of the distance to this end.
    """
    start_parameters, parameters = np.array(continued_points[0].parameter_values), np.asarray(parameters, float)
    continuations = [continue_to_values(continued_point, parameters) for continued_point in continued_points]
    common_fraction = min(move_fraction for _, move_fraction in continuations)
    if common_fraction < 1.0:
        parameters = start_parameters + EXISTENCE_FRACTION * common_fraction * (parameters - start_parameters)
        continuations = [continue_to_values(continued_point, parameters) for continued_point in continued_points]
    return tuple(continued_point for continued_point, _ in continuations), parameters


def _misfits_and_jacobian(continued_points, target_values):
    """Return (value minus target of each point, derivatives with respect to the parameters)."""
    point_values = np.array([continued_point.value for continued_point in continued_points])
    return point_values - np.asarray(target_values), np.stack(
        [value_gradient(continued_point) for continued_point in continued_points]
    )


def _gauss_newton_fit(continued_points, target_values, lower_bounds, upper_bounds):
    is_converged = False
    for _ in range(MAX_NEWTON_STEPS):
        misfits, jacobian = _misfits_and_jacobian(continued_points, target_values)
        parameters = np.array(continued_points[0].parameter_values)
        parameter_step = -np.linalg.lstsq(jacobian, misfits, rcond=None)[0]
        if is_converged:
            break
        continued_points, _ = move_continued_points(
            continued_points, np.clip(parameters + parameter_step, lower_bounds, upper_bounds)
        )
        is_converged = abs(parameter_step).max() < NEWTON_TOLERANCE * (1.0 + abs(parameters).max())
    return ParameterFit(parameters, misfits, jacobian, bool(is_converged), continued_points)

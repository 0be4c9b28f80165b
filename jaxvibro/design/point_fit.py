"""Fit parameters of scenes to values of special points by the Gauss-Newton method, with `located`."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..scene import check
from ..scene.codes import SolutionStatus
from ..scene.scene import replace_unchecked
from .located import located
from .located_point import Located

MAX_ITERATIONS, STEP_TOLERANCE = 60, 1e-12  # Gauss-Newton steps; a shorter step, in scales, is the last
# In scales: a shorter step that is no shorter than its predecessor is rounding, and is the last.
ROUNDING_STEP = 1e-8
MAX_STEP = 2.0  # longest step, in scales
BOUND_FRACTION = 0.25  # fraction of the distance to a bound that a step keeps
MIN_FRACTION = 1.0 / 64.0  # smallest fraction of a step
COST_TOLERANCE = 1e-12  # relative tolerance of the cost
TINY = 1e-300
RANK_TOLERANCE = 1e-9  # relative to the strongest combination: a weaker one is undetermined and held


class PointFunctions(NamedTuple):
    """Values of special points as functions of parameters.

    Attributes
    ----------
    functions : tuple of Located
        Functions of the points.
    values : ndarray
        Published values, array of shape (points,).
    sigma : ndarray
        Standard errors of the published values, array of shape (points,).
    name_groups : tuple of tuple of str
        Names of each parameter.
    scales : ndarray
        Scales of the parameters, array of shape (numbers,).
    lower, upper : ndarray
        Bounds of the parameters, arrays of shape (numbers,).
    """

    functions: tuple[Located, ...]
    values: Float[np.ndarray, " points"]
    sigma: Float[np.ndarray, " points"]
    name_groups: tuple[tuple[str, ...], ...]
    scales: Float[np.ndarray, " numbers"]
    lower: Float[np.ndarray, " numbers"]
    upper: Float[np.ndarray, " numbers"]


class PointFit(NamedTuple):
    """Fitted parameters.

    Attributes
    ----------
    parameters : ndarray
        Values of the parameters, array of shape (numbers,).
    residuals : ndarray
        Computed minus published values, in standard errors. Array of shape (points,).
    jacobian : ndarray
        Derivatives of `residuals` with respect to the parameters in units of their scales. Array of shape (points,
        numbers).
    converged : bool
        True if the iteration has converged.
    """

    parameters: Float[np.ndarray, " numbers"]
    residuals: Float[np.ndarray, " points"]
    jacobian: Float[np.ndarray, "points numbers"]
    converged: bool


def make_point_functions(record, name_groups, scales, lower, upper):
    """Make the `PointFunctions` of a `PointRecord`."""
    functions = tuple(located(point, None, wall) for point, wall in zip(record.points, record.walls, strict=True))
    for point in functions:
        for name in (group_name for name_group in name_groups for group_name in name_group):
            check.require_parameter(name, point.special.scene.names, name)
            if name == point.name:
                raise check.ArgumentError(f"free.{name}", "must not be the parameter of a point", name)
    return PointFunctions(
        functions, record.values, np.full(len(functions), record.sigma), name_groups, scales, lower, upper
    )


def fit_points(points, parameters):
    """Solve the least-squares problem from initial parameters.

    The iteration starts at `parameters`, or at the nearest tested parameters at which all points exist, on the line
    from the parameters of the points. Returns None if there are none.
    """
    own_values = np.array(
        [
            [float(function.special.scene.parameter(name_group[0])) for name_group in points.name_groups]
            for function in points.functions
        ]
    )
    point_fit = _nearest_solvable_fit(points, np.mean(own_values, 0), parameters)
    if point_fit is None:
        return None
    previous_size = ROUNDING_STEP
    for _ in range(MAX_ITERATIONS):
        step = -np.linalg.lstsq(point_fit.jacobian, point_fit.residuals, rcond=RANK_TOLERANCE)[0]
        step_size = float(abs(step).max())
        is_short, previous_size = step_size <= STEP_TOLERANCE or previous_size <= step_size < ROUNDING_STEP, step_size
        next_fit = _take_step(points, point_fit, _max_step_fraction(points, point_fit.parameters, step) * step)
        if next_fit is None:
            return point_fit
        point_fit = next_fit
        if is_short:
            return point_fit._replace(converged=True)
    return point_fit


def _nearest_solvable_fit(points, own_values, parameters):
    """Return the `PointFit` at parameters, or at the nearest tested parameters at which all points exist.

    The tested parameters lie on the line from the parameters of the points.
    """
    fraction = 1.0
    while fraction >= MIN_FRACTION:
        point_fit = _evaluate(points, own_values + fraction * (parameters - own_values))
        if point_fit is not None:
            return point_fit
        fraction *= 0.5
    return _evaluate(points, own_values)


def _take_step(points, point_fit, step):
    """Return the `PointFit` after the largest tried fraction of a step that does not increase the cost, or None."""
    fraction, max_cost = 1.0, (1.0 + COST_TOLERANCE) * (point_fit.residuals @ point_fit.residuals)
    while fraction >= MIN_FRACTION:
        next_fit = _evaluate(points, point_fit.parameters + fraction * step * points.scales)
        if next_fit is not None and (
            next_fit.residuals @ next_fit.residuals <= max_cost or abs(step).max() <= ROUNDING_STEP
        ):
            return next_fit
        fraction *= 0.5
    return None


def _max_step_fraction(points, parameters, step):
    """Return the largest admissible fraction of a step."""
    fractions = [1.0, MAX_STEP / max(float(abs(step).max()), TINY)]
    for parameter, change, lower, upper in zip(
        parameters, step * points.scales, points.lower, points.upper, strict=True
    ):
        bound_distance = (upper - parameter) if change > 0 else (parameter - lower)
        if change and np.isfinite(bound_distance):
            fractions.append((1.0 - BOUND_FRACTION) * bound_distance / abs(change))
    return min(fractions)


def _evaluate(points, parameters):
    """Return the `PointFit` at parameters, or None if a point does not exist."""
    residuals, jacobian = [], []
    for function, value, sigma in zip(points.functions, points.values, points.sigma, strict=True):
        scene = function.special.scene
        changed_scene = replace_unchecked(
            scene,
            {
                name: parameter
                for name_group, parameter in zip(points.name_groups, parameters, strict=True)
                for name in name_group
            },
        )
        located_point = function.solve(changed_scene)
        if int(located_point.status) != SolutionStatus.OK:
            return None
        gradient = jax.grad(function)(changed_scene)
        residuals.append((float(located_point.value) - value) / sigma)
        jacobian.append(
            [sum(float(gradient.parameter(name)) for name in name_group) for name_group in points.name_groups]
        )
    jacobian = np.array(jacobian) * points.scales / points.sigma[:, None]
    return PointFit(np.array(parameters), np.array(residuals), jacobian, False)

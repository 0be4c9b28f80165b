"""Fit parameters of scenes to published values of special points by the Gauss-Newton method."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..scene import check
from ..scene.scene import replace_unchecked
from ..scene.state import SolutionStatus
from .located import Located, located

MAX_ITERATIONS, STEP_TOLERANCE = 60, 1e-12  # Gauss-Newton steps; a shorter step, in scales, is the last
# In scales: a shorter step that is no shorter than its predecessor is rounding, and is the last.
ROUNDING_STEP = 1e-8
MAX_STEP = 2.0  # longest step, in scales
BOUND_FRACTION = 0.25  # fraction of the distance to a bound that a step keeps
MIN_FRACTION = 1.0 / 64.0  # smallest fraction of a step
COST_TOLERANCE = 1e-12  # relative tolerance of the cost
TINY = 1e-300
RANK_TOLERANCE = 1e-9  # relative to the strongest combination: a weaker one is undetermined and held


class SpecialPointProblem(NamedTuple):
    """Special points as functions of the fitted parameters, with their published values.

    Attributes
    ----------
    point_functions : tuple of Located
        Value of each point as a function of its scene.
    values : ndarray
        Published values, array of shape (points,).
    sigma : ndarray
        Standard errors of the published values, array of shape (points,).
    name_groups : tuple of tuple of str
        Names of the scene parameters that share the value of each fitted parameter.
    scales : ndarray
        Scales of the parameters, array of shape (numbers,).
    lower, upper : ndarray
        Bounds of the parameters, arrays of shape (numbers,).
    """

    point_functions: tuple[Located, ...]
    values: Float[np.ndarray, " points"]
    sigma: Float[np.ndarray, " points"]
    name_groups: tuple[tuple[str, ...], ...]
    scales: Float[np.ndarray, " numbers"]
    lower: Float[np.ndarray, " numbers"]
    upper: Float[np.ndarray, " numbers"]


class SpecialPointFit(NamedTuple):
    """Result of a fit to special points.

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


def make_point_problem(record, name_groups, scales, lower, upper):
    """Make the `SpecialPointProblem` of a `PointRecord`."""
    point_functions = tuple(
        located(point_function, None, wall) for point_function, wall in zip(record.points, record.walls, strict=True)
    )
    for point_function in point_functions:
        for name in (member_name for name_group in name_groups for member_name in name_group):
            check.require_parameter(name, point_function.special.scene.names, name)
            if name == point_function.name:
                raise check.ArgumentError(f"free.{name}", "must not be the parameter of a point", name)
    return SpecialPointProblem(
        point_functions, record.values, np.full(len(point_functions), record.sigma), name_groups, scales, lower, upper
    )


def fit_special_points(point_problem, parameters):
    """Solve the least-squares problem from initial parameters.

    The iteration starts at `parameters` if all points exist there. Otherwise it starts at the nearest tested parameters
    at which all points exist, on the line towards the mean parameters of the scenes of the points. Returns None if the
    points exist at no tested parameters.
    """
    scene_parameter_rows = np.array(
        [
            [float(point_function.special.scene.parameter(name_group[0])) for name_group in point_problem.name_groups]
            for point_function in point_problem.point_functions
        ]
    )
    point_fit = _nearest_solvable_fit(point_problem, np.mean(scene_parameter_rows, 0), parameters)
    if point_fit is None:
        return None
    previous_step_size = ROUNDING_STEP
    for _ in range(MAX_ITERATIONS):
        step = -np.linalg.lstsq(point_fit.jacobian, point_fit.residuals, rcond=RANK_TOLERANCE)[0]
        step_size = float(abs(step).max())
        is_last_step, previous_step_size = (
            step_size <= STEP_TOLERANCE or previous_step_size <= step_size < ROUNDING_STEP,
            step_size,
        )
        next_fit = _take_step(
            point_problem, point_fit, _max_step_fraction(point_problem, point_fit.parameters, step) * step
        )
        if next_fit is None:
            return point_fit
        point_fit = next_fit
        if is_last_step:
            return point_fit._replace(converged=True)
    return point_fit


def _nearest_solvable_fit(point_problem, mean_scene_parameters, parameters):
    """Return the `SpecialPointFit` at the tested parameters nearest to `parameters` at which all points exist, or None.

    The tested parameters lie on the line from `mean_scene_parameters` to `parameters`.
    """
    fraction = 1.0
    while fraction >= MIN_FRACTION:
        point_fit = _evaluate_point_fit(
            point_problem, mean_scene_parameters + fraction * (parameters - mean_scene_parameters)
        )
        if point_fit is not None:
            return point_fit
        fraction *= 0.5
    return _evaluate_point_fit(point_problem, mean_scene_parameters)


def _take_step(point_problem, point_fit, step):
    """Return the `SpecialPointFit` after the largest tried fraction of a step that does not increase the cost.

    Returns None if every tried fraction increases the cost, or leads to parameters at which a point does not exist.
    """
    fraction, max_cost = 1.0, (1.0 + COST_TOLERANCE) * (point_fit.residuals @ point_fit.residuals)
    while fraction >= MIN_FRACTION:
        next_fit = _evaluate_point_fit(point_problem, point_fit.parameters + fraction * step * point_problem.scales)
        if next_fit is not None and (
            next_fit.residuals @ next_fit.residuals <= max_cost or abs(step).max() <= ROUNDING_STEP
        ):
            return next_fit
        fraction *= 0.5
    return None


def _max_step_fraction(point_problem, parameters, step):
    """Return the largest fraction of a step that respects the step limit and keeps a distance from the bounds."""
    fractions = [1.0, MAX_STEP / max(float(abs(step).max()), TINY)]
    for parameter_value, change, lower, upper in zip(
        parameters, step * point_problem.scales, point_problem.lower, point_problem.upper, strict=True
    ):
        bound_distance = (upper - parameter_value) if change > 0 else (parameter_value - lower)
        if change and np.isfinite(bound_distance):
            fractions.append((1.0 - BOUND_FRACTION) * bound_distance / abs(change))
    return min(fractions)


def _evaluate_point_fit(point_problem, parameters):
    """Evaluate residuals and Jacobian at parameters; return a `SpecialPointFit`, or None if a point does not exist."""
    residuals, jacobian = [], []
    for point_function, published_value, sigma in zip(
        point_problem.point_functions, point_problem.values, point_problem.sigma, strict=True
    ):
        scene = point_function.special.scene
        changed_scene = replace_unchecked(
            scene,
            {
                name: parameter_value
                for name_group, parameter_value in zip(point_problem.name_groups, parameters, strict=True)
                for name in name_group
            },
        )
        located_point = point_function.solve(changed_scene)
        if int(located_point.status) != SolutionStatus.OK:
            return None
        value_gradient = jax.grad(point_function)(changed_scene)
        residuals.append((float(located_point.value) - published_value) / sigma)
        jacobian.append(
            [
                sum(float(value_gradient.parameter(name)) for name in name_group)
                for name_group in point_problem.name_groups
            ]
        )
    jacobian = np.array(jacobian) * point_problem.scales / point_problem.sigma[:, None]
    return SpecialPointFit(np.array(parameters), np.array(residuals), jacobian, False)

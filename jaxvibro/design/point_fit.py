"""Numbers of scenes fitted to values of special points, by Gauss and Newton, through `located`."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..scene import check
from ..scene.codes import SolutionStatus
from ..scene.scene import replace_unchecked
from .located import located
from .located_point import Located

MAX_ITERATIONS, STEP_TOLERANCE = 60, 1e-12  # of Newton's steps; one as short, in scales, is the last
ROUNDING_STEP = (
    1e-8  # scales: of steps that are shorter, one that is no shorter than the one before is the last: rounding
)
MAX_STEP = 2.0  # scales: the longest step
BOUND_FRACTION = 0.25  # of the way to a bound is kept
MIN_FRACTION = 1.0 / 64.0  # of a step
COST_TOLERANCE = 1e-12  # of the squares' sum
TINY = 1e-300
RANK_TOLERANCE = 1e-9  # of the strongest combination: a weaker one is not felt by the points, and held


class PointFunctions(NamedTuple):
    """Values of special points as functions of numbers: the functions, what was published, its errors, the names of
    each number, of several that are one, and their scales."""

    functions: tuple[Located, ...]
    values: Float[np.ndarray, " points"]
    sigma: Float[np.ndarray, " points"]
    name_groups: tuple[tuple[str, ...], ...]
    scales: Float[np.ndarray, " numbers"]
    lower: Float[np.ndarray, " numbers"]
    upper: Float[np.ndarray, " numbers"]


class PointFit(NamedTuple):
    """numbers; residuals: values less published ones, in errors; jacobian: their derivatives by numbers in scales; met:
    whether the last step was a short one."""

    parameters: Float[np.ndarray, " numbers"]
    residuals: Float[np.ndarray, " points"]
    jacobian: Float[np.ndarray, "points numbers"]
    converged: bool


def make_point_functions(record, name_groups, scales, lower, upper):
    """The `PointFunctions` of a `PointRecord`."""
    functions = tuple(located(point, None, wall) for point, wall in zip(record.points, record.walls, strict=True))
    for point in functions:
        for name in (group_name for name_group in name_groups for group_name in name_group):
            check.require_parameter(name, point.special.scene.names, name)
            if name == point.name:
                raise check.ArgumentError(f"free.{name}", "must not be what a point's value is of", name)
    return PointFunctions(
        functions, record.values, np.full(len(functions), record.sigma), name_groups, scales, lower, upper
    )


def fit_points(points, parameters):
    """The least squares from numbers on: `PointFit`; None where a point exists at none of the numbers on the way
    there."""
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
    """The `PointFit` at numbers, or as near on the way from the points' own as all of them exist."""
    fraction = 1.0
    while fraction >= MIN_FRACTION:
        point_fit = _evaluate(points, own_values + fraction * (parameters - own_values))
        if point_fit is not None:
            return point_fit
        fraction *= 0.5
    return _evaluate(points, own_values)


def _take_step(points, point_fit, step):
    """The `PointFit` after as much of a step as makes it no worse; None where none does."""
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
    """How much of a step is taken at most."""
    fractions = [1.0, MAX_STEP / max(float(abs(step).max()), TINY)]
    for parameter, change, lower, upper in zip(
        parameters, step * points.scales, points.lower, points.upper, strict=True
    ):
        bound_distance = (upper - parameter) if change > 0 else (parameter - lower)
        if change and np.isfinite(bound_distance):
            fractions.append((1.0 - BOUND_FRACTION) * bound_distance / abs(change))
    return min(fractions)


def _evaluate(points, parameters):
    """The `PointFit` at numbers, None where a point is not reached."""
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

"""Locate special points with error bars, and fit scene parameters to prescribed special points."""

from typing import NamedTuple

import numpy as np
import optax
from jaxtyping import Float

from ..branches.diagram import Diagram
from ..branches.explore import explore
from ..loci.point_continuation import ContinuedPoint, continue_to_values, value_gradient
from ..maps.itinerary import format_label, mirror_itinerary

SECOND_LARGEST_STEP = 0.07  # of the second diagram; the first has 0.1
ROUNDING = 8.0 * np.finfo(float).eps


class DiagramWithCheck(NamedTuple):
    """Two diagrams of one scene; their difference gives the error bars of the first.

    Attributes
    ----------
    first : Diagram
        Diagram with the usual steps.
    second : Diagram
        Diagram with smaller steps.
    """

    first: Diagram
    second: Diagram


def explore_twice(scene, explore_table, first_diagram=None):
    """Return the `DiagramWithCheck` of the [explore] table of a scene file.

    `first_diagram` is the first diagram if it is already known.
    """
    scene = scene.replace(**explore_table.at)
    common_settings = {
        "max_period": explore_table.max_period,
        "seed": explore_table.seed,
        "budget": explore_table.budget,
    }
    first_diagram = first_diagram or explore(scene, explore_table.parameter, explore_table.bounds, **common_settings)
    return DiagramWithCheck(
        first_diagram,
        explore(
            scene, explore_table.parameter, explore_table.bounds, **common_settings, largest_step=SECOND_LARGEST_STEP
        ),
    )


def special_point_value(diagrams, kind, orbit_label=None, target_value=-np.inf, n_periods=None):
    """Return (value, error) of the special point of a kind nearest to a target value, by default the lowest.

    `orbit_label` restricts the special points to orbits whose label, or that of their mirror image, is `orbit_label`.
    `n_periods` restricts them to orbits with this number of drive periods. The result is nan without a match.
    """
    special_points = [
        nearest_special_point(diagram, kind, target_value, orbit_label, n_periods) for diagram in diagrams
    ]
    special_values = [np.nan if special_point is None else special_point.value for special_point in special_points]
    return special_values[0], abs(special_values[0] - special_values[1]) + ROUNDING * abs(special_values[0])


def nearest_special_point(diagram, kind, target_value=-np.inf, orbit_label=None, n_periods=None):
    """Return the `Special` of one diagram whose value `special_point_value` returns; None if there is none."""
    matching_points = [
        special_point for special_point in diagram.points(kind) if _matches_orbit(special_point, orbit_label, n_periods)
    ]
    if target_value == -np.inf:
        return min(matching_points, key=lambda special_point: special_point.value, default=None)
    return min(matching_points, key=lambda special_point: abs(special_point.value - target_value), default=None)


def neighbour_labels(special_point):
    """Return the labels of the orbits that meet at a grazing."""
    return {format_label(neighbour.itinerary) for neighbour in special_point.joins}


def _matches_orbit(special_point, orbit_label, n_periods):
    has_label = orbit_label is None or orbit_label in (
        special_point.label,
        format_label(mirror_itinerary(special_point.itinerary)),
    )
    return has_label and n_periods in (None, len(special_point.itinerary))


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

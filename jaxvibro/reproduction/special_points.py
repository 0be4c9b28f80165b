"""Locate special points with error bars, by two continuations with different steps."""

from typing import NamedTuple

import numpy as np

from ..branches.diagram import Diagram
from ..branches.explore import explore
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

"""Locate special points with error bars, from two diagrams with different continuation steps."""

from typing import NamedTuple

import numpy as np

from ..branches.diagram import Diagram
from ..branches.explore import explore
from ..maps.itinerary import label, mirror_itinerary
from ..problem.orbit_point import itinerary

SECOND_LARGEST_STEP = 0.07  # of the second diagram; the first has 0.1
ROUNDING = 8.0 * np.finfo(float).eps


class DiagramPair(NamedTuple):
    """Two diagrams of one scene; the second gives the error bars of the first."""

    first: Diagram
    second: Diagram


def explore_twice(scene, table, first_diagram=None):
    """Return the `DiagramPair` of the [explore] table of a scene file; `first_diagram` is reused if given."""
    scene = scene.replace(**table.at)
    settings = {"max_period": table.max_period, "seed": table.seed, "budget": table.budget}
    first_diagram = first_diagram or explore(scene, table.parameter, table.bounds, **settings)
    return DiagramPair(
        first_diagram, explore(scene, table.parameter, table.bounds, **settings, largest_step=SECOND_LARGEST_STEP)
    )


def special_value(diagrams, kind, orbit_label=None, target=-np.inf, periods=None):
    """Return (value, error) of the special point of a kind nearest to a target, by default the lowest; nan without one.

    `orbit_label` restricts the points to orbits with this label or that of the mirror image, and `periods` to a number
    of drive periods.
    """
    specials = [nearest_special(item, kind, target, orbit_label, periods) for item in diagrams]
    values = [np.nan if item is None else item.value for item in specials]
    return values[0], abs(values[0] - values[1]) + ROUNDING * abs(values[0])


def nearest_special(diagram, kind, target=-np.inf, orbit_label=None, periods=None):
    """Return the `Special` whose value `special_value` returns; None without one."""
    candidates = [special for special in diagram.points(kind) if _matches(special, orbit_label, periods)]
    if target == -np.inf:
        return min(candidates, key=lambda special: special.value, default=None)
    return min(candidates, key=lambda special: abs(special.value - target), default=None)


def neighbour_labels(special):
    """Return the labels of the orbits that meet at a grazing."""
    return {label(itinerary(orbit_row, float(special.scene.frequency))) for orbit_row in special.joins}


def _matches(special, orbit_label, periods):
    has_label = orbit_label is None or orbit_label in (special.label, label(mirror_itinerary(special.itinerary)))
    return has_label and periods in (None, len(special.itinerary))

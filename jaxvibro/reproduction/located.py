"""Special points with error bars: located twice, from diagrams whose branches were stepped through differently."""

from typing import NamedTuple

import numpy as np

from ..branches.diagram import Diagram
from ..branches.explore import explore
from ..maps.itinerary import label, mirrored
from ..problem.orbit_on_branch import itinerary

STEPS = 0.07  # the largest of the second diagram; 0.1 of the first
ROUNDING = 8.0 * np.finfo(float).eps


class Twice(NamedTuple):
    """Two diagrams of one scene: the second tells how well the first is known."""

    first: Diagram
    second: Diagram


def twice(scene, table, first=None):
    """The `Twice` of what a scene file's [explore] asks; first: the diagram, where it is there already."""
    scene = scene.replace(**table.at)
    asked = {"max_period": table.max_period, "seed": table.seed, "budget": table.budget}
    first = first or explore(scene, table.parameter, table.bounds, **asked)
    return Twice(first, explore(scene, table.parameter, table.bounds, **asked, largest_step=STEPS))


def value(pair, kind, name=None, near=-np.inf, periods=None):
    """(value, error) of a special point of a kind: of those of orbits with this label, or its mirror image's, and so
    many periods the nearest to a value, by default the lowest. nan where there is none."""
    found = [nearest(one, kind, near, name, periods) for one in pair]
    here = [np.nan if one is None else one.value for one in found]
    return here[0], abs(here[0] - here[1]) + ROUNDING * abs(here[0])


def nearest(diagram, kind, near=-np.inf, name=None, periods=None):
    """The `Special` that `value` tells of, None where there is none."""
    found = [one for one in diagram.points(kind) if _is_meant(one, name, periods)]
    if near == -np.inf:
        return min(found, key=lambda one: one.value, default=None)
    return min(found, key=lambda one: abs(one.value - near), default=None)


def labelled(special):
    """The labels of the orbits that meet at a grazing."""
    return {label(itinerary(one, float(special.scene.frequency))) for one in special.joins}


def _is_meant(one, name, periods):
    named = name is None or name in (one.label, label(mirrored(one.itinerary)))
    return named and periods in (None, len(one.itinerary))

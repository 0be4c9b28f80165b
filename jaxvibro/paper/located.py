"""Special points with error bars: located twice, from diagrams whose branches were stepped through differently."""

from typing import NamedTuple

import numpy as np

from ..diagram import Diagram
from ..explore import explore
from ..itinerary import label, mirrored

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
    here = [_nearest(one, kind, name, near, periods) for one in pair]
    return here[0], abs(here[0] - here[1]) + ROUNDING * abs(here[0])


def _nearest(diagram, kind, name, near, periods):
    found = [one.value for one in diagram.points(kind) if _is_meant(one, name, periods)]
    if near == -np.inf:
        return min(found, default=np.nan)
    return min(found, key=lambda each: abs(each - near), default=np.nan)


def _is_meant(one, name, periods):
    named = name is None or name in (one.label, label(mirrored(one.itinerary)))
    return named and periods in (None, len(one.itinerary))

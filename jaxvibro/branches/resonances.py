"""Where areas are kept: orbits whose multipliers are third or fourth roots of 1.

Without damping, and walls that give all speed back, the product of the multipliers is 1: a pair lies on the circle,
where the trace is between -2 and 2 (elliptic), or is real (hyperbolic). The ends of that are SN or BP and PD. Within it
orbits of three and four times the period meet the orbit at the resonances 1:3 and 1:4, where it may lose those that
stay near it (Arnold, Mathematical Methods of Classical Mechanics, appendix 7).
"""

import numpy as np

from ..orbits.orbit import areas_kept
from .user_monitors import crossings

TRACES = {"R3": -1.0, "R4": 0.0}


def resonances(task, points, look):
    """The `Event`s R3 and R4 of a row of points, none unless areas are kept."""
    if not areas_kept(look.trace, look.determinant):
        return []

    def beyond(trace):
        return lambda point: float(np.sum(point.multipliers).real) - trace

    return [one for kind, trace in TRACES.items() for one in crossings(task, points, look, kind, beyond(trace))]

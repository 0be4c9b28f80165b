"""Where areas are kept: orbits whose multipliers are third or fourth roots of 1.

Without damping, and walls that give all speed back, the product of the multipliers is 1: a pair lies on the circle,
where the trace is between -2 and 2 (elliptic), or is real (hyperbolic). The ends of that are SN or BP and PD. Within it
orbits of three and four times the period meet the orbit at the resonances 1:3 and 1:4, where it may lose those that
stay near it (Arnold, Mathematical Methods of Classical Mechanics, appendix 7).
"""

import numpy as np

from ..orbits.orbit import is_area_preserving
from .user_monitors import locate_crossings

RESONANT_TRACES = {"R3": -1.0, "R4": 0.0}


def locate_resonances(task, points, diagnostics):
    """The `Event`s R3 and R4 of a row of points, none unless areas are kept."""
    if not is_area_preserving(diagnostics.trace, diagnostics.determinant):
        return []

    def trace_offset(resonant_trace):
        return lambda point: float(np.sum(point.multipliers).real) - resonant_trace

    return [
        event
        for kind, trace in RESONANT_TRACES.items()
        for event in locate_crossings(task, points, diagnostics, kind, trace_offset(trace))
    ]

"""Locate resonances of area-preserving maps: orbits whose multipliers are third or fourth roots of 1.

Without damping, and with walls of restitution 1, the product of the multipliers is 1. A pair lies on the unit circle,
where the trace is between -2 and 2 (elliptic), or is real (hyperbolic). The elliptic range ends at SN or BP and at PD.
Within it orbits of three and four times the period meet the orbit at the resonances 1:3 and 1:4, where it may lose its
stability (Arnold, Mathematical Methods of Classical Mechanics, appendix 7).
"""

import numpy as np

from ..orbits.orbit import is_area_preserving
from .user_monitors import locate_crossings

RESONANT_TRACES = {"R3": -1.0, "R4": 0.0}


def locate_resonances(task, points, diagnostics):
    """Locate the `Event` of each R3 and R4; there are none unless areas are preserved."""
    if not is_area_preserving(diagnostics.trace, diagnostics.determinant):
        return []

    def trace_offset(resonant_trace):
        return lambda point: float(np.sum(point.multipliers).real) - resonant_trace

    return [
        event
        for kind, trace in RESONANT_TRACES.items()
        for event in locate_crossings(task, points, diagnostics, kind, trace_offset(trace))
    ]

"""Locate resonances of area-preserving maps: multipliers that are primitive third or fourth roots of 1.

Without damping, and with walls of restitution 1, the product of the multipliers is 1. A pair lies on the unit circle,
where the trace is between -2 and 2 (elliptic), or is real (hyperbolic). The elliptic
range ends at SN, SB or BP, at PD, or at a grazing. At the resonances 1:3 and 1:4 within this range, orbits of three and
four times the period meet the orbit, and the orbit may lose its stability (Arnold, Mathematical Methods of Classical
Mechanics, appendix 7).
"""

import numpy as np

from ..orbits.orbit import has_unit_determinants
from .user_monitors import locate_crossings

RESONANT_TRACES = {"R3": -1.0, "R4": 0.0}


def locate_resonances(task, points, diagnostics):
    """Locate the `Event` of each R3 and R4. Return no events unless areas are preserved."""
    if not has_unit_determinants(diagnostics.trace, diagnostics.determinant):
        return []

    def trace_offset_function(resonant_trace):
        return lambda point: float(np.sum(point.multipliers).real) - resonant_trace

    return [
        event
        for kind, resonant_trace in RESONANT_TRACES.items()
        for event in locate_crossings(task, points, diagnostics, kind, trace_offset_function(resonant_trace))
    ]

"""The stroboscopic map between rigid walls in ball arithmetic, with certified contacts."""

from . import soft


def strobe(scene, x, v, phase=0.0, contact=0.0, periods=1, precision=200):
    """Record of `periods` drive periods from (x, v) at a drive phase in radians, by `soft.strobe`.

    contact is 0 (free: a start on a resting wall and moving into it rebounds at time 0) or -1, +1 (landed there
    already). Raises Discard where a test would be unfair: an impact slower than 1e-2, a turning point nearer than
    1e-8, an impact or a wall within 1e-9 of the start or the end, more than 60 impacts; ValueError beyond a wall.
    """
    record = soft.strobe(scene, x, v, phase, contact, periods, precision)
    record.jacobian = soft.floats(record.jacobian)
    return record

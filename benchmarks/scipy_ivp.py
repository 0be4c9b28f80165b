"""Map states with SciPy's solve_ivp, one at a time, with a terminal event per flight and contact, or without events."""

import math

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.work import CAP, GAMMA, OMEGA, PERIOD, RESTITUTION, Strobes, blank, held


def flight(t, y, amplitude):
    """Compute the right-hand side between the walls, equation 3."""
    return y[1], amplitude * math.cos(OMEGA * t) - y[0] - 2 * GAMMA * y[1]


def duffing(cubic):
    """Make the right-hand side with a cubic term."""

    def field(t, y, amplitude):
        x, v = y
        return v, amplitude * math.cos(OMEGA * t) - x - cubic * x * x * x - 2 * GAMMA * v

    return field


def passes(side, direction):
    """Make the event function that rises, or falls (direction -1), through 0 at the wall on a side."""

    def event(t, y, amplitude):
        return side * y[0] - 1.0

    event.terminal, event.direction = True, direction
    return event


WALLS = passes(-1, 1.0), passes(1, 1.0)


def contact(side, stiffness):
    """Make the right-hand side beyond the soft wall on a side."""
    damping = held(stiffness)

    def field(t, y, amplitude):
        return y[1], amplitude * math.cos(OMEGA * t) - y[0] - 2 * damping * y[1] - stiffness * (y[0] - side)

    return field


def pieces(stiffness, cubic):
    """Return {side of the wall in contact, 0 for none: right-hand side, events}."""
    found = {0: (flight if cubic is None else duffing(cubic), WALLS)}
    if stiffness is not None:
        found |= {side: (contact(side, stiffness), (passes(side, -1.0),)) for side in (-1, 1)}
    return found


def strobe(states, tolerance, stiffness=None, method="DOP853", cubic=None):
    """Map (n, 3) states x, x', A over one period with rtol = atol = tolerance; returns Strobes.

    An end is nan if the integrator fails or at the CAP-th impact.
    """
    result, known = blank(states), pieces(stiffness, cubic)
    for (x, v, amplitude), end, sides, times in zip(states, *result, strict=True):
        time, y, within, count = 0.0, [x, v], 0, 0
        while count < CAP:
            field, events = known[within]
            given = {"events": events, "args": (amplitude,), "rtol": tolerance, "atol": tolerance}
            piece = solve_ivp(field, (time, PERIOD), y, method, **given)
            time, y = piece.t[-1], piece.y[:, -1]
            if piece.status != 1:
                break
            if within:
                y, within = [float(within), y[1]], 0
                continue
            side = 1 if piece.t_events[1].size else -1
            sides[count], times[count] = side, time
            count += 1
            if stiffness is None:
                y = [float(side), -RESTITUTION * y[1]]
            else:
                y, within = [float(side), y[1]], side
        end[:] = y if piece.status == 0 else math.nan
    return result


def plain(states, tolerance, stiffness, method):
    """Map the states between soft walls without events: the step-size control handles the kinks.

    There is no itinerary: sides and times are None.
    """
    damping, ends = held(stiffness), np.full((len(states), 2), np.nan)

    def field(t, y, amplitude):
        x, v = y
        depth = x - 1.0 if x > 1.0 else x + 1.0 if x < -1.0 else 0.0
        return v, amplitude * math.cos(OMEGA * t) - x - 2 * (damping if depth else GAMMA) * v - stiffness * depth

    for (x, v, amplitude), end in zip(states, ends, strict=True):
        given = {"args": (amplitude,), "rtol": tolerance, "atol": tolerance}
        whole = solve_ivp(field, (0.0, PERIOD), (x, v), method, **given)
        if whole.status == 0:
            end[:] = whole.y[:, -1]
    return Strobes(ends, None, None)

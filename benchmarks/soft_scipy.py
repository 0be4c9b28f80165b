"""SciPy's solve_ivp between soft walls, one state at a time: a terminal event ends each flight and contact, or none."""

import math

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.soft_work import held
from benchmarks.work import CAP, GAMMA, OMEGA, PERIOD, blank


def flight(t, y, amplitude):
    """Right-hand side between the walls."""
    return y[1], amplitude * math.cos(OMEGA * t) - y[0] - 2 * GAMMA * y[1]


def meets(side):
    """The event that rises through 0 where the mass meets the wall on a side, or (side 0) none."""

    def event(t, y, *_):
        return side * y[0] - 1.0

    event.terminal, event.direction = True, 1.0
    return event


def contact(side, stiffness, damping):
    """Right-hand side beyond the wall on a side, and the event that falls through 0 where the mass leaves it."""

    def field(t, y, amplitude):
        return y[1], amplitude * math.cos(OMEGA * t) - y[0] - 2 * damping * y[1] - stiffness * (y[0] - side)

    def event(t, y, *_):
        return side * y[0] - 1.0

    event.terminal, event.direction = True, -1.0
    return field, (event,)


def strobe(states, stiffness, tolerance, method):
    """Map (n, 3) states x, x', A through one period with rtol = atol = tolerance; returns Strobes.

    An end is nan where the integrator gives up or enters a wall for the CAP-th time.
    """
    walls, result = (meets(-1), meets(1)), blank(states)
    pieces = {0: (flight, walls)} | {side: contact(side, stiffness, held(stiffness)) for side in (-1, 1)}
    for (x, v, amplitude), end, sides, times in zip(states, *result, strict=True):
        time, y, within, count = 0.0, [x, v], 0, 0
        while count < CAP:
            field, events = pieces[within]
            given = {"events": events, "args": (amplitude,), "rtol": tolerance, "atol": tolerance}
            piece = solve_ivp(field, (time, PERIOD), y, method, **given)
            time, y = piece.t[-1], piece.y[:, -1]
            if piece.status != 1:
                break
            if within:
                y, within = [float(within), y[1]], 0
                continue
            within = 1 if piece.t_events[1].size else -1
            sides[count], times[count] = within, time
            y, count = [float(within), y[1]], count + 1
        end[:] = y if piece.status == 0 else math.nan
    return result


def plain(states, stiffness, tolerance, method):
    """Ends (n, 2) of the same states with no event: one right-hand side, its kinks left to the control of the step."""
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
    return ends

"""SciPy's DOP853 with one terminal event a wall, restarted after each rebound; one state at a time."""

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.work import CAP, GAMMA, OMEGA, PERIOD, RESTITUTION, blank


def field(t, y, amplitude):
    """Right-hand side of equation 3."""
    return y[1], amplitude * np.cos(OMEGA * t) - y[0] - 2 * GAMMA * y[1]


def left(t, y, amplitude):
    """Rise through 0 where the mass goes through the wall at -1."""
    return -1.0 - y[0]


def right(t, y, amplitude):
    """Rise through 0 where the mass goes through the wall at 1."""
    return y[0] - 1.0


for event in (left, right):
    event.terminal = True
    event.direction = 1.0


def strobe(states, tolerance=1e-9):
    """Map (n, 3) states x, x', A through one period with rtol = atol = tolerance; returns Strobes."""
    result = blank(states)
    for (x, v, amplitude), end, sides, times in zip(states, *result, strict=True):
        time, y, count = 0.0, [x, v], 0
        while True:
            flight = solve_ivp(
                field,
                (time, PERIOD),
                y,
                "DOP853",
                events=(left, right),
                args=(amplitude,),
                rtol=tolerance,
                atol=tolerance,
            )
            time, y = flight.t[-1], flight.y[:, -1]
            if flight.status != 1 or count == CAP:
                break
            side = 1 if flight.t_events[1].size else -1
            sides[count], times[count] = side, time
            y = [float(side), -RESTITUTION * y[1]]
            count += 1
        end[:] = y
    return result

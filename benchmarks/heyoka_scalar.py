"""heyoka's Taylor integrator with one terminal event a wall, one state at a time; the rebound is a Python callback."""

import functools

import heyoka
import numpy as np

from benchmarks.work import CAP, GAMMA, OMEGA, PERIOD, RESTITUTION, blank

# heyoka derives a longer dead time after an event by default, and misses impacts that follow within it. This one only
# keeps it from finding the impact that it has just handled.
COOLDOWN = 1e-12


def system():
    """Return the position's symbol and equation 3, with A as parameter 0."""
    x, v = heyoka.make_vars("x", "v")
    force = heyoka.par[0] * heyoka.cos(OMEGA * heyoka.time)
    return x, [(x, v), (v, force - x - 2 * GAMMA * v)]


@functools.cache
def build(tolerance):
    """Compile an integrator: itself, and the list of (side, time) that its callbacks fill."""
    position, equations = system()
    impacts = []

    def meet(side):
        def rebound(integrator, _):
            impacts.append((side, integrator.time))
            state = integrator.state
            state[0] = side
            state[1] *= -RESTITUTION
            return len(impacts) < CAP

        return rebound

    rising = heyoka.event_direction.positive
    events = [
        heyoka.t_event(side * position - 1.0, callback=meet(side), direction=rising, cooldown=COOLDOWN)
        for side in (-1, 1)
    ]
    return heyoka.taylor_adaptive(equations, [0.0, 0.0], tol=tolerance, t_events=events), impacts


def strobe(states, tolerance=1e-15):
    """Map (n, 3) states x, x', A through one period at heyoka's tolerance; returns Strobes."""
    integrator, impacts = build(tolerance)
    y, parameter = integrator.state, integrator.pars
    result = blank(states)
    for row, end, sides, times in zip(states, *result, strict=True):
        impacts.clear()
        integrator.time = 0.0
        integrator.reset_cooldowns()
        y[:], parameter[0] = row[:2], row[2]
        integrator.propagate_until(PERIOD)
        end[:] = y
        if impacts:
            sides[: len(impacts)], times[: len(impacts)] = np.transpose(impacts)
    return result

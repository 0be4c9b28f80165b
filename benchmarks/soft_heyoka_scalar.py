"""heyoka's Taylor integrator between soft walls, one state at a time: events switch the parameters of the force."""

import functools

import heyoka
import numpy as np

from benchmarks.heyoka_scalar import COOLDOWN
from benchmarks.soft_work import held
from benchmarks.work import CAP, GAMMA, OMEGA, PERIOD, blank


def system():
    """The position's symbol and the equation; parameters: A, damping, stiffness, position of the wall that presses."""
    x, v = heyoka.make_vars("x", "v")
    amplitude, damping, stiffness, place = (heyoka.par[k] for k in range(4))
    force = amplitude * heyoka.cos(OMEGA * heyoka.time)
    return x, [(x, v), (v, force - x - 2 * damping * v - stiffness * (x - place))]


@functools.cache
def build(stiffness, tolerance):
    """Compile an integrator: itself, and the list of (side, time) that its callbacks fill."""
    position, equations = system()
    entries, free = [], (GAMMA, 0.0, 0.0)

    def passes(side):
        within = (held(stiffness), stiffness, side)

        def switch(integrator, direction):
            if direction > 0:
                entries.append((side, integrator.time))
            integrator.state[0] = side
            integrator.pars[1:] = within if direction > 0 else free
            return len(entries) < CAP

        return switch

    # One event for both ways: of two, the one for the way out misses some that follow an entry within heyoka's step.
    events = [heyoka.t_event(side * position - 1.0, callback=passes(side), cooldown=COOLDOWN) for side in (-1, 1)]
    return heyoka.taylor_adaptive(equations, [0.0, 0.0], tol=tolerance, t_events=events), entries


def strobe(states, stiffness, tolerance):
    """Map (n, 3) states x, x', A through one period at heyoka's tolerance; returns Strobes."""
    integrator, entries = build(stiffness, tolerance)
    y, parameters = integrator.state, integrator.pars
    result = blank(states)
    for row, end, sides, times in zip(states, *result, strict=True):
        entries.clear()
        integrator.time = 0.0
        integrator.reset_cooldowns()
        y[:], parameters[:] = row[:2], (row[2], GAMMA, 0.0, 0.0)
        integrator.propagate_until(PERIOD)
        end[:] = y
        if entries:
            sides[: len(entries)], times[: len(entries)] = np.transpose(entries)
    return result

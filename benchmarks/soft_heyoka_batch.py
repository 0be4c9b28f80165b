"""heyoka's batch integrator between soft walls: events switch the parameters of a lane's force."""

import functools

import heyoka
import numpy as np

from benchmarks.heyoka_batch import LANES
from benchmarks.heyoka_scalar import COOLDOWN
from benchmarks.soft_heyoka_scalar import system
from benchmarks.soft_work import held
from benchmarks.work import CAP, GAMMA, PERIOD, blank


@functools.cache
def build(stiffness, tolerance):
    """Compile an integrator: itself, and the list of (lane, side, time) that its callbacks fill."""
    position, equations = system()
    entries, counts, free = [], [0] * LANES, (GAMMA, 0.0, 0.0)

    def passes(side):
        within = (held(stiffness), stiffness, side)

        def switch(integrator, direction, lane):
            integrator.state[0, lane] = side
            integrator.pars[1:, lane] = within if direction > 0 else free
            if direction > 0:
                entries.append((lane, side, integrator.time[lane]))
                counts[lane] += 1
                if counts[lane] == CAP:
                    # a lane cannot leave its batch: at rest, without force, it meets no wall again
                    integrator.state[:, lane] = integrator.pars[:, lane] = 0.0
            return True

        return switch

    events = [heyoka.t_event_batch(side * position - 1.0, callback=passes(side), cooldown=COOLDOWN) for side in (-1, 1)]
    start = np.zeros((2, LANES))
    return heyoka.taylor_adaptive_batch(equations, start, tol=tolerance, t_events=events), entries, counts


def strobe(states, stiffness, tolerance):
    """Map (n, 3) states x, x', A, n a multiple of LANES, through one period; returns Strobes."""
    integrator, entries, counts = build(stiffness, tolerance)
    y, parameters = integrator.state, integrator.pars
    zero, until = np.zeros(LANES), np.full(LANES, PERIOD)
    result = blank(states)
    for first in range(0, len(states), LANES):
        rows = slice(first, first + LANES)
        entries.clear()
        counts[:] = [0] * LANES
        integrator.set_time(zero)
        integrator.reset_cooldowns()
        y[:], parameters[0] = states[rows, :2].T, states[rows, 2]
        parameters[1:] = np.array([[GAMMA], [0.0], [0.0]])
        integrator.propagate_until(until)
        result.ends[rows] = y.T
        slots = [0] * LANES
        for lane, side, time in entries:
            result.sides[first + lane, slots[lane]] = side
            result.times[first + lane, slots[lane]] = time
            slots[lane] += 1
    return result

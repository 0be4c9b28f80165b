"""heyoka's batch integrator with one terminal event a wall; the rebound is a Python callback a lane."""

import functools

import heyoka
import numpy as np

from benchmarks.heyoka_scalar import COOLDOWN, system
from benchmarks.work import CAP, PERIOD, RESTITUTION, blank

LANES = 2 * heyoka.recommended_simd_size()


@functools.cache
def build(tolerance):
    """Compile an integrator: itself, and the list of (lane, side, time) that its callbacks fill."""
    position, equations = system()
    impacts, counts = [], [0] * LANES

    def meet(side):
        def rebound(integrator, _, lane):
            impacts.append((lane, side, integrator.time[lane]))
            counts[lane] += 1
            state = integrator.state
            state[0, lane] = side
            state[1, lane] *= -RESTITUTION
            if counts[lane] == CAP:
                # a lane cannot leave its batch: at rest, without force, it meets no wall again
                state[:, lane] = integrator.pars[0, lane] = 0.0
            return True

        return rebound

    rising = heyoka.event_direction.positive
    events = [
        heyoka.t_event_batch(side * position - 1.0, callback=meet(side), direction=rising, cooldown=COOLDOWN)
        for side in (-1, 1)
    ]
    start = np.zeros((2, LANES))
    return heyoka.taylor_adaptive_batch(equations, start, tol=tolerance, t_events=events), impacts, counts


def strobe(states, tolerance=1e-15):
    """Map (n, 3) states x, x', A, n a multiple of LANES, through one period; returns Strobes."""
    integrator, impacts, counts = build(tolerance)
    y, parameter = integrator.state, integrator.pars
    zero, until = np.zeros(LANES), np.full(LANES, PERIOD)
    result = blank(states)
    for first in range(0, len(states), LANES):
        rows = slice(first, first + LANES)
        impacts.clear()
        counts[:] = [0] * LANES
        integrator.set_time(zero)
        integrator.reset_cooldowns()
        y[:], parameter[0] = states[rows, :2].T, states[rows, 2]
        integrator.propagate_until(until)
        result.ends[rows] = y.T
        slots = [0] * LANES
        for lane, side, time in impacts:
            result.sides[first + lane, slots[lane]] = side
            result.times[first + lane, slots[lane]] = time
            slots[lane] += 1
    return result

"""Map states with heyoka's batch integrator and one terminal event per wall; callbacks as in `heyoka_scalar`."""

import functools

import heyoka
import numpy as np

from benchmarks.heyoka_scalar import FREE, events, rigid_system, soft_system
from benchmarks.work import CAP, PERIOD, RESTITUTION, blank, held

LANES = 2 * heyoka.recommended_simd_size()


class Told:
    """Record of the callbacks: (lane, side, time) of each impact or entry, and the number of each lane."""

    def __init__(self):
        self.impacts, self.counts = [], [0] * LANES

    def clear(self):
        """Clear the record."""
        self.impacts.clear()
        self.counts[:] = [0] * LANES

    def note(self, integrator, side, lane):
        """Add an event of a lane."""
        self.impacts.append((lane, side, integrator.time[lane]))
        self.counts[lane] += 1
        if self.counts[lane] == CAP:
            # A lane cannot leave its batch; at rest and without force it hits no further wall.
            integrator.state[:, lane] = integrator.pars[:, lane] = 0.0

    def write(self, sides, times):
        """Write the itineraries of the lanes, (LANES, CAP)."""
        slots = [0] * LANES
        for lane, side, time in self.impacts:
            sides[lane, slots[lane]], times[lane, slots[lane]] = side, time
            slots[lane] += 1


def rebounds(told):
    """Make the callbacks at rigid walls."""

    def meet(side):
        def rebound(integrator, _, lane):
            state = integrator.state
            state[0, lane] = side
            state[1, lane] *= -RESTITUTION
            told.note(integrator, side, lane)
            return True

        return rebound

    return meet


def switches(told, stiffness):
    """Make the callbacks at soft walls, which record entries."""

    def meet(side):
        within = (held(stiffness), stiffness, side)

        def switch(integrator, direction, lane):
            integrator.state[0, lane] = side
            integrator.pars[1:, lane] = within if direction > 0 else FREE
            if direction > 0:
                told.note(integrator, side, lane)
            return True

        return switch

    return meet


@functools.cache
def build(tolerance, stiffness, cubic):
    """Compile an integrator; returns it and the record of its callbacks."""
    told = Told()
    position, equations = rigid_system(cubic) if stiffness is None else soft_system()
    meet = rebounds(told) if stiffness is None else switches(told, stiffness)
    found = events(heyoka.t_event_batch, position, meet, stiffness)
    return heyoka.taylor_adaptive_batch(equations, np.zeros((2, LANES)), tol=tolerance, t_events=found), told


def strobe(states, tolerance=1e-15, stiffness=None, cubic=None):
    """Map (n, 3) states x, x', A, n a multiple of LANES, over one period; returns Strobes."""
    integrator, told = build(tolerance, stiffness, cubic)
    y, parameters = integrator.state, integrator.pars
    zero, until = np.zeros(LANES), np.full(LANES, PERIOD)
    result = blank(states)
    for first in range(0, len(states), LANES):
        rows = slice(first, first + LANES)
        told.clear()
        integrator.set_time(zero)
        integrator.reset_cooldowns()
        y[:], parameters[0] = states[rows, :2].T, states[rows, 2]
        if stiffness is not None:
            parameters[1:] = np.array(FREE)[:, None]
        integrator.propagate_until(until)
        result.ends[rows] = y.T
        told.write(result.sides[rows], result.times[rows])
    return result

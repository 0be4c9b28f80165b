"""Map states with heyoka's Taylor integrator and one terminal event per wall, one state at a time.

A Python callback reverses the velocity at a rigid wall, and switches the parameters of the force at a soft one.
"""

import functools

import heyoka
import numpy as np

from benchmarks.work import CAP, GAMMA, OMEGA, PERIOD, RESTITUTION, blank, held

# heyoka's default dead time after an event is longer, and misses impacts that follow within it. This one only prevents
# repeated detection of the same impact.
COOLDOWN = 1e-12
FREE = (GAMMA, 0.0, 0.0)  # damping, stiffness and position of the wall in contact: no contact


def rigid_system(cubic):
    """Return the symbol of the position and equation 3, with A as parameter 0 and an optional cubic term."""
    x, v = heyoka.make_vars("x", "v")
    force = heyoka.par[0] * heyoka.cos(OMEGA * heyoka.time)
    pull = force - x - 2 * GAMMA * v
    return x, [(x, v), (v, pull if cubic is None else pull - cubic * x * x * x)]


def soft_system():
    """Return the symbol of the position and the equation, with A and the entries of FREE as parameters."""
    x, v = heyoka.make_vars("x", "v")
    amplitude, damping, stiffness, place = (heyoka.par[k] for k in range(4))
    force = amplitude * heyoka.cos(OMEGA * heyoka.time)
    return x, [(x, v), (v, force - x - 2 * damping * v - stiffness * (x - place))]


def events(make, position, meet, stiffness):
    """Make the events of the walls, of one of heyoka's classes, that call meet(side).

    Between soft walls one event serves both directions: a separate event for the exit misses some that follow an entry
    within heyoka's step.
    """
    way = heyoka.event_direction.positive if stiffness is None else heyoka.event_direction.any
    return [make(side * position - 1.0, callback=meet(side), direction=way, cooldown=COOLDOWN) for side in (-1, 1)]


def rebounds(told):
    """Make the callbacks at rigid walls, which record (side, time)."""

    def meet(side):
        def rebound(integrator, _):
            told.append((side, integrator.time))
            state = integrator.state
            state[0] = side
            state[1] *= -RESTITUTION
            return len(told) < CAP

        return rebound

    return meet


def switches(told, stiffness):
    """Make the callbacks at soft walls, which record (side, time) of entries."""

    def meet(side):
        within = (held(stiffness), stiffness, side)

        def switch(integrator, direction):
            if direction > 0:
                told.append((side, integrator.time))
            integrator.state[0] = side
            integrator.pars[1:] = within if direction > 0 else FREE
            return len(told) < CAP

        return switch

    return meet


@functools.cache
def build(tolerance, stiffness, cubic):
    """Compile an integrator; returns it and the list of (side, time) that its callbacks fill."""
    told = []
    position, equations = rigid_system(cubic) if stiffness is None else soft_system()
    meet = rebounds(told) if stiffness is None else switches(told, stiffness)
    found = events(heyoka.t_event, position, meet, stiffness)
    return heyoka.taylor_adaptive(equations, [0.0, 0.0], tol=tolerance, t_events=found), told


def strobe(states, tolerance=1e-15, stiffness=None, cubic=None):
    """Map (n, 3) states x, x', A over one period at heyoka's tolerance; returns Strobes."""
    integrator, told = build(tolerance, stiffness, cubic)
    y, parameters = integrator.state, integrator.pars
    result = blank(states)
    for row, end, sides, times in zip(states, *result, strict=True):
        told.clear()
        integrator.time = 0.0
        integrator.reset_cooldowns()
        y[:], parameters[0] = row[:2], row[2]
        if stiffness is not None:
            parameters[1:] = FREE
        integrator.propagate_until(PERIOD)
        end[:] = y
        if told:
            sides[: len(told)], times[: len(told)] = np.transpose(told)
    return result

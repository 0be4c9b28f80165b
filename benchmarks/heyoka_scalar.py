"""heyoka's Taylor integrator with one terminal event a wall, one state at a time.

A Python callback turns the mass round at a rigid wall, and switches the parameters of the force at a soft one.
"""

import functools

import heyoka
import numpy as np

from benchmarks.work import CAP, GAMMA, OMEGA, PERIOD, RESTITUTION, blank, held

# heyoka derives a longer dead time after an event by default, and misses impacts that follow within it. This one only
# keeps it from finding the impact that it has just handled.
COOLDOWN = 1e-12
FREE = (GAMMA, 0.0, 0.0)  # damping, stiffness, position of the wall that presses: none does


def rigid_system(cubic):
    """The position's symbol and equation 3, with A as parameter 0, and perhaps a cubic term."""
    x, v = heyoka.make_vars("x", "v")
    force = heyoka.par[0] * heyoka.cos(OMEGA * heyoka.time)
    pull = force - x - 2 * GAMMA * v
    return x, [(x, v), (v, pull if cubic is None else pull - cubic * x * x * x)]


def soft_system():
    """The position's symbol and the equation, with A and what FREE names as parameters."""
    x, v = heyoka.make_vars("x", "v")
    amplitude, damping, stiffness, place = (heyoka.par[k] for k in range(4))
    force = amplitude * heyoka.cos(OMEGA * heyoka.time)
    return x, [(x, v), (v, force - x - 2 * damping * v - stiffness * (x - place))]


def events(make, position, meet, stiffness):
    """The events of the walls, made by one of heyoka's classes, that call meet(side).

    Between soft walls one event is for both ways: of two, the one for the way out misses some that follow an entry
    within heyoka's step.
    """
    way = heyoka.event_direction.positive if stiffness is None else heyoka.event_direction.any
    return [make(side * position - 1.0, callback=meet(side), direction=way, cooldown=COOLDOWN) for side in (-1, 1)]


def rebounds(told):
    """The callbacks at rigid walls, which note (side, time)."""

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
    """The callbacks at soft walls, which note (side, time) of entries."""

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
    """Compile an integrator: itself, and the list of (side, time) that its callbacks fill."""
    told = []
    position, equations = rigid_system(cubic) if stiffness is None else soft_system()
    meet = rebounds(told) if stiffness is None else switches(told, stiffness)
    found = events(heyoka.t_event, position, meet, stiffness)
    return heyoka.taylor_adaptive(equations, [0.0, 0.0], tol=tolerance, t_events=found), told


def strobe(states, tolerance=1e-15, stiffness=None, cubic=None):
    """Map (n, 3) states x, x', A through one period at heyoka's tolerance; returns Strobes."""
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

"""Map whole drive periods with each method between fixed walls, from impact to impact."""

import functools
import math
from typing import NamedTuple

import heyoka
import numpy as np

from tests.reference import contacts
from tests.reference.lanes import LONG, Side, travel
from tests.reference.lanes import Lanes as LongLanes

from . import methods
from .exact_flow import Lanes, Wall
from .flights import Flights

ROOM = 32  # largest number of impacts in a period; a lane with more is given up


class Scenes(NamedTuple):
    """Parameters and states at phase 0, (scenes,) each, of one mass between fixed walls `low` and `high`."""

    amplitude: np.ndarray
    omega: np.ndarray
    gamma: np.ndarray
    restitution: np.ndarray
    low: np.ndarray
    high: np.ndarray
    x: np.ndarray
    v: np.ndarray


class Period(NamedTuple):
    """End of a period: (scenes,) x and v, nan on failure; (scenes, ROOM) sides of the impacts, 0 in empty slots."""

    x: np.ndarray
    v: np.ndarray
    sides: np.ndarray


def by_flights(met, scenes, room=ROOM):
    """Map a `Period` by a method of `methods`: an impact reverses the velocity and starts the next flight."""
    count = len(scenes.x)
    x, v, phase = scenes.x.copy(), scenes.v.copy(), np.zeros(count)
    left, sides, turn = 2.0 * np.pi / scenes.omega, np.zeros((count, room), np.int8), np.zeros(count, int)
    nothing = np.zeros(count)
    while (left > 0).any() and (turn < room).any():
        lanes = Lanes(scenes.gamma, scenes.omega, scenes.amplitude, phase, x, v)
        walls = Wall(-1, 0, scenes.low, nothing, nothing), Wall(1, 0, scenes.high, nothing, nothing)
        going = np.flatnonzero((left > 0) & (turn < room)) if met.func is not methods.by_diffrax else np.arange(count)
        known = nothing, np.zeros(count, int), nothing, np.ones(count, bool)
        found = met(Flights(lanes, walls, np.where(turn < room, left, 0.0), *known).some(going))
        hit = found.side != 0
        x[going] = np.where(hit, np.where(found.side > 0, scenes.high[going], scenes.low[going]), found.x)
        v[going] = np.where(hit, -scenes.restitution[going] * found.v, found.v)
        sides[going[hit], turn[going[hit]]] = found.side[hit]
        spent = np.where(hit, found.time, left[going])
        phase[going] += scenes.omega[going] * spent
        left[going] = np.where(hit, np.maximum(left[going] - spent, 0.0), 0.0)
        turn[going] += hit
    given_up = (turn >= room) & (left > 0)
    return Period(np.where(given_up, np.nan, x), np.where(given_up, np.nan, v), sides)


@functools.cache
def _heyoka(tolerance):
    """Return an integrator with callbacks that reverse the velocity, and the data they read and write."""
    x, v = heyoka.make_vars("x", "v")
    gamma, omega, amplitude, low, high = (heyoka.par[k] for k in range(5))
    told, given = [], {"restitution": 1.0, "room": ROOM}

    def meet(side):
        def rebound(integrator, _):
            told.append(side)
            integrator.state[0] = integrator.pars[3 if side < 0 else 4]
            integrator.state[1] *= -given["restitution"]
            return len(told) < given["room"]

        return rebound

    way = {"direction": heyoka.event_direction.positive, "cooldown": 1e-12}
    events = [
        heyoka.t_event(low - x, callback=meet(-1), **way),
        heyoka.t_event(x - high, callback=meet(1), **way),
    ]
    equations = [(x, v), (v, amplitude * heyoka.cos(omega * heyoka.time) - x - 2.0 * gamma * v)]
    return heyoka.taylor_adaptive(equations, [0.0, 0.0], tol=tolerance, t_events=events), told, given


def by_heyoka(scenes, tolerance, room=ROOM):
    """Map a `Period` by heyoka in one call, as its users do it: a callback reverses the velocity."""
    integrator, told, given = _heyoka(tolerance)
    found = Period(scenes.x.copy(), scenes.v.copy(), np.zeros((len(scenes.x), room), np.int8))
    for lane, (amplitude, omega, gamma, restitution, low, high, x, v) in enumerate(zip(*scenes, strict=True)):
        told.clear()
        given.update(restitution=restitution, room=room)
        integrator.time, integrator.pars[:] = 0.0, (gamma, omega, amplitude, low, high)
        integrator.state[:] = x, v
        integrator.reset_cooldowns()
        integrator.propagate_until(2.0 * math.pi / omega)
        found.sides[lane, : len(told)] = told
        found.x[lane], found.v[lane] = integrator.state if len(told) < room else (math.nan, math.nan)
    return found


def true(scenes):
    """Return the `Period` in 80-bit floats, each contact certified; x and v may be such floats."""
    count = len(scenes.x)
    x, v, begun = scenes.x.astype(LONG), scenes.v.astype(LONG), np.zeros(count, LONG)
    end = 2 * LONG(np.pi) / scenes.omega.astype(LONG) + LONG(1.2246467991473532e-16) * 2 / scenes.omega
    sides, turn, going = np.zeros((count, ROOM), np.int8), np.zeros(count, int), np.arange(count)
    while going.size:
        lanes = _long_lanes(scenes, going, x, v, begun)
        left = end[going] - begun[going]
        time, side, _, _ = contacts.first_contact(lanes, left.astype(float), np.zeros(going.size))
        hit = np.isfinite(time)
        spent = np.where(hit, time, left)
        at_x, at_v = travel(lanes, lanes.x, lanes.v, np.zeros_like(spent), spent)
        wall = np.where(side > 0, scenes.high[going], scenes.low[going])
        x[going], v[going] = np.where(hit, wall, at_x), np.where(hit, -scenes.restitution[going] * at_v, at_v)
        begun[going] += spent
        sides[going[hit], turn[going[hit]]] = side[hit]
        turn[going] += hit
        going = going[hit & (turn[going] < ROOM)]
    given_up = turn >= ROOM
    return Period(np.where(given_up, np.nan, x), np.where(given_up, np.nan, v), sides)


def _long_lanes(scenes, going, x, v, begun):
    phase = scenes.omega[going].astype(LONG) * begun[going]
    nothing = np.zeros(going.size)
    walls = [Side(-1, 0, scenes.low[going], nothing, nothing), Side(1, 0, scenes.high[going], nothing, nothing)]
    own = (each[going] for each in (scenes.gamma, scenes.omega, scenes.amplitude))
    return LongLanes(*own, phase, x[going], v[going], walls)

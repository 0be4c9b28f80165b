"""Flights for the missed-contact test: near grazes of known depth, and what truly happens, in 80-bit floats."""

from typing import NamedTuple

import numpy as np
from jax import tree

from .contacts import first_contact
from .lanes import LONG, Lanes, Side, acceleration, clearance, scale, take, travel, wall_course

DEEPEST, ULPS, LATEST = 1e-2, 8, 5.0


class Flights(NamedTuple):
    """Flights from doubles that are exact inputs; arrays of one length. What is expected is right for these doubles.

    lanes: the starts. horizon: time to fly. contact: whether there is an impact in that time; side (-1, +1; 0 none),
    time (inf: none) and relative speed of the first one. depth of the near graze: > 0 a contact, < 0 a miss. ulp:
    spacing of a double at the flight's scale.
    """

    lanes: Lanes
    horizon: np.ndarray
    contact: np.ndarray
    side: np.ndarray
    time: np.ndarray
    speed: np.ndarray
    depth: np.ndarray
    ulp: np.ndarray


def make_flights(seed, count, left=0, right=None, periods=1, sample=20000):
    """Flights: left and right are None (no wall), 0 (at rest) or the harmonic of a moving wall; periods 1 to 3.

    omega runs from 0.3 (periods 1) or from where the horizon is 5 (periods 2, 3) to 5; gamma 0 to 1.5, A 0 to 10.
    """
    rng = np.random.default_rng([seed, periods, 9 if left is None else left, 9 if right is None else right])
    flights = some_flights(rng, sample, left, right, periods)
    while len(flights.time) < count:
        more = some_flights(rng, sample, left, right, periods)
        flights = tree.map(lambda one, other: np.concatenate([one, other]) if np.ndim(one) else one, flights, more)
    return take(flights, slice(count))


def some_flights(rng, n, left, right, periods):
    """The flights that survive of n draws."""
    lanes = draw_lanes(rng, n, left, right, periods)
    horizon = 2 * np.pi * periods / lanes.omega
    graze = rng.uniform(0, np.minimum(LATEST, horizon))
    pick = rng.integers(0, len(lanes.walls), n)
    aim(lanes, pick, graze, np.zeros(n))
    low = np.log(ULPS * np.spacing(scale(lanes)))
    depth = np.exp(rng.uniform(low, np.log(DEEPEST))) * rng.choice([-1.0, 1.0], n)
    good = aim(lanes, pick, graze, depth) & inside(lanes, graze, depth)
    lanes, horizon, graze, pick = take((lanes, horizon, graze, pick), good)
    ulp = np.spacing(scale(lanes))
    time, side, speed, sure = first_contact(lanes, horizon, ULPS * ulp)
    depth, design = -depth_at(lanes, pick, graze), np.array([wall.side for wall in lanes.walls])[pick]
    sure &= np.where(depth > 0, (time < graze) & (side == design), time > graze)
    return take(Flights(lanes, horizon, np.isfinite(time), side, time, speed, depth, ulp), sure)


def draw_lanes(rng, n, left, right, periods):
    """n scenes and start phases; the states are set later."""
    kind = rng.choice(4, n, p=[0.05, 0.03, 0.46, 0.46])
    gamma = np.choose(kind, [np.zeros(n), np.ones(n), rng.uniform(0, 0.3, n), rng.uniform(0, 1.5, n)])
    omega = rng.uniform(0.3 if periods == 1 else 2 * np.pi * periods / LATEST, 5, n)
    phase = np.where(rng.random(n) < 0.5, 0.0, rng.uniform(0, 2 * np.pi, n))
    gap, low = rng.uniform(0.3, 4, n), rng.uniform(-4, 2, n)
    walls = []
    for side, harmonic, place in ((-1, left, low), (1, right, low + gap)):
        if harmonic is not None:
            swing, own = rng.uniform(0, 0.45, n) * gap, rng.uniform(0, 2 * np.pi, n)
            walls.append(Side(side, harmonic, place, swing if harmonic else np.zeros(n), own))
    return Lanes(gamma, omega, rng.uniform(0, 10, n), phase, np.zeros(n), np.zeros(n), walls)


def aim(lanes, pick, graze, depth):
    """Set the starts so that wall `pick` is left at relative rest at time graze, `depth` behind it; mask of minima."""
    begin, good = graze.astype(LONG), np.zeros(len(lanes.x), bool)
    for k, wall in enumerate(lanes.walls):
        mine = np.flatnonzero(pick == k)
        some, t = take(lanes, mine), begin[mine]
        place, speed, change = wall_course(some, take(wall, mine), t)
        x = place + wall.side * depth[mine]
        good[mine] = wall.side * (change - acceleration(some, x, speed, t)) > 0
        back = travel(some, x, speed, t, np.zeros_like(t))
        lanes.x[mine], lanes.v[mine] = (value.astype(float) for value in back)
    return good


def inside(lanes, graze, depth, samples=12):
    """A coarse look that spares work: between the walls at the start and, but for the graze itself, up to it."""
    good = np.ones(len(lanes.x), bool)
    for part in np.arange(samples) / samples:
        for wall in lanes.walls:
            good &= clearance(lanes, wall, part * graze)[0] > np.where(part > 0, -np.abs(depth), 0)
    return good


def depth_at(lanes, pick, graze):
    """Exact clearance at the extremum near the intended time, for the rounded start (two Newton steps)."""
    t, result = graze.astype(LONG), np.zeros(len(lanes.x), LONG)
    for k, wall in enumerate(lanes.walls):
        mine = np.flatnonzero(pick == k)
        some, other, at = take(lanes, mine), take(wall, mine), t[mine]
        for _ in range(2):
            _, slope, bend = clearance(some, other, at)
            at = at - slope / bend
        result[mine] = clearance(some, other, at)[0]
    return result

"""Flights for the missed-contact test: near grazes of known depth, and what truly happens, in 80-bit floats."""

from dataclasses import dataclass

import numpy as np

from .contacts import first_contact
from .lanes import LONG, Lanes, Side, acceleration, clearance, scale, travel, wall_course
from .scene import Motion, Scene, Wall

DEEPEST, ULPS, LATEST = 1e-2, 8, 5.0


@dataclass
class Flights:
    """Flights from doubles that are exact inputs; arrays of one length. What is expected is right for these doubles.

    lanes: gamma, omega, amplitude, phase (start's drive phase), x, v and walls (see lanes.Lanes, lanes.Side).
    periods: the whole periods to fly, horizon = periods 2 pi / omega. contact: whether there is an impact in that
    time; side (-1, +1; 0 none), time (inf: none) and relative speed of the first one. design: the side of the wall
    of the near graze, graze: its time, depth: its depth, > 0 a contact, < 0 a miss. ulp: spacing of a double at the
    flight's scale.
    """

    lanes: Lanes
    periods: int
    horizon: np.ndarray
    contact: np.ndarray
    side: np.ndarray
    time: np.ndarray
    speed: np.ndarray
    design: np.ndarray
    graze: np.ndarray
    depth: np.ndarray
    ulp: np.ndarray


def make_flights(seed, count, left=0, right=None, periods=1, sample=20000):
    """Flights: left and right are None (no wall), 0 (at rest) or the harmonic of a moving wall; periods 1 to 3.

    omega runs from 0.3 (periods 1) or from where the horizon is 5 (periods 2, 3) to 5; gamma 0 to 1.5, A 0 to 10.
    """
    rng = np.random.default_rng([seed, periods, 9 if left is None else left, 9 if right is None else right])
    parts, total = [], 0
    while total < count:
        parts.append(some_flights(rng, sample, left, right, periods))
        total += len(parts[-1].time)
    return first(join(parts), count)


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
    lanes, horizon, graze, pick = lanes.take(good), horizon[good], graze[good], pick[good]
    ulp = np.spacing(scale(lanes))
    time, side, speed, sure = first_contact(lanes, horizon, ULPS * ulp)
    depth, design = -depth_at(lanes, pick, graze), np.array([wall.side for wall in lanes.walls])[pick]
    hit = (time < graze) & (side == design)
    sure &= np.where(depth > 0, hit, time > graze)
    values = (horizon, np.isfinite(time), side, time, speed, design, graze, depth, ulp)
    every = Flights(lanes, periods, *(np.asarray(value) for value in values))
    return first(every, sure)


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
    begin, good = graze.astype(LONG), np.zeros(len(lanes), bool)
    for k, wall in enumerate(lanes.walls):
        mine = np.flatnonzero(pick == k)
        some, t = lanes.take(mine), begin[mine]
        place, speed, change = wall_course(some, wall.take(mine), t)
        x = place + wall.side * depth[mine]
        good[mine] = wall.side * (change - acceleration(some, x, speed, t)) > 0
        back = travel(some, x, speed, t, np.zeros_like(t))
        lanes.x[mine], lanes.v[mine] = (value.astype(float) for value in back)
    return good


def inside(lanes, graze, depth, samples=12):
    """A coarse look that spares work: between the walls at the start and, but for the graze itself, up to it."""
    good = np.ones(len(lanes), bool)
    for part in np.arange(samples) / samples:
        for wall in lanes.walls:
            good &= clearance(lanes, wall, part * graze)[0] > np.where(part > 0, -np.abs(depth), 0)
    return good


def depth_at(lanes, pick, graze):
    """Exact clearance at the extremum near the intended time, for the rounded start (two Newton steps)."""
    t, result = graze.astype(LONG), np.zeros(len(lanes), LONG)
    for k, wall in enumerate(lanes.walls):
        mine = np.flatnonzero(pick == k)
        some, other, at = lanes.take(mine), wall.take(mine), t[mine]
        for _ in range(2):
            _, slope, bend = clearance(some, other, at)
            at = at - slope / bend
        result[mine] = clearance(some, other, at)[0]
    return result


def scene_of(flights, k, restitution):
    """The Scene of flight k, with a restitution for its walls."""
    lanes, walls = flights.lanes, {}
    for wall in lanes.walls:
        motion = Motion(float(wall.swing[k]), float(wall.phase[k]), wall.harmonic) if wall.harmonic else None
        walls[wall.side] = Wall(float(wall.position[k]), restitution, motion)
    oscillator = (float(value[k]) for value in (lanes.gamma, lanes.omega, lanes.amplitude))
    return Scene(*oscillator, walls.get(-1), walls.get(1))


def first(flights, which):
    """The flights of a mask, or the first `which` of them."""
    index = slice(which) if isinstance(which, int) else which
    arrays = [value[index] for name, value in vars(flights).items() if name not in ("lanes", "periods")]
    return Flights(flights.lanes.take(index), flights.periods, *arrays)


def join(parts):
    """One Flights of several."""
    arrays = [gather(parts, name) for name in vars(parts[0]) if name not in ("lanes", "periods")]
    lanes = [part.lanes for part in parts]
    walls = []
    for same in zip(*(own.walls for own in lanes), strict=True):
        walls.append(Side(same[0].side, same[0].harmonic, *(gather(same, n) for n in ("position", "swing", "phase"))))
    inputs = [gather(lanes, name) for name in ("gamma", "omega", "amplitude", "phase", "x", "v")]
    return Flights(Lanes(*inputs, walls), parts[0].periods, *arrays)


def gather(records, name):
    """One array of the records' arrays of a name."""
    return np.concatenate([getattr(record, name) for record in records])

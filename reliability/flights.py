"""Construct flights whose first contact is known, from the contact backward.

They are so short that the clearance is convex or concave from the start to `until`, by a bound on its third derivative.
80-bit floats decide them for the doubles to which the start is rounded.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .exact_flow import LONG, Lanes, Wall, acceleration, clearance, course, fly

SLACK = 8  # ulp of a flight's largest length; a turning point this close to a wall is doubtful


class Flights(NamedTuple):
    """Flights with the same walls.

    `walls`: the aimed wall first; `until`: the contact is known up to this time; `time`, `side`: the first contact
    until then, inf and 0 if there is none; `measure`: the varied quantity of the case, (lanes,), described in
    `Case.measure`; `sure`: True if the contact is beyond the stated doubt.
    """

    lanes: Lanes
    walls: tuple[Wall, ...]
    until: np.ndarray
    time: np.ndarray
    side: np.ndarray
    measure: np.ndarray
    sure: np.ndarray

    def some(self, lanes):
        """Select lanes."""
        walls = tuple(wall.some(lanes) for wall in self.walls)
        return Flights(self.lanes.some(lanes), walls, *(each[lanes] for each in self[2:]))


class Shape(NamedTuple):
    """Static properties of flights: side and harmonic of the aimed wall, harmonic of the other one or None."""

    side: int = 1
    harmonic: int = 0
    other: int | None = None


class Ranges(NamedTuple):
    """Distributions of the parameters of a case, functions of (generator, count); `size` of all lengths but A."""

    gamma: Callable = lambda rng, n: np.where(rng.random(n) < 0.1, 0.0, rng.uniform(0.0, 1.5, n))
    omega: Callable = lambda rng, n: rng.uniform(0.3, 5.0, n)
    amplitude: Callable = lambda rng, n: rng.uniform(0.0, 10.0, n)
    size: float = 1.0


def joined(parts, count):
    """Join Flights with the same walls, the first `count` of them."""
    lanes = Lanes(*map(np.concatenate, zip(*(part.lanes for part in parts), strict=True)))
    walls = []
    for same in zip(*(part.walls for part in parts), strict=True):
        walls.append(Wall(*same[0][:2], *(np.concatenate([one[k] for one in same]) for k in (2, 3, 4))))
    rest = (np.concatenate([part[k] for part in parts]) for k in range(2, len(Flights._fields)))
    return Flights(lanes, tuple(walls), *rest).some(slice(count))


def numbers(rng, n, ranges):
    """Draw Lanes; phase, x and v are those at the contact, and x and v are set later."""
    drawn = (getattr(ranges, name)(rng, n) for name in ("gamma", "omega", "amplitude"))
    return Lanes(*drawn, rng.uniform(0.0, 2.0 * np.pi, n), np.zeros(n), np.zeros(n))


def drawn_wall(rng, n, side, harmonic, lanes, ranges):
    """Draw a wall; a moving one is about as fast as the mass."""
    place, turn = ranges.size * rng.uniform(-4.0, 4.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    swing = ranges.size * rng.random(n) * np.minimum(1.0, 3.0 / (harmonic * lanes.omega)) if harmonic else np.zeros(n)
    return Wall(side, harmonic, place, swing, turn)


def farther(rng, lanes, wall, bound, until, ranges, harmonic):
    """Return the wall, and possibly one on the other side, farther away than the mass can move until then."""
    if harmonic is None:
        return (wall,)
    n = len(lanes.x)
    other = drawn_wall(rng, n, -wall.side, harmonic, lanes, ranges)
    gap = 1.01 * (bound * until + wall.swing + other.swing) + ranges.size * rng.uniform(0.05, 3.0, n)
    return wall, other._replace(position=wall.position - wall.side * gap)


def fastest(lanes, time):
    """Bound abs(x) and abs(v) within a time of the lanes, forward and backward."""
    return (np.hypot(lanes.x, lanes.v) + lanes.amplitude * time) * np.exp(2.0 * lanes.gamma * time)


def steepest(lanes, wall, bound):
    """Bound the third derivative of a clearance for bounded abs(x) and abs(v)."""
    force = lanes.amplitude + 2.0 * lanes.gamma * bound + bound
    rate = wall.harmonic * lanes.omega
    return lanes.amplitude * lanes.omega + 2.0 * lanes.gamma * force + bound + wall.swing * rate**3


def longest(lanes):
    """Return a time within which nothing grows by much."""
    return 0.5 / (1.0 + 2.0 * lanes.gamma + lanes.omega)


def laid_back(lanes, before):
    """Return the lanes at an earlier time, in doubles."""
    x, v = (each.astype(float) for each in fly(lanes, -before))
    return lanes._replace(phase=np.mod(lanes.phase - lanes.omega * before, 2.0 * np.pi), x=x, v=v)


def ulp(lanes, walls):
    """Return the spacing of doubles at a flight's largest length."""
    lengths = [abs(lanes.x), abs(lanes.v), abs(lanes.amplitude)]
    return np.spacing(np.maximum.reduce(lengths + [abs(wall.position) + abs(wall.swing) for wall in walls]))


def crossing(lanes, wall, t, until):
    """Return the time near t at which a clearance passes 0: Newton's method, kept between 0 and until."""
    for _ in range(6):
        gap, slope, _ = clearance(lanes, wall, t)
        with np.errstate(all="ignore"):
            t = np.clip(np.nan_to_num(t - gap / slope, nan=0.0), 0.0, until)
    return t


def grazes(rng, n, shape, ranges, low=SLACK, high=1e-2, most_ulp=math.inf):
    """Draw flights with turning points beyond a wall or short of it.

    `measure` is the depth, negative without contact, from `low` ulp to `high` of the size, or `most_ulp`.
    """
    lanes = numbers(rng, n, ranges)
    wall = drawn_wall(rng, n, shape.side, shape.harmonic, lanes, ranges)
    nothing = np.zeros(n)
    place, speed, change = (each.astype(float) for each in course(lanes, wall, nothing))
    lanes = lanes._replace(x=place, v=speed)
    bend = wall.side * (change - acceleration(lanes, place, speed, nothing)).astype(float)
    room = longest(lanes) / max(1.0, shape.harmonic)
    bound = fastest(lanes, 2.0 * room)
    before = rng.uniform(0.2, 0.95, n) * np.minimum(room, 0.5 * bend / steepest(lanes, wall, bound))
    until = 2.0 * before
    walls = farther(rng, lanes, wall, bound, until, ranges, shape.other)
    unit = ulp(lanes, walls)
    with np.errstate(invalid="ignore", divide="ignore"):
        deepest = np.minimum(np.minimum(high * ranges.size, most_ulp * unit), 0.12 * bend * before * before)
        least, most = np.log(low * unit), np.log(deepest)
    good = (bend > 0) & (most > least)
    depth = np.exp(least + rng.random(n) * (most - least)) * rng.choice([-1.0, 1.0], n)
    lanes = lanes._replace(x=lanes.x + wall.side * np.where(good, depth, 0.0))
    lanes, walls = lanes.some(good), tuple(each.some(good) for each in walls)
    until, before, unit = until[good], before[good], unit[good]
    lanes = laid_back(lanes, before)
    return decided(lanes, walls, before.astype(LONG), until, unit, low)


def decided(lanes, walls, turn, until, unit, low):
    """Return the Flights of the rounded starts, by their motion near the turning point."""
    wall = walls[0]
    for _ in range(3):
        _, slope, bend = clearance(lanes, wall, turn)
        turn = turn - slope / bend
    gap, _, bend = clearance(lanes, wall, turn)
    hits = gap < 0
    with np.errstate(invalid="ignore"):
        time = crossing(lanes, wall, turn - np.sqrt(np.where(hits, -2.0 * gap / bend, 0.0)), turn)
    sure = (abs(gap) >= low * unit) & (turn > 0) & (turn < until)
    time, side = np.where(hits, time, np.inf).astype(float), np.where(hits, wall.side, 0)
    return Flights(lanes, walls, until, time, side, -gap.astype(float), sure)


def squeezes(rng, n, shape, ranges):
    """Draw flights between walls at a distance down to 1e-12, which may move; `measure` is the time between the two."""
    lanes, (side, harmonic, _) = numbers(rng, n, ranges), shape
    near = drawn_wall(rng, n, -side, 0, lanes, ranges)
    met = drawn_wall(rng, n, side, harmonic, lanes, ranges)
    gap = ranges.size * np.exp(rng.uniform(np.log(1e-12), np.log(0.1), n))
    speed = ranges.size * rng.uniform(0.1, 3.0, n)
    met = met._replace(position=near.position + side * gap, swing=met.swing * gap)
    if harmonic:  # the smallest distance is the gap
        met = met._replace(position=met.position + side * met.swing)
    lanes = lanes._replace(x=near.position, v=side * speed)
    until = 4.0 * (gap + 2.0 * met.swing) / speed
    slower = (fastest(lanes, until) * (1.0 + 2.0 * lanes.gamma) + lanes.amplitude) * until
    slower += met.swing * harmonic * lanes.omega
    good = (slower < 0.3 * speed) & (until < longest(lanes))
    lanes, walls, until = lanes.some(good), (met.some(good), near.some(good)), until[good]
    speed, begun = speed[good], clearance(lanes, walls[0], np.zeros(len(until)))[0]
    time = crossing(lanes, walls[0], begun / speed, until).astype(float)
    sure = begun > SLACK * ulp(lanes, walls)
    return Flights(lanes, walls, until, time, np.full(len(until), side), time, sure)


def hops(rng, n, shape, ranges):
    """Draw flights that leave a fixed wall at low speed and are pressed back; `measure` is that speed."""
    lanes, side = numbers(rng, n, ranges), shape.side
    wall = drawn_wall(rng, n, side, 0, lanes, ranges)
    leaves = ranges.size * np.exp(rng.uniform(np.log(1e-10), np.log(0.1), n))
    lanes = lanes._replace(x=wall.position, v=-side * leaves)
    press = side * acceleration(lanes, lanes.x, lanes.v, np.zeros(n)).astype(float)
    until = 3.0 * leaves / press
    bound = fastest(lanes, longest(lanes))
    good = (press > 0) & (until < longest(lanes)) & (until * steepest(lanes, wall, bound) < 0.3 * press)
    walls = farther(rng, lanes, wall, bound, longest(lanes), ranges, shape.other)
    lanes, walls = lanes.some(good), tuple(each.some(good) for each in walls)
    until, press, leaves = until[good], press[good], leaves[good]
    time = crossing(lanes, walls[0], (2.0 * leaves / press).astype(LONG), until)
    sure = leaves * time / 4.0 > SLACK * ulp(lanes, walls)  # height of the hop
    return Flights(lanes, walls, until, time.astype(float), np.full(len(until), side), leaves, sure)


def on_walls(rng, n, shape, ranges, into):
    """Draw flights that start on a fixed wall, into it or away and pulled away; `measure` is the speed."""
    lanes, side = numbers(rng, n, ranges), shape.side
    wall = drawn_wall(rng, n, side, 0, lanes, ranges)
    speed = ranges.size * np.exp(rng.uniform(np.log(1e-10), np.log(1.0), n))
    lanes = lanes._replace(x=wall.position, v=(side if into else -side) * speed)
    pull = -side * acceleration(lanes, lanes.x, lanes.v, np.zeros(n)).astype(float)
    bound = fastest(lanes, longest(lanes))
    until = np.minimum(longest(lanes), 0.5 * pull / steepest(lanes, wall, bound))
    good = np.ones(n, bool) if into else pull > 0
    walls = farther(rng, lanes, wall, bound, longest(lanes), ranges, shape.other)
    lanes, walls = lanes.some(good), tuple(each.some(good) for each in walls)
    until, count = np.abs(until[good]), int(good.sum())
    time, hit = (np.zeros(count), side) if into else (np.full(count, np.inf), 0)
    return Flights(lanes, walls, until, time, np.full(count, hit), speed[good], np.ones(count, bool))

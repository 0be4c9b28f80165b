"""Define the hard cases: distributions of flights and their batches of one size."""

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tests.reference import flights as certified

from . import flights
from .exact_flow import Lanes, Wall
from .flights import Flights, Ranges, Shape

STILL = (Shape(1), Shape(-1), Shape(1, 0, 0), Shape(-1, 0, 2))
MOVING = (Shape(1, 1), Shape(-1, 2), Shape(1, 1, 0), Shape(-1, 3, 1))
DRAWN = 1.6  # ratio of flights drawn at once to those required


class Case(NamedTuple):
    """Case: description `words`, `draw` (rng, n, shape) -> Flights, static `shapes`, name of `Flights.measure`."""

    name: str
    words: str
    draw: Callable
    shapes: tuple[Shape, ...]
    measure: str = "depth"

    def batch(self, size, k):
        """Return batch number k, of `size` certain flights, and the number of doubtful ones among those drawn."""
        rng, parts, count, doubtful = np.random.default_rng([*self.name.encode(), k]), [], 0, 0
        shape = self.shapes[k % len(self.shapes)]
        while count < size:
            found = self.draw(rng, int(DRAWN * (size - count)) + 64, shape)
            doubtful += int((~found.sure).sum())
            parts.append(found.some(found.sure))
            count += len(parts[-1].until)
        return flights.joined(parts, size), doubtful


def logarithmic(low, high):
    """Make a log-uniform distribution between two numbers."""
    return lambda rng, n: np.exp(rng.uniform(np.log(low), np.log(high), n))


def uniform(low, high):
    """Make a uniform distribution between two numbers."""
    return lambda rng, n: rng.uniform(low, high, n)


def near_one(rng, n):
    """Draw 1, and numbers that differ from it by 1e-16 to 1e-2."""
    near = 1.0 + rng.choice([-1.0, 1.0], n) * logarithmic(1e-16, 1e-2)(rng, n)
    return np.where(rng.random(n) < 0.1, 1.0, near)


def nearly_none(rng, n):
    """Draw 0, and numbers of 1e-16 to 1e-2."""
    return np.where(rng.random(n) < 0.3, 0.0, logarithmic(1e-16, 1e-2)(rng, n))


def past_one(rng, n):
    """Draw as `near_one`, and numbers up to 50."""
    return np.where(rng.random(n) < 0.5, near_one(rng, n), logarithmic(1.0, 50.0)(rng, n))


def whole(rng, n, shape):
    """Draw flights of up to 5 time units that are certified piece by piece, with first contacts of others."""
    found = certified.make_flights(
        int(rng.integers(1 << 30)), n, *((None, shape.harmonic) if shape.side > 0 else (shape.harmonic, None))
    )
    own = found.lanes
    lanes = Lanes(own.gamma, own.omega, own.amplitude, own.phase, own.x, own.v)
    walls = tuple(Wall(each.side, each.harmonic, each.position, each.swing, each.phase) for each in own.walls)
    until = np.where(found.contact, found.time.astype(float) + 1e-6, found.horizon)
    time, side = found.time.astype(float), np.where(found.contact, found.side, 0)
    return Flights(lanes, walls, until, time, side, found.depth.astype(float), np.ones(len(side), bool))


def drawn(draw, ranges=None, **more):
    """Make a distribution with the given ranges of the parameters."""
    return functools.partial(draw, ranges=ranges or Ranges(), **more)


GRAZES = "near grazing: contacts 8 ulp to 1e-2 deep, and misses by the same distances"
CASES = (
    Case("grazes", f"{GRAZES}; fixed walls", drawn(flights.grazes), STILL),
    Case("grazes, moving walls", f"{GRAZES}; moving wall", drawn(flights.grazes), MOVING),
    Case(
        "past critical damping",
        "the same, gamma at and near 1, up to 50",
        drawn(flights.grazes, Ranges(gamma=past_one)),
        STILL,
    ),
    Case(
        "resonance",
        "the same, omega at and near 1, gamma 0 to 1e-2",
        drawn(flights.grazes, Ranges(gamma=nearly_none, omega=near_one)),
        STILL,
    ),
    Case(
        "strong drive", "the same, A 100 to 1e6", drawn(flights.grazes, Ranges(amplitude=logarithmic(1e2, 1e6))), STILL
    ),
    Case(
        "slow drive", "the same, omega 0.01 to 0.1", drawn(flights.grazes, Ranges(omega=logarithmic(0.01, 0.1))), STILL
    ),
    Case("fast drive", "the same, omega 10 to 50", drawn(flights.grazes, Ranges(omega=uniform(10.0, 50.0))), STILL),
    Case(
        "harmonics",
        "the same, wall motion of harmonic 17 or 50",
        drawn(flights.grazes),
        (Shape(1, 50), Shape(-1, 17, 0)),
    ),
    Case(
        "small scenes",
        "the same, all lengths scaled by 1e-12",
        drawn(flights.grazes, Ranges(amplitude=uniform(0.0, 1e-11), size=1e-12)),
        STILL,
    ),
    Case(
        "the other wall near",
        "flights from one wall to the other of duration 1e-13 to 0.1, in gaps from 1e-12 on",
        drawn(flights.squeezes),
        (Shape(1, 0, 0), Shape(-1, 1, 0), Shape(1, 2, 0)),
        "time between",
    ),
    Case(
        "slow impacts",
        "bounces that leave a wall with speeds of 0.1 to 1e-10, at least 8 ulp high",
        drawn(flights.hops),
        STILL,
        "speed",
    ),
    Case(
        "starts into a wall",
        "on a wall, moving into it with speeds of 1e-10 to 1",
        drawn(flights.on_walls, into=True),
        STILL,
        "speed",
    ),
    Case(
        "starts away from a wall",
        "on a wall, moving away from it and accelerated away",
        drawn(flights.on_walls, into=False),
        STILL,
        "speed",
    ),
)
WHOLE = Case("whole flights", f"{GRAZES}, at the end of flights of up to 5 time units", whole, MOVING[:2] + STILL[:2])
DOUBT = Case("in doubt", "near grazing by 1 to 8 ulp", drawn(flights.grazes, low=1.0, most_ulp=8.0), STILL)

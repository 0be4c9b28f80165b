"""The record of a motion over a strobe, and the rules by which a draw is too near a graze."""

import math
from dataclasses import dataclass, field

from flint import arb

from .search import Discard

SLOWEST = 1e-2
NEAREST = 1e-8
EDGE = 1e-9
MOST = 60


@dataclass
class Record:
    """The motion over a strobe. Times since its start; balls unless stated otherwise.

    turns holds every turning point of x - x_wall in flight, one wall after the other (Turn: time, side, clearance,
    minimum). least_clearance is the least of all of them, least_minimum of the minima alone (floats, inf if none).
    norm is the largest 2-norm of d(end)/d(state at an earlier time), product that of the norms of all flights' and
    impacts' matrices, jacobian d(end)/d(start) (rows of floats).
    scale is the largest of |x|, |v| at start, impacts and end, wall distances, A and A / sqrt(D).
    """

    x: arb = None
    v: arb = None
    times: list = field(default_factory=list)
    sides: list = field(default_factory=list)
    speeds: list = field(default_factory=list)
    turns: list = field(default_factory=list)
    least_speed: float = math.inf
    least_clearance: float = math.inf
    least_minimum: float = math.inf
    norm: float = 1.0
    product: float = 1.0
    jacobian: tuple = ((1.0, 0.0), (0.0, 1.0))
    scale: float = 0.0

    @property
    def count(self):
        """How many impacts there were."""
        return len(self.times)


def keep_turns(record, turns, since):
    """Add a flight's turning points to the record."""
    for turn in turns:
        near = float(turn.clearance)
        if near < NEAREST:
            raise Discard("a near graze")
        record.turns.append(turn._replace(time=since + turn.time))
        record.least_clearance = min(record.least_clearance, near)
        if turn.minimum:
            record.least_minimum = min(record.least_minimum, near)


def multiply(one, two):
    """Product of two 2 by 2 matrices."""
    return tuple(tuple(row[0] * two[0][j] + row[1] * two[1][j] for j in (0, 1)) for row in one)


def norm(matrix):
    """2-norm of a 2 by 2 matrix."""
    (a, b), (c, d) = matrix
    return 0.5 * (math.hypot(a + d, b - c) + math.hypot(a - d, b + c))

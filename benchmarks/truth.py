"""Compute true ends and itineraries in ball arithmetic or by high-precision Taylor series; judge results."""

from typing import NamedTuple

import mpmath
import numpy as np

from benchmarks.work import CAP, CUBIC, GAMMA, OMEGA, RESTITUTION, blank, held
from tests.reference import own_force, soft
from tests.reference.scene import Scene, Soft, Wall
from tests.reference.search import Discard

# Without an itinerary (the hand-written kernel returns none) an error of the end beyond this is a wrong itinerary.
FAR = 1e-6


class Truth(NamedTuple):
    """True ends (n, 2) and sides (n, CAP); `judged` (n,) is False for lanes that are excluded."""

    ends: np.ndarray
    sides: np.ndarray
    judged: np.ndarray


class Verdict(NamedTuple):
    """Numbers of lanes judged and wrong; errors of the ends (largest of x and x') of lanes with right itineraries."""

    judged: int
    wrong: int
    median: float
    high: float
    worst: float


def find(states, stiffness=None):
    """Compute the Truth for (n, 3) states x, x', A.

    Excluded are lanes that the reference rejects: an impact or entry slower than 1e-2 (so all chatter), a turning point
    within 1e-8 of a wall, an impact within 1e-9 of the end of the period, and more than CAP impacts.
    """
    ends, sides, _ = blank(states)
    judged = np.ones(len(states), dtype=bool)
    for lane, (x, v, amplitude) in enumerate(states):
        try:
            record = soft.strobe(Scene(GAMMA, OMEGA, amplitude, wall(-1.0, stiffness), wall(1.0, stiffness)), x, v)
        except Discard:
            judged[lane] = False
            continue
        if record.count > CAP:
            judged[lane] = False
            continue
        ends[lane] = float(record.x), float(record.v)
        sides[lane, : record.count] = record.sides
    return Truth(ends, sides, judged)


def duffing(states):
    """Compute the Truth for Duffing's oscillator.

    Excluded are an impact slower than 1e-2, a turning point or an end within 1e-8 of a wall, and more than CAP impacts.
    """
    ends, sides, _ = blank(states)
    judged = np.ones(len(states), dtype=bool)
    numbers = {"cubic": CUBIC, "damping": GAMMA}
    with mpmath.workdps(30):
        for lane, (x, v, amplitude) in enumerate(states):
            try:
                flown = own_force.flown(
                    own_force.duffing, numbers, amplitude, OMEGA, (-1.0, 1.0), RESTITUTION, x, v, most=CAP
                )
            except ArithmeticError:
                judged[lane] = False
                continue
            judged[lane] = flown.least > 1e-2 and flown.nearest > 1e-8
            ends[lane] = [float(each) for each in flown.end]
            sides[lane, : len(flown.hits)] = [side for _, side, _ in flown.hits]
    return Truth(ends, sides, judged)


def wall(place, stiffness):
    """Make the reference's wall at a position."""
    return Wall(place, RESTITUTION) if stiffness is None else Soft(place, stiffness, held(stiffness))


def judge(ends, sides, truth, far=FAR):
    """Judge ends (n, 2) and sides (n, CAP), or None for no itinerary, of the first n lanes of the truth.

    A nan end is wrong; without an itinerary a large error of the end is too. Errors are nan if no lane is right.
    """
    count = min(len(ends), len(truth.ends))
    judged = truth.judged[:count]
    error = np.abs(ends[:count] - truth.ends[:count]).max(axis=1)
    astray = error > far if sides is None else (sides[:count] != truth.sides[:count]).any(axis=1)
    astray |= np.isnan(error)
    wrong = judged & astray
    error = error[judged & ~wrong]
    median, high, worst = np.quantile(error, [0.5, 0.99, 1.0]) if error.size else (np.nan,) * 3
    return Verdict(int(judged.sum()), int(wrong.sum()), float(median), float(high), float(worst))

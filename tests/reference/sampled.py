"""The motion at times that are given, and its derivatives, from a certified strobe: replayed at many digits.

A derivative is a central difference of two replays, displaced by exact small steps: no chain rule, no saltation matrix.
"""

import numpy as np
from flint import arb, ctx

from .ball import Flight, Oscillator
from .slopes import PRECISION, STEP, landing, numbers, wall_at, with_numbers
from .soft import Way


def states(draw, record, times):
    """Doubles (times, 2) of x and v at these times, none of them at an impact of the record (`orbit.strobe`)."""
    with ctx.workprec(PRECISION):
        return np.array([[float(part) for part in row] for row in _run(draw, record, times, times)])


def slopes(draw, record, times):
    """The derivatives (times, 2, numbers + 1) by the numbers of the draw, as `slopes.names`, and by the own time."""
    values = numbers(draw)
    columns = []
    with ctx.workprec(PRECISION):
        for k in range(len(values) + 1):
            ends = []
            for sign in (1, -1):
                moved = [arb(each) + sign * arb(STEP) * (place == k) for place, each in enumerate(values)]
                late = [arb(time) + sign * arb(STEP) * (k == len(values)) for time in times]
                ends.append(_run(with_numbers(draw, moved), record, times, late))
            pairs = zip(*ends, strict=True)
            columns.append([[float((a - b) / (2 * arb(STEP))) for a, b in zip(*rows, strict=True)] for rows in pairs])
    return np.moveaxis(np.array(columns), 0, -1)


def _run(start, record, times, late):
    """Balls x, v at the late times; times: the same to a little, by which their flights are told."""
    scene, x, v, phase = start
    oscillator, since, found = Oscillator(*scene[:3]), arb(0), []
    left = list(zip(times, late, strict=True))
    for guess, side in [*zip(record.times, record.sides, strict=True), (None, 0)]:
        flight = Flight(oscillator, x, v, phase + oscillator.omega * since)
        while left and (guess is None or arb(left[0][0]) < guess):
            found.append(flight(arb(left.pop(0)[1]) - since))
        if guess is None:
            return found
        wall = scene.left if side < 0 else scene.right
        length = landing(flight, wall, (guess - since).mid())
        since += length
        x, speed = wall_at(oscillator, wall, phase + oscillator.omega * since)
        v = speed - wall.restitution * (flight(length)[1] - speed)


class Until(Way):
    """A mass on its way between walls that may be soft, to a time in place of a number of periods."""

    def __init__(self, draw, time):
        """draw: numbers may be balls, displaced by a little."""
        scene, x, v, phase = draw
        super().__init__(scene, arb(x), arb(v), arb(phase), 0.0, 1, 1e-2)
        self.end = arb(time)


def soft_end(draw, time, precision=400):
    """The `soft.Record` of the way to a time. Raises Discard and Undecided as `soft.strobe` does."""
    with ctx.workprec(precision):
        return Until(draw, time).go()

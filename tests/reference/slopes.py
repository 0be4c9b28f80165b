"""Derivatives of the stroboscopic map by the state and by every number of the scene, of any order.

A certified itinerary is replayed at many digits for numbers displaced by exact small steps, and the differences are
the derivatives: no chain rule, no saltation matrix. The steps are far below what changes an itinerary that keeps the
rules of `orbit.strobe`. A start on a wall that rebounds at once is left out: its derivative is one-sided.
"""

from itertools import islice
from math import comb

import numpy as np
from flint import arb, ctx

from .ball import Flight, Oscillator
from .scene import Scene

PRECISION = 640
STEP = 2.0**-100  # the error of a central difference is of the order of its square, the rounding's 2^-640 / STEP^order
SETTLED = 2.0**-400  # after a Newton step this small the next would be below the last digit


def names(scene):
    """The names of the numbers, in the order of every vector here.

    x, v, phase (the drive's at the start), gamma, omega, amplitude; then for the left wall and the right one, where
    there is one, position, restitution and, where it moves, motion.amplitude, motion.phase: "left.motion.phase".
    """
    found = ["x", "v", "phase", "gamma", "omega", "amplitude"]
    for side, wall in scene.walls():
        own = ["position", "restitution", *(["motion.amplitude", "motion.phase"] if wall.motion else [])]
        found += [f"{'left' if side < 0 else 'right'}.{name}" for name in own]
    return found


def numbers(draw):
    """The values of a draw (scene, x, v, phase), in the order of `names`."""
    scene, *state = draw
    return [
        *state,
        *scene[:3],
        *(value for _, wall in scene.walls() for value in (*wall[:2], *(wall.motion or ())[:2])),
    ]


def with_numbers(draw, values):
    """(scene, x, v, phase) of the draw's structure with other values, in the order of `names`."""
    scene, left = draw[0], iter(values)
    x, v, phase, *plain = islice(left, 6)
    walls = []
    for wall in (scene.left, scene.right):
        if wall is not None:
            wall = wall._replace(position=next(left), restitution=next(left))
            if wall.motion is not None:
                wall = wall._replace(motion=wall.motion._replace(amplitude=next(left), phase=next(left)))
        walls.append(wall)
    return Scene(*plain, *walls), x, v, phase


def jacobian(draw, record, periods=1):
    """The first derivatives, an array (2 + 2 impacts, names): rows x and v at the end, impact times, impact speeds.

    draw: (scene, x, v, phase); record: its `orbit.strobe` over the same periods.
    """
    units = np.eye(len(names(draw[0])))
    columns = [derivative(draw, record, unit, 1, periods) for unit in units]
    return np.array([[float(ball) for ball in column] for column in columns]).T


def directional(draw, record, direction, order, periods=1):
    """The array (2,) of d^order/ds^order of (x, v) at the end for the numbers p + s direction, at s = 0.

    Mixed derivatives follow by polarisation: D^2[a, b] = (D^2[a + b, a + b] - D^2[a - b, a - b]) / 4.
    """
    return np.array([float(ball) for ball in derivative(draw, record, direction, order, periods)[:2]])


def derivative(draw, record, direction, order, periods=1, step=STEP):
    """Balls: a derivative of x, v, the impact times and speeds along a direction; the radii are of rounding alone."""
    with ctx.workprec(PRECISION):
        total = [arb(0)] * (2 + 2 * record.count)
        pairs = [(arb(value), arb(float(slope))) for value, slope in zip(numbers(draw), direction, strict=True)]
        for k in range(order + 1):
            shift = (order - 2 * k) * arb(step)
            start = with_numbers(draw, [value + shift * slope for value, slope in pairs])
            weight = (-1) ** k * comb(order, k)
            total = [one + weight * row for one, row in zip(total, replay(start, record, periods), strict=True)]
        return [each / (2 * arb(step)) ** order for each in total]


def replay(start, record, periods=1):
    """Balls x, v at the end, impact times, impact speeds of a start, for the record's sides and near its times."""
    scene, x, v, phase = start
    oscillator, since, times, speeds = Oscillator(*scene[:3]), arb(0), [], []
    for guess, side in zip(record.times, record.sides, strict=True):
        wall = scene.left if side < 0 else scene.right
        flight = Flight(oscillator, x, v, phase + oscillator.omega * since)
        length = landing(flight, wall, (guess - since).mid())
        since += length
        x, speed = wall_at(oscillator, wall, phase + oscillator.omega * since)
        relative = flight(length)[1] - speed
        v = speed - wall.restitution * relative
        times.append(since)
        speeds.append(side * relative)
    end = 2 * arb.pi() * periods / oscillator.omega
    return [*Flight(oscillator, x, v, phase + oscillator.omega * since)(end - since), *times, *speeds]


def landing(flight, wall, t):
    """The time, since the flight's start, at which it meets the wall near t, exact to the working precision."""
    oscillator = flight.oscillator
    for _ in range(8):
        x, v = flight(t)
        place, speed = wall_at(oscillator, wall, flight.theta + oscillator.omega * t)
        step = ((x - place) / (v - speed)).mid()
        t = (t - step).mid()
        if abs(step) < SETTLED:
            return t
    raise ArithmeticError("an impact that Newton's method does not settle on")


def wall_at(oscillator, wall, theta):
    """Position and velocity of a wall at a drive phase."""
    if wall.motion is None:
        return arb(wall.position), arb(0)
    amplitude, own, harmonic = wall.motion
    sin, cos = (harmonic * theta + own).sin_cos()
    return wall.position + amplitude * cos, -harmonic * oscillator.omega * amplitude * sin

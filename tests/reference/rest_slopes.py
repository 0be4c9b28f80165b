"""Derivatives of a drive period that may hold rests, of its end and of its impacts, by differences at many digits.

What happens is found in doubles: closed-form flights are looked at on a grid, hops as slow as `TINY` end in rest where
the press on the wall lasts, a rest ends where the press does. A period is thus cut into stretches, from its start or
from a release to the next rest or to its end. A stretch is made again in mpmath for displaced numbers, its impacts and
its release by Newton's method, and central differences are the derivatives: no series of hops is ever summed, as a
stretch that begins with a release knows nothing of what was before.
"""

from typing import NamedTuple

import numpy as np
from mpmath import mpf, pi, workdps
from scipy.optimize import brentq

from . import rests, slopes
from .special import exact, fly, place, restitution

DIGITS = 50
STEP = mpf(10) ** -15
GRID = 2e-3  # between looks at a flight
TINY = 1e-4  # the speed of leaving below which hops end in rest, or the mass is let go
CLEAR = 1e-12  # a mass that has left its wall is farther from it
SURE = 1e-3  # presses and their changes that are smaller decide nothing
ROOM = 20.0  # times what is left of hops: so much sooner they are to end than the rest, or the period


class UnfairError(Exception):
    """Rounding decides what happens."""


class Stretch(NamedTuple):
    """since: (side, time) of the release that it begins with, None: the start; hits: (time, side) of its impacts.
    Times are since drive phase 0."""

    since: tuple[int, float] | None
    hits: list


class Story(NamedTuple):
    """What happens in a period. held: the side of the wall that the mass rests on at the end, 0: none; of the last
    stretch slowest: the least speed of an impact; plastic: whether one without rebound lets the mass leave."""

    stretches: list
    held: int
    slowest: float
    plastic: bool


def story(scene, x, v, phase):
    """The `Story` of a start. Raises UnfairError."""
    t, own, stretches, slowest, plastic = phase / scene.omega, 0, [Stretch(None, [])], np.inf, False
    end = t + 2.0 * np.pi / scene.omega
    for _ in range(1000):
        hit = _first(scene, _flight(scene, t, x, v), own, t, end)
        if hit is None:
            return Story(stretches, 0, slowest, plastic)
        t, own, speed = hit
        stretches[-1].hits.append((t, own))
        slowest = min(slowest, speed)
        again = restitution(scene, own)
        if again * speed >= TINY:
            x, v = _left(scene, own, t, again * speed)
            continue
        push = press(scene, own, t)
        if abs(push) < SURE:
            raise UnfairError("no press")
        if push < 0:
            plastic |= again == 0
            x, v = _left(scene, own, t, again * speed)
            continue
        late = 2.0 * again * speed / ((1.0 - again) * push)
        free = _let_go(scene, own, t, end)
        if t + ROOM * late > min(end, free or end) - SURE:
            raise UnfairError("hardly a rest")
        if free is None:
            return Story(stretches, own, slowest, plastic)
        change = (press(scene, own, free + 1e-6) - press(scene, own, free - 1e-6)) / 2e-6
        if abs(change) < SURE or end - free < SURE:
            raise UnfairError("hardly a release")
        t, slowest, plastic = free, np.inf, False
        stretches.append(Stretch((own, t), []))
        x, v = _left(scene, own, t, 0.0)
    raise UnfairError("no end of impacts")


def press(scene, side, t):
    """How hard a wall holds a mass that rests on it."""
    where, pace, bend = _wall(scene, side, t)
    return side * (scene.amplitude * np.cos(scene.omega * t) - where - 2.0 * scene.gamma * pace - bend)


def _wall(scene, side, t):
    wall = scene.right if side > 0 else scene.left
    if wall.motion is None:
        return wall.position + 0.0 * t, 0.0 * t, 0.0 * t
    swing, own, harmonic = wall.motion
    rate, angle = harmonic * scene.omega, harmonic * scene.omega * t + own
    out = swing * np.cos(angle)
    return wall.position + out, -rate * swing * np.sin(angle), -rate * rate * out


def _flight(scene, begin, x, v):
    """(x, v) at any times."""
    gamma, omega = scene.gamma, scene.omega
    force, root = scene.amplitude / (1.0 - omega**2 + 2j * gamma * omega), np.sqrt(complex(gamma**2 - 1.0))

    def forced(t):
        turned = force * np.exp(1j * omega * t)
        return turned.real, (1j * omega * turned).real

    a, b = x - forced(begin)[0], v - forced(begin)[1]

    def at(t):
        c, s, fade = np.cosh(root * (t - begin)), np.sinh(root * (t - begin)) / root, np.exp(-gamma * (t - begin))
        p, q = forced(t)
        return p + fade * ((c + gamma * s) * a + s * b).real, q + fade * (-s * a + (c - gamma * s) * b).real

    return at


def _first(scene, flight, own, begin, end):
    """(time, side, speed) of the first impact of a flight that leaves a wall on a side, None where there is none."""
    looks = begin + np.concatenate([np.geomspace(1e-7, GRID, 60), np.arange(2 * GRID, end - begin, GRID)])
    looks, found = np.append(looks[looks < end], end), []
    for side, _ in scene.walls():

        def clear(t, side=side):
            return side * (_wall(scene, side, t)[0] - flight(t)[0])

        far = clear(looks)
        gone = np.logical_or.accumulate(far > CLEAR) if side == own else np.ones(len(looks), bool)
        met = np.flatnonzero(gone & (far <= 0))
        if len(met):
            before = looks[met[0] - 1] if met[0] else begin
            t = brentq(clear, before, looks[met[0]], xtol=1e-15) if clear(before) > 0 else before
            found.append((t, side, side * (flight(t)[1] - _wall(scene, side, t)[1])))
    return min(found, default=None)


def _left(scene, side, t, speed):
    where, pace, _ = _wall(scene, side, t)
    return where, pace - side * speed


def _let_go(scene, side, begin, end):
    """When a rest on a wall ends, None: not before the end."""
    looks = np.append(np.arange(begin, end, GRID), end)
    over = np.flatnonzero(press(scene, side, looks) <= 0)
    if not len(over):
        return None
    return brentq(lambda t: press(scene, side, t), looks[over[0] - 1], looks[over[0]], xtol=1e-15)


def again(drawn, stretch, held=0):
    """(x and v at the period's end, (time since its start, speed) of each impact) of a stretch; drawn: (scene, x, v,
    phase) in mpfs; held: the side of the wall that the mass rests on at the end."""
    scene, x, v, phase = drawn
    start = phase / scene.omega
    end, told, now = start + 2 * pi / scene.omega, [], (start, x, v)
    if stretch.since is not None:
        side, guess = stretch.since
        now = rests.departure(scene, side, rests.release(scene, side, mpf(guess)), 0)
    for guess, side in stretch.hits:
        t = rests.landing(scene, side, now, mpf(guess))
        speed = -rests.height(scene, side, now, t)[1]
        told.append((t - start, speed))
        now = rests.departure(scene, side, t, restitution(scene, side) * speed)
    if held:
        wall = place(scene, held, end)
        return (wall.x, wall.v), told
    return fly(scene, *now, end), told


def jacobian(drawn, told):
    """The derivatives of x and v at the end by the numbers, in the order of `slopes.names`: an array (2, names)."""
    last = told.stretches[-1]
    if told.held:
        last = Stretch(None, [])  # the wall is where it is
    return _differences(drawn, lambda moved: again(moved, last, told.held)[0])


def base_end(drawn, told):
    """x and v at the end."""
    with workdps(DIGITS):
        base = (exact(drawn[0]), *map(mpf, drawn[1:]))
        return np.array([float(each) for each in again(base, told.stretches[-1], told.held)[0]])


def impacts(drawn, told, near, most):
    """{time: (by time, by speed)} of the impacts at these times, at most so many of a stretch: arrays (names,)."""
    found = {}
    for stretch in told.stretches:
        few = Stretch(stretch.since, stretch.hits[:most])
        wanted = [k for k, (t, _) in enumerate(few.hits) if np.min(abs(near - _since(drawn, t))) < 1e-7]
        if not wanted:
            continue
        rows = _differences(drawn, lambda moved, few=few: [each for row in again(moved, few)[1] for each in row])
        found |= {_since(drawn, few.hits[k][0]): rows[2 * k : 2 * k + 2] for k in wanted}
    return found


def _since(drawn, t):
    return t - drawn[3] / drawn[0].omega


def _differences(drawn, function):
    """Central differences of a function of displaced numbers: an array (what it gives, names)."""
    with workdps(DIGITS):
        values = [mpf(each) for each in slopes.numbers(drawn)]
        base = (exact(drawn[0]), *map(mpf, drawn[1:]))
        columns = []
        for k, value in enumerate(values):
            ends = []
            for step in (STEP, -STEP):
                moved = [*values[:k], value + step, *values[k + 1 :]]
                ends.append(function(slopes.with_numbers(base, moved)))
            columns.append([float((a - b) / (2 * STEP)) for a, b in zip(*ends, strict=True)])
    return np.array(columns).T


def curvature(drawn, told, direction):
    """The second derivatives of x and v at the end along a direction: an array (2,)."""
    last, step = Stretch(None, []) if told.held else told.stretches[-1], mpf(10) ** -12
    with workdps(DIGITS + 10):
        values, base = [mpf(each) for each in slopes.numbers(drawn)], (exact(drawn[0]), *map(mpf, drawn[1:]))
        ends = []
        for way in (-step, mpf(0), step):
            moved = [value + way * mpf(float(slope)) for value, slope in zip(values, direction, strict=True)]
            ends.append(again(slopes.with_numbers(base, moved), last, told.held)[0])
        return np.array([float((a - 2 * b + c) / step**2) for a, b, c in zip(*ends, strict=True)])

"""Derivatives of a drive period that may hold sticking phases, of its end and its impacts, by differences.

`rests` finds the motion in few digits. A period is cut into stretches, from its start or from a release to the next
sticking or to its end. A stretch is computed again at many digits for displaced numbers, its impacts and its release by
Newton's method, and central differences are the derivatives: no series of bounces is ever summed, as a stretch that
begins with a release depends on nothing before it.
"""

from typing import NamedTuple

import numpy as np
from mpmath import mpf, workdps

from . import rests, slopes
from .special import exact, fly, place, restitution, span

SEARCH_DIGITS, DIGITS = 20, 50
STEP = mpf(10) ** -15
SURE = 1e-3  # contact forces, their rates and times that are smaller decide nothing


class UnfairError(ArithmeticError):
    """Rounding decides what happens."""


class Stretch(NamedTuple):
    """since: (side, time) of the release that it begins with, None: the start; hits: (time, side) of its impacts.
    Times are since drive phase 0."""

    since: tuple[int, float] | None
    hits: list


class Story(NamedTuple):
    """What happens in a period. held: the side of the wall that the mass sticks to at the end, 0: none; of the last
    stretch slowest: the least speed of an impact; plastic: whether one without rebound lets the mass leave."""

    stretches: list
    held: int
    slowest: float
    plastic: bool


def story(scene, x, v, phase):
    """Return the `Story` of a start. Raises UnfairError."""
    with workdps(SEARCH_DIGITS):
        given = exact(scene)
        start = mpf(phase) / given.omega
        end = start + span(given, 1)
        since, hit, stretches = None, rests.first(given, (start, mpf(x), mpf(v)), 0, until=end), []
        if hit is None or hit.time >= end:
            return Story([Stretch(None, [])], 0, np.inf, False)
        hits, begin = [hit], (hit.side, hit.time, restitution(given, hit.side) * hit.speed)
        while True:
            more, began, side = rests.bounces(given, *begin, end)
            hits += more
            stretches.append(Stretch(since, [(float(each.time), each.side) for each in hits]))
            if began is None:
                plastic = any(not restitution(given, each.side) for each in hits)
                return Story(stretches, 0, float(min((each.speed for each in hits), default=np.inf)), plastic)
            free = rests.let_go(given, side, began, end)
            if began > min(end, free or end) - SURE or rests.press_alone(given, side, began) < SURE:
                raise UnfairError("it hardly sticks")
            if free is None:
                return Story(stretches, side, np.inf, False)
            if abs(rests.press(given, side, free)[1]) < SURE or end - free < SURE:
                raise UnfairError("it is hardly released")
            since, hits, begin = (side, float(free)), [], (side, free, mpf(0))


def again(drawn, stretch, held=0):
    """Return x and v at the period's end, and (time since its start, speed) of each impact, of a stretch.

    drawn: (scene, x, v, phase) in mpfs; held: the side of the wall that the mass sticks to at the end.
    """
    scene, x, v, phase = drawn
    start = phase / scene.omega
    end, told, now = start + span(scene, 1), [], (start, x, v)
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


def last_stretch(told):
    """Return the stretch that decides the end; a mass that sticks is where its wall is."""
    return Stretch(None, []) if told.held else told.stretches[-1]


def jacobian(drawn, told):
    """Return the derivatives of x and v at the end by the numbers, in the order of `slopes.names`: (2, names)."""
    return _differences(drawn, lambda moved: again(moved, last_stretch(told), told.held)[0])


def base_end(drawn, told):
    """Return x and v at the end."""
    with workdps(DIGITS):
        base = (exact(drawn[0]), *map(mpf, drawn[1:]))
        return np.array([float(each) for each in again(base, last_stretch(told), told.held)[0]])


def impacts(drawn, told, near, most):
    """Return {time: (by time, by speed)} of the impacts at these times, at most so many of a stretch: (names,)."""
    found, start = {}, drawn[3] / drawn[0].omega
    for stretch in told.stretches:
        few = Stretch(stretch.since, stretch.hits[:most])
        wanted = [k for k, (t, _) in enumerate(few.hits) if np.min(abs(near - t + start)) < 1e-7]
        if not wanted:
            continue
        rows = _differences(drawn, lambda moved, few=few: [each for row in again(moved, few)[1] for each in row])
        found |= {few.hits[k][0] - start: rows[2 * k : 2 * k + 2] for k in wanted}
    return found


def _differences(drawn, function):
    """Return central differences of a function of displaced numbers, by each of them: (values, names)."""
    units = np.eye(len(slopes.names(drawn[0])))
    return np.array([_along(drawn, function, unit, STEP, (1, 0, -1)) / 2 for unit in units]).T


def curvature(drawn, told, direction):
    """Return the second derivatives of x and v at the end along a direction: (2,)."""
    step, last = mpf(10) ** -12, last_stretch(told)
    return _along(drawn, lambda moved: again(moved, last, told.held)[0], direction, step, (1, -2, 1), 2)


def _along(drawn, function, direction, step, weights, order=1):
    """Return the sum of weights times a function of numbers displaced by -1, 0 and 1 steps, over step^order."""
    with workdps(DIGITS + 10):
        values, base = [mpf(each) for each in slopes.numbers(drawn)], (exact(drawn[0]), *map(mpf, drawn[1:]))
        rows = []
        for sign, weight in zip((1, 0, -1), weights, strict=True):
            moved = [value + sign * step * mpf(float(by)) for value, by in zip(values, direction, strict=True)]
            if weight:
                rows.append([weight * each for each in function(slopes.with_numbers(base, moved))])
        return np.array([float(sum(column) / step**order) for column in zip(*rows, strict=True)])

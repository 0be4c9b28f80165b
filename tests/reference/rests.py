"""Motions that rest, in as many digits as wanted: hops one by one, from the closed form of each flight.

Scenes are `scene.Scene`s, made exact by the caller (`special.exact`); times are since drive phase 0. A hop is looked
for near where the press at its start would end it, other flights on a grid; both ends are brought to all digits by
Newton's method. Hops are flown until their speed is below 10^-(a quarter of the digits): from there on the press hardly
changes.
"""

from typing import NamedTuple

from mpmath import cos, fabs, inf, mp, mpf

from .special import fly, place, restitution

GRID = mpf(1) / 100  # between looks at a flight
SHORT = mpf(1) / 10  # a hop that is shorter is looked for from its guess
ROUNDS = 60  # of Newton's method


class Hit(NamedTuple):
    """An impact: time, speed before it against the wall, side."""

    time: mpf
    speed: mpf
    side: int


def press(scene, side, t):
    """How hard a wall holds a mass that rests on it, and how fast that changes, by a difference."""
    step = mpf(10) ** (-mp.dps // 3)
    here, after, before = (press_alone(scene, side, t + k * step) for k in (0, 1, -1))
    return here, (after - before) / (2 * step)


def press_alone(scene, side, t):
    """The same without its change."""
    wall = place(scene, side, t)
    return side * (scene.amplitude * cos(scene.omega * t) - wall.x - 2 * scene.gamma * wall.v - wall.a)


def release(scene, side, t):
    """The root of the press near a time."""
    for _ in range(ROUNDS):
        here, change = press(scene, side, t)
        t -= here / change
        if fabs(here / change) < mpf(10) ** (5 - mp.dps):
            return t
    raise ArithmeticError("no release")


def height(scene, side, begin, t):
    """(distance from a wall, its rate) of the flight from `begin`, (time, x, v)."""
    x, v = fly(scene, *begin, t)
    wall = place(scene, side, t)
    return side * (wall.x - x), side * (wall.v - v)


def landing(scene, side, begin, guess):
    """The time near a guess at which a flight is at a wall."""
    t = guess
    for _ in range(ROUNDS):
        y, rate = height(scene, side, begin, t)
        t -= y / rate
        if fabs(y / rate) < mpf(10) ** (-2 * mp.dps // 5) * fabs(t - begin[0]):
            return t
    raise ArithmeticError("no landing")


def departure(scene, side, t, speed):
    """(time, x, v) of leaving a wall with a speed against it."""
    wall = place(scene, side, t)
    return t, wall.x, wall.v - side * speed


def first(scene, begin, own, step, growth, until=inf):
    """The first `Hit` of a flight, on a grid of steps that grow, None where it has none until a time; own: the side
    that it leaves."""
    t = begin[0]
    above = dict.fromkeys((side for side, _ in scene.walls()), None)
    while t < until:
        t, before, step = t + step, t, min(step * growth, GRID)
        for side in above:
            y, _ = height(scene, side, begin, t)
            if y <= 0 and (side != own or above[side]):
                low, high = before, t
                for _ in range(12):
                    middle = (low + high) / 2
                    low, high = (middle, high) if height(scene, side, begin, middle)[0] > 0 else (low, middle)
                t = landing(scene, side, begin, high)
                return Hit(t, -height(scene, side, begin, t)[1], side)
            above[side] = above[side] or y > 0
    return None


def next_hit(scene, side, t, speed, until=inf):
    """The `Hit` after a wall was left with a speed, None where there may be none until a time."""
    begin, (here, change) = departure(scene, side, t, speed), press(scene, side, t)
    guess = 2 * speed / here if here > 0 else GRID
    if speed == 0 and here < 0 < change:  # drawn off, to be pressed soon
        guess = -3 * here / change
    if speed > 0 and guess < SHORT and guess * fabs(change) < here / 5:
        t = landing(scene, side, begin, t + guess * (1 - 2 * speed * change / (3 * here**2)))
        return Hit(t, -height(scene, side, begin, t)[1], side)
    return first(scene, begin, side, min(guess / 8, GRID) if guess > 0 else GRID, mpf(5) / 4, until)


def until_rest(scene, side, t, speed, end, most=4000):
    """(the `Hit`s after a wall was left at a time with a speed, when the mass comes to rest on it, None: not before
    `end`, which is that wall's next release)."""
    hits, tiny, again = [], mpf(10) ** (-mp.dps // 4), restitution(scene, side)
    for _ in range(most):
        here, _ = press(scene, side, t)
        if here > 0 and speed < tiny * here:
            return hits, t + 2 * speed / ((1 - again) * here)
        if speed == 0 and here > 0:
            return hits, t
        hit = next_hit(scene, side, t, speed, end)
        if hit is None or hit.side != side or hit.time >= end:
            return hits, None
        hits.append(hit)
        t, speed = hit.time, again * hit.speed
    raise ArithmeticError("no end of hops")


def from_release(scene, side, t, end=inf, most=4000):
    """(all `Hit`s after a wall let the mass go, when it next comes to rest, None: not before `end`, on which side)."""
    hits, now, own, speed = [], t, side, mpf(0)
    for _ in range(most):
        hit = next_hit(scene, own, now, speed, end)
        if hit is None:
            return hits, None, own
        hits.append(hit)
        own, now, speed = hit.side, hit.time, restitution(scene, hit.side) * hit.speed
        if now >= end:
            return hits, None, own
        here, _ = press(scene, own, now)
        if here > 0 and speed < mpf(10) ** (-mp.dps // 4) * here:
            return hits, now + (2 * speed / ((1 - restitution(scene, own)) * here) if speed else 0), own
    raise ArithmeticError("no rest")


def state_after(scene, side, t, speed, end):
    """(x, v) at a time after a wall was left, with a speed, or let the mass go."""
    tiny = mpf(10) ** (-mp.dps // 4)
    while True:
        here, _ = press(scene, side, t)
        if here > tiny and speed < tiny * here:  # it rests
            t, speed = let_go(scene, side, t, end), mpf(0)
            if t is None:
                return tuple(place(scene, side, end)[:2])
        hit = next_hit(scene, side, t, speed, end)
        if hit is None or hit.time >= end:
            return fly(scene, *departure(scene, side, t, speed), end)
        side, t, speed = hit.side, hit.time, restitution(scene, hit.side) * hit.speed


def let_go(scene, side, t, end):
    """When a wall lets go a mass that rests on it from a time on, None where not before `end`."""
    while t < end:
        if press_alone(scene, side, t + GRID) <= 0:
            found = release(scene, side, t + GRID / 2)
            return found if found < end else None
        t += GRID
    return None

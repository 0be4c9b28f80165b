"""Motions that stick, in as many digits as wanted: bounces one by one, from the closed form of each flight.

Scenes are `scene.Scene`s, made exact by the caller (`special.exact`); times are since drive phase 0. A bounce is
expected where the contact force at its start would end it, other impacts are searched on a grid in doubles; both are
brought to all digits by Newton's method. Bounces are computed until their speed is below 10^-(a quarter of the digits):
from there on the contact force hardly changes.
"""

from typing import NamedTuple

import numpy as np
from mpmath import cos, fabs, inf, mp, mpf
from scipy.linalg import expm

from .special import fly, place, restitution

GRID = mpf(1) / 100  # between samples of a flight
CHUNK = 512  # samples at once
SHORT = mpf(1) / 10  # a bounce that is shorter is expected near its guess
ROUNDS = 60  # of Newton's method
MOST = 4000  # impacts


class Hit(NamedTuple):
    """An impact: time, speed before it against the wall, side."""

    time: mpf
    speed: mpf
    side: int


def press(scene, side, t):
    """Return the contact force of a sticking mass and its time derivative, by a difference."""
    step = mpf(10) ** (-mp.dps // 3)
    here, after, before = (press_alone(scene, side, t + k * step) for k in (0, 1, -1))
    return here, (after - before) / (2 * step)


def press_alone(scene, side, t):
    """Return the contact force of a sticking mass."""
    wall = place(scene, side, t)
    return side * (scene.amplitude * cos(scene.omega * t) - wall.x - 2 * scene.gamma * wall.v - wall.a)


def presses(scene, side, times):
    """Return the contact forces at an array of times, in doubles."""
    x, v, a = _wall(scene, side, times)
    return side * (float(scene.amplitude) * np.cos(float(scene.omega) * times) - x - 2 * float(scene.gamma) * v - a)


def _wall(scene, side, times):
    """Return position, velocity and acceleration of a wall at an array of times, in doubles."""
    wall = scene.right if side > 0 else scene.left
    swing, phase, harmonic = map(float, wall.motion or (0, 0, 0))
    rate = harmonic * float(scene.omega)
    out = swing * np.exp(1j * (rate * times + phase))
    return float(wall.position) + out.real, -rate * out.imag, -(rate**2) * out.real


def _samples(scene, t, x, v):
    """Return the positions of a flight at the CHUNK times that follow a time in steps of GRID, in doubles."""
    omega, gamma, amplitude = float(scene.omega), float(scene.gamma), float(scene.amplitude)
    rates = [[0, 1, 0, 0], [-1, -2 * gamma, amplitude, 0], [0, 0, 0, -omega], [0, 0, omega, 0]]
    step, angle = expm(float(GRID) * np.array(rates)), omega * float(t)
    states = np.array([[float(x), float(v), np.cos(angle), np.sin(angle)]])
    while len(states) <= CHUNK:
        states, step = np.concatenate([states, states @ step.T]), step @ step
    return states[1 : CHUNK + 1, 0]


def release(scene, side, t):
    """Return the root of the contact force near a time."""
    for _ in range(ROUNDS):
        here, change = press(scene, side, t)
        t -= here / change
        if fabs(here / change) < mpf(10) ** (5 - mp.dps):
            return t
    raise ArithmeticError("no release")


def height(scene, side, begin, t):
    """Return the distance from a wall and its rate in the flight from `begin`, (time, x, v)."""
    x, v = fly(scene, *begin, t)
    wall = place(scene, side, t)
    return side * (wall.x - x), side * (wall.v - v)


def landing(scene, side, begin, guess):
    """Return the time near a guess at which a flight is at a wall."""
    t = guess
    for _ in range(ROUNDS):
        y, rate = height(scene, side, begin, t)
        t -= y / rate
        if fabs(y / rate) < mpf(10) ** (-2 * mp.dps // 5) * fabs(t - begin[0]):
            return t
    raise ArithmeticError("no landing")


def departure(scene, side, t, speed):
    """Return (time, x, v) of leaving a wall with a speed against it."""
    wall = place(scene, side, t)
    return t, wall.x, wall.v - side * speed


def first(scene, begin, own, step=GRID, growth=1, until=inf):
    """Return the first `Hit` of a flight that leaves the wall on the side `own`, None without one before a time.

    The steps between samples grow up to GRID.
    """
    t, away = begin[0], {side: side != own for side, _ in scene.walls()}
    while t < until:
        fine, found = step < GRID, []
        late = [step] if fine else float(GRID) * np.arange(1, CHUNK + 1)
        xs = [fly(scene, *begin, t + step)[0]] if fine else _samples(scene, t, *fly(scene, *begin, t))
        for side, was_away in away.items():
            walls = [place(scene, side, t + step).x] if fine else _wall(scene, side, float(t) + late)[0]
            gaps = side * (np.array(walls) - xs)
            hits = np.flatnonzero((np.logical_or.accumulate(gaps > 0) | was_away) & (gaps <= 0))
            found += [(hits[0], side)] if len(hits) else []
            away[side] = was_away or bool((gaps > 0).any())
        if found:
            k, side = min(found)
            low, high = t + mpf(late[k - 1] if k else 0), t + mpf(late[k])
            for _ in range(12):
                middle = (low + high) / 2
                low, high = (middle, high) if height(scene, side, begin, middle)[0] > 0 else (low, middle)
            t = landing(scene, side, begin, high)
            return Hit(t, -height(scene, side, begin, t)[1], side)
        t, step = t + mpf(late[-1]), step * growth
    return None


def next_hit(scene, side, t, speed, until=inf):
    """Return the `Hit` after a wall was left with a speed, None where there may be none until a time."""
    begin, (here, change) = departure(scene, side, t, speed), press(scene, side, t)
    guess = 2 * speed / here if here > 0 else GRID
    if speed == 0 and here < 0 < change:  # drawn off, to be pressed soon
        guess = -3 * here / change
    if speed > 0 and guess < SHORT and guess * fabs(change) < here / 5:
        t = landing(scene, side, begin, t + guess * (1 - 2 * speed * change / (3 * here**2)))
        return Hit(t, -height(scene, side, begin, t)[1], side)
    return first(scene, begin, side, min(guess / 8, GRID) if guess > 0 else GRID, mpf(5) / 4, until)


def bounces(scene, side, t, speed, end=inf):
    """Return what follows when a wall is left with a speed.

    The result is (the `Hit`s until the mass sticks, the time at which it sticks, None if not before `end`, the side).
    """
    hits, tiny = [], mpf(10) ** (-mp.dps // 4)
    for _ in range(MOST):
        here, _ = press(scene, side, t)
        if here > tiny and speed < tiny * here:
            return hits, t + 2 * speed / ((1 - restitution(scene, side)) * here), side
        hit = next_hit(scene, side, t, speed, end)
        if hit is None or hit.time >= end:
            return hits, None, side
        hits.append(hit)
        t, side, speed = hit.time, hit.side, restitution(scene, hit.side) * hit.speed
    raise ArithmeticError("no end of bounces")


def from_release(scene, side, t, end=inf):
    """Return the `bounces` after a wall lets the mass go."""
    return bounces(scene, side, t, mpf(0), end)


def state_after(scene, side, t, speed, end):
    """Return (x, v) at a time after a wall was left, with a speed, or let the mass go."""
    while True:
        hits, began, last = bounces(scene, side, t, speed, end)
        if began is None:
            if hits:
                t, side, speed = hits[-1].time, last, restitution(scene, last) * hits[-1].speed
            return fly(scene, *departure(scene, side, t, speed), end)
        side, t, speed = last, let_go(scene, last, began, end), mpf(0)
        if t is None:
            return tuple(place(scene, side, end)[:2])


def let_go(scene, side, t, end):
    """Return when a wall lets go a mass that sticks to it from a time on, None if not before `end`."""
    times = np.arange(float(t), float(end) + float(GRID), float(GRID))[1:]
    free = np.flatnonzero(presses(scene, side, times) <= 0)
    if not len(free):
        return None
    found = release(scene, side, mpf(times[free[0]]) - GRID / 2)
    return found if found < end else None

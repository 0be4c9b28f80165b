"""Lyapunov exponents of an oscillator between two walls at rest, in NumPy alone: nothing is shared with the package.

Every lane goes from one point of a grid in time to the next by the textbook's closed form, gamma < 1 and D > 0: forced
response and damped rotation. A step at whose end the mass is beyond a wall, or in which it turns near one, is looked
into: the first contact is bracketed, then found by bisection and Newton's method on the closed form. Two tangent
vectors are carried along, by the rotation in flight and by the impact's derivative, and made orthogonal each period:
both exponents are measured, neither comes from the determinant.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

STEPS = 40  # of the grid in a period
HALVINGS, POLISH = 7, 3
BOUNCES = 60  # within one step; more are chatter, which this method does not follow


@dataclass
class Oscillator:
    """x'' + 2 gamma x' + x = A cos(omega t) between walls at rest: numbers, A an array of lanes."""

    amplitude: np.ndarray
    omega: float
    gamma: float
    restitution: float
    walls: tuple[float, float]

    def forced(self, time):
        """x and v of the steady motion that meets no wall: the real part of F exp(i omega t), and its derivative."""
        w = self.omega
        turn = self.amplitude / (1 - w * w + 2j * self.gamma * w) * np.exp(1j * w * time)
        return turn.real, -w * turn.imag

    def rotated(self, pair, time):
        """The free motion, a damped rotation, of (x, v)."""
        root = np.sqrt(1 - self.gamma**2)
        fade, cosine, sine = np.exp(-self.gamma * time), np.cos(root * time), np.sin(root * time) / root
        x, v = pair
        return (
            fade * ((cosine + self.gamma * sine) * x + sine * v),
            fade * ((cosine - self.gamma * sine) * v - sine * x),
        )

    def flown(self, x, v, start, time):
        """(x, v) a time after the start."""
        p, q = self.forced(start)
        a, b = self.rotated((x - p, v - q), time)
        p, q = self.forced(start + time)
        return a + p, b + q

    def pull(self, x, v, time):
        """The acceleration."""
        return self.amplitude * np.cos(self.omega * time) - x - 2 * self.gamma * v

    def lanes(self, index):
        """The oscillator of some lanes."""
        return Oscillator(self.amplitude[index], self.omega, self.gamma, self.restitution, self.walls)


def exponents(one, x, v, periods, settle):
    """(mean growth of both tangents, impacts), each a period, of every lane: shapes (lanes, 2) and (lanes,).

    one: an `Oscillator`; x, v: where lanes start at phase 0; settle: periods left out.
    """
    x, v = np.array(x, float), np.array(v, float)
    tangents = np.tile(np.eye(2)[:, :, None], (1, 1, len(x)))
    growth, hits = np.zeros((2, len(x))), np.zeros(len(x))
    grid = np.linspace(0.0, 2 * np.pi / one.omega, STEPS + 1)
    for period in range(settle + periods):
        if period == settle:
            growth[:], hits[:] = 0.0, 0.0
        for start, end in pairwise(grid):
            x, v, tangents = step(one, x, v, tangents, start, end - start, hits)
        growth += orthogonal(tangents)
    return growth.T / periods, hits / periods


def step(one, x, v, tangents, start, length, hits):
    """x, v and tangents (2, 2, lanes) from one point of the grid to the next; the impacts are counted."""
    end_x, end_v = one.flown(x, v, start, length)
    met = np.flatnonzero(meets(one, x, v, start, length, end_x, end_v))
    new = np.stack(one.rotated((tangents[:, 0], tangents[:, 1]), length), axis=1)
    if len(met):
        here = one.lanes(met)
        end_x[met], end_v[met], new[:, :, met] = bounced(
            here, x[met], v[met], tangents[:, :, met], start, length, hits, met
        )
    return end_x, end_v, new


def bounced(one, x, v, tangents, start, left, hits, met):
    """x, v and tangents at the end of a step of lanes that meet a wall in it."""
    start, left = np.full(len(x), start), np.full(len(x), left)
    live, bounce = np.arange(len(x)), one.restitution
    for _ in range(BOUNCES):
        here = one.lanes(live)
        time, wall = first(here, x[live], v[live], start[live], left[live])
        _, pace = here.flown(x[live], v[live], start[live], time)
        start[live] += time
        left[live] -= time
        shear = here.pull(wall, -bounce * pace, start[live]) + bounce * here.pull(wall, pace, start[live])
        a, b = one.rotated((tangents[:, 0, live], tangents[:, 1, live]), time)
        tangents[:, :, live] = np.stack([-bounce * a, shear / pace * a - bounce * b], axis=1)
        x[live], v[live] = wall, -bounce * pace
        hits[met[live]] += 1
        end_x, end_v = here.flown(x[live], v[live], start[live], left[live])
        live = live[meets(here, x[live], v[live], start[live], left[live], end_x, end_v)]
        if not len(live):
            ends = one.flown(x, v, start, left)
            return *ends, np.stack(one.rotated((tangents[:, 0], tangents[:, 1]), left), axis=1)
    raise RuntimeError("chatter: this method does not follow it")


def meets(one, x, v, start, length, end_x, end_v):
    """Which lanes meet a wall in a step: beyond it at the end, or at a turning point within."""
    low, high = one.walls
    met = (end_x <= low) | (end_x >= high)
    reach = abs(v - end_v) * length  # with a margin: between its ends x turns within half of that
    up = (v > 0) & (end_v < 0) & (np.maximum(x, end_x) + reach > high)
    down = (v < 0) & (end_v > 0) & (np.minimum(x, end_x) - reach < low)
    maybe = np.flatnonzero((up | down) & ~met)
    if len(maybe):
        x, v, start, length = (np.broadcast_to(each, met.shape)[maybe] for each in (x, v, start, length))
        here = one.lanes(maybe)
        far = here.flown(x, v, start, turning(here, x, v, start, length))[0]
        met[maybe] = (far >= high) | (far <= low)
    return met


def turning(one, x, v, start, length):
    """When v changes its sign."""
    sign = np.sign(v)

    def speed(time):
        x_then, v_then = one.flown(x, v, start, time)
        return sign * v_then, sign * one.pull(x_then, v_then, start + time)

    return root(speed, np.zeros(len(x)), np.array(length, float))


def root(function, early, late):
    """Where a function, given as (value, slope), ceases to be positive: bisection, then Newton's method."""
    for _ in range(HALVINGS):
        middle = 0.5 * (early + late)
        still = function(middle)[0] > 0
        early, late = np.where(still, middle, early), np.where(still, late, middle)
    time = 0.5 * (early + late)
    for _ in range(POLISH):
        value, slope = function(time)
        time = np.clip(time - value / np.where(slope == 0, 1.0, slope), early, late)
    return time


def first(one, x, v, start, left):
    """(time, wall) of the first contact: by the turning point if that is beyond a wall, else by the end."""
    low, high = one.walls
    end_x, end_v = one.flown(x, v, start, left)
    turns = np.sign(end_v) != np.sign(v)
    limit = left.copy()
    limit[turns] = turning(one.lanes(turns), x[turns], v[turns], start[turns], left[turns])
    far, _ = one.flown(x, v, start, limit)
    beyond = (far >= high) | (far <= low)
    side = np.where(np.where(beyond, far, end_x) >= high, 1, -1)
    wall = np.where(side > 0, high, low)
    early, late = np.where(beyond, 0.0, limit), np.where(beyond, limit, left)

    def clearance(time):
        at, pace = one.flown(x, v, start, time)
        return side * (wall - at), -side * pace

    return root(clearance, early, late), wall


def orthogonal(tangents):
    """Gram and Schmidt, in place: the logarithms of both lengths, (2, lanes)."""
    one, two = tangents
    size = np.hypot(*one)
    one /= size
    two -= one * (one * two).sum(axis=0)
    rest = np.hypot(*two)
    two /= rest
    return np.log([size, rest])

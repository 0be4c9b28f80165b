"""Certified search for the first contact of one free flight.

The flight is cut into pieces on which the clearance of a wall, by its Taylor series and a bound on the rest, is
monotone or has a monotone derivative. So every turning point is found, and between them signs decide.
Floats only choose where to look and carry slack; every sign that decides is the sign of a ball.
"""

import math
from itertools import pairwise
from typing import NamedTuple

from flint import arb, ctx

from . import taylor
from .ball import Flight

DEEPEST = 45
SLACK = 1e-12
WIDEST = 1e-25


class Undecided(ArithmeticError):
    """A ball was too wide to decide a sign: try again with more precision."""


class Discard(ValueError):
    """The draw is too close to a graze, a slow impact or an end to be a fair test."""


class Turn(NamedTuple):
    """A turning point of x - x_wall: time, side of the wall, clearance there, and whether that is a minimum."""

    time: arb
    side: int
    clearance: arb
    minimum: bool


def sign(ball):
    """+1, -1 or 0 of a ball; 0 only for an exact zero."""
    if ball > 0:
        return 1
    if ball < 0:
        return -1
    if ball.is_zero():
        return 0
    raise Undecided("the sign of a ball that contains 0")


class Course:
    """A free flight from (x, v) at drive phase theta, seen from the walls of a scene."""

    def __init__(self, scene, oscillator, x, v, theta):
        self.scene, self.oscillator, self.theta = scene, oscillator, theta
        self.flight = Flight(oscillator, x, v, theta)
        self.seen = {}
        if not (x.rad() < WIDEST and v.rad() < WIDEST):
            raise Undecided("a start too uncertain for the slack of the floats")
        rates = [wall.motion.harmonic * scene.omega for _, wall in scene.walls() if wall.motion]
        rates += [term.harmonic * scene.omega for term in scene.drive]
        self.fastest = max([1 + 2 * scene.gamma, scene.omega, *rates])

    def state(self, t):
        """x, v, sin and cos of the drive phase at t; kept when t is a float."""
        if isinstance(t, float) and t in self.seen:
            return self.seen[t]
        x, v = self.flight(arb(t))
        result = (x, v, *(self.theta + self.oscillator.omega * t).sin_cos())
        if isinstance(t, float):
            self.seen[t] = result
        return result

    def wall_motion(self, wall, t):
        """B cos(psi), B sin(psi) and psi' of a wall's motion."""
        if wall.motion is None:
            return arb(0), arb(0), arb(0)
        b, phase, m = wall.motion
        sin, cos = (m * (self.theta + self.oscillator.omega * t) + arb(phase)).sin_cos()
        return b * cos, b * sin, m * self.oscillator.omega

    def clearance(self, side, wall, t):
        """c and its first two derivatives at t, as balls."""
        x, v, _, _ = self.state(t)
        o = self.oscillator
        acceleration = o.force(self.theta + o.omega * t) - 2 * o.gamma * v - x
        bc, bs, rate = self.wall_motion(wall, t)
        c = wall.position + bc - x
        dc, ddc = -rate * bs - v, -rate * rate * bc - acceleration
        return (c, dc, ddc) if side > 0 else (-c, -dc, -ddc)

    def series(self, side, wall, middle, radius):
        """Floats: the derivatives of c at the middle, the bound for the next one, and slack for rounding."""
        s, (x, v, sin, cos) = self.scene, self.state(middle)
        x, v = float(x), float(v)
        theta = self.theta + self.oscillator.omega * middle
        waves = [(tone.rate, *tone.wave(theta)) for tone in self.oscillator.tones[1:]]
        more = [taylor.motion(*(float(each) for each in wave)) for wave in waves]
        own = taylor.response(s.gamma, s.omega, x, v, s.amplitude * float(cos), -s.amplitude * float(sin), more)
        bc, bs, rate = (float(value) for value in self.wall_motion(wall, middle))
        other = taylor.motion(rate, bc, bs)
        grown, energy, b = math.exp(2 * s.gamma * radius), math.hypot(x, v), math.hypot(bc, bs)
        bound = taylor.ceiling(s.gamma, s.omega, abs(s.amplitude), energy, radius, grown) + b * rate**taylor.ORDER
        for amplitude, harmonic, _ in s.drive:
            bound += taylor.ceiling(s.gamma, harmonic * s.omega, abs(amplitude), 0.0, radius, grown)
        slack = SLACK * (energy + abs(s.amplitude) + sum(abs(term.amplitude) for term in s.drive) + b)
        return [side * (w - y) for w, y in zip(other, own, strict=True)], 1.001 * bound, slack


def polish(function, low, high, curvature):
    """Ball around the one zero of function (value, slope: balls) between low and high, where |slope'| <= curvature."""
    low, high = float(low), float(high)
    rising = bool(function(arb(high))[0] > 0)
    t = 0.5 * (low + high)
    for _ in range(80):
        value, slope = (float(ball) for ball in function(arb(t)))
        low, high = (low, t) if (value > 0) == rising else (t, high)
        newton = t - value / slope if slope else math.inf
        step = (newton if low <= newton <= high else 0.5 * (low + high)) - t
        t += step
        if abs(step) < 1e-9 or low >= high:
            break
    t = arb(t)
    for _ in range(8):
        value, slope = function(t)
        step = (value / slope).mid()
        t = (t - step).mid()
        if not abs(step) > 1e-35:
            break
    return enclose(function, t, curvature)


def enclose(function, t, curvature):
    """One interval Newton step around an exact t: the zero lies in the ball returned."""
    value, slope = function(t)
    delta = 4 * abs(value / slope).upper() + arb(2) ** (20 - ctx.prec)
    wide = slope + arb(0, 1) * (curvature * delta)
    shift = value / wide
    if not abs(shift) < delta:
        raise Undecided("Newton's interval step does not contract")
    return t - shift


def turning_times(course, side, wall, a, b, depth=0):
    """Balls around all zeros of c' in [a, b], in order."""
    low, high = float(a), float(b)
    middle, radius = 0.5 * (low + high), 0.5 * (high - low) * (1 + 1e-9) + 1e-15
    series, bound, slack = course.series(side, wall, middle, radius)
    if abs(series[1]) > taylor.spread(series, 1, radius, bound) + slack * course.fastest:
        return []
    if abs(series[2]) > taylor.spread(series, 2, radius, bound) + slack * course.fastest**2:
        bend = 1 if series[2] > 0 else -1
        start = sign(course.clearance(side, wall, a)[1]) or bend
        if start == sign(course.clearance(side, wall, b)[1]):
            return []
        third = abs(series[3]) + taylor.spread(series, 3, radius, bound)
        return [polish(lambda t: course.clearance(side, wall, t)[1:], a, b, third * 1.001)]
    if depth > DEEPEST:
        raise Discard("a turning point that is degenerate")
    first = turning_times(course, side, wall, a, middle, depth + 1)
    return first + turning_times(course, side, wall, middle, b, depth + 1)


def piece(course, side, wall, a, b):
    """Turning points of one wall's clearance in [a, b], and the time at which it first passes 0, or None."""
    turns, last = [], a
    for t in [*turning_times(course, side, wall, a, b), None]:
        c, _, ddc = course.clearance(side, wall, b if t is None else t)
        if t is not None:
            turns.append(Turn(t, side, c, bool(ddc > 0)))
            if not (c > 0 or c < 0):
                return turns, None
        if sign(c) < 0:
            low, high = float(a), float(b)
            middle, radius = 0.5 * (low + high), 0.5 * (high - low) * (1 + 1e-9) + 1e-15
            series, bound, _ = course.series(side, wall, middle, radius)
            second = abs(series[2]) + taylor.spread(series, 2, radius, bound)
            return turns, polish(
                lambda t: course.clearance(side, wall, t)[:2], last, b if t is None else t, second * 1.001
            )
        last = t
    return turns, None


def first_contact(course, length):
    """(time, side) of the first contact within length or None, and the turning points before it."""
    steps = max(1, math.ceil(float(length) * course.fastest))
    ends = [float(length) * k / steps for k in range(steps)] + [length]
    turns = []
    for a, b in pairwise(ends):
        hits = []
        for side, wall in course.scene.walls():
            found, hit = piece(course, side, wall, a, b)
            turns += found
            hits += [(hit, side)] if hit is not None else []
        if hits:
            first = min(hits, key=lambda hit: float(hit[0]))
            if any(not other[0] > first[0] for other in hits if other is not first):
                raise Undecided("two walls at one time")
            return first, [turn for turn in turns if turn.time < first[0]]
    return None, turns

"""Lanes between walls that may be soft, and move, in NumPy alone: nothing is shared with the package.

Free, or within a wall, a lane is a damped oscillator under a few cosines: the textbook's closed form, damping below
critical. In absolute coordinates a soft wall adds k2 x_b(t) to the force. A lane takes steps of a fraction of a drive
period, within a wall of its half-swing; where a step ends beyond a wall, or turns back near one, or comes out of one,
the time is bracketed, then found by bisection and Newton's method on the closed form. Two tangent vectors are carried
along, by the rotation in flight and by what each crossing does to them, and made orthogonal each period: both
exponents are measured, neither comes from the determinant.
"""

from dataclasses import dataclass

import numpy as np

STEPS = 40  # of a free flight in a period
SWINGS = 10  # steps of a half-swing within a wall
HALVINGS, POLISH = 7, 3  # of a root
MOST = 100_000  # steps of a period: more are chatter, which this method does not follow


@dataclass
class Wall:
    """A wall at position + swing cos(harmonic omega t + angle): rigid with a restitution, else soft."""

    side: int
    position: float
    restitution: float | None = None
    stiffness: float = 0.0
    damping: float = 0.0
    swing: float = 0.0
    harmonic: int = 1
    angle: float = 0.0


@dataclass
class Mode:
    """x'' + 2 gamma x' + stiffness x = constant + sum of Re(force exp(i rate t)); forces: (force, rate)."""

    stiffness: float
    gamma: float
    constant: float
    forces: list
    step: float

    def forced(self, time):
        """x and v of the steady motion."""
        x, v = self.constant / self.stiffness + 0.0 * time, 0.0 * time
        for force, rate in self.forces:
            turn = force / (self.stiffness - rate * rate + 2j * self.gamma * rate) * np.exp(1j * rate * time)
            x, v = x + turn.real, v - rate * turn.imag
        return x, v

    def rotated(self, x, v, time):
        """The free motion, a damped rotation, of (x, v)."""
        own = np.sqrt(self.stiffness - self.gamma**2)
        fade, cosine, sine = np.exp(-self.gamma * time), np.cos(own * time), np.sin(own * time) / own
        return (
            fade * ((cosine + self.gamma * sine) * x + sine * v),
            fade * ((cosine - self.gamma * sine) * v - self.stiffness * sine * x),
        )

    def flown(self, x, v, start, time):
        """(x, v) a time after the start."""
        p, q = self.forced(start)
        a, b = self.rotated(x - p, v - q, time)
        p, q = self.forced(start + time)
        return a + p, b + q

    def pull(self, x, v, time):
        """The acceleration."""
        total = self.constant - self.stiffness * x - 2 * self.gamma * v
        return total + sum((force * np.exp(1j * rate * time)).real for force, rate in self.forces)


class Lanes:
    """Lanes on their way. walls: `Wall`s; x, v, mode (0, or the side of the wall around it),
    time since the period began; tangents (2, 2, lanes); hits and within: impacts, entries among them, and time within,
    on the left and on the right."""

    def __init__(self, amplitude, omega, gamma, walls, x, v):
        self.omega, self.walls = omega, {wall.side: wall for wall in walls}
        self.x, self.v = np.array(x, float), np.array(v, float)
        size = len(self.x)
        self.modes = {0: Mode(1.0, gamma, 0.0, [(amplitude, omega)], 2 * np.pi / omega / STEPS)}
        for side, wall in self.walls.items():
            if wall.restitution is None:
                stiffness = 1.0 + wall.stiffness
                own = wall.stiffness * wall.swing * np.exp(1j * wall.angle), wall.harmonic * omega
                half = np.pi / np.sqrt(stiffness - wall.damping**2) / SWINGS
                forces = [(amplitude, omega), own]
                step = min(half, 2 * np.pi / omega / STEPS)
                self.modes[side] = Mode(stiffness, wall.damping, wall.stiffness * wall.position, forces, step)
        self.time, self.mode = np.zeros(size), np.zeros(size, int)
        for side in self.walls:
            self.mode[self.gap(side, self.x, self.v, self.time)[0] < 0] = side
        self.tangents = np.tile(np.eye(2)[:, :, None], (1, 1, size))
        self.hits, self.within = np.zeros((2, size)), np.zeros((2, size))

    def place(self, side, time):
        """Position and velocity of a wall."""
        wall = self.walls[side]
        rate = wall.harmonic * self.omega
        angle = rate * time + wall.angle
        return wall.position + wall.swing * np.cos(angle), -wall.swing * rate * np.sin(angle)

    def gap(self, side, x, v, time):
        """How far a wall is, and how fast that changes."""
        where, pace = self.place(side, time)
        return side * (where - x), side * (pace - v)

    def period(self):
        """One drive period on."""
        length = 2 * np.pi / self.omega
        self.time[:] = 0.0
        for _ in range(MOST):
            going = self.time < length
            if not going.any():
                return
            for side in self.modes:
                lanes = np.flatnonzero(going & (self.mode == side))
                if len(lanes):
                    (self.fly if side == 0 else self.press)(lanes, side, length)
        raise RuntimeError("chatter: this method does not follow it")

    def moved(self, lanes, mode, span):
        """The lanes a time on, in their mode."""
        self.x[lanes], self.v[lanes] = mode.flown(self.x[lanes], self.v[lanes], self.time[lanes], span)
        turned = mode.rotated(self.tangents[:, 0, lanes], self.tangents[:, 1, lanes], span)
        self.tangents[:, :, lanes] = np.stack(turned, axis=1)

    def ended(self, lanes, span, length):
        """Their clocks; one that has come to the end says so."""
        left = length - self.time[lanes]
        self.time[lanes] = np.where(span >= left, length, self.time[lanes] + span)

    def fly(self, lanes, _, length):
        """A step of free lanes, up to the first wall that they meet."""
        mode = self.modes[0]
        span = np.minimum(mode.step, length - self.time[lanes])
        met = np.zeros(len(lanes), int)
        for side in self.walls:
            when = self.meeting(mode, lanes, side, span)
            met, span = np.where(when < span, side, met), np.minimum(when, span)
        self.moved(lanes, mode, span)
        self.ended(lanes, span, length)
        for side, wall in self.walls.items():
            some = lanes[met == side]
            if not len(some):
                continue
            self.hits[(side + 1) // 2, some] += 1
            where, pace = self.place(side, self.time[some])
            before, self.x[some] = self.v[some].copy(), where
            if wall.restitution is None:
                self.mode[some] = side
                jump = 2 * (self.modes[0].gamma - wall.damping) * before
                self.tangents[:, 1, some] += jump / (before - pace) * self.tangents[:, 0, some]
                continue
            self.v[some] = pace - wall.restitution * (before - pace)
            rate = wall.harmonic * self.omega
            bend = -rate * rate * (where - wall.position)
            pulls = [mode.pull(where, v, self.time[some]) for v in (self.v[some], before)]
            shear = (pulls[0] + wall.restitution * pulls[1] - (1 + wall.restitution) * bend) / (before - pace)
            a, b = self.tangents[:, 0, some].copy(), self.tangents[:, 1, some].copy()
            self.tangents[:, 0, some], self.tangents[:, 1, some] = (
                -wall.restitution * a,
                shear * a - wall.restitution * b,
            )

    def meeting(self, mode, lanes, side, span):
        """When each lane meets a wall, inf where that is not within its step."""
        x, v, start = self.x[lanes], self.v[lanes], self.time[lanes]

        def apart(time, some=slice(None)):
            return self.gap(side, *mode.flown(x[some], v[some], start[some], time), start[some] + time)

        def bend(time, some):
            rate = self.walls[side].harmonic * self.omega
            at = mode.flown(x[some], v[some], start[some], time)
            then = start[some] + time
            wall = -rate * rate * (self.place(side, then)[0] - self.walls[side].position)
            return side * (wall - mode.pull(*at, then))

        first, closing = apart(0.0 * span)
        last, opening = apart(span)
        end, found = span.copy(), last < 0
        turns = (closing < 0) & (opening > 0) & ~found & (np.minimum(first, last) < (opening - closing) * span)
        some = np.flatnonzero(turns)
        if len(some):
            low = root(lambda t: (-apart(t, some)[1], -bend(t, some)), np.zeros(len(some)), span[some])
            deep = apart(low, some)[0] < 0
            end[some[deep]], found[some[deep]] = low[deep], True
        when, hit = np.full(len(lanes), np.inf), np.flatnonzero(found)
        if len(hit):
            when[hit] = root(lambda t: apart(t, hit), np.zeros(len(hit)), end[hit])
        return when

    def press(self, lanes, side, length):
        """A step of lanes within a wall, up to where they leave it."""
        wall, mode = self.walls[side], self.modes[side]
        span = np.minimum(mode.step, length - self.time[lanes])
        x, v, start = self.x[lanes], self.v[lanes], self.time[lanes]
        ends = mode.flown(x, v, start, span)
        out = self.gap(side, *ends, start + span)[0] > 0
        some = np.flatnonzero(out)
        if len(some):

            def depth(time):
                at = mode.flown(x[some], v[some], start[some], time)
                return tuple(-each for each in self.gap(side, *at, start[some] + time))

            span[some] = root(depth, np.zeros(len(some)), span[some])
        self.moved(lanes, mode, span)
        self.ended(lanes, span, length)
        self.within[(side + 1) // 2, lanes] += span
        gone = lanes[out]
        if len(gone):
            self.x[gone], pace = self.place(side, self.time[gone])
            self.mode[gone] = 0
            v = self.v[gone]
            jump = 2 * (wall.damping - self.modes[0].gamma) * v
            self.tangents[:, 1, gone] += jump / (v - pace) * self.tangents[:, 0, gone]


def exponents(lanes, periods, settle):
    """(mean growth of both tangents (lanes, 2), impacts (2, lanes), time within (2, lanes)), each a period."""
    growth = np.zeros((2, len(lanes.x)))
    for k in range(settle + periods):
        if k == settle:
            growth[:], lanes.hits[:], lanes.within[:] = 0.0, 0.0, 0.0
        lanes.period()
        growth += orthogonal(lanes.tangents)
    return growth.T / periods, lanes.hits / periods, lanes.within / periods


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


def orthogonal(tangents):
    """Gram and Schmidt, in place: the logarithms of both lengths, (2, lanes)."""
    one, two = tangents
    size = np.hypot(*one)
    one /= size
    two -= one * (one * two).sum(axis=0)
    rest = np.hypot(*two)
    two /= rest
    return np.log([size, rest])

"""Branches of simple periodic orbits in the amplitude, in closed form, as a reference for continuation.

The orbits have one impact in n periods on a wall at 1 (P n 0 1), or are symmetric P111 between walls at -1 and 1. With
the speed u before an impact, the free part of the motion there is u (a, b), so that

    A(u)^2 = D ((1 - a u)^2 + b^2 u^2 / omega^2),
    trace M = -R trace E - (1 + R) E12 (omega^2 / u + (1 - omega^2) a + 2 gamma b),

where E is the free flow and M the derivative from an impact to the next (over half a period if symmetric). A multiplier
is 1 or -1 where trace M = 1 + det M or -(1 + det M), each at one u. Orbits end where the motion penetrates a wall
between impacts; this point is searched along u. gamma < 1.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

GRID, FLIGHT = 800, 600  # numbers of speeds and times at which the clearance of a motion is evaluated


class Family(NamedTuple):
    """Parameters of a branch: gamma, omega, R, number n of drive periods, symmetric P111 or not."""

    gamma: float
    omega: float
    restitution: float
    periods: int
    symmetric: bool

    @property
    def length(self):
        """Time between impacts."""
        return np.pi / self.omega if self.symmetric else 2 * np.pi * self.periods / self.omega

    @property
    def label(self):
        """Label of its orbits."""
        return "P111" if self.symmetric else f"P{self.periods}01"

    @property
    def resonance(self):
        """D, the squared dynamic stiffness."""
        return (1 - self.omega**2) ** 2 + (2 * self.gamma * self.omega) ** 2

    def flow(self, time):
        """Return the rows of the free flow matrix."""
        root = np.sqrt(1 - self.gamma**2)
        decay = np.exp(-self.gamma * time)
        s, c = decay * np.sin(root * time) / root, decay * np.cos(root * time)
        return (c + self.gamma * s, s), (-s, c - self.gamma * s)

    @property
    def shares(self):
        """Coefficients (a, b) of the free part of the motion."""
        (e, f), (g, h) = self.flow(self.length)
        mirror = -1.0 if self.symmetric else 1.0
        matrix = np.array([[e - mirror, f], [g, h - mirror]])
        return np.linalg.solve(matrix, np.array([f * self.restitution, mirror + h * self.restitution]))

    def amplitude(self, speed):
        """Return A of the orbit with this impact speed."""
        a, b = self.shares
        return np.sqrt(self.resonance * ((1 - a * speed) ** 2 + (b * speed / self.omega) ** 2))

    def speeds(self, amplitude):
        """Return both roots of A(u), nan if there are none."""
        a, b = self.shares
        size = a**2 + (b / self.omega) ** 2
        with np.errstate(invalid="ignore"):
            root = np.sqrt(a**2 - size * (1 - amplitude**2 / self.resonance))
        return np.stack([(a + root) / size, (a - root) / size])

    def steady(self, speed):
        """Return the cosine and sine coefficients of the steady response, with time measured from an impact."""
        a, b = self.shares
        return 1 - a * speed, -b * speed / self.omega

    def motion(self, speed, time):
        """Return (x, v) at a time after the impact at 1."""
        a, b = self.shares
        inphase, behind = self.steady(speed)
        (e, f), (g, h) = self.flow(time)
        cosine, sine = np.cos(self.omega * time), np.sin(self.omega * time)
        x, v = speed * a, speed * (b - self.restitution)
        forced = inphase * cosine + behind * sine, self.omega * (behind * cosine - inphase * sine)
        return e * x + f * v + forced[0], g * x + h * v + forced[1]

    def sections(self, speed):
        """Return the states at phase 0 of the drive, one per period: [(x, v), ...]."""
        p, q = self.steady(speed)
        stiff, drag = 1 - self.omega**2, 2 * self.gamma * self.omega
        phase = np.arctan2(drag * p - stiff * q, stiff * p + drag * q)  # phase of the drive at the impact
        time = np.mod(-phase, 2 * np.pi) / self.omega
        if not self.symmetric:
            return [self.motion(speed, time + 2 * np.pi * k / self.omega) for k in range(self.periods)]
        over = time > self.length
        x, v = self.motion(speed, np.where(over, time - self.length, time))
        return [(np.where(over, -x, x), np.where(over, -v, v))]

    def turning(self, sign):
        """Return the impact speed with a multiplier `sign`, of the half map if symmetric; below 0 or inf: none."""
        a, b = self.shares
        (e, f), (_, h) = self.flow(self.length)
        r, det = self.restitution, self.restitution**2 * np.exp(-2 * self.gamma * self.length)
        mirror = -1.0 if self.symmetric else 1.0
        trace = sign * mirror * (1 + det)
        rest = (1 - self.omega**2) * a + 2 * self.gamma * b
        inverse = ((-r * (e + h) - trace) / ((1 + r) * f) - rest) / self.omega**2
        return 1 / inverse if inverse else np.inf

    def clearance(self, speed):
        """Return the smallest distance to a wall between impacts, negative beyond it."""
        speed = np.asarray(speed, float)[..., None]
        times = self.length * (np.arange(FLIGHT) + 0.5) / FLIGHT
        _, v = self.motion(speed, times)
        # Turning points between two times: two steps of Newton's method along the secant.
        turn, step = v[..., :-1] * v[..., 1:] < 0, self.length / FLIGHT
        slope = np.where(turn, (v[..., 1:] - v[..., :-1]) / step, 1.0)
        near = times[:-1] - v[..., :-1] / slope
        near = near - np.where(turn, self.motion(speed, near)[1] / slope, 0.0)
        x, _ = self.motion(speed, near)
        return np.where(turn, 1.0 - (abs(x) if self.symmetric else x), 1.0).min(-1)


class Truth(NamedTuple):
    """Branch in closed form.

    `bounds` are those of A, `start` an impact speed on the branch, `low` and `high` the impact speeds at its ends,
    `ends` their kinds, "GR" or "bound", and `special` ((kind, A), ...) the special points, ends included.
    """

    family: Family
    bounds: tuple[float, float]
    start: float
    low: float
    high: float
    ends: tuple[str, str]
    special: tuple[tuple[str, float], ...]


def draw(rng, symmetric, periods=1):
    """Draw a random branch, a `Truth`; None if it is short or two special points nearly coincide."""
    family = Family(*(float(rng.uniform(*each)) for each in ((0.01, 0.4), (0.4, 4.0), (0.3, 0.95))), periods, symmetric)
    graze = np.sqrt(family.resonance)
    high = float(rng.uniform(1.5, 4.0)) * graze
    top = family.speeds(high)[0]
    if not top > 0.05:
        return None
    speeds = top * (np.arange(GRID) + 0.5) / GRID
    real = family.clearance(speeds) > 0
    if not real.any():
        return None
    start = int(rng.choice(np.flatnonzero(real)))
    first, last = run_of(real, start)
    if last - first < GRID // 20:
        return None
    at = (first + last) // 2
    lowest = 0.0 if first == 0 else brentq(family.clearance, speeds[first - 1], speeds[first], xtol=1e-13)
    highest = top if last == GRID - 1 else brentq(family.clearance, speeds[last], speeds[last + 1], xtol=1e-13)
    ends = "GR", "bound" if last == GRID - 1 else "GR"
    found = [("GR", family.amplitude(lowest))] + [("GR", family.amplitude(highest))] * (ends[1] == "GR")
    for kind, sign in (("SN", 1.0), ("SB" if symmetric else "PD", -1.0)):
        speed = family.turning(sign)
        if lowest < speed < highest:
            found.append((kind, family.amplitude(speed)))
    inner = sorted([lowest, highest, *(family.turning(sign) for sign in (1.0, -1.0))])
    if np.diff(inner).min() < 1e-3 * top or lowest_amplitude(family, lowest, highest) < 1e-2 * graze:
        return None
    least = 0.5 * lowest_amplitude(family, lowest, highest)
    told = tuple((kind, float(value)) for kind, value in found)
    return Truth(family, (float(least), high), float(speeds[at]), float(lowest), float(highest), ends, told)


def run_of(flags, place):
    """Return the first and last index of the run of true flags around an index."""
    first = last = place
    while first > 0 and flags[first - 1]:
        first -= 1
    while last < len(flags) - 1 and flags[last + 1]:
        last += 1
    return first, last


def lowest_amplitude(family, low, high):
    """Return the smallest A between two speeds."""
    fold = family.turning(1.0)
    return min(family.amplitude(each) for each in (low, high, *([fold] if low < fold < high else [])))

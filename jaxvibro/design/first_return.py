"""The impacts that a motion makes from an impact on, forward or backward in time, and how near flights come to walls.

In NumPy, as a search asks for single flights of many scenes. A flight is looked at in short steps, exact but for
rounding (the matrix exponential of x, v and the drive together); between two of them the clearance is a cubic, within a
known bound. So no impact is passed over but such as reach less than that bound into a wall.
"""

from typing import NamedTuple

import numpy as np
from scipy import linalg

from ..scene.scene import SIDES

STEP = 0.04  # of the fastest time there is
MOST = 20_000  # steps
TERMS = 14  # of the power series within a step
POLISH = 60  # halvings at most
ROUNDING = 1e-15  # of a step: as near to the root is at it


class Impact(NamedTuple):
    """side: -1, 1; time; speed: before it."""

    side: float
    time: float
    speed: float


class WallCourse(NamedTuple):
    """How a wall moves. sign: of its side; bounce: R; position; swing, rate, phase: of its cosine."""

    sign: float
    bounce: float
    position: float
    swing: float
    rate: float
    phase: float


class Motion:
    """A scene's motions, its drive at a phase at time 0; way: 1 forward, -1 backward in time."""

    def __init__(self, scene, phase, way=1):
        self.way, self.phase, self.rate = way, phase, float(scene.frequency)
        self.walls = [wall_of(scene, side, phase) for side in scene.walls]
        push, damping = float(scene.amplitude), float(scene.damping)
        self.matrix = way * np.array(
            [[0, 1, 0, 0], [-1, -2 * damping, push, 0], [0, 0, 0, -self.rate], [0, 0, self.rate, 0.0]]
        )
        fastest = max(1.0, 2 * damping, self.rate, *(abs(wall.rate) for wall in self.walls))
        self.step = STEP / fastest
        self.power = np.eye(4)[None]

    def start(self, side, time, speed):
        """The state (x, v, cos, sin) at an impact, after it forward in time, before it backward."""
        wall = self._wall(side)
        where, pace = course(wall, time)
        v = pace + side * speed * (-wall.bounce if self.way > 0 else 1.0)
        return np.array([where, v, np.cos(self.phase + self.rate * time), np.sin(self.phase + self.rate * time)])

    def onward(self, impact: Impact, until: float, count: int) -> list[Impact]:
        """The next impacts, `count` at most, as long as they come no later (backward: no earlier) than a time."""
        found: list[Impact] = []
        while len(found) < count:
            if self.way < 0 and self._wall(impact.side).bounce <= 0:
                break
            impact = self._next(impact, until)
            if impact is None:
                break
            found.append(impact)
        return found

    def least(self, nodes):
        """(clearance, side, time) of each flight between nodes that are impacts where it turns back nearest to a wall,
        or is deepest in one, inf where it does neither; what can have been missed is taken off."""
        starts = np.array([self.start(*one) for one in zip(nodes.sides, nodes.first, nodes.second, strict=True)])[:-1]
        spans = np.diff(nodes.first)
        steps = self._powers(int(min(MOST, np.ceil(np.max(spans, initial=0.0) / self.step))))
        path = np.einsum("kij,fj->kfi", steps, starts)
        since, every = self.step * np.arange(len(steps))[:, None], np.arange(len(spans))
        least, sides, when = np.full(len(spans), np.inf), np.zeros(len(spans)), np.array(nodes.first[:-1])
        for wall in self.walls:
            clear, rate = self._clear(wall, path, nodes.first[:-1] + since)
            clear[0] = np.where(nodes.sides[:-1] == wall.sign, 0.0, clear[0])
            value, inside = _lowest(clear, rate, self.step)
            place = since[:-1] + inside
            counts = (place > 0) & (place < spans) & ((inside < self.step) | (value < 0))
            value = np.where(counts, value, np.inf)
            low = np.argmin(value, 0)
            nearer = value[low, every] < least
            least = np.where(nearer, value[low, every], least)
            sides = np.where(nearer, wall.sign, sides)
            when = np.where(nearer, nodes.first[:-1] + place[low, every], when)
        return least - self._passed(path), sides, when

    def _wall(self, side):
        return next(wall for wall in self.walls if wall.sign == side)

    def _powers(self, count):
        """The matrices of so many steps, from none on."""
        one = linalg.expm(self.matrix * self.step) if len(self.power) < 2 else self.power[1]
        if len(self.power) < 2:
            self.power = np.stack([np.eye(4), one])
        while len(self.power) <= count:
            self.power = np.concatenate([self.power, self.power @ (self.power[-1] @ one)])
        return self.power[: count + 1]

    def _clear(self, wall, path, time):
        """(clearance, its rate along the way)."""
        where, pace = course(wall, time)
        return wall.sign * (where - path[..., 0]), self.way * wall.sign * (pace - path[..., 1])

    def _passed(self, path):
        """How far the clearance may be from its cubic, of each flight."""
        x, v = np.max(abs(path[..., 0]), 0), np.max(abs(path[..., 1]), 0)
        push, drag = abs(self.matrix[1, 2]), abs(self.matrix[1, 1])
        second = push + drag * v + x
        third = push * self.rate + drag * second + v
        fourth = push * self.rate**2 + drag * third + second
        fourth = fourth + max((abs(wall.swing) * wall.rate**4 for wall in self.walls), default=0.0)
        return 1.1 * fourth * self.step**4 / 384.0

    def _next(self, impact, until):
        """The first `Impact` after one, None where there is none until a time."""
        count = int(min(MOST, np.ceil(abs(until - impact.time) / self.step) + 1))
        path = self._powers(count) @ self.start(*impact)
        since = self.step * np.arange(len(path))
        first = None
        for wall in self.walls:
            clear, rate = self._clear(wall, path, impact.time + self.way * since)
            clear[0] = 0.0 if wall.sign == impact.side else clear[0]
            value, place = _lowest(clear, rate, self.step)
            hit = np.flatnonzero(value < 0)
            if len(hit) and (first is None or hit[0] <= first[0]):
                met = self._met(wall, path[hit[0]], impact.time + self.way * since[hit[0]], place[hit[0]], hit[0])
                if first is None or met.time * self.way < first[1].time * self.way:
                    first = hit[0], met
        if first is None or (first[1].time - until) * self.way > 0:
            return None
        return first[1]

    def _met(self, wall, state, time, inside, place):
        """The impact in a step from a state on, in which the clearance is below 0 at a place."""
        terms = [state]
        for k in range(1, TERMS):
            terms.append(self.matrix @ terms[-1] / k)
        terms = np.array(terms[::-1])

        def clear(since):
            here = np.zeros(4)
            for term in terms:
                here = here * since + term
            value, rate = self._clear(wall, here, time + self.way * since)
            return value, rate, here

        low, high = 0.0, inside
        if place == 0 and clear(0.0)[0] <= 1e-12:  # it leaves this wall: the root at 0 is not the next
            low = next((high * 0.5**k for k in range(1, 40) if clear(high * 0.5**k)[0] > 0), 0.0)
        since = 0.5 * (low + high)
        for _ in range(POLISH):
            value, rate, _ = clear(since)
            low, high = (since, high) if value > 0 else (low, since)
            newton = since - value / rate if rate < 0 else low
            new = newton if low < newton < high else 0.5 * (low + high)
            if abs(new - since) <= ROUNDING * self.step:
                break
            since = new
        rate = clear(since)[1]
        speed = max(-rate, 0.0) if self.way > 0 else max(-rate, 0.0) / wall.bounce
        return Impact(wall.sign, time + self.way * since, speed)


def wall_of(scene, side, phase):
    """The `WallCourse` of a wall, the drive at a phase at time 0."""
    wall, sign = scene.walls[side], 1.0 if side == SIDES[1] else -1.0
    swing = rate = turn = 0.0
    if wall.motion is not None:
        swing, rate = float(wall.motion.amplitude), wall.motion.harmonic * float(scene.frequency)
        turn = float(wall.motion.phase) + wall.motion.harmonic * phase
    return WallCourse(sign, float(scene.bounce(side)), float(wall.position), swing, rate, turn)


def course(wall, time):
    """A wall's position and velocity at a time."""
    angle = wall.rate * time + wall.phase
    return wall.position + wall.swing * np.cos(angle), -wall.swing * wall.rate * np.sin(angle)


def _lowest(clear, rate, step):
    """(the least value of the cubic in each step, where in the step)."""
    begin, end = clear[:-1], clear[1:]
    slope, last = rate[:-1] * step, rate[1:] * step
    square, cube = 3 * (end - begin) - 2 * slope - last, 2 * (begin - end) + slope + last
    inside = square * square - 3 * cube * slope
    turns = (slope < 0) & (last > 0) & (inside >= 0)
    root = np.sqrt(np.where(turns, inside, 1.0))
    # the root at which the cubic bends upwards, without cancellation
    bottom = np.where(square > 0, -slope / (square + root), (root - square) / np.where(cube == 0, 1.0, 3 * cube))
    bottom = np.where(turns, np.clip(bottom, 0.0, 1.0), 1.0)
    value = np.where(turns, begin + bottom * (slope + bottom * (square + bottom * cube)), end)
    return np.where(value < end, value, end), step * np.where(value < end, bottom, 1.0)

"""The impacts that a motion makes from an impact on, forward or backward in time, and how near flights come to walls.

In NumPy, as a search asks for single flights of many scenes. A flight is looked at in short steps, exact but for
rounding (the matrix exponential of x, v and the drive together); between two of them the clearance is a cubic, within a
known bound. So no impact is passed over but such as reach less than that bound into a wall. The impact on a soft wall
is where the mass enters it; the flight begins where it comes out, which is looked for in the same way.
"""

from typing import NamedTuple

import numpy as np
import scipy

from ..scene.scene import SIDES

STEP = 0.04  # of the fastest time there is
MOST = 20_000  # steps
TERMS = 14  # of the power series within a step
POLISH = 60  # halvings at most
ROUNDING = 1e-15  # of a step: as near to the root is at it
SWING, TOUCH = 96, 1e-6  # steps that are looked at together: a half swing; of a step: a stay takes as long at least
LONGEST = 8.0  # drive periods that a stay within a soft wall is looked for


class Impact(NamedTuple):
    """side: -1, 1; time; speed: before it."""

    side: float
    time: float
    speed: float


class WallCourse(NamedTuple):
    """How a wall moves, and what it does. sign: of its side; bounce: R, -1 of a soft one; position; swing, rate, phase:
    of its cosine; stiffness, damping: 1 + k2 and gamma2 of a soft one, None of a rigid one."""

    sign: float
    bounce: float
    position: float
    swing: float
    rate: float
    phase: float
    stiffness: float | None
    damping: float | None


class Term(NamedTuple):
    """A term of the drive: force cos(rate t + phase), since time 0."""

    force: float
    rate: float
    phase: float


class Motion:
    """A scene's motions, its drive at a phase at time 0; way: 1 forward, -1 backward in time. A state is x, v, and the
    cosine and the sine of each `Term` of the drive."""

    def __init__(self, scene, phase, way=1):
        self.way, self.phase, self.rate = way, phase, float(scene.frequency)
        self.walls = [wall_of(scene, side, phase) for side in scene.walls]
        self.drive = [Term(float(scene.amplitude), self.rate, phase)]
        for each in scene.drive:
            angle = each.harmonic * phase + float(each.phase)
            self.drive.append(Term(float(each.amplitude), each.harmonic * self.rate, angle))
        damping, size = float(scene.damping), 2 + 2 * len(self.drive)
        matrix = np.zeros((size, size))
        matrix[0, 1], matrix[1, :2] = 1.0, [-1.0, -2.0 * damping]
        self.matrix = way * _driven(matrix, self.drive, 2)
        fastest = max(1.0, 2 * damping, *(one.rate for one in self.drive), *(abs(wall.rate) for wall in self.walls))
        self.step = STEP / fastest
        self.power, self.stays = np.eye(size)[None], {}

    def start(self, side, time, speed):
        """(the state (x, v, cos, sin), its time) at an impact, after it forward in time, before it backward; None of
        one on a soft wall that lets the mass not go."""
        wall = self._wall(side)
        pace = course(wall, time)[1]
        v = pace + side * speed * (-wall.bounce if self.way > 0 else 1.0)
        if self.way > 0 and wall.stiffness is not None:
            out = self._stayed(wall, time, v)
            if out is None:
                return None
            time, v = out
        return np.array([course(wall, time)[0], v, *self._phasors(time)]), time

    def _phasors(self, time):
        """Cosine and sine of each term of the drive at a time."""
        angles = [term.rate * time + term.phase for term in self.drive]
        return [wave(angle) for angle in angles for wave in (np.cos, np.sin)]

    def onward(self, impact: Impact, until: float, count: int) -> list[Impact]:
        """The next impacts, `count` at most, as long as they come no later (backward: no earlier) than a time."""
        found: list[Impact] = []
        while len(found) < count:
            if self.way < 0 and self._wall(impact.side).bounce == 0:
                break
            impact = self._next(impact, until)
            if impact is None:
                break
            found.append(impact)
        return found

    def least(self, nodes):
        """(clearance, side, time) of each flight between nodes that are impacts where it turns back nearest to a wall,
        or is deepest in one, inf where it does neither; what can have been missed is taken off."""
        begun = [self.start(*one) for one in zip(nodes.sides[:-1], nodes.first[:-1], nodes.second[:-1], strict=True)]
        stuck = np.array([one is None for one in begun])
        begun = [one or (np.zeros(len(self.matrix)), time) for one, time in zip(begun, nodes.first, strict=False)]
        starts, times = (np.array(one) for one in zip(*begun, strict=True))
        spans = nodes.first[1:] - times
        steps = self._powers(int(min(MOST, np.ceil(np.max(spans, initial=0.0) / self.step))))
        path = np.einsum("kij,fj->kfi", steps, starts)
        since, every = self.step * np.arange(len(steps))[:, None], np.arange(len(spans))
        least, sides, when = np.full(len(spans), np.inf), np.zeros(len(spans)), times
        for wall in self.walls:
            clear, rate = self._clear(wall, path, times + since)
            clear[0] = np.where(nodes.sides[:-1] == wall.sign, 0.0, clear[0])
            value, inside = _lowest(clear, rate, self.step)
            place = since[:-1] + inside
            counts = (place > 0) & (place < spans) & ((inside < self.step) | (value < 0))
            value = np.where(counts, value, np.inf)
            low = np.argmin(value, 0)
            nearer = value[low, every] < least
            least = np.where(nearer, value[low, every], least)
            sides = np.where(nearer, wall.sign, sides)
            when = np.where(nearer, times + place[low, every], when)
        return np.where(stuck, -np.inf, least - self._passed(path)), sides, when

    def _wall(self, side):
        return next(wall for wall in self.walls if wall.sign == side)

    def _powers(self, count):
        """The matrices of so many steps, from none on."""
        one = scipy.linalg.expm(self.matrix * self.step) if len(self.power) < 2 else self.power[1]
        self.power = _powers(self.power, one, max(count + 1, 2))
        return self.power[: count + 1]

    def _clear(self, wall, path, time):
        """(clearance, its rate along the way)."""
        where, pace = course(wall, time)
        return wall.sign * (where - path[..., 0]), self.way * wall.sign * (pace - path[..., 1])

    def _passed(self, path):
        """How far the clearance may be from its cubic, of each flight."""
        x, v = np.max(abs(path[..., 0]), 0), np.max(abs(path[..., 1]), 0)
        pushes = [sum(abs(term.force) * term.rate**k for term in self.drive) for k in range(3)]
        drag = abs(self.matrix[1, 1])
        second = pushes[0] + drag * v + x
        third = pushes[1] + drag * second + v
        fourth = pushes[2] + drag * third + second
        fourth = fourth + max((abs(wall.swing) * wall.rate**4 for wall in self.walls), default=0.0)
        return 1.1 * fourth * self.step**4 / 384.0

    def _next(self, impact, until):
        """The first `Impact` after one, None where there is none until a time."""
        begun = self.start(*impact)
        if begun is None:
            return None
        start, time = begun
        count = int(min(MOST, np.ceil(max((until - time) * self.way, 0.0) / self.step) + 1))
        path = self._powers(count) @ start
        since = self.step * np.arange(len(path))
        first = None
        for wall in self.walls:
            clear, rate = self._clear(wall, path, time + self.way * since)
            clear[0] = 0.0 if wall.sign == impact.side else clear[0]
            value, place = _lowest(clear, rate, self.step)
            hit = np.flatnonzero(value < 0)
            if len(hit) and (first is None or hit[0] <= first[0]):
                met = self._met(wall, path[hit[0]], time + self.way * since[hit[0]], place[hit[0]], hit[0])
                if met is None:
                    return None
                if first is None or met.time * self.way < first[1].time * self.way:
                    first = hit[0], met
        if first is None or (first[1].time - until) * self.way > 0:
            return None
        return first[1]

    def _met(self, wall, state, time, inside, place):
        """The impact in a step from a state on, in which the clearance is below 0 at a place; None of one on a soft
        wall that the mass was never outside of."""
        series = _series(self.matrix, state)

        def clear(since):
            here = series(since)
            return *self._clear(wall, here, time + self.way * since), here

        low, high = 0.0, inside
        if place == 0 and clear(0.0)[0] <= 1e-12:  # it leaves this wall: the root at 0 is not the next
            low = next((high * 0.5**k for k in range(1, 40) if clear(high * 0.5**k)[0] > 0), 0.0)
        since = _root(lambda since: clear(since)[:2], low, high, self.step)
        _, rate, here = clear(since)
        time = time + self.way * since
        if self.way < 0 and wall.stiffness is not None:
            out = self._stayed(wall, time, here[1])
            if out is None:
                return None
            time, v = out
            return Impact(wall.sign, time, max(wall.sign * (v - course(wall, time)[1]), 0.0))
        speed = max(-rate, 0.0) if self.way > 0 else max(-rate, 0.0) / wall.bounce
        return Impact(wall.sign, time, speed)

    def _stayed(self, wall, time, v):
        """(time, velocity) at the other end of a stay within a soft wall; None of one that does not end."""
        matrix, step, powers = self._within(wall)
        own, (where, _) = wall.rate * time + wall.phase, course(wall, time)
        state = np.array([where, v, 1.0, np.cos(own), np.sin(own), *self._phasors(time)])

        def inside(path, since):
            place, pace = course(wall, time + self.way * since)
            return wall.sign * (path[..., 0] - place), self.way * wall.sign * (path[..., 1] - pace)

        most, since, back = min(MOST * step, LONGEST * 2.0 * np.pi / self.rate), np.zeros(1), np.zeros(0, int)
        while not len(back):
            if since[-1] > most:
                return None
            path, since = powers @ state, since[-1] + step * np.arange(len(powers))
            back, state = np.flatnonzero(inside(path, since)[0][1:] <= 0.0), path[-1]
        first, series = since[back[0]], _series(matrix, path[back[0]])
        low = 0.0 if first > 0 else TOUCH * step  # the root at 0 is where it begins
        more = _root(lambda more: inside(series(more), first + more), low, step, step)
        return time + self.way * (first + more), float(series(more)[1])

    def _within(self, wall):
        """(the matrix of x, v, 1, the wall's cosine and sine and the drive's within a soft wall; a step; its powers,
        from none on)."""
        if wall.sign not in self.stays:
            size, spring = 5 + 2 * len(self.drive), wall.stiffness - 1.0
            matrix = np.zeros((size, size))
            pulls = spring * wall.position, spring * wall.swing, 0.0
            matrix[0, 1], matrix[1, :5] = 1.0, [-wall.stiffness, -2.0 * wall.damping, *pulls]
            matrix[3, 4], matrix[4, 3] = -wall.rate, wall.rate
            matrix, rates = _driven(matrix, self.drive, 5), [term.rate for term in self.drive]
            step = STEP / max(np.sqrt(wall.stiffness), 2.0 * wall.damping, *rates, abs(wall.rate))
            one = scipy.linalg.expm(self.way * matrix * step)
            self.stays[wall.sign] = self.way * matrix, step, _powers(np.eye(size)[None], one, SWING)
        return self.stays[wall.sign]


def _driven(matrix, drive, first):
    """A matrix with the drive's terms put in, cosines and sines from a place on."""
    for k, term in zip(range(first, len(matrix), 2), drive, strict=True):
        matrix[1, k] = term.force
        matrix[k, k + 1], matrix[k + 1, k] = -term.rate, term.rate
    return matrix


def wall_of(scene, side, phase):
    """The `WallCourse` of a wall, the drive at a phase at time 0."""
    wall, sign = scene.walls[side], 1.0 if side == SIDES[1] else -1.0
    swing = rate = turn = 0.0
    if wall.motion is not None:
        swing, rate = float(wall.motion.amplitude), wall.motion.harmonic * float(scene.frequency)
        turn = float(wall.motion.phase) + wall.motion.harmonic * phase
    soft = (1.0 + float(wall.stiffness), float(scene.parameter(f"{side}.damping"))) if wall.soft else (None, None)
    return WallCourse(sign, float(scene.bounce(side)), float(wall.position), swing, rate, turn, *soft)


def course(wall, time):
    """A wall's position and velocity at a time."""
    angle = wall.rate * time + wall.phase
    return wall.position + wall.swing * np.cos(angle), -wall.swing * wall.rate * np.sin(angle)


def _powers(known, one, count):
    """The powers of a matrix, so many at least, from those that are known on."""
    while len(known) < count:
        known = np.concatenate([known, known @ (known[-1] @ one)])
    return known


def _series(matrix, state):
    """The state within a step, by how long it is since it began."""
    terms = [state]
    for k in range(1, TERMS):
        terms.append(matrix @ terms[-1] / k)

    def at(since):
        here = np.zeros(len(state))
        for term in terms[::-1]:
            here = here * since + term
        return here

    return at


def _root(value_and_rate, low, high, step):
    """Where a value goes from above 0 to below it."""
    since = 0.5 * (low + high)
    for _ in range(POLISH):
        value, rate = value_and_rate(since)
        low, high = (since, high) if value > 0 else (low, since)
        newton = since - value / rate if rate < 0 else low
        new = newton if low < newton < high else 0.5 * (low + high)
        if abs(new - since) <= ROUNDING * step:
            break
        since = new
    return since


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

"""The stroboscopic map in ball arithmetic, with certified contacts and the growth of errors along the orbit."""

import math
from dataclasses import dataclass, field

from flint import arb, ctx

from .ball import Oscillator
from .scene import static_scale
from .search import Course, Discard, Undecided, first_contact, sign

SLOWEST = 1e-2
NEAREST = 1e-8
EDGE = 1e-9
MOST = 60


@dataclass
class Record:
    """The motion over a strobe. Times since its start; balls unless stated otherwise.

    turns holds every turning point of x - x_wall in flight, one wall after the other (Turn: time, side, clearance,
    minimum). least_clearance is the least of all of them, least_minimum of the minima alone (floats, inf if none).
    norm is the largest 2-norm of d(end)/d(state at an earlier time), product that of the norms of all flights' and
    impacts' matrices, jacobian d(end)/d(start) (rows of floats).
    scale is the largest of |x|, |v| at start, impacts and end, wall distances, A and A / sqrt(D).
    """

    x: arb = None
    v: arb = None
    times: list = field(default_factory=list)
    sides: list = field(default_factory=list)
    speeds: list = field(default_factory=list)
    turns: list = field(default_factory=list)
    least_speed: float = math.inf
    least_clearance: float = math.inf
    least_minimum: float = math.inf
    norm: float = 1.0
    product: float = 1.0
    jacobian: tuple = ((1.0, 0.0), (0.0, 1.0))
    scale: float = 0.0

    @property
    def count(self):
        """How many impacts there were."""
        return len(self.times)


def strobe(scene, x, v, phase=0.0, contact=0.0, periods=1, precision=200):
    """Record of `periods` drive periods from (x, v) at a drive phase in radians.

    contact is 0 (free: a start on a resting wall and moving into it rebounds at time 0) or -1, +1 (landed there
    already). Raises Discard where a test would be unfair: an impact slower than 1e-2, a turning point nearer than
    1e-8, an impact or a wall within 1e-9 of the start or the end, more than 60 impacts; ValueError beyond a wall.
    """
    for bits in (precision, 2 * precision, 4 * precision, 8 * precision):
        with ctx.workprec(bits):
            try:
                record = run(scene, arb(x), arb(v), arb(phase), contact, periods)
            except Undecided:
                continue
            if max(float(ball.rad()) for ball in [record.x, record.v, *record.times]) < 1e-30 * record.scale:
                return record
    raise Discard("undecided at the highest precision")


def run(scene, x, v, phase, contact, periods):
    """One attempt at the precision in force."""
    oscillator, record, factors = Oscillator(*scene[:3], scene.drive), Record(scale=static_scale(scene)), []
    t, end = arb(0), 2 * arb.pi() * periods / arb(scene.omega)
    hit = meet(scene, oscillator, x, v, phase, contact)
    touching = contact
    while True:
        theta = phase + oscillator.omega * t
        record.scale = max(record.scale, abs(float(x)), abs(float(v)))
        if hit is None:
            course = Course(scene, oscillator, x, v, theta)
            check_start(course, touching)
            hit, turns = first_contact(course, end - t)
            keep_turns(record, turns, t)
            length = hit[0] if hit else end - t
            x, v = course.flight(length)
            factors += [flown(oscillator, length / 4)] * 4
            record.product *= norm(flown(oscillator, length))
            if hit is None:
                break
            t, theta = t + length, theta + oscillator.omega * length
        x, v = rebound(scene, oscillator, record, factors, (x, v, theta, t), hit[1])
        touching, hit = hit[1], None
        if record.count > MOST or end - t < EDGE:
            raise Discard("too many impacts, or one at the end")
    check_start(Course(scene, oscillator, x, v, phase), 0)
    record.x, record.v, record.scale = x, v, max(record.scale, abs(float(x)), abs(float(v)))
    grow(record, factors)
    return record


def meet(scene, oscillator, x, v, phase, contact):
    """The impact at time 0 of a given start that lies exactly on a wall and moves into it, or None."""
    course = Course(scene, oscillator, x, v, phase)
    for side, wall in scene.walls():
        c, dc, _ = course.clearance(side, wall, 0.0)
        if contact == 0 and c.is_zero() and sign(dc) < 0:
            return arb(0), side
    return None


def check_start(course, touching):
    """The state lies between the walls, and leaves the one it touches."""
    for side, wall in course.scene.walls():
        c, dc, _ = course.clearance(side, wall, 0.0)
        if side == touching or c.is_zero():
            if not dc > 0:
                raise Discard("on a wall and not leaving it")
        elif abs(c) < EDGE:
            raise Discard("on a wall to within rounding")
        elif sign(c) < 0:
            raise ValueError(f"the start lies beyond the wall at side {side}")


def keep_turns(record, turns, since):
    """Add a flight's turning points to the record."""
    for turn in turns:
        near = float(turn.clearance)
        if near < NEAREST:
            raise Discard("a near graze")
        record.turns.append(turn._replace(time=since + turn.time))
        record.least_clearance = min(record.least_clearance, near)
        if turn.minimum:
            record.least_minimum = min(record.least_minimum, near)


def rebound(scene, oscillator, record, factors, at, side):
    """The state after the impact v+ - v_b = -R (v- - v_b); adds the impact and its saltation matrix."""
    x, v, theta, t = at
    wall = scene.left if side < 0 else scene.right
    course = Course(scene, oscillator, x, v, theta)
    cosine, sine, rate = course.wall_motion(wall, arb(0))
    place, speed, change = wall.position + cosine, -rate * sine, -rate * rate * cosine
    relative, r = v - speed, arb(wall.restitution)
    if not side * relative > SLOWEST:
        raise Discard("a slow impact")
    after = speed - r * relative
    force = oscillator.force(theta) - place
    before_pull, after_pull = force - 2 * oscillator.gamma * v, force - 2 * oscillator.gamma * after
    shear = (after_pull + r * before_pull - (1 + r) * change) / relative
    factors.append(((-float(r), 0.0), (float(shear), -float(r))))
    record.product *= norm(factors[-1])
    record.times.append(t)
    record.sides.append(side)
    record.speeds.append(abs(relative))
    record.least_speed = min(record.least_speed, abs(float(relative)))
    record.scale = max(record.scale, abs(float(v)), abs(float(after)))
    return place, after


def flown(oscillator, length):
    """The derivative of a free flight, as floats."""
    return tuple(tuple(float(entry) for entry in row) for row in oscillator.homogeneous(length))


def grow(record, factors):
    """Norm and jacobian from the factors in order of travel, multiplied from the end backward."""
    product = ((1.0, 0.0), (0.0, 1.0))
    for factor in reversed(factors):
        product = multiply(product, factor)
        record.norm = max(record.norm, norm(product))
    record.jacobian = product


def multiply(one, two):
    """Product of two 2 by 2 matrices."""
    return tuple(tuple(row[0] * two[0][j] + row[1] * two[1][j] for j in (0, 1)) for row in one)


def norm(matrix):
    """2-norm of a 2 by 2 matrix."""
    (a, b), (c, d) = matrix
    return 0.5 * (math.hypot(a + d, b - c) + math.hypot(a - d, b + c))

"""The stroboscopic map between walls that may be soft, in ball arithmetic, and its derivative as a product.

The rules by which a draw is too near a graze are those of `records`; depths beyond a soft wall are measured in 1 / W, W
being the rate of a contact's ring (`spring`).
"""

from dataclasses import dataclass, field
from typing import NamedTuple

from flint import arb, ctx

from . import records
from .ball import Oscillator
from .records import EDGE, MOST, SLOWEST, keep_turns, multiply, norm
from .scene import Soft, static_scale
from .search import Course, Discard, Undecided, first_contact, sign
from .spring import Press, depth_of_exit, way_out

PARTS = 4  # of a flight or a contact: so often the norm is taken on the way


@dataclass
class Record(records.Record):
    """The motion over a strobe: the fields of `records.Record`, and those of contacts with soft walls.

    An entry into a soft wall counts as an impact with a time, a side and a speed. exits: times since the strobe's start
    and sides at which the mass left a soft wall. jacobian: rows of balls. sharp: as norm, but a change of x beyond a
    soft wall counts W times, as befits one who keeps d there.
    """

    exits: list = field(default_factory=list)
    sharp: float = 1.0


class Factor(NamedTuple):
    """A factor of the derivative, rows of balls; that of a PARTS-th of its time, if it takes any; W before it.

    W is 1 but beyond a soft wall.
    """

    rows: tuple
    part: tuple | None = None
    before: float = 1.0


def strobe(scene, x, v, phase=0.0, contact=0.0, periods=1, precision=200, slowest=SLOWEST):
    """Record of `periods` drive periods from (x, v) at a drive phase in radians.

    A start beyond a soft wall is in contact and no impact; one on it and moving into it enters at time 0, unless
    contact is its side. contact is 0 (free: a start on a resting wall and moving into it rebounds at time 0) or -1, +1
    (landed there already). Raises Discard where a test would be unfair: an impact or entry slower than `slowest`, a
    turning point nearer than 1e-8 (or 1e-8 / W of the way out of a soft wall), an impact or a wall within 1e-9 of the
    start or the end, more than 60 impacts, a ring that takes too long. ValueError beyond a rigid wall.
    """
    for bits in (precision, 2 * precision, 4 * precision, 8 * precision):
        with ctx.workprec(bits):
            try:
                record = Way(scene, arb(x), arb(v), arb(phase), contact, periods, slowest).go()
            except Undecided:
                continue
            balls = [record.x, record.v, *record.times, *(time for time, _ in record.exits)]
            if max(float(ball.rad()) for ball in balls) < 1e-30 * record.scale:
                return record
    raise Discard("undecided at the highest precision")


class Way:
    """A mass on its way through a strobe, at the precision in force."""

    def __init__(self, scene, x, v, phase, contact, periods, slowest):
        self.scene, self.oscillator = scene, Oscillator(*scene[:3], scene.drive)
        self.x, self.v, self.phase, self.t = x, v, phase, arb(0)
        self.end = 2 * arb.pi() * periods / arb(scene.omega)
        self.touching, self.held, self.slowest = contact, 0, slowest
        self.record, self.factors = Record(scale=static_scale(scene)), []

    def theta(self):
        """The drive's phase now."""
        return self.phase + self.oscillator.omega * self.t

    def wall(self, side):
        """The wall on a side."""
        return self.scene.left if side < 0 else self.scene.right

    def place(self, wall):
        """Position, velocity and acceleration of a wall now."""
        if wall.motion is None:
            return arb(wall.position), arb(0), arb(0)
        b, own, m = wall.motion
        sin, cos = (m * self.theta() + arb(own)).sin_cos()
        rate = m * self.oscillator.omega
        return wall.position + b * cos, -rate * b * sin, -rate * rate * b * cos

    def course(self):
        """The free flight from here."""
        return Course(self.scene, self.oscillator, self.x, self.v, self.theta())

    def go(self):
        """The Record of the whole strobe."""
        self.measure()
        side, self.held = self.look()
        if side:
            self.meet(side)
        while self.press() if self.held else self.fly():
            if self.record.count > MOST or self.end - self.t < EDGE:
                raise Discard("too many impacts, or one at the end")
        self.t, self.touching = self.end, 0
        if self.look() != (0, self.held):
            raise Discard("on a wall to within rounding")
        self.record.x, self.record.v = self.x, self.v
        self.measure()
        grow(self.record, self.factors)
        return self.record

    def measure(self):
        """The scale knows of this state."""
        self.record.scale = max(self.record.scale, abs(float(self.x)), abs(float(self.v)))

    def look(self):
        """(side of a wall that the mass lies on and moves into, side of a soft one that it is beyond); 0 for none."""
        met = held = 0
        for side, wall in self.scene.walls():
            soft = isinstance(wall, Soft)
            c, speed, _ = self.course().clearance(side, wall, 0.0)
            if side == self.touching or c.is_zero():
                if sign(speed) <= 0:
                    if side == self.touching or speed.is_zero():
                        raise Discard("on a wall and not leaving it")
                    met = side
            elif abs(c) < (EDGE / (1 + wall.stiffness) ** 0.5 if soft and c < 0 else EDGE):
                raise Discard("on a wall to within rounding")
            elif sign(c) < 0:
                if not soft:
                    raise ValueError(f"the start lies beyond the wall at side {side}")
                held = side
        return met, held

    def fly(self):
        """Fly on to the next wall and meet it; False where the end comes first."""
        course = self.course()
        hit, turns = first_contact(course, self.end - self.t)
        keep_turns(self.record, turns, self.t)
        length = hit[0] if hit else self.end - self.t
        self.x, self.v = course.flight(length)
        self.factors.append(Factor(*(self.oscillator.homogeneous(length / k) for k in (1, PARTS))))
        if hit is None:
            return False
        self.t += length
        self.meet(hit[1])
        return True

    def press(self):
        """Go through a contact and leave the wall; False where the end comes first."""
        side, wall = self.held, self.wall(self.held)
        place, pace, _ = self.place(wall)
        d = arb(0) if self.touching == side else side * (self.x - place)
        press = Press(self.scene, side, wall, d, side * (self.v - pace), self.theta())
        hit, _ = way_out(press, self.end - self.t)
        length = self.end - self.t if hit is None else hit
        d, speed = press(length)
        rate = float(press.ring.rate)
        self.factors.append(Factor(*(press.ring.homogeneous(length / k) for k in (1, PARTS)), rate))
        self.t += length
        place, pace, _ = self.place(wall)
        self.x, self.v = place + (side * d if hit is None else 0), pace + side * speed
        if hit is None:
            return False
        if depth_of_exit(press, hit) < press.near or not speed < 0:
            raise Discard("a slow exit")
        self.measure()
        self.salt(arb(1), 2 * (press.ring.g - self.oscillator.gamma) * self.v / (side * speed), rate)
        self.record.exits.append((self.t, side))
        self.touching, self.held = side, 0
        return True

    def meet(self, side):
        """Rebound from a rigid wall, or enter a soft one."""
        wall = self.wall(side)
        self.x, pace, change = self.place(wall)
        relative = self.v - pace
        soft = isinstance(wall, Soft)
        if not side * relative > (self.slowest if soft else SLOWEST):
            raise Discard("a slow impact")
        self.measure()
        self.record.times.append(self.t)
        self.record.sides.append(side)
        self.record.speeds.append(abs(relative))
        self.record.least_speed = min(self.record.least_speed, abs(float(relative)))
        self.touching = side
        gamma = self.oscillator.gamma
        if soft:
            self.held = side
            self.salt(arb(1), -2 * (arb(wall.damping) - gamma) * self.v / relative)
            return
        r, pull = arb(wall.restitution), self.oscillator.force(self.theta()) - self.x
        before, self.v = self.v, pace - r * relative
        shear = pull - 2 * gamma * self.v + r * (pull - 2 * gamma * before) - (1 + r) * change
        self.salt(-r, shear / relative)
        self.measure()

    def salt(self, kept, shear, before=1.0):
        """The factor of an entry, an exit (kept = 1) or a rebound (kept = -R).

        A soft wall: I + (f+ - f-) n^T / (n f-), the flow f seen from the wall. A state that is dx ahead comes there
        dx / (v - x_b') earlier and goes that long under the other force: dv gains (a+ - a-) dx / (v - x_b'). At depth
        0 the accelerations a differ by the damping alone.
        """
        self.factors.append(Factor(((kept, arb(0)), (shear, kept)), None, before))


def grow(record, factors):
    """The record's norms and jacobian from the factors in order of travel."""
    product = (arb(1), arb(0)), (arb(0), arb(1))
    for factor in reversed(factors):
        for step in [factor.part] * PARTS if factor.part else [factor.rows]:
            product = multiply(product, step)
            (a, b), (c, d) = ((float(entry) for entry in row) for row in product)
            record.norm = max(record.norm, norm(((a, b), (c, d))))
            record.sharp = max(record.sharp, norm(((a / factor.before, b), (c / factor.before, d))))
    record.jacobian = product

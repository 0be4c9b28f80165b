"""A mass beyond a soft wall: exact motion in ball arithmetic, and the certified search for its way out.

The depth d = side * (x - x_b) follows from the equation of motion without the large force stiffness * x_b:

    d'' + 2 g d' + K d = side * (A cos(theta) - x_b - 2 g x_b' - x_b''),    K = 1 + stiffness,

and further terms of the drive beside A cos(theta).

So d is a slow part, the steady answer to the right side, and a ring, which dies out freely. W = sqrt(K) is the ring's
rate. Where the slow part is greater than the ring can be, the mass stays beyond the wall and no step is as short as the
ring asks for; all else is looked at as `search` does, in pieces that resolve the ring.
"""

import math

from flint import arb

from . import taylor
from .ball import Spring
from .search import WIDEST, Discard, Undecided, piece

MOST = 4000  # short pieces of a contact
NEAREST = 1e-8  # a turning point at a depth of less, times 1 / W, is too near the way out


class Ring(Spring):
    """What a contact does without its force; W is its rate."""

    def __init__(self, wall):
        super().__init__(1 + arb(wall.stiffness), arb(wall.damping))
        self.rate = self.k.sqrt()

    def answer(self, rate, cosine, sine):
        """The steady answer to cosine cos(psi) + sine sin(psi), psi' = rate: its own cosine and sine."""
        stiff, drag = self.k - rate**2, 2 * self.g * rate
        d = stiff**2 + drag**2
        if d == 0:
            raise Discard("resonance on a wall without damping")
        return (cosine * stiff - sine * drag) / d, (cosine * drag + sine * stiff) / d


class Press:
    """A contact from the depth d and its speed at drive phase theta. It has the face of `search.Course`, d for c."""

    def __init__(self, scene, side, wall, d, speed, theta):
        self.ring = ring = Ring(wall)
        if not (d.rad() * ring.rate < WIDEST and speed.rad() < WIDEST):
            raise Undecided("a start too uncertain to be looked at")
        omega = arb(scene.omega)
        self.level = -side * arb(wall.position) / ring.k
        self.tones = [(omega, theta, *ring.answer(omega, arb(side * scene.amplitude), arb(0)))]
        for amplitude, m, phase in scene.drive:
            self.tones.append(
                (m * omega, m * theta + arb(phase), *ring.answer(m * omega, side * arb(amplitude), arb(0)))
            )
        if wall.motion is not None:
            b, own, m = side * arb(wall.motion.amplitude), arb(wall.motion.phase), wall.motion.harmonic
            rate = m * omega
            force = -b * (1 - rate**2), 2 * b * ring.g * rate
            self.tones.append((rate, m * theta + own, *ring.answer(rate, *force)))
        self.seen, self.begin = {}, (d, speed)
        slow = self.slow(arb(0), 2)
        self.start = d - slow[0], speed - slow[1]
        self.reach = [abs(p) + abs(q) for _, _, p, q in self.tones]
        self.fastest = max(float(ring.rate + 2 * ring.g), *(float(rate) for rate, *_ in self.tones))
        self.near = NEAREST / float(ring.rate)

    def slow(self, t, count):
        """The slow part and its derivatives, so many in all."""
        total = [self.level] + [arb(0)] * (count - 1)
        for rate, psi, p, q in self.tones:
            sin, cos = (psi + rate * t).sin_cos()
            for k in range(count):
                total[k] += p * cos + q * sin
                p, q = rate * q, -rate * p
        return total

    def ringing(self, t):
        """The ring and its speed at t."""
        (a, b), (c, d) = self.ring.homogeneous(t)
        r, u = self.start
        return a * r + b * u, c * r + d * u

    def state(self, t):
        """(derivatives of the slow part up to ORDER - 1, ring, speed of the ring) at t; kept when t is a float."""
        if isinstance(t, float) and t in self.seen:
            return self.seen[t]
        result = (self.slow(arb(t), taylor.ORDER), *self.ringing(arb(t)))
        if isinstance(t, float):
            self.seen = {**dict(list(self.seen.items())[-3:]), t: result}
        return result

    def __call__(self, t):
        """(d, d') after t."""
        if arb(t).is_zero():
            return self.begin
        slow, r, u = self.state(t)
        return slow[0] + r, slow[1] + u

    def clearance(self, _side, _wall, t):
        """d and its first two derivatives at t, as balls."""
        slow, r, u = self.state(t)
        return *self(t), slow[2] - 2 * self.ring.g * u - self.ring.k * r

    def series(self, _side, _wall, middle, radius):
        """Floats: the derivatives of d at the middle, the bound for the next one, and slack for rounding.

        E = hypot(W r, r') of the ring r grows backward by less than exp(2 g radius).
        """
        slow, r, u = self.state(middle)
        k, g, rate = self.ring.k, self.ring.g, self.ring.rate
        free = [r, u]
        on_r, on_u = arb(1), arb(0)  # of W r and r' in W^(1-n) times the n-th derivative
        for _ in range(taylor.ORDER):
            on_r, on_u = -on_u, on_r - 2 * g / rate * on_u
            free.append(-2 * g * free[-1] - k * free[-2])
        energy = ((rate * r) ** 2 + u**2).sqrt() * (2 * g * radius).exp()
        bound = (abs(on_r) + abs(on_u)) * energy * rate ** (taylor.ORDER - 1)
        bound += sum(reach * tone[0] ** taylor.ORDER for reach, tone in zip(self.reach, self.tones, strict=True))
        found = [float(one + other) for one, other in zip(slow, free, strict=False)]
        bound = 1.001 * float(bound.upper())
        sizes = [*(abs(each) for each in found), bound]
        return found, bound, 1e-13 * max(each / self.fastest**n for n, each in enumerate(sizes))

    def stays(self, low, high):
        """Whether the mass is certainly far beyond the wall from low to high, however the ring stands."""
        middle, radius = 0.5 * (low + high), 0.5 * (high - low) * (1 + 1e-9)
        _, r, u = self.state(low)
        ring = (r**2 + (u / self.ring.rate) ** 2).sqrt()
        drift = sum(reach * tone[0] for reach, tone in zip(self.reach, self.tones, strict=True))
        return bool(self.slow(arb(middle), 1)[0] - drift * radius - ring > self.near)


def way_out(press, length):
    """The time within length at which d first falls to 0, or None, and all turning points of d in pieces looked at.

    Raises Discard at a turning point with |d| < 1e-8 / W, or where too many pieces are as short as the ring asks for.
    """
    least, stop, looks = 1 / press.fastest, float(length), 0
    t, step, turns = 0.0, least, []
    while t < stop:
        last = t + step >= stop - 1e-3 * least
        b = length if last else t + step
        if press.stays(t, float(b)):
            step *= 2
        elif step > least:
            step = max(least, 0.25 * step)
            continue
        else:
            looks += 1
            if looks > MOST:
                raise Discard("a ring that takes too long")
            found, hit = piece(press, 1, None, t, b)
            turns += [turn for turn in found if hit is None or turn.time < hit]
            if any(abs(float(turn.clearance)) < press.near for turn in found):
                raise Discard("a near release")
            if hit is not None:
                return hit, turns
        t = float(b)
        if last:
            break
    return None, turns


def depth_of_exit(press, t):
    """How far d would go beyond 0 after the exit at t if the mass were pulled on: speed^2 / 2 |d''|, a float."""
    _, speed, bend = (float(ball) for ball in press.clearance(1, None, t))
    return speed**2 / (2 * abs(bend)) if bend else math.inf

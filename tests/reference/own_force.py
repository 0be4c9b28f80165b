"""Impact oscillators under forces that are no spring: Taylor series by hand, in as many digits as mpmath is set to.

x'' = f(t, x, v) + A cos(omega t + phase) between rigid walls, or between soft ones at rest that push as k depth^1.5
(1 + d rate), the law of Hunt and Crossley, and of Hertz for d = 0. Within a wall the series are in s, depth = e^2 and
dt = 2 e ds. Each force's recurrence is written out here. A number u is held as the integer nearest to u 2^bits, as
Python multiplies these many times faster than mpmath its own.
"""

from operator import mul
from typing import NamedTuple

from mpmath import mp, mpf

GUARD = 24  # bits beyond the digits asked for
NOISE = 32  # units, by which the value of a series may be off
FINEST = 60  # halvings of a step at most, to tell its turning points apart
MOST = 400  # impacts, by default
FAR = 10**6  # a motion as far out does not come back


class RunsAwayError(ArithmeticError):
    """A motion that a force drives off without end."""


class Flown(NamedTuple):
    """end: (x, v); hits: [(time, side, speed)] of impacts and entries; least: the slowest of these and of the exits;
    nearest: the least clearance at turning points towards a wall, and at the end, and the least depth at turning points
    within one; turns: [(time, side, clearance or depth)] of the turning points."""

    end: tuple
    hits: list
    least: mpf
    nearest: mpf
    turns: list


class Fixed(NamedTuple):
    """Numbers in units of 2^-bits."""

    bits: int

    def of(self, value):
        return int(mp.nint(mp.ldexp(mpf(value), self.bits)))

    def back(self, whole):
        return mp.ldexp(mpf(whole), -self.bits)

    def times(self, a, b):
        return a * b >> self.bits

    def dot(self, a, b, k):
        """The k-th coefficient of the product of two series."""
        return sum(map(mul, a, b[k::-1])) >> self.bits

    def at(self, terms, late):
        """The value of a series."""
        total, bits = 0, self.bits
        for term in reversed(terms):
            total = (total * late >> bits) + term
        return total


def duffing(n, p, x, v, k, memory):
    square = memory.setdefault("square", [])
    square.append(n.dot(x, x, k))
    return -x[k] - n.times(p["cubic"], n.dot(square, x, k)) - 2 * n.times(p["damping"], v[k])


def pendulum(n, p, x, v, k, memory):
    sine, cosine, slope = (memory.setdefault(name, []) for name in ("sine", "cosine", "slope"))
    if k == 0:
        sine.append(n.of(mp.sin(n.back(x[0]))))
        cosine.append(n.of(mp.cos(n.back(x[0]))))
    else:
        slope.append(k * x[k])
        sine.append(n.dot(slope, cosine, k - 1) // k)
        cosine.append(-n.dot(slope, sine, k - 1) // k)
    return -sine[k] - 2 * n.times(p["damping"], v[k])


def stribeck(n, p, x, v, k, memory):
    """-x - (low + (high - low) exp(-(u / slip)^2)) tanh(u / smooth), u = v - belt."""
    names = ["u", "rises", "square", "sinks", "bell", "tanh", "slope", "size"]
    u, rises, square, sinks, bell, tanh, slope, size = (memory.setdefault(name, []) for name in names)
    if k == 0:
        u.append(v[0] - p["belt"])
        wide, narrow = (n.back(p[name]) for name in ("slip", "smooth"))
        bell.append(n.of(mp.exp(-((n.back(u[0]) / wide) ** 2))))
        tanh.append(n.of(mp.tanh(n.back(u[0]) / narrow)))
        memory["over"] = n.of(1 / wide**2), n.of(1 / narrow)
    else:
        u.append(v[k])
        rises.append(k * v[k])
    square.append(n.times(n.dot(u, u, k), memory["over"][0]))
    if k:
        sinks.append(k * square[k])
        bell.append(-n.dot(sinks, bell, k - 1) // k)
        tanh.append(n.times(n.dot(rises, slope, k - 1), memory["over"][1]) // k)
    slope.append((1 << n.bits if k == 0 else 0) - n.dot(tanh, tanh, k))
    size.append(n.times(p["high"] - p["low"], bell[k]) + (p["low"] if k == 0 else 0))
    return -x[k] - n.dot(size, tanh, k)


def van_der_pol(n, p, x, v, k, memory):
    square = memory.setdefault("square", [])
    square.append((1 << n.bits if k == 0 else 0) - n.dot(x, x, k))
    return -x[k] + n.times(p["gain"], n.dot(square, v, k))


def falling(n, p, x, v, k, memory):
    """A constant pull without a spring."""
    return -(p["c0"] if k == 0 else 0) - 2 * n.times(p["damping"], v[k])


FORCES = {"duffing": duffing, "pendulum": pendulum, "stribeck": stribeck, "van_der_pol": van_der_pol}


def wave(n, size, frequency, angle, count):
    """Taylor coefficients of size cos(angle + frequency s) in s; all but the angle and count in units."""
    square = n.times(frequency, frequency)
    terms = [n.times(size, n.of(mp.cos(angle))), -n.times(n.times(size, frequency), n.of(mp.sin(angle)))]
    for k in range(2, count):
        terms.append(-n.times(square, terms[k - 2]) // (k * (k - 1)))
    return terms


def series(n, force, p, drive, x, v):
    """Taylor coefficients of x, two more than the drive has."""
    place, speed, memory = [x, v], [v], {}
    for k, push in enumerate(drive):
        place.append((force(n, p, place, speed, k, memory) + push) // ((k + 1) * (k + 2)))
        speed.append((k + 2) * place[k + 2])
    return place


def within(n, force, p, push, drive, wall, side, e, w, count):
    """Taylor coefficients in s of e, of the rate of the depth, and of the time since, within the wall on a side."""
    (amplitude, frequency, angle), (stiffness, dissipation) = drive, push
    root, rate, time, turn, memory = [e], [w], [0], [], {}
    cosine, sine = [n.of(mp.cos(angle))], [n.of(mp.sin(angle))]
    square, cube, place, speed, pull = [], [], [], [], []
    for k in range(count):
        square.append(n.dot(root, root, k))
        cube.append(n.dot(square, root, k))
        place.append(side * square[k] + (wall if k == 0 else 0))
        speed.append(side * rate[k])
        if k:
            turn.append(n.times(frequency, k * time[k]))
            old = cosine[:]
            cosine.append(-n.dot(turn, sine, k - 1) // k)
            sine.append(n.dot(turn, old, k - 1) // k)
        own = force(n, p, place, speed, k, memory) + n.times(amplitude, cosine[k])
        pull.append(side * own - n.times(stiffness, cube[k] + n.times(dissipation, n.dot(cube, rate, k))))
        root.append(rate[k] // (k + 1))
        rate.append(2 * n.dot(pull, root, k) // (k + 1))
        time.append(2 * root[k] // (k + 1))
    return root, rate, time


def contact(n, stay, rest, w, omega, angle):
    """Return (time, rate of the depth, depth) at the exit from a wall or after the time that is left, and the turning
    points [(time, depth)]; stay: `within` from an angle of the drive, e and w."""
    late, e, turns = 0, 0, []
    while True:
        root_, rate, time = stay(angle + omega * n.back(late), e, w)
        step = reach(n, (root_, rate), 1 << n.bits, {}, 0)
        out, some = first(n, [-term for term in root_], step, 0)
        turns += [(n.back(late + n.at(time, at)), n.back(value) ** 2) for at, value in some if out is None or at < out]
        span = step if out is None else out
        over = late + n.at(time, span) >= rest
        if over:
            time[0] = late - rest
            span = root(n, time, derived(time), 0, span)
        e, w = n.at(root_, span), n.at(rate, span)
        if over:
            return rest, w, n.times(e, e), turns
        late += n.at(time, span)
        if out is not None:
            return late, w, 0, turns


def flown(
    force, p, amplitude, frequency, walls, restitution, x, v, periods=1, phase=0, shallow=0, most=MOST, push=None
):
    """`Flown` of a state over so many periods of the drive.

    walls: left and right, None, a position or (position, amplitude, phase, harmonic) of one that moves as position +
    amplitude cos(harmonic (omega t + phase of the drive) + phase); restitution: one, or a pair. Where the mass turns
    back at most so shallow behind a wall there is no impact, and a clearance below 0. push: (k, d) of soft walls.

    Raises ArithmeticError where there are more than the most impacts, or turning points that cannot be told apart, and
    RunsAwayError where it goes off to infinity within the time.
    """
    n = Fixed(int(3.33 * mp.dps) + GUARD)
    count, given = int(1.2 * mp.dps), amplitude
    omega, p = mpf(frequency), {name: n.of(value) for name, value in p.items()}
    amplitude, frequency, shallow = n.of(given), n.of(omega), n.of(shallow)
    bounce = [n.of(each) for each in (restitution if isinstance(restitution, tuple) else (restitution,) * 2)]
    t, end, x, v = 0, n.of(periods * 2 * mp.pi / omega), n.of(x), n.of(v)
    drive, push = (amplitude, frequency), push and [n.of(each) for each in push]
    hits, exits, turns, touched = [], [], [], 0
    while t < end:
        angle = mpf(phase) + omega * n.back(t)
        terms = series(n, force, p, wave(n, amplitude, frequency, angle, count - 1), x, v)
        ways = {}
        for side, wall in zip((-1, 1), walls, strict=True):
            if wall is not None:
                ways[side] = course(n, wall, omega, angle, count + 1)
        ahead = {side: [side * (a - b) for a, b in zip(terms, way, strict=True)] for side, way in ways.items()}
        if touched:
            ahead[touched][0] = 0
        step = reach(n, [terms, *ways.values()], end - t, ahead, shallow)
        found = []
        for side, clearance in ahead.items():
            hit, some = first(n, clearance, step, shallow)
            turns += [(n.back(t + late), side, n.back(-value)) for late, value in some if hit is None or late < hit]
            if hit is not None:
                found.append((hit, side))
        late, side = min(found, default=(step, 0))
        turns = [one for one in turns if one[0] <= n.back(t + late)]
        x, v, t, touched = n.at(terms, late), n.at(derived(terms), late), t + late, side
        if abs(x) > FAR << n.bits:
            raise RunsAwayError("it runs away")
        if side:
            x, moving = n.at(ways[side], late), n.at(derived(ways[side]), late)
            hits.append((n.back(t), side, n.back(side * (v - moving))))
            if len(hits) > most:
                raise ArithmeticError("too many impacts")
            if not push:
                v = moving - n.times(bounce[side > 0], v - moving)
                continue

            def stay(angle, e, w, wall=x, side=side):
                return within(n, force, p, push, (*drive, angle), wall, side, e, w, count)

            late, w, depth, some = contact(n, stay, end - t, side * v, omega, mpf(phase) + omega * n.back(t))
            turns += [(n.back(t) + time, side, least) for time, least in some]
            x, v, t = x + side * depth, side * w, t + late
            if t < end:
                exits.append(n.back(-w))
    last = [-n.at(clearance, late) for side, clearance in ahead.items() if side != touched]
    nearest = min([clear for _, _, clear in turns] + [n.back(each) for each in last], default=mp.inf)
    least = min([speed for _, _, speed in hits] + exits, default=mp.inf)
    return Flown((n.back(x), n.back(v)), hits, least, nearest, turns)


def course(n, wall, omega, angle, count):
    """Taylor coefficients of a wall's place."""
    if not isinstance(wall, tuple):
        return [n.of(wall)] + [0] * (count - 1)
    position, swing, own, harmonic = wall
    terms = wave(n, n.of(swing), n.of(harmonic * omega), harmonic * angle + mpf(own), count)
    return [terms[0] + n.of(position), *terms[1:]]


def reach(n, some, longest, ahead, shallow):
    """A step over which some series are good, at whose end the mass is not about to touch."""
    unit, step = 10 ** (-mpf(mp.dps)), 1 << n.bits
    for terms in some:
        for k in (len(terms) - 2, len(terms) - 1):
            if terms[k]:
                step = min(step, n.of((unit / abs(n.back(terms[k]))) ** (mpf(1) / k)))
    if step >= longest:
        return longest
    while shallow and any(abs(n.at(clearance, step)) <= 2 * shallow for clearance in ahead.values()):
        step = step * 9 // 10
    return step


def derived(terms):
    return [k * term for k, term in enumerate(terms)][1:]


def first(n, ahead, step, shallow):
    """(when the wall is first met, None if it is not; [(when, -clearance)] of turning points before): ahead is below 0
    between the walls, or 0 and about to fall. Halves of the step are halved until bounds on a derivative say that it,
    or its slope, goes one way."""
    slope, bend = derived(ahead), derived(derived(ahead))
    steepest, most = (bound(n, derived(each), step) for each in (slope, bend))
    turns, below, todo = [], 0, [(0, step, 0)]
    while todo:
        low, high, depth = todo.pop()
        middle, half = (low + high) // 2, n.back(high - low) / 2
        rises = abs(n.back(n.at(slope, middle))) > steepest * half
        if not rises and not abs(n.back(n.at(bend, middle))) > most * half:
            if depth == FINEST:
                raise ArithmeticError("turning points that cannot be told apart")
            todo += [(middle, high, depth + 1), (low, middle, depth + 1)]
            continue
        before, after = n.at(slope, low), n.at(slope, high)
        if before > 0 > after:
            top = root(n, slope, bend, low, high)
            value = n.at(ahead, top)
            if value >= shallow:
                return root(n, ahead, slope, below, top), turns
            turns.append((top, value))
            below = high
        elif before <= 0 < after:
            below = root(n, slope, bend, low, high)
        elif after <= 0:
            below = high
        if after > 0 and n.at(ahead, high) >= shallow:
            return root(n, ahead, slope, below, high), turns
        if n.at(ahead, high) < 0:
            below = high
    return None, turns


def bound(n, terms, step):
    """A bound on the size of a series over a step."""
    return n.back(n.at([abs(term) for term in terms], step)) + mpf(10) ** (3 - mp.dps)


def root(n, terms, slopes, low, high):
    """Where a series passes 0 between two places where its signs differ: Newton's method, halving where it leaves."""
    falls = n.at(terms, low) > 0 or n.at(terms, high) < 0
    place = (low + high) // 2
    for _ in range(4 * n.bits):
        value, slope = n.at(terms, place), n.at(slopes, place)
        if abs(value) <= NOISE:
            return place
        if (value > 0) is not falls:
            high = place
        else:
            low = place
        new = place - (value << n.bits) // slope if slope else high
        if not low < new < high:
            new = (low + high) // 2
        if abs(new - place) <= 1 or high - low <= 2:
            return new
        place = new
    raise ArithmeticError("a root that Newton's method does not find")

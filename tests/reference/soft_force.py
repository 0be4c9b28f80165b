"""Soft walls with laws of their own beside forces that are no spring: series by hand, in digits as many as one likes.

x'' = f(t, x, v) + A cos(omega t + phase) between two walls that stand still, less the push of a wall beyond it. Within
a wall the series are in s, depth = e^2 and dt = 2 e ds, in which k depth^1.5 is k e^3.
"""

from mpmath import mp, mpf

CELLS = 24  # of a step, at whose ends what is to keep its sign is looked at


def _product(a, b, k):
    return sum((a[j] * b[k - j] for j in range(k + 1)), mpf(0))


def duffing(p, x, v, k, memory):
    square = memory.setdefault("square", [])
    square.append(_product(x, x, k))
    return -x[k] - p["cubic"] * _product(square, x, k) - 2 * p["damping"] * v[k]


def series(force, p, amplitude, frequency, phase, t, x, v):
    """Taylor coefficients of x from t on."""
    place, speed, memory = [mpf(x), mpf(v)], [mpf(v)], {}
    angle = frequency * t + phase
    drive = [amplitude * mp.cos(angle), -amplitude * frequency * mp.sin(angle)]
    for k in range(mp.dps - 1):
        if k > 1:
            drive.append(-(frequency**2) * drive[k - 2] / (k * (k - 1)))
        place.append((force(p, place, speed, k, memory) + drive[k]) / ((k + 1) * (k + 2)))
        speed.append((k + 2) * place[k + 2])
    return place


def linear(q, square, cube, w, k):
    return q["stiffness"] * square[k] + 2 * q["damping"] * w[k]


def hertz(q, square, cube, w, k):
    return q["stiffness"] * cube[k]


def hunt_crossley(q, square, cube, w, k):
    return q["stiffness"] * (cube[k] + q["dissipation"] * _product(cube, w, k))


LAWS = {"linear": linear, "hertz": hertz, "hunt_crossley": hunt_crossley}


def _within(force, p, law, q, drive, wall, sign, t, e, w):
    """(coefficients in s of e, of the rate of the depth, and of the time since) within the wall on a side."""
    amplitude, frequency, phase = drive
    root, rate, time = [mpf(e)], [mpf(w)], [mpf(0)]
    cosine, sine = [mp.cos(frequency * t + phase)], [mp.sin(frequency * t + phase)]
    square, cube, place, speed, pull, memory = [], [], [], [], [], {}
    for k in range(mp.dps):
        square.append(_product(root, root, k))
        cube.append(_product(square, root, k))
        place.append(sign * square[k] + (wall if k == 0 else 0))
        speed.append(sign * rate[k])
        if k:
            turn = [frequency * j * time[j] / k for j in range(k + 1)]
            cosine.append(-_product(turn, [*sine, mpf(0)], k))
            sine.append(_product(turn, cosine, k))
        pull.append(sign * (force(p, place, speed, k, memory) + amplitude * cosine[k]) - law(q, square, cube, rate, k))
        root.append(rate[k] / (k + 1))
        rate.append(2 * _product(root, pull, k) / (k + 1))
        time.append(2 * root[k] / (k + 1))
    return root, rate, time


def _value(terms, at):
    return mp.polyval(terms[::-1], at)


def _slope(terms):
    return [k * term for k, term in enumerate(terms)][1:]


def _root(terms, low, high):
    """The root between two places where a polynomial has two signs."""
    first, slope = _value(terms, low), _slope(terms)
    for _ in range(12):
        middle = (low + high) / 2
        if (_value(terms, middle) > 0) == (first > 0):
            low = middle
        else:
            high = middle
    at = (low + high) / 2
    for _ in range(8):
        at -= _value(terms, at) / _value(slope, at)
    return at


def _radius(lists, sizes):
    step = mpf(1) / 2
    for terms, size in zip(lists, sizes, strict=True):
        for k in (len(terms) - 2, len(terms) - 1):
            if terms[k]:
                step = min(step, (mpf(10) ** (2 - mp.dps) * size / abs(terms[k])) ** (mpf(1) / k))
    return step


def _first(terms, step, start):
    """(where a polynomial that is positive first comes to zero, None; its least value where it turns back)."""
    least, slope = mp.inf, _slope(terms)
    before = start
    for cell in range(CELLS):
        after = step * (cell + 1) / CELLS
        if _value(terms, after) <= 0:
            return _root(terms, before, after), least
        if _value(slope, before) < 0 < _value(slope, after):
            turn = _root(slope, before, after)
            low = _value(terms, turn)
            if low <= 0:
                return _root(terms, before, turn), least
            least = min(least, low)
        before = after
    return None, least


def flown(force, p, law, q, amplitude, frequency, walls, x, v, phase=0):
    """((x, v) after a period of the drive, [(time, side, speed) of the entries], the least speed at a wall, the least
    clearance, or depth, where the motion turns back)."""
    drive = mpf(amplitude), mpf(frequency), mpf(phase)
    p, q = ({name: mpf(value) for name, value in each.items()} for each in (p, q))
    walls = [mpf(wall) for wall in walls]
    t, end, x, v, side, fresh = mpf(0), 2 * mp.pi / drive[1], mpf(x), mpf(v), 0, 0
    hits, slowest, nearest = [], mp.inf, mp.inf
    while t < end:
        terms = series(force, p, *drive, t, x, v)
        step = min(end - t, _radius([terms], [1]))
        found = []
        for sign, wall in zip((-1, 1), walls, strict=True):
            gap = [-sign * term for term in terms]
            gap[0] += sign * wall
            if fresh == sign:  # it has just left this wall, and the root at 0 is divided out
                gap = gap[1:]
            at, least = _first(gap, step, mpf(0))
            nearest = min(nearest, least)
            if at is not None:
                found.append((at, sign))
        fresh = 0
        if not found:
            t, x, v = t + step, _value(terms, step), _value(_slope(terms), step)
            continue
        at, side = min(found)
        t, v, x = t + at, _value(_slope(terms), at), walls[(side + 1) // 2]
        hits.append((t, side, side * v))
        e, w, wall = mpf(0), side * v, x
        slowest = min(slowest, w)
        while side and t < end:
            root, rate, time = _within(force, p, law, q, drive, wall, side, t, e, w)
            step = _radius((root, rate), (max(abs(e), abs(w)),) * 2)
            out, least = _first(root[1:] if e == 0 else root, step, mpf(0))
            if e:
                nearest = min(nearest, least**2)
            span = step if out is None else out
            if t + _value(time, span) >= end:
                late = list(time)
                late[0] -= end - t
                span, out, over = _root(late, mpf(0), span), None, True
            else:
                over = False
            e, w = _value(root, span), _value(rate, span)
            t = end if over else t + _value(time, span)
            x, v = wall + side * e**2, side * w
            if out is not None:
                slowest = min(slowest, -w)
                x, fresh, side = wall, side, 0
    return (x, v), hits, slowest, nearest

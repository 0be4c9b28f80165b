"""Impact oscillators under forces that are no spring: Taylor series by hand, in digits as many as one likes (mpmath).

x'' = f(t, x, v) + A cos(omega t), rigid walls that stand still. Each force's recurrence is written out here.
"""

from mpmath import mp, mpf

CELLS = 24  # of a step, at whose ends the clearance and its slope are looked at


def _product(a, b, k):
    return sum((a[j] * b[k - j] for j in range(k + 1)), mpf(0))


def duffing(p, x, v, k, memory):
    square = memory.setdefault("square", [])
    square.append(_product(x, x, k))
    return -x[k] - p["cubic"] * _product(square, x, k) - 2 * p["damping"] * v[k]


def pendulum(p, x, v, k, memory):
    sine, cosine = memory.setdefault("sine", []), memory.setdefault("cosine", [])
    if k == 0:
        sine.append(mp.sin(x[0]))
        cosine.append(mp.cos(x[0]))
    else:
        sine.append(sum(j * x[j] * cosine[k - j] for j in range(1, k + 1)) / k)
        cosine.append(-sum(j * x[j] * sine[k - j] for j in range(1, k + 1)) / k)
    return -sine[k] - 2 * p["damping"] * v[k]


def stribeck(p, x, v, k, memory):
    """-x - (low + (high - low) exp(-(u / slip)^2)) tanh(u / smooth), u = v - belt."""
    names = ["u", "square", "bell", "tanh", "slope"]
    u, square, bell, tanh, slope = (memory.setdefault(name, []) for name in names)
    u.append(v[k] - (p["belt"] if k == 0 else 0))
    square.append(_product(u, u, k) / p["slip"] ** 2)
    if k == 0:
        bell.append(mp.exp(-square[0]))
        tanh.append(mp.tanh(u[0] / p["smooth"]))
    else:
        bell.append(-sum(j * square[j] * bell[k - j] for j in range(1, k + 1)) / k)
        tanh.append(sum(j * u[j] * slope[k - j] for j in range(1, k + 1)) / (k * p["smooth"]))
    slope.append((1 if k == 0 else 0) - _product(tanh, tanh, k))
    size = [(p["high"] - p["low"]) * each for each in bell]
    size[0] += p["low"]
    return -x[k] - _product(size, tanh, k)


def van_der_pol(p, x, v, k, memory):
    square = memory.setdefault("square", [])
    square.append((1 if k == 0 else 0) - _product(x, x, k))
    return -x[k] + p["gain"] * _product(square, v, k)


def series(force, p, amplitude, frequency, t, x, v):
    """Taylor coefficients of x from t on."""
    place, speed, memory = [mpf(x), mpf(v)], [mpf(v)], {}
    drive = [amplitude * mp.cos(frequency * t), -amplitude * frequency * mp.sin(frequency * t)]
    for k in range(mp.dps - 1):
        if k > 1:
            drive.append(-(frequency**2) * drive[k - 2] / (k * (k - 1)))
        place.append((force(p, place, speed, k, memory) + drive[k]) / ((k + 1) * (k + 2)))
        speed.append((k + 2) * place[k + 2])
    return place


def flown(force, p, amplitude, frequency, walls, restitution, x, v, periods=1):
    """((x, v) after so many periods of the drive, [(time, side, speed) of the impacts], the least speed of these, the
    least clearance at turning points towards a wall)."""
    amplitude, frequency, restitution = mpf(amplitude), mpf(frequency), mpf(restitution)
    p = {name: mpf(value) for name, value in p.items()}
    t, end, x, v = mpf(0), periods * 2 * mp.pi / frequency, mpf(x), mpf(v)
    hits, nearest = [], mp.inf
    while t < end:
        terms = series(force, p, amplitude, frequency, t, x, v)
        step = min(end - t, mpf(1) / 2)
        for k in (mp.dps - 1, mp.dps):
            if terms[k]:
                step = min(step, (mpf(10) ** (2 - mp.dps) / abs(terms[k])) ** (mpf(1) / k))
        found = []
        for side, wall in zip((-1, 1), walls, strict=True):
            if wall is not None:
                hit, clear = _first(terms, step, side, mpf(wall))
                nearest = min(nearest, clear)
                if hit is not None:
                    found.append((hit, side, mpf(wall)))
        late, side, wall = min(found, default=(step, 0, None))
        x, v, t = _value(terms, late), _slope(terms, late), t + late
        if side:
            hits.append((t, side, side * v))
            x, v = wall, -restitution * v
    return (x, v), hits, min((speed for _, _, speed in hits), default=mp.inf), nearest


def _value(terms, late):
    total = mpf(0)
    for term in reversed(terms):
        total = total * late + term
    return total


def _slope(terms, late):
    return _value([k * term for k, term in enumerate(terms)][1:], late)


def _first(terms, step, side, wall):
    """(when the wall is first met, None if it is not; the least clearance at a turning point towards it before)."""
    ahead = [side * term for term in terms]
    ahead[0] -= side * wall
    begins = abs(ahead[0]) < mpf(10) ** (8 - mp.dps)
    if begins and ahead[1] < 0:
        ahead[0] = mpf(0)
    clear, low = mp.inf, mpf(0)
    for cell in range(CELLS):
        high = step * (cell + 1) / CELLS
        slopes = _slope(ahead, low), _slope(ahead, high)
        if slopes[0] > 0 > slopes[1]:
            top = _root(lambda s: _slope(ahead, s), low, high)
            value = _value(ahead, top)
            if value >= 0:
                return _root(lambda s: _value(ahead, s), low, top), clear
            clear = min(clear, -value)
        elif _value(ahead, high) >= 0 and slopes[1] > 0:
            return _root(lambda s: _value(ahead, s), low, high), clear
        low = high
    return None, clear


def _root(function, low, high):
    return mp.findroot(function, (low, high), solver="anderson", tol=mpf(10) ** (6 - 2 * mp.dps), maxsteps=200)


FORCES = {"duffing": duffing, "pendulum": pendulum, "stribeck": stribeck, "van_der_pol": van_der_pol}

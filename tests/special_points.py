"""Special points of branches by the high-precision references, from approximate times and speeds of their impacts."""

import mpmath
import numpy as np
from mpmath import mpf, workdps

from jaxvibro.scene.scene_properties import typical_length
from jaxvibro.scene.state import Contact

from .reference import rests
from .reference import special as reference
from .reference.bends import bend
from .reference.special import exact, span, with_value
from .truths import plain

DIGITS = 50
SLOW = 1e-7  # an impact of less speed is the touch of a grazing orbit
LOOKS = 64  # at the clearance of a flight, or of a period of a longer one


def reference_name(scene, name):
    """Return a parameter as the references name it: there "restitution" is that of both walls."""
    shared = [key for key in ("left", "right") if (wall := getattr(scene, key)) and wall.restitution is None]
    return f"{shared[0]}.restitution" if name == "restitution" and len(shared) == 1 else name


def rows_of(spot, keep=slice(None)):
    """Return the times, speeds and sides of impacts of an orbit, as lists."""
    times, speeds, sides = (np.asarray(part)[keep].tolist() for part in (spot.times, spot.speeds, spot.sides))
    return times, speeds, [int(side) for side in sides]


def impacts_of(spot):
    """Return the times, speeds and sides of the impacts that are no touches."""
    return rows_of(spot, np.asarray(spot.speeds) > SLOW)


def find_touch(scene, spot, wall=None):
    """Return (impact before, time, side) of the touch of a grazing orbit; wall: of several walls that are touched."""
    times, speeds, sides = (np.asarray(part) for part in (spot.times, spot.speeds, spot.sides))
    kept = np.flatnonzero(speeds > SLOW)
    walls = [wall] if wall else ["left", "right"]
    touches = [k for k in np.flatnonzero(speeds <= SLOW) if ("left", "right")[int(sides[k] > 0)] in walls]
    if touches:
        time, side = float(times[touches[0]]), int(sides[touches[0]])
    else:
        time, side = _nearest_approach(exact(scene), impacts_of(spot), spot.periods, walls)
    before = [row for row, k in enumerate(kept) if times[k] < time]
    return (before[-1] if before else max(0, len(kept) - 1)), time, side


def _nearest_approach(scene, impacts, periods, walls):
    """Return (time, side) of the least clearance of an orbit between its impacts, about, by parabolas."""
    times, _, sides = impacts
    begins, nearest = times or [0.0], []
    for k, begin in enumerate(begins):
        end = begins[k + 1] if k + 1 < len(begins) else begins[0] + float(span(scene, periods))
        step = min(end - begin, float(span(scene, 1))) / LOOKS
        looks = np.arange(begin + step, end, step)
        x = np.array([_state(scene, [part[k : k + 1] for part in impacts], time)[0] for time in looks])
        for side, _ in scene.walls():
            if ("left", "right")[side > 0] not in walls:
                continue
            clear = side * (np.array([reference.place(scene, side, time).x for time in looks]) - x).astype(float)
            first = 2 if times and side == sides[k] else 0  # after the impact on this wall the mass is near it
            nearest += [(*low, side) for low in _minima(looks[first:], clear[first:])]
    return min(nearest)[1:]


def _minima(times, values):
    """Return (value, time) of the minima between samples at equal steps of time."""
    before, here, after = values[:-2], values[1:-1], values[2:]
    (at,) = np.nonzero((here <= before) & (here <= after))
    rise, bend = (after - before)[at], (after + before - 2.0 * here)[at]
    lows = here[at] - rise**2 / (8.0 * bend)
    return list(zip(lows.tolist(), (times[1:-1][at] - 0.5 * (times[1] - times[0]) * rise / bend).tolist(), strict=True))


def _state(scene, impact, time):
    """Return the state at a time after an impact ([time], [speed], [side]), or without one."""
    if not impact[0]:
        return reference.forced(scene, time)
    (begin,), (speed,), (side,) = impact
    wall = reference.place(scene, side, begin)
    v = wall.v - side * reference.restitution(scene, side) * speed
    return reference.fly(scene, begin, wall.x, v, time)


def exact_value(scene, kind, name, value, spot, moves=(), wall=None, digits=40):
    """Return the value of a parameter at a special point by the reference.

    spot: the orbit, about. moves: (name, change) of numbers of the scene. wall: the one that a GR touches.
    """
    given = plain(scene)
    with workdps(digits):
        for other, change in moves:
            other = reference_name(scene, other)
            given = with_value(given, other, mpf(_number(given, other)) + change)
        touch = find_touch(plain(scene), spot, wall) if kind == "GR" else None
        rows = impacts_of(spot) if kind == "GR" else rows_of(spot)
        return reference.special(given, reference_name(scene, name), kind, value, *rows, spot.periods, touch, digits)


def _number(scene, name):
    """Return a number of a reference's scene; "restitution" is that of both walls."""
    if name == "restitution":
        return next(wall.restitution for _, wall in scene.walls())
    for part in name.split("."):
        scene = getattr(scene, reference.FIELDS.get(part, part))
    return scene


def reference_error(point):
    """Return how far the value of an SN, SB, BP, PD or GR is from the reference's."""
    return abs(float(exact_value(point.scene, point.kind, point.name, point.value, point.spot) - point.value))


def reference_bend(point):
    """Return the coefficient b of the normal form of an SN, PD or SB in many digits."""
    given = plain(point.scene), reference_name(point.scene, point.name), point.kind, point.value
    return float(bend(*given, *rows_of(point.spot), point.spot.periods, typical_length(point.scene)))


def grazing_reference(point, is_half_orbit):
    """Return (time, acceleration, matrix) of the touch of a grazing in 60 digits, from impacts polished there."""
    impacts, given = impacts_of(point.spot), plain(point.scene)
    name = reference_name(point.scene, point.name)
    row, guess, side = find_touch(given, point.spot)
    with workdps(60):
        scene, (times, speeds, sides) = exact(given), impacts
        whole = span(scene, point.spot.periods)
        if times:
            hits = reference.orbit(given, name, point.value, *impacts, point.spot.periods, 30)
            times, speeds = (list(part) for part in zip(*hits, strict=True))
            guess = times[row] + (mpf(guess) - times[row]) % whole
        before = [part[row : row + 1] for part in (times, speeds, sides)]
        start = mpmath.findroot(lambda t: _state(scene, before, t)[1] - reference.place(scene, side, t).v, mpf(guess))
        listed = sorted((start + (t - start) % whole, u, s) for t, u, s in zip(times, speeds, sides, strict=True))
        end = start + (whole / 2 if is_half_orbit else whole)
        matrix, last = mpmath.eye(2), start
        for t, u, impact_side in listed:
            if t < end:
                flight = reference.free(scene.gamma, t - last)
                matrix, last = reference.rebound(scene, impact_side, t, u) / u * flight * matrix, t
        matrix = reference.free(scene.gamma, end - last) * matrix
        acceleration = -float(rests.press_alone(scene, side, start))
        return float(start), acceleration, np.array((-matrix if is_half_orbit else matrix).tolist(), float)


def _releases(spot):
    """Return the indices of the rows at which a wall lets go."""
    return np.flatnonzero(abs(spot.sides) >= Contact.STUCK)


def completion_value(point):
    """Return the amplitude next to a CH at which the bounces after a release just end in sticking, by bisection."""
    base, values = exact(plain(point.scene)), []
    for begin in _releases(point.spot):
        with workdps(80):  # with 50 some bounces next to the CH are decided otherwise
            for reach in (1e-10, 1e-7):
                low, high = (mpf(point.value) + sign * reach for sign in (-1, 1))
                first = _end_in_sticking(base, point.spot, begin, low)
                if first != _end_in_sticking(base, point.spot, begin, high):
                    break
            else:
                continue
            while high - low > 1e-13:
                middle = (low + high) / 2
                is_low = _end_in_sticking(base, point.spot, begin, middle) == first
                low, high = (middle, high) if is_low else (low, middle)
            values.append(float(low))
    return min(values, key=lambda value: abs(value - point.value), default=np.inf)


def _end_in_sticking(base, spot, begin, value):
    """Return whether the bounces after a release end in sticking before the next one."""
    scene = with_value(base, "amplitude", value)
    side, count, releases = int(np.sign(spot.sides[begin])), len(spot.times), _releases(spot)
    now = rests.release(scene, side, mpf(spot.times[begin]))
    after = next((begin + k) % count for k in range(1, count + 1) if (begin + k) % count in releases)
    own, late = int(np.sign(spot.sides[after])), spot.times[after]
    late += 0 if late > spot.times[begin] else float(span(scene, spot.periods))
    end = rests.release(scene, own, mpf(late))
    try:
        _, began, last = rests.from_release(scene, side, now, end)
    except ArithmeticError:
        return False
    return began is not None and last == own and began < end


def zero_force_value(point):
    """Return the amplitude next to a CH or RL at which an impact with R = 0 meets no force, None without one."""
    spot, base = point.spot, exact(plain(point.scene))
    length = float(span(base, spot.periods))
    walls = {-1: base.left, 1: base.right}
    hits = [k for k in range(len(spot.times)) if abs(spot.sides[k]) == 1 and not walls[int(spot.sides[k])].restitution]
    with workdps(DIGITS):
        forces = [(abs(float(rests.press_alone(base, int(spot.sides[k]), mpf(spot.times[k])))), k) for k in hits]
        if not forces or min(forces)[0] > 1e-9:
            return None
        row = min(forces)[1]
        releases = _releases(spot).tolist() or [row]
        begin = min(releases, key=lambda k: (spot.times[row] - spot.times[k]) % length or length)
        late = (spot.times[row] - spot.times[begin]) % length or length

        def force(value):
            scene = with_value(base, "amplitude", value)
            side = int(np.sign(spot.sides[begin]))
            now, speed = rests.release(scene, side, mpf(spot.times[begin])), mpf(0)
            end = now + late
            while now <= end - 1e-6:
                hit = rests.next_hit(scene, side, now, speed)
                side, now, speed = hit.side, hit.time, rests.restitution(scene, hit.side) * hit.speed
            return rests.press_alone(scene, side, now)

        one, two = (mpf(point.value) + sign * mpf(10) ** -9 for sign in (-1, 1))
        low, high = force(one), force(two)
        return float(one - low * (two - one) / (high - low))

"""Orbits that stick, and places on their branches, by bounces of 50 digits."""

from types import SimpleNamespace

import numpy as np
from mpmath import mpf, workdps

import jaxvibro as jv
from jaxvibro.branches.follow import polish_orbit
from jaxvibro.problem.orbit_equations import are_releases, sides_with_release_codes

from .reference import rests
from .reference.special import exact, span, with_value
from .truths import plain

DIGITS = 50


def scene_of(rng):
    """A random scene: two walls or one, R per wall, perhaps a moving right wall."""
    gamma, omega, amplitude = rng.uniform((0.02, 0.5, 0.3), (0.3, 3.2, 6.0))
    if rng.random() < 0.15:
        gamma = rng.uniform(0.3, 1.4)
    left, right = -rng.uniform(0.3, 1.5), rng.uniform(-0.1, 1.5)
    own = None if rng.random() < 0.5 else rng.uniform(0.3, 0.95)
    kind = rng.integers(4)
    motion = jv.Motion(rng.uniform(0.05, 0.25), rng.uniform(0, 6.28)) if kind == 2 else None
    walls = (None if kind == 3 else jv.Wall(left, own), jv.Wall(right, motion=motion))
    if kind == 0:
        walls = (jv.Wall(-1.0), jv.Wall(1.0))
    return jv.make_scene(amplitude, omega, gamma, rng.uniform(0.5, 0.9), walls)


def resting(rng):
    """(scene, orbit) that a random scene settles on, and that rests."""
    while True:
        scene = scene_of(rng)
        scene = scene.replace(frequency=rng.uniform(0.25, 1.0), restitution=rng.uniform(0.05, 0.85))
        try:
            orbit = jv.find_orbit(scene, jv.State(float(scene.right.position) - 0.1, 0.0))
        except (jv.OrbitError, jv.ArgumentError):
            continue
        if orbit.rests and orbit.periods <= 4:
            yield scene, orbit


def errors(scene, orbit):
    """(largest error of a time, of a speed; impacts and releases compared), from release to release."""
    along, z = polish_orbit(orbit, "amplitude")
    rows, count = len(along.sequence.sides), int(np.sum(along.sequence.sides != 0))
    sides = sides_with_release_codes(along.sequence)[:count]
    spot = SimpleNamespace(times=z[:count], speeds=z[rows : rows + count], sides=sides)
    given, length = exact(plain(scene)), 2.0 * np.pi / float(scene.frequency) * orbit.periods
    frees = np.flatnonzero(are_releases(spot.sides))
    worst, count = np.zeros(2), 0
    for begin in frees:
        with workdps(DIGITS):
            side = int(np.sign(spot.sides[begin]))
            now = rests.release(given, side, mpf(spot.times[begin]))
            worst[0] = max(worst[0], abs(float(now - mpf(spot.times[begin]))))
            hits, _, own = rests.from_release(given, side, now)
            k = begin
            for hit in hits:
                k = (k + 1) % len(spot.times)
                if are_releases(spot.sides[k]):
                    assert own == np.sign(spot.sides[k])
                    break
                late = float((hit.time - mpf(spot.times[k])) % mpf(length))
                worst = np.maximum(worst, [min(late, length - late), abs(float(hit.speed - mpf(spot.speeds[k])))])
                assert hit.side == spot.sides[k]
                count += 1
    return np.array([*worst, count, len(frees)])


def met(point):
    """(the amplitude near a CH or RL at which an impact without speed after it meets no press, None: there is none; the
    point)."""
    spot, base = point.spot, exact(plain(point.scene))
    count, length = len(spot.times), float(span(base, spot.periods))
    hits = [k for k in range(count) if abs(spot.sides[k]) == 1]
    takes = [k for k in hits if not point.scene.bounce(("left", "right")[int(spot.sides[k] > 0)])]
    with workdps(DIGITS):
        pushes = [(abs(float(rests.press_alone(base, int(spot.sides[k]), mpf(spot.times[k])))), k) for k in takes]
        if not pushes or min(pushes)[0] > 1e-9:
            return None, point
        row = min(pushes)[1]
        frees = [k for k in range(count) if are_releases(spot.sides[k])] or [row]
        begin = min(frees, key=lambda k: (spot.times[row] - spot.times[k]) % length or length)
        late = (spot.times[row] - spot.times[begin]) % length or length

        def press(value):
            given = with_value(base, "amplitude", value)
            side = int(np.sign(spot.sides[begin]))
            now, speed = rests.release(given, side, mpf(spot.times[begin])), mpf(0)
            end = now + late
            while True:
                hit = rests.next_hit(given, side, now, speed)
                side, now, speed = hit.side, hit.time, rests.restitution(given, hit.side) * hit.speed
                if now > end - 1e-6:
                    return rests.press_alone(given, side, now)

        one, two = mpf(point.value) - mpf(10) ** -9, mpf(point.value) + mpf(10) ** -9
        low, high = press(one), press(two)
        return float(one - low * (two - one) / (high - low)), point


def halved(point):
    """The amplitude at which hops just end in rest, by halving."""
    spot = point.spot
    frees = np.flatnonzero(are_releases(spot.sides))
    base = exact(plain(point.scene))
    found = []
    for begin in frees:
        with workdps(80):  # with 50 some hops next to the CH are decided otherwise
            for reach in (1e-10, 1e-7):
                low, high = (mpf(point.value) + sign * reach for sign in (-1, 1))
                first = _ends(base, spot, begin, low)
                if first != _ends(base, spot, begin, high):
                    break
            else:
                continue
            while high - low > 1e-13:
                middle = (low + high) / 2
                low, high = (middle, high) if _ends(base, spot, begin, middle) == first else (low, middle)
            found.append(float(low))
    return min(found, key=lambda one: abs(one - point.value), default=np.inf)


def _ends(base, spot, begin, value):
    """Whether the hops after a release end in rest before the next one."""
    given = with_value(base, "amplitude", value)
    side, count = int(np.sign(spot.sides[begin])), len(spot.times)
    now = rests.release(given, side, mpf(spot.times[begin]))
    after = next((begin + k) % count for k in range(1, count + 1) if are_releases(spot.sides[(begin + k) % count]))
    own, late = int(np.sign(spot.sides[after])), spot.times[after]
    late += 0 if late > spot.times[begin] else float(span(given, spot.periods))
    end = rests.release(given, own, mpf(late))
    try:
        _, began, last = rests.from_release(given, side, now, end)
    except ArithmeticError:
        return False
    return began is not None and last == own and began < end

"""Special points of branches by the high-precision references, from approximate times and speeds of their impacts."""

import mpmath
import numpy as np
from mpmath import mpf, workdps

from jaxvibro.problem.grazing_contact import find_grazing_contacts
from jaxvibro.problem.orbit_point import set_up_equations
from jaxvibro.scene.codes import Contact
from jaxvibro.scene.typical_scales import typical_length
from tests.reference import rests
from tests.reference import special as reference
from tests.reference.bends import bend
from tests.reference.special import exact, span, with_value
from tests.truths import plain

DIGITS = 50


def reference_name(point):
    """Return the parameter as the references name it: there "restitution" is that of both walls."""
    shared = [key for key in ("left", "right") if (wall := getattr(point.scene, key)) and wall.restitution is None]
    return f"{shared[0]}.restitution" if point.name == "restitution" and len(shared) == 1 else point.name


def impacts_of(point):
    """Return the times, speeds and sides of the impacts of a point as lists of numbers."""
    return point.spot.times.tolist(), point.spot.speeds.tolist(), [int(side) for side in point.spot.sides]


def reference_error(point):
    """Return how far the value of an SN, SB, BP, PD or GR is from the reference's."""
    contact = None
    if point.kind == "GR":
        problem, z = set_up_equations(point.scene, point.name, point.spot)
        contacts = find_grazing_contacts(problem, z, typical_length(point.scene))
        if not any(entry.is_impact for entry in contacts):
            first = contacts[0]
            begin = point.spot.times[first.row] if len(point.spot.times) else 0.0
            contact = first.row, begin + first.time_since_impact, first.side
    given = plain(point.scene), reference_name(point), point.kind, point.value
    expected = reference.special(*given, *impacts_of(point), point.spot.periods, contact)
    return abs(float(expected - point.value))


def reference_bend(point):
    """Return the coefficient b of the normal form of an SN, PD or SB in many digits."""
    given = plain(point.scene), reference_name(point), point.kind, point.value
    return float(bend(*given, *impacts_of(point), point.spot.periods, typical_length(point.scene)))


def return_matrix(point, contact_time, is_half_orbit):
    """Return the matrix M of a grazing by flights and rebounds in 60 digits, from impacts polished there."""
    keep = [speed > 1e-7 for speed in point.spot.speeds]
    times, speeds, sides = (
        [number for number, kept in zip(row, keep, strict=True) if kept] for row in impacts_of(point)
    )
    with workdps(60):
        scene = exact(plain(point.scene))
        given = plain(point.scene), reference_name(point), point.value, times, speeds, sides, point.spot.periods, 30
        hits = reference.orbit(*given) if times else []
        whole, start = span(scene, point.spot.periods), mpf(contact_time)
        listed = sorted((start + (t - start) % whole, u, side) for (t, u), side in zip(hits, sides, strict=True))
        end = start + (whole / 2 if is_half_orbit else whole)
        matrix, last = mpmath.eye(2), start
        for t, u, side in listed:
            if t < end:
                matrix = reference.rebound(scene, side, t, u) / u * reference.free(scene.gamma, t - last) * matrix
                last = t
        matrix = reference.free(scene.gamma, end - last) * matrix
        return np.array((-matrix if is_half_orbit else matrix).tolist(), float)


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

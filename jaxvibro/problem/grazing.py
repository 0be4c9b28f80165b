"""What goes on from a grazing: the orbits of each itinerary that its touches give, and which of them are real.

At a grazing the orbit is one of each itinerary that has the touches as impacts without speed, or leaves them out. On
each of these branches it is a regular point; those along which speeds and clearances become positive meet there.
"""

from functools import singledispatch
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from continuation import event_search, locate
from continuation.arclength import Control, Point
from continuation.points import start_point

from .diagnostics import Diagnostics, diagnose
from .equations import OrbitEquations, are_releases, codes, problem
from .same_orbit import turns
from .touches import admissible, bearing, scales, span, stays, touches, wall_sides

ASIDE = 1e-5, 1e-7  # steps, in scaled lengths, after which a branch that leaves a grazing is looked at
SURE, LOOSE = 1e-12, 1e-10  # Newton's tolerance there, with impacts added and with none: slow ones leave rounding
FLAT = 1e-6  # of a speed's or a distance's rate along a branch: as small is none
ROUNDS = 12  # of Newton's steps to an orbit without impacts
SINGULAR = 1e-7  # of the largest singular value: one as small is a direction that is not solved for
FEW = 4  # touches at once, of which every choice is tried


class GrazingExit(NamedTuple):
    """A branch that leaves a grazing admissibly. along: its orbits; point: the grazing itself, its tangent leading
    away; near, look: z a little on, and its `Diagnostics`; included: which of the touches are its impacts."""

    along: OrbitEquations
    point: Point
    near: Float[np.ndarray, " unknowns"]
    look: Diagnostics
    included: tuple[bool, ...]


def each_choice(along, z, met, length):
    """What `leave` finds in both directions along the orbits of each itinerary that the touches give."""
    for included in _distinct(along, z, met):
        new, start, out = with_touches(along, z, met, included)
        tangent = event_search.tangent(problem(new), start, scales(new, length), new)
        rates = opened(new, start, tangent, out)
        for sign in (1.0, -1.0):
            yield leave(new, start, sign * tangent, sign * rates, length, included)


def exits(along, z, length, ways=each_choice):
    """(the `Touch`es at a grazing; the `GrazingExit`s that leave it, of the branch that came there itself too; whether
    each way that opens is one of them: Newton's method may not converge there). ways: as `each_choice`."""
    met = touches(along, z, length)
    found = list(ways(along, z, met, length))
    return met, [way for way, _ in found if way], all(sure for _, sure in found)


def with_touches(along, z, met, included):
    """The orbit with some of the touches as impacts: (its `OrbitEquations`, its z, the others as `left_out` gives
    them)."""
    every = listed(along, z, met, included)
    kept = [one for one in every if one.kept]
    new, start = with_impacts(along, z, kept)
    return new, start, left_out(new, start, every, kept)


def with_impacts(along, z, hits, rows=()):
    """(the `OrbitEquations` of orbits with these impacts, z of the one that is there); rows: that these were in."""
    new = recut(along, padded(along, [(one.time, one.speed, one.side) for one in hits]), rows)
    if not hits:
        return new, free_start(new, z[-1], _begun(along, z))
    return new, np.concatenate([new.cycle.times, new.cycle.speeds, z[2 * len(along.cycle.sides) or 2 :]])


@singledispatch
def recut(along, cycle, rows):
    """What is followed, with a cycle of some rows' impacts alone."""
    return along._replace(cycle=cycle)


def _distinct(along, z, met):
    """The choices of touches to be impacts: of those that are one orbit, counted from another period, the branch's own
    or the first."""
    own, kept = tuple(one.own for one in met), []
    if not met:  # as of passes that differ by less than samples tell: none is known to be the touch
        return [own]
    times = np.array([one.late + (z[one.row] if len(along.cycle.sides) else 0.0) for one in met])
    places = turns(along, z, times, np.array([one.side for one in met]))
    for included in _choices(met):
        alike = [tuple(included[k] for k in row) for row in places]
        if (included == own or own not in alike) and not any(one in kept for one in alike):
            kept.append(included)
    return kept


def _choices(met):
    """Which touches are to be impacts: every choice of a few; of many all, none, those that are and the others."""
    if len(met) <= FEW:
        return list(product((False, True), repeat=len(met)))
    own = tuple(one.own for one in met)
    return list(dict.fromkeys([own, tuple(not one for one in own), (False,) * len(met), (True,) * len(met)]))


class Hit(NamedTuple):
    time: float
    speed: float
    side: int
    kept: bool


def listed(along, z, met, included):
    """All impacts and touches in order of travel, those kept that are no touches or are to be impacts."""
    rows, wanted = len(along.cycle.sides), dict(zip(met, included, strict=True))
    own = {touch.row: touch for touch in met if touch.own}
    found = []
    sides = codes(along.cycle)
    for row in np.flatnonzero(sides):
        touch, side = own.get(int(row)), int(sides[row])
        one = Hit(z[row], 0.0 if touch else z[rows + row], side, wanted[touch] if touch else True)
        found.append(((int(row), 0.0), one))
    for touch in met:
        if not touch.own:
            begin = z[touch.row] if rows else 0.0
            found.append(((touch.row, touch.late), Hit(begin + touch.late, 0.0, touch.side, wanted[touch])))
    return [one for _, one in sorted(found)]


def left_out(along, z, every, kept):
    """(row, wall, time since the flight after that row's impact began) of each touch that is none of those kept.

    along, z: of the orbit that has the impacts kept, in rows in this order.
    """
    walls, found, held = wall_sides(along.scene), [], stays(along, z)
    whole = span(along, z)
    place = len(kept) - 1  # what is before the first is after the last
    for one in every:
        if one.kept:
            place = kept.index(one)
        else:
            begin, row = kept[place].time if kept else 0.0, max(place, 0)
            found.append((row, walls.index(one.side), (one.time - begin) % whole - float(held[row])))
    return found


def padded(along, impacts):
    """A cycle with these impacts, (time, speed, side) each, in rows of a power of two; none without impacts. A side is
    +-2 where it is no impact but a release, +-3 where the mass lifts before that rest (`Cycle.releases`)."""
    rows = 0 if not impacts else max(2, 1 << (len(impacts) - 1).bit_length())
    columns = np.zeros((3, rows))
    for k, one in enumerate(impacts):
        columns[:, k] = one
    times, speeds, sides = columns
    released = np.where(are_releases(sides), abs(sides) - 1.0, 0.0)
    marks = released if released.any() else None
    return along.cycle._replace(times=times, speeds=speeds, sides=np.sign(sides), releases=marks)


def _begun(along, z):
    """(x, v) at the section of an orbit that a force of the user's own drives; of another it does not matter."""
    if along.scene.force is None or not len(along.cycle.sides):
        return z[:2]
    look = diagnose(along, z[None])
    return look.x[0, 0], look.v[0, 0]


def free_start(along, value, near):
    """z of the orbit without impacts: the only one under spring and damper, else that near some (x, v)."""
    of_force = along.scene.force is not None
    start = np.array([*(near if of_force and np.isfinite(near).all() else (0.0, 0.0)), value])
    for _ in range(ROUNDS if of_force else 1):
        rest, slopes = (np.asarray(each) for each in locate.evaluated(problem(along), start, along))
        matrix = slopes[
            :, :2
        ]  # at a fold or a branch point, which a force may have, no step leads along its null vector
        step = np.linalg.lstsq(matrix, rest, SINGULAR)[0] if of_force else np.linalg.solve(matrix, rest)
        start[:2] -= step
        if abs(step).max() <= locate.SMALL * (1.0 + abs(start).max()):
            break
    return start


def opening(along, z, direction, row, wall, late):
    """How fast the distance of a flight at a time grows in a direction of z."""
    ends = (bearing(along, row, wall, np.append(z + sign * locate.APART * direction, late))[0] for sign in (1, -1))
    return float(np.subtract(*ends) / (2.0 * locate.APART))


def opened(along, z, tangent, out):
    """How fast the speeds that are zero, and the distances of the touches left out, grow along a tangent."""
    rows = len(along.cycle.sides)
    slow = [tangent[rows + k] for k in along.hits if z[rows + k] == 0.0]
    return np.array(slow + [opening(along, z, tangent, *each) for each in out])


def leave(along, z, tangent, rates, length, included):
    """(the `GrazingExit` along a tangent of a branch, None where it is none; whether that is sure). rates: as `opened`
    gives them."""
    if (rates < -FLAT).any():
        return None, True
    way, met = stepped(along, z, tangent, length, included, SURE if any(included) else LOOSE, ASIDE)
    return way, met or rates.min(initial=0.0) <= 0


def stepped(along, z, tangent, length, included, tolerance, asides):
    """(the `GrazingExit` along a tangent, None where none of these steps aside comes to an admissible orbit; whether
    one of them comes to an orbit)."""
    point = start_point(z, tangent)
    numbers = (np.float64(each) for each in (0.0, 1.0, tolerance, -np.inf, np.inf))
    control, met = Control(scales(along, length), *numbers), False
    for aside in asides:
        near = event_search.step(problem(along), point, aside, control, along)
        met |= bool(near.met)
        look = diagnose(along, near.z[None])
        if near.met and admissible(along, near.z, look)[0]:
            return GrazingExit(along, point, near.z, look, included), True
    return None, met

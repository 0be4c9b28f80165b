"""Grazing of soft walls, where the orbits with a contact and those without it are one branch, its tangent continuous.

So it is where the force is continuous at the touch: at a wall that stands still whatever its damping, as the damping's
jump goes with the velocity; at one that moves only if its damping is the scene's. Else a grazing is as that of a rigid
wall, and left to `touches`.

A contact of speed u is u^2 / 2 a deep, a being the acceleration away from the wall: with u and with -u the equations of
the impacts have the same orbit to first order, so that a grazing is a singular point of theirs. It is found, and left,
by way of the orbit that leaves the contact out, of which it is a regular point.
"""

from typing import NamedTuple

import numpy as np

from continuation import event_search
from continuation.locate import Located

from . import grazing, touches
from .equations import codes, problem
from .grazing import FLAT, LOOSE, with_impacts, with_touches
from .touches import scales, touched, wall_sides

NEAR = 1e-4  # of the scene's length per t: as slow a contact is about to be none
ASIDE = 1e-3, 1e-4  # as in `touches`; nearer to the singular point Newton's steps are rounding
WHOLE = 1e-9  # of the scene's length: as near is a touch of another wall at the same point


def is_smooth(scene, side):
    """Whether the wall on a side is soft, and a mass that moves along with it feels no jump of force on entering."""
    wall = scene.left if side < 0 else scene.right
    return wall is not None and wall.soft and (wall.motion is None or wall.damping is None)


def is_singular(along, touches):
    """Whether at some `Touch`es a contact with a soft wall has no speed: the equations are singular there."""
    return any(touch.own and is_smooth(along.scene, touch.side) for touch in touches)


def slow(along, z, length):
    """Rows of contacts with soft walls that are about to lose their speed."""
    size, sides = len(along.cycle.sides), along.cycle.sides
    return [int(k) for k in along.hits if z[size + k] < NEAR * length and is_smooth(along.scene, sides[k])]


def lost(along, zs):
    """Which points, (points,), have a contact with a soft wall of a speed below zero that is above at the point
    before."""
    size, sides, found = len(along.cycle.sides), along.cycle.sides, np.zeros(len(zs), bool)
    for k in along.hits:
        if is_smooth(along.scene, sides[k]):
            found[1:] |= (zs[:-1, size + k] > 0) & (zs[1:, size + k] < 0)
    return found


def located(along, z, rows, length):
    """The grazing near z at which contacts with soft walls, in these rows, lose their speed: a `locate.Located`."""
    size, sides = len(along.cycle.sides), along.cycle.sides
    keep = [k for k in np.flatnonzero(sides != 0) if k not in rows]
    hits = [grazing.Hit(z[k], z[size + k], codes(along.cycle)[k], True) for k in keep]
    new, start = with_impacts(along, z, hits, keep)
    places = [_place(along, z, row, keep) for row in rows]
    found = touched(new, start, *places[0])
    if found.z is None:
        return found
    new_size, count = len(new.cycle.sides), len(z) - 2 * size
    met = np.array(z)
    met[-count:] = found.z[-count:]
    whole = touches.span(along, met)
    for place, k in enumerate(keep):
        met[k], met[size + k] = found.z[place], found.z[new_size + place]
    for row, (before, wall, late) in zip(rows, places, strict=True):
        late, distance, _ = touches.settled_near(new, found.z, before, wall, late)
        if not abs(distance) <= WHOLE * length:
            return Located(None, found.residual)
        met[row] = (found.z[before] + touches.stays(new, found.z)[before] if keep else 0.0) + late
        met[row] -= whole * np.round((met[row] - z[row]) / whole)
        met[size + row] = 0.0
    return found._replace(z=met)


def _place(along, z, row, keep):
    """(row before, counted among those kept, wall, time since the flight after that began) of a row that is left out;
    keep: the rows that are kept."""
    wall = wall_sides(along.scene).index(int(along.cycle.sides[row]))
    whole = touches.span(along, z)
    if not keep:
        return 0, wall, float(np.mod(z[row], whole))
    late = np.mod(z[row] - z[keep], whole)
    before = int(np.argmin(late))
    return before, wall, float(late[before] - touches.stays(along, z)[keep[before]])


def exits(along, z, length):
    """As `grazing.exits`, also where the walls touched are soft."""
    return grazing.exits(along, z, length, _ways)


def _ways(along, z, met, length):
    """As `grazing.each_choice`; where all is smooth, both directions of the orbit that leaves the touches out."""
    if not met or not all(is_smooth(along.scene, one.side) for one in met):
        yield from grazing.each_choice(along, z, met, length)
        return
    none = (False,) * len(met)
    bare, start, out = with_touches(along, z, met, none)
    tangent = event_search.tangent(problem(bare), start, scales(bare, length), bare)
    order = sorted(range(len(met)), key=lambda k: (met[k].row, 0.0 if met[k].own else met[k].late))
    opening, pull = np.zeros(len(met)), np.zeros(len(met))
    for k, one in zip(order, out, strict=True):
        opening[k] = grazing.opening(bare, start, tangent, *one)
        pull[k] = -touches.settled_near(bare, start, *one)[2]
    for sign in (1.0, -1.0):
        if (sign * opening > -FLAT).all():
            rates = sign * grazing.opened(bare, start, tangent, out)
            yield grazing.leave(bare, start, sign * tangent, rates, length, none)
        else:
            falls = {k: Fall(-sign * opening[k], pull[k]) for k in order if sign * opening[k] <= -FLAT}
            yield _entering(along, z, met, falls, sign * tangent, length)


class Fall(NamedTuple):
    """How a flight comes to touch a wall along a branch: how fast it comes nearer, its acceleration away from it."""

    rate: float
    pull: float


def _entering(along, z, met, falls, ahead, length):
    """(the `GrazingExit` along which walls that come nearer are entered, None where it is none; whether that is sure).

    falls: the `Fall` of each touch that is entered, by its place, in order of travel; ahead: the tangent of the orbits
    that leave the touches out. The exit's point lies a little on, as the grazing's tangent says nothing of its bend.
    """
    if any(fall.pull <= 0 for fall in falls.values()):
        return None, True
    included = tuple(k in falls for k in range(len(met)))
    new, start, _ = with_touches(along, z, met, included)
    for aside in ASIDE:
        guess, tangent = _aside(new, start, list(falls.values()), ahead, aside * length)
        way, _ = grazing.stepped(new, guess, tangent, length, included, LOOSE, (0.0,))
        if way:
            tangent = event_search.tangent(problem(new), way.near, scales(new, length), new, tangent)
            return way._replace(point=way.point._replace(z=way.near, tangent=tangent)), True
    return None, False


def _aside(new, start, falls, ahead, most):
    """(z where the fastest of the contacts that begin has a speed, the unit direction there from the grazing).

    A length s along `ahead`, a contact has the speed sqrt(2 pull rate s), and the rest is as without it to that order.
    Newton's method comes to the orbit from there, but not from the grazing.
    """
    size, free = len(new.cycle.sides), (len(ahead) - 1) // 2
    length = most**2 / max(2.0 * fall.pull * fall.rate for fall in falls)
    moved, tangent, falls, place = np.zeros(len(start)), np.zeros(len(start)), iter(falls), 0
    moved[-1] = ahead[-1]
    for k in new.hits:
        if start[size + k] == 0.0:
            fall = next(falls)
            speed = np.sqrt(2.0 * fall.pull * fall.rate * length)
            tangent[k], tangent[size + k] = -speed / fall.pull, speed
        else:
            moved[k], moved[size + k] = ahead[place], ahead[free + place]
            place += 1
    return start + length * moved + tangent, tangent / np.linalg.norm(scales(new, length) * tangent)

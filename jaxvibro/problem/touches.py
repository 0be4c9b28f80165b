"""Grazing: where a branch's impact loses its speed or a flight comes to touch a wall, and what goes on from there.

At such a point the orbit is one of each itinerary that has the touches as impacts without speed, or leaves them out. On
each of these branches it is a regular point; those along which speeds and clearances become positive meet there.
"""

from functools import partial, singledispatch
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from continuation import event_search, locate
from continuation.arclength import Control, Point
from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import one_kernel
from ..flight.coefficients import frame
from ..orbits import flight_clearance, impact_equations
from .diagnostics import Diagnostics, diagnose, flight
from .equations import OrbitEquations, cycle_at, problem, there
from .same_orbit import turns

TOUCH = 1e-8  # of the scene's length: a clearance or a speed (length per t) as small is zero
ASIDE = 1e-5, 1e-7  # steps, in scaled lengths, after which a branch that leaves a grazing is looked at
SURE, LOOSE = 1e-12, 1e-10  # Newton's tolerance there, with impacts added and with none: slow ones leave rounding
FLAT = 1e-6  # of a speed's or a distance's rate along a branch: as small is none
ENDS = 1e-5  # of a flight: a touch as near to its ends is that of the impact there
ROUNDS = 6  # of Newton's steps to a turning point
FEW = 4  # touches at once, of which every choice is tried


class Touch(NamedTuple):
    """A touch of a wall. row: of the impact at it, or of that before it; side; late: its time since that impact's;
    own: whether the branch has it as an impact."""

    row: int
    side: int
    late: float
    own: bool


class GrazingExit(NamedTuple):
    """A branch that leaves a grazing admissibly. along: its orbits; point: the grazing itself, its tangent leading
    away; near, look: z a little on, and its `Diagnostics`; included: which of the touches are its impacts."""

    along: OrbitEquations
    point: Point
    near: np.ndarray
    look: Diagnostics
    included: tuple[bool, ...]


def scales(along, length):
    """The weights of z: times as they are and speeds over the scene's length, their mean square over the impacts;
    parameters over the length where they are one."""
    rows = len(along.cycle.sides)
    share = 1.0 / max(1.0, np.sqrt(np.sum(along.cycle.sides != 0)))
    hit = np.asarray(along.cycle.sides != 0, float) * share
    own = np.concatenate([hit, hit / length]) if rows else np.ones(2) / length
    count = max(int(mark) for mark in jax.tree.leaves(along.which))
    return np.append(own, [1.0 / _parameter_scale(along.which, k, length) for k in range(1, count + 1)])


def _parameter_scale(marks, k, length):
    """The scene's length where a parameter is a length, else 1."""
    walls = marks.walls.values()
    lengths = [marks.amplitude, *(wall.position for wall in walls)]
    lengths += [wall.motion.amplitude for wall in walls if wall.motion is not None]
    return length if any(mark == k for mark in lengths) else 1.0


@persistent_jit
def _contact(y, along, row, wall):
    return one_kernel(_met, y, along, row, wall)


def _met(y, along, row, wall):
    """(distance, speed, acceleration) towards a wall of the flight after a row; y = (z, the time since its start)."""
    z, late = y[:-1], y[-1]
    if len(along.cycle.sides):
        built = frame(there(along, z))
        found = impact_equations.flights(built, cycle_at(along, z))
    else:
        built, found = flight(along, z)
    every = flight_clearance.relative(built, found, jnp.full_like(found.time, late))
    return jnp.stack([jnp.stack([one[k] for one in every])[wall, row] for k in range(3)])


def _bearing(along, row, wall, y):
    """Distance and speed towards a wall."""
    return np.asarray(_contact(y, along, np.int32(row), np.int32(wall)))[:2]


def touched(along, z, row, wall, late):
    """The point near where the flight after a row touches a wall: `locate.Located` of z."""
    bearing = partial(_bearing, along, row, wall)

    def system(y):
        value, slopes = (np.asarray(each) for each in locate.evaluated(problem(along), y[:-1], along))
        whole = np.vstack([np.pad(slopes, ((0, 0), (0, 1))), locate.differences(bearing, y)])
        return np.concatenate([value, bearing(y)]), whole

    found = locate.newton(system, np.append(z, late))
    return found if found.z is None else found._replace(z=found.z[:-1])


def settled_near(along, z, row, wall, late):
    """(time, distance, acceleration towards the wall) at the turning point of the flight after a row that is near."""
    for _ in range(ROUNDS):
        distance, speed, pull = np.asarray(_contact(np.append(z, late), along, np.int32(row), np.int32(wall)))
        late -= speed / pull
    return late, distance, pull


def touches(along, z, length):
    """The `Touch`es at a point."""
    sides, look = along.cycle.sides, diagnose(along, z[None])
    rows = len(sides)
    hit = np.flatnonzero(sides != 0)
    still = [int(k) for k in hit if abs(z[rows + k]) < TOUCH * length]
    found = [Touch(k, int(sides[k]), 0.0, True) for k in still]
    walls = wall_sides(along.scene)
    spans, held = flight_times(along, z), stays(along, z)
    for row, wall in zip(*np.nonzero(abs(look.clear[0]) < TOUCH * length), strict=True):
        late, side = float(look.late[0, row, wall]), walls[wall]
        following = int(hit[(np.flatnonzero(hit == row)[0] + 1) % len(hit)]) if rows else None
        begins = row in still and sides[row] == side and late < ENDS * spans[row]
        ends = following in still and sides[following] == side and late > (1.0 - ENDS) * spans[row]
        if not (begins or ends):
            found.append(Touch(int(row), side, float(held[row]) + late, False))
    return found


def stilled(along, z, length):
    """z with the speeds that are zero but for rounding put to zero."""
    rows = len(along.cycle.sides)
    found = np.array(z)
    speeds = found[rows : 2 * rows]
    speeds[abs(speeds) < TOUCH * length] = 0.0
    return found


def is_pressed(along, z, there_are):
    """Whether at one of the touches that are impacts the wall is in the way of the mass, which then rests on it."""
    walls = wall_sides(along.scene)
    pulls = [
        float(_contact(np.append(z, 0.0), along, np.int32(one.row), np.int32(walls.index(one.side)))[2])
        for one in there_are
        if one.own
    ]
    return any(pull > 0 for pull in pulls)


def span(along, z):
    """How long the orbit is."""
    return float(along.cycle.periods) * 2.0 * np.pi / float(there(along, z).frequency)


def flight_times(along, z):
    """How long each flight is, (rows,); of an orbit without impacts its periods, (1,)."""
    if not len(along.cycle.sides):
        return np.array([span(along, z)])
    return np.asarray(_times(along, z)[0])


def stays(along, z):
    """How long the mass is within the wall at each impact, before the flight after it begins, (rows,); (1,) of none."""
    rows = len(along.cycle.sides)
    return np.asarray(_times(along, z)[1]) if rows and along.scene.soft_sides else np.zeros(max(1, rows))


@persistent_jit
def _times(along, z):
    found = impact_equations.flights(frame(there(along, z)), cycle_at(along, z))
    return found.time, 0.0 * found.time if found.met.stay is None else found.met.stay


def wall_sides(scene):
    """The sides of the walls that there are."""
    return [side for side, wall in ((-1, scene.left), (1, scene.right)) if wall is not None]


def each_choice(along, z, met, length):
    """What `leave` finds in both directions along the orbits of each itinerary that the touches give."""
    for included in _distinct(along, z, met):
        new, start, out = with_touches(along, z, met, included)
        for sign in (1.0, -1.0):
            yield leave(new, start, out, sign, length, included)


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
        return new, free_start(new, z[-1])
    return new, np.concatenate([new.cycle.times, new.cycle.speeds, z[2 * len(along.cycle.sides) or 2 :]])


@singledispatch
def recut(along, cycle, rows):
    """What is followed, with a cycle of some rows' impacts alone."""
    return along._replace(cycle=cycle)


def _distinct(along, z, met):
    """The choices of touches to be impacts: of those that are one orbit, counted from another period, the branch's own
    or the first."""
    own, kept = tuple(one.own for one in met), []
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
    for row in np.flatnonzero(along.cycle.sides != 0):
        touch, side = own.get(int(row)), int(along.cycle.sides[row])
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
    """A cycle with these impacts, (time, speed, side) each, in rows of a power of two; none without impacts."""
    rows = 0 if not impacts else max(2, 1 << (len(impacts) - 1).bit_length())
    columns = np.zeros((3, rows))
    for k, one in enumerate(impacts):
        columns[:, k] = one
    times, speeds, sides = columns
    return along.cycle._replace(times=times, speeds=speeds, sides=sides)


def free_start(along, value):
    """z of the orbit without impacts."""
    start = np.array([0.0, 0.0, value])
    rest, slopes = (np.asarray(each) for each in locate.evaluated(problem(along), start, along))
    start[:2] = -np.linalg.solve(slopes[:, :2], rest)
    return start


def opening(along, z, direction, row, wall, late):
    """How fast the distance of a flight at a time grows in a direction of z."""
    ends = (_bearing(along, row, wall, np.append(z + sign * locate.APART * direction, late))[0] for sign in (1, -1))
    return float(np.subtract(*ends) / (2.0 * locate.APART))


def leave(along, z, out, sign, length, included):
    """(the `GrazingExit` in one direction of a branch, None where it is none; whether that is sure). out: the touches
    left out."""
    tangent = sign * event_search.tangent(problem(along), z, scales(along, length), along)
    rows = len(along.cycle.sides)
    rates = [tangent[rows + k] for k in along.hits if z[rows + k] == 0.0]
    rates += [opening(along, z, tangent, *each) for each in out]
    if any(rate < -FLAT for rate in rates):
        return None, True
    way, met = stepped(along, z, tangent, length, included, SURE if any(included) else LOOSE, ASIDE)
    return way, met or min(rates, default=0.0) <= 0


def stepped(along, z, tangent, length, included, tolerance, asides):
    """(the `GrazingExit` along a tangent, None where none of these steps aside comes to an admissible orbit; whether
    one of them comes to an orbit)."""
    zero = np.zeros(())
    point = Point(z, tangent, zero, zero, zero, np.True_, np.True_)
    numbers = (np.float64(each) for each in (0.0, 1.0, tolerance, -np.inf, np.inf))
    control, met = Control(scales(along, length), *numbers), False
    for aside in asides:
        near = event_search.step(problem(along), point, aside, control, along)
        met |= bool(near.met)
        look = diagnose(along, near.z[None])
        if near.met and admissible(along, near.z, look)[0]:
            return GrazingExit(along, point, near.z, look, included), True
    return None, met


def admissible(along, zs, look):
    """Which points keep to their walls and hit them with positive speed: (points,)."""
    zs = np.atleast_2d(zs)
    fast = (zs[:, len(along.cycle.sides) + along.hits] > 0).all(axis=1)
    return fast & (look.clear >= -along.slack).all(axis=(1, 2)) & np.isfinite(zs).all(axis=1)

"""Touches: where an impact of an orbit has no speed, or a flight comes to a wall without one."""

from functools import partial, singledispatch
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from continuation import locate
from continuation.persistent_jit import SOON, persistent_jit

from ..compiled.kernels import one_kernel
from ..flight.coefficients import framed
from ..orbits import flight_clearance, impact_equations
from ..orbits.flight_clearance import TOUCH
from .diagnostics import diagnose, flight
from .equations import cycle_at, number_there, problem, there

ENDS = 1e-5  # of a flight: a touch as near to its ends is that of the impact there
ROUNDS = 6  # of Newton's steps to a turning point


class Touch(NamedTuple):
    """A touch of a wall. row: of the impact at it, or of that before it; side; late: its time since that impact's;
    own: whether the branch has it as an impact."""

    row: int
    side: int
    late: float
    own: bool


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
    lengths = [marks.amplitude, *(term.amplitude for term in marks.drive), *(wall.position for wall in walls)]
    lengths += [wall.motion.amplitude for wall in walls if wall.motion is not None]
    return length if any(mark == k for mark in lengths) else 1.0


def _met(y, along, row, wall):
    """(distance, speed, acceleration) towards a wall of the flight after a row; y = (z, the time since its start)."""
    z, late = y[:-1], y[-1]
    if len(along.cycle.sides):
        built = framed(there(along, z))
        found = impact_equations.flights(built, cycle_at(along, z))
    else:
        built, found = flight(along, z)
    every = flight_clearance.relative(built, found, jnp.full_like(found.time, late))
    return jnp.stack([jnp.stack([one[k] for one in every])[wall, row] for k in range(3)])


@persistent_jit(compiler_options=SOON, numpy_first=_met)
def _contact(y, along, row, wall):
    return one_kernel(_met, y, along, row, wall)


def bearing(along, row, wall, y):
    """Distance and speed towards a wall."""
    return np.asarray(_contact(y, along, np.int32(row), np.int32(wall)))[:2]


def touched(along, z, row, wall, late):
    """The point near where the flight after a row touches a wall: `locate.Located` of z."""
    towards = partial(bearing, along, row, wall)

    def system(y):
        value, slopes = (np.asarray(each) for each in locate.evaluated(problem(along), y[:-1], along))
        whole = np.vstack([np.pad(slopes, ((0, 0), (0, 1))), locate.differences(towards, y)])
        return np.concatenate([value, towards(y)]), whole

    found = locate.newton(system, np.append(z, late))
    return found if found.z is None else found._replace(z=found.z[:-1])


def zero_near(along, z, towards, places=None):
    """The point near z where a function of z is zero too: `locate.Located`. places: those in z of the unknowns that the
    function depends on, None: all."""

    def system(z):
        value, slopes = (np.asarray(each) for each in locate.evaluated(problem(along), z, along))
        return np.append(value, towards(z)), np.vstack([slopes, locate.differences(towards, z, places)])

    return locate.newton(system, z)


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
    still = [int(k) for k in along.hits if abs(z[rows + k]) < TOUCH * length]
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


def acceleration(along, z, row):
    """That towards the wall of an impact, relative to it, as it is left."""
    wall = wall_sides(along.scene).index(int(along.cycle.sides[row]))
    return float(_contact(np.append(z, 0.0), along, np.int32(row), np.int32(wall))[2])


def is_pressed(along, z, there_are):
    """Whether at one of the touches that are impacts the wall is in the way of the mass, which then rests on it."""
    return any(acceleration(along, z, one.row) > 0 for one in there_are if one.own)


def span(along, z):
    """How long the orbit is."""
    return float(along.cycle.periods) * 2.0 * np.pi / number_there(along, z, "frequency")


def flight_times(along, z):
    """How long each flight is, (rows,); of an orbit without impacts its periods, (1,)."""
    if not len(along.cycle.sides):
        return np.array([span(along, z)])
    return np.asarray(_times(along, z)[0])


def stays(along, z):
    """How long the mass is within the wall at each impact, before the flight after it begins, (rows,); (1,) of none."""
    rows = len(along.cycle.sides)
    return np.asarray(_times(along, z)[1]) if rows and along.scene.soft_sides else np.zeros(max(1, rows))


@persistent_jit(compiler_options=SOON, numpy_first=True)
def _times(along, z):
    found = impact_equations.flights(framed(there(along, z)), cycle_at(along, z))
    return found.time, 0.0 * found.time if found.met.stay is None else found.met.stay


def wall_sides(scene):
    """The sides of the walls that there are."""
    return [side for side, wall in ((-1, scene.left), (1, scene.right)) if wall is not None]


def admissible(along, zs, look):
    """Which points keep to their walls and hit them with positive speed, and rest where they are to: (points,)."""
    zs = np.atleast_2d(zs)
    fast = (zs[:, len(along.cycle.sides) + along.hits] > 0).all(axis=1)
    kept = np.concatenate([*rests(along, look), look.plain], axis=1)
    clear = (look.clear >= -along.slack).all(axis=(1, 2)) & (kept > -along.slack).all(axis=1)
    return fast & clear & np.isfinite(zs).all(axis=1)


@singledispatch
def rests(along, look):
    """(how long rests are, how hard walls hold in them), what is not to come to zero along what is followed."""
    return look.rest, look.hold

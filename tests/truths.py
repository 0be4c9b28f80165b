"""Motions of single scenes by the reference implementations, in one form for every kind of scene.

Nothing here shares code with the package. A motion whose impacts rounding decides is refused with `Discard`.
"""

from functools import partial
from typing import NamedTuple

import mpmath
import numpy as np
from flint import ctx
from mpmath import mpf

from .reference import own_force, records, rests, sampled, soft, special
from .reference.scene import Motion, Scene, Soft, Term, Wall
from .reference.search import Discard, Undecided

DIGITS = 34
APART = mpf(10) ** -10  # of two states, for a derivative by differences
CLEAR = 100.0  # allowed errors from a wall, or a graze, at which a motion counts as decided
CHATTER_SPEED = 1e-4  # slower impacts are hops of a chatter, which a flight of a user-defined force counts one by one


class Truth(NamedTuple):
    """A motion over some drive periods.

    x, v: the end; times, sides, speeds: of the impacts and of the entries into soft walls; numbers of many digits.
    matrix: the derivative of the end by the initial state, None where it is not computed. allowed: absolute error that
    a correct computation with a given relative error of 1 may have: the scale of the motion times the growth of errors.
    least_clearance: at turning points, None where it is not computed.
    """

    x: object
    v: object
    times: list
    sides: list
    speeds: list
    matrix: np.ndarray | None
    allowed: float
    least_clearance: float | None = None


def plain(scene):
    """Return a scene as the references' record of floats."""

    def wall(given):
        if given is None:
            return None
        motion = given.motion and Motion(
            float(given.motion.amplitude), float(given.motion.phase), given.motion.harmonic
        )
        if given.law is not None:
            return Soft(float(given.position), None, None, motion)
        if given.soft:
            return Soft(float(given.position), float(given.stiffness), float(given.damping), motion)
        bounce = scene.restitution if given.restitution is None else given.restitution
        return Wall(float(given.position), float(bounce), motion)

    drive = tuple(Term(float(term.amplitude), term.harmonic, float(term.phase)) for term in scene.drive or ())
    damping = 0.0 if scene.damping is None else float(scene.damping)
    numbers = damping, float(scene.frequency), float(scene.amplitude)
    return Scene(*numbers, wall(scene.left), wall(scene.right), drive)


def closed_form(scene, x, v, phase, periods=1):
    """Return the motion of a linear oscillator: ball arithmetic, certified impacts."""
    given = plain(scene)
    record = soft.strobe(given, x, v, phase, periods=periods)
    matrix = np.array([[float(entry) for entry in row] for row in record.jacobian])
    allowed = record.scale * (1.0 + max(record.norm, record.sharp))
    events = record.times, [int(side) for side in record.sides], record.speeds
    return Truth(record.x, record.v, *events, matrix, allowed, record.least_minimum)


def resting(scene, x, v, phase, periods=1):
    """Return the end of a motion that may stick: hops one by one, at many digits; without impacts' times."""
    with mpmath.workdps(DIGITS):
        given = special.exact(plain(scene))
        begin = mpf(phase) / given.omega
        end = begin + special.span(given, periods)
        start = begin, mpf(x), mpf(v)
        hit = rests.first(given, start, 0, rests.GRID, 1, end)
        if hit is None or hit.time >= end:
            place = special.fly(given, *start, end)
        else:
            if hit.speed < records.SLOWEST or end - hit.time < records.EDGE:
                raise Discard("a slow impact, or one at the end")
            again = special.restitution(given, hit.side) * hit.speed
            place = rests.state_after(given, hit.side, hit.time, again, end)
    scale = max(abs(x), abs(v), *(abs(float(each)) for each in place), abs(float(given.amplitude)), 1.0)
    return Truth(*place, None, None, None, None, 1e2 * scale)


FORCES = own_force.FORCES | {"polynomial": own_force.falling}
contact_series = None  # properties/test_orbits.py still names it; `series` does what it did, for any number of periods


def series(scene, x, v, phase, periods=1):
    """Return the motion under a user-defined force between rigid walls or those with a contact law: series by hand."""
    given, tolerance = plain(scene), float(scene.force.tolerance)
    walls, bounces, push = [], [], None
    for own, wall in ((scene.left, given.left), (scene.right, given.right)):
        walls.append(wall and (wall.position if wall.motion is None else (wall.position, *wall.motion)))
        bounces.append(getattr(wall, "restitution", 0.0))
        if wall and own.law is not None:
            push = tuple(float(own.law.numbers[name]) for name in ("stiffness", "dissipation"))
    numbers = {name: float(value) for name, value in scene.force.numbers.items()}
    fly = partial(
        own_force.flown, FORCES[scene.force.function.__name__], numbers, given.amplitude, given.omega, tuple(walls)
    )
    fly = partial(fly, tuple(bounces), phase=phase, periods=periods, most=60, push=push)
    with mpmath.workdps(DIGITS):
        try:
            true = fly(x, v)
            matrix = _differences(lambda *state: fly(*state).end, true.end, x, v)
        except own_force.RunsAwayError as error:
            raise Discard("it runs away") from error
        except ArithmeticError as error:
            raise Discard("hops without an end") from error
    size = max(*(abs(float(each)) for each in true.end), abs(x), abs(v), 4.0 + abs(given.amplitude))
    return _decided(true.end, true.hits, matrix, size, float(true.least), float(true.nearest), tolerance)


def _differences(end, place, x, v):
    """Return the derivative of an end by the initial state, by differences."""
    columns = [end(mpf(x) + APART, mpf(v)), end(mpf(x), mpf(v) + APART)]
    return np.array([[float((column[k] - place[k]) / APART) for column in columns] for k in (0, 1)])


def _decided(place, hits, matrix, size, slowest, nearest, tolerance):
    """Return the Truth of a motion, unless it comes too near to a graze for its tolerance."""
    allowed = 20.0 * size * (1.0 + abs(matrix).max())
    if min(nearest, slowest**2 / (2.0 * size)) < CLEAR * tolerance * allowed or slowest < 1e-2:
        raise Discard("a near graze")
    times, sides, speeds = zip(*hits, strict=True) if hits else ((), (), ())
    return Truth(*place, list(times), list(sides), list(speeds), matrix, allowed)


def derivative(motions, step):
    """Return the derivative of (x, v, *times, *speeds) along a line, by differences, and how uncertain it is.

    motions: Truths at -2, -1, 1 and 2 steps on the line. It raises `Discard` if their impacts differ.
    """
    if any(list(motion.sides) != list(motions[0].sides) for motion in motions):
        raise Discard("other impacts beside the start")
    with mpmath.workdps(DIGITS), ctx.workprec(200):
        low, below, above, high = ([m.x, m.v, *m.times, *m.speeds] for m in motions)
        near = np.array([float((b - a) / (2.0 * step)) for a, b in zip(below, above, strict=True)])
        far = np.array([float((b - a) / (4.0 * step)) for a, b in zip(low, high, strict=True)])
    return near + (near - far) / 3.0, abs(near - far)


def closed_form_at(scene, x, v, phase, time):
    """Return the state of a linear oscillator at a time, as a Truth whose impacts are those before it."""
    try:
        record = sampled.soft_end((plain(scene), x, v, phase), time)
    except Undecided as error:
        raise Discard("undecided") from error
    allowed = record.scale * (1.0 + max(record.norm, record.sharp))
    sides = [int(side) for side in record.sides]
    return Truth(record.x, record.v, record.times, sides, record.speeds, None, allowed, record.least_minimum)

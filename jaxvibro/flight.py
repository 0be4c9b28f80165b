"""One step of a path: it flies to the next event or as far as is certain, lands, rebounds, rests or is released.

Each step is a handful of stages on lanes; a stage's results are stored, see `lanes.stage`.
"""

from typing import NamedTuple

import jax
from jax import lax

from . import event, flow, impact
from .lanes import choose, least, most, stage, two_sum
from .wall import chosen, course, press


class Path(NamedTuple):
    """Where a lane is: x, v and the time to go, with the low parts of their sums; the drive's angle; the contact.

    contact: 0 free; times the wall's sign: 1 has landed and leaves, 2 rests on the wall, 3 is released, no push on it.
    """

    x: jax.Array
    x_low: jax.Array
    v: jax.Array
    v_low: jax.Array
    cosine: jax.Array
    sine: jax.Array
    rest: jax.Array
    rest_low: jax.Array
    contact: jax.Array


class Step(NamedTuple):
    """What a step did: its time, the path before any impact and after, the side of the impact (0: none), its speed."""

    time: jax.Array
    flown: Path
    path: Path
    side: jax.Array
    speed: jax.Array


def micro(frame, path):
    """One certified step of every lane that has time to go; a lane that has none stays as it is."""
    going = path.rest > 0
    drive, jet = _jets(frame, path)
    if not frame.walls:
        time = choose(going, least(frame.reach, path.rest), 0.0)
        flown = _advance(frame, path, jet, time)
        none = lax.full_like(path.x, 0.0)
        return Step(time, flown, flown, none, none)
    held, bounds = _held(frame, path, drive, jet)
    steps = stage(_near, frame, path, held, bounds)
    if len(frame.walls) == 2:
        side, near, other = stage(_nearer, path, steps), least(*steps), most(*steps)
    else:
        side, near, other = lax.full_like(path.x, float(frame.walls[0].sign)), steps[0], frame.reach
    aim = stage(_aim, frame, path, held, bounds, side)
    time, side = stage(_decide, frame, path, aim, near, other, side)
    time, side = choose(going, time, 0.0), choose(going, side, 0.0)
    flown = _advance(frame, path, jet, time)
    landed = stage(impact.meet, frame, flown, side)
    after, speed = stage(impact.part, frame, flown, landed, side, time)
    return Step(time, flown, after, side, speed)


def _jets(frame, path):
    """The derivatives of the drive's force and of x, to flow.ORDER, two at a time so that each is computed once."""
    drive = [frame.force * path.cosine, -(frame.force * path.sine) * frame.frequency]
    jet = [path.x, path.v]
    while len(jet) <= flow.ORDER:
        new = stage(flow.extend, frame.frequency, frame.damping, drive[-2:], jet[-2:])
        drive += new[0]
        jet += new[1]
    return drive, jet[: flow.ORDER + 1]


def _held(frame, path, drive, jet):
    """The jet of x of a free lane; of one that rests, the wall's less the press on it: the clearance is then the press.

    And for each wall a bound on the seventh derivative of x - x_b over the reach.
    """
    bound = frame.reach * (frame.curb + frame.slope * (lax.abs(jet[6]) + lax.abs(jet[7]))) + lax.abs(jet[7])
    stuck = lax.abs(path.contact) == impact.STUCK
    bound = choose(stuck, chosen(path.contact, frame.walls, frame.tails), bound)
    bounds = tuple(bound + swing for swing in frame.swings)
    if all(wall.swing is None for wall in frame.walls):
        push = [drive[0] - path.x, *drive[1 : event.TERMS + 1]]
        still = [path.x] + [0.0] * event.TERMS
        return tuple(choose(stuck, p - f, y) for p, f, y in zip(still, push, jet, strict=False)), bounds
    return stage(_moving, frame, path, jet[: event.TERMS + 1]), bounds


def _moving(frame, path, jet):
    values = (frame.force, frame.frequency, frame.damping, path.cosine, path.sine)
    stuck = lax.abs(path.contact) == impact.STUCK
    presses = [press(wall, *values, event.TERMS) for wall in frame.walls]
    courses = [course(wall, frame.frequency, path.cosine, path.sine, event.TERMS) for wall in frame.walls]
    found = []
    for k, free in enumerate(jet):
        push = chosen(path.contact, frame.walls, [each[k] for each in presses])
        where = [lax.full_like(push, 0.0) if each[k] is None else each[k] for each in courses]
        found.append(choose(stuck, chosen(path.contact, frame.walls, where) - push, free))
    return tuple(found)


def _progress(frame, path, jet, bound, side, way):
    leaving = path.contact * side
    on = (leaving == impact.LANDED) | (leaving == impact.RELEASED)
    g, rest = event.progress(side, jet, way, path.x_low, bound, frame.reach, on)
    for k in (0, 1):
        g[k] = choose(leaving == impact.RELEASED, 0.0, g[k])
    return g, rest


def _near(frame, path, jet, bounds):
    """For each wall a step that is certain not to meet it."""
    found = []
    for wall, bound in zip(frame.walls, bounds, strict=True):
        way = course(wall, frame.frequency, path.cosine, path.sine, event.TERMS)
        g, rest = _progress(frame, path, jet, bound, float(wall.sign), way)
        time = event.free_step(g, event.cubic(g, rest, frame.reach), frame.reach)
        elsewhere = path.contact == -impact.STUCK * wall.sign
        found.append(choose(elsewhere, frame.reach, time))
    return tuple(found)


def _nearer(path, steps):
    """The sign of the wall that may be met first."""
    stuck = lax.abs(path.contact) == impact.STUCK
    right = lax.select(stuck, path.contact > 0, steps[1] <= steps[0])
    return choose(right, 1.0, lax.full_like(path.x, -1.0))


def _aim(frame, path, jet, bounds, side):
    """The polynomial of the progress towards the wall on a side, and its rest."""
    ways = [course(wall, frame.frequency, path.cosine, path.sine, event.TERMS) for wall in frame.walls]
    way = []
    for k in range(event.TERMS + 1):
        where = [each[k] for each in ways]
        zeros = [lax.full_like(path.x, 0.0) if each is None else each for each in where]
        way.append(None if all(each is None for each in where) else chosen(side, frame.walls, zeros))
    g, rest = _progress(frame, path, jet, chosen(side, frame.walls, bounds), side, way)
    return (*g, rest)


def _decide(frame, path, aim, near, other, side):
    """(time to fly, side of the wall met at its end or 0)."""
    *g, rest = aim
    bend = event.cubic(g, rest, frame.reach)
    step, time, exists = event.sure_step(g, bend, frame.reach, near)
    time, error, certain = event.root(g, rest, frame.reach, time, exists)
    tiny = 4.0 * event.rounding(time.dtype) * frame.period
    close = error * (lax.abs(g[2]) + g[1] / frame.reach) < event.landing(time.dtype) * g[1]
    inside = (time + error <= path.rest) | ((error <= tiny) & (time <= path.rest + tiny))
    lands = certain & close & inside & (time <= other)
    step = least(most(step, choose(certain, time - error, 0.0)), other)
    return least(choose(lands, time, step), path.rest), choose(lands, side, 0.0)


def _advance(frame, path, jet, time):
    angle = frame.frequency * time
    gains = stage(_gain, jet, time, angle)
    return stage(_add, path, time, gains)


def _gain(jet, time, angle):
    return flow.shift(jet, time), flow.shift(jet[1:], time), flow.versine(angle), flow.sinus(angle)


def _add(path, time, gains):
    dx, dv, versed, sined = gains
    x, x_low = two_sum(path.x, dx + path.x_low)
    v, v_low = two_sum(path.v, dv + path.v_low)
    cosine, sine = flow.turn(path.cosine, path.sine, versed, sined)
    rest, low = two_sum(path.rest, -time)
    rest, rest_low = two_sum(rest, low + path.rest_low)
    return Path(x, x_low, v, v_low, cosine, sine, rest, rest_low, path.contact)

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
    """Where a lane is: x, v and the time to go with the low parts of their sums, the drive's cosine and sine, the contact.

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
    if not frame.walls:
        time = choose(going, least(frame.reach, path.rest), 0.0)
        flown = _fly(frame, path, time)
        none = lax.full_like(path.x, 0.0)
        return Step(time, flown, flown, none, none)
    jet, bounds = stage(_jet, frame, path)
    steps = stage(_near, frame, path, jet, bounds)
    aim = stage(_aim, frame, path, jet, bounds, steps)
    time, side = stage(_decide, frame, path, aim)
    time, side = choose(going, time, 0.0), choose(going, side, 0.0)
    flown = _fly(frame, path, time)
    landed = stage(impact.meet, frame, flown, side)
    after, speed = stage(impact.part, frame, flown, landed, side, time)
    return Step(time, flown, after, side, speed)


def _jet(frame, path):
    """The jet of x of a free lane; of one that rests, the wall's less the press on it: the clearance is then the press."""
    values = (frame.force, frame.frequency, frame.damping)
    jet = flow.jet(*values, path.x, path.v, path.cosine, path.sine, event.TERMS)
    bound = frame.reach * (frame.curb + frame.slope * (lax.abs(jet[6]) + lax.abs(jet[7]))) + lax.abs(jet[7])
    stuck = lax.abs(path.contact) == impact.STUCK
    presses = [press(wall, *values, path.cosine, path.sine, event.TERMS) for wall in frame.walls]
    courses = [course(wall, frame.frequency, path.cosine, path.sine, event.TERMS) for wall in frame.walls]
    for k in range(event.TERMS + 1):
        push = chosen(path.contact, frame.walls, [each[k] for each in presses])
        where = [each[k] for each in courses]
        moved = lax.full_like(push, 0.0)
        if any(each is not None for each in where):
            moved = chosen(path.contact, frame.walls, [moved if each is None else each for each in where])
        jet[k] = choose(stuck, moved - push, jet[k])
    tails = chosen(path.contact, frame.walls, frame.tails)
    bound = choose(stuck, tails, bound)
    return tuple(jet), tuple(bound + swing for swing in frame.swings)


def _progress(frame, path, jet, bound, wall):
    way = course(wall, frame.frequency, path.cosine, path.sine, event.TERMS)
    leaving = path.contact * wall.sign
    on = (leaving == impact.LANDED) | (leaving == impact.RELEASED)
    g, rest = event.progress(wall.sign, jet, way, path.x_low, bound, frame.reach, on)
    for k in (0, 1):
        g[k] = choose(leaving == impact.RELEASED, 0.0, g[k])
    return g, rest


def _near(frame, path, jet, bounds):
    """For each wall a step that is certain not to meet it."""
    found = []
    for wall, bound in zip(frame.walls, bounds, strict=True):
        g, rest = _progress(frame, path, jet, bound, wall)
        time = event.free_step(g, event.cubic(g, rest, frame.reach), frame.reach)
        elsewhere = path.contact == -impact.STUCK * wall.sign
        found.append(choose(elsewhere, frame.reach, time))
    return tuple(found)


def _aim(frame, path, jet, bounds, steps):
    """The wall that is met first, or may be: (its polynomial, rest, certain step, the other's, its sign)."""
    if len(frame.walls) == 1:
        (wall,) = frame.walls
        g, rest = _progress(frame, path, jet, bounds[0], wall)
        return (*g, rest, steps[0], frame.reach, lax.full_like(rest, float(wall.sign)))
    stuck = lax.abs(path.contact) == impact.STUCK
    right = lax.select(stuck, path.contact > 0, steps[1] <= steps[0])
    found = [_progress(frame, path, jet, bound, wall) for wall, bound in zip(frame.walls, bounds, strict=True)]
    (first, rest_first), (second, rest_second) = found
    g = [choose(right, b, a) for a, b in zip(first, second, strict=True)]
    rest, side = choose(right, rest_second, rest_first), choose(right, lax.full_like(rest_first, 1.0), -1.0)
    return (*g, rest, least(*steps), most(*steps), side)


def _decide(frame, path, aim):
    """(time to fly, side of the wall met at its end or 0)."""
    *g, rest, near, other, side = aim
    bend = event.cubic(g, rest, frame.reach)
    step, time, exists = event.sure_step(g, bend, frame.reach, near)
    time, error, certain = event.root(g, rest, frame.reach, time, exists)
    tiny = 4.0 * event.rounding(time.dtype) * frame.period
    close = error * (lax.abs(g[2]) + g[1] / frame.reach) < event.landing(time.dtype) * g[1]
    inside = (time + error <= path.rest) | ((error <= tiny) & (time <= path.rest + tiny))
    lands = certain & close & inside & (time <= other)
    step = least(most(step, choose(certain, time - error, 0.0)), other)
    return least(choose(lands, time, step), path.rest), choose(lands, side, 0.0)


def _fly(frame, path, time):
    gains = stage(_gain, frame, path, time)
    return stage(_add, path, time, gains)


def _gain(frame, path, time):
    values = (frame.force, frame.frequency, frame.damping)
    jet = flow.jet(*values, path.x, path.v, path.cosine, path.sine, flow.ORDER)
    angle = frame.frequency * time
    return flow.shift(jet, time), flow.shift(jet[1:], time), flow.versine(angle), flow.sinus(angle)


def _add(path, time, gains):
    dx, dv, versed, sined = gains
    x, x_low = two_sum(path.x, dx + path.x_low)
    v, v_low = two_sum(path.v, dv + path.v_low)
    cosine, sine = flow.turn(path.cosine, path.sine, versed, sined)
    rest, low = two_sum(path.rest, -time)
    rest, rest_low = two_sum(rest, low + path.rest_low)
    return Path(x, x_low, v, v_low, cosine, sine, rest, rest_low, path.contact)

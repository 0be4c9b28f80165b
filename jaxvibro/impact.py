"""The impact law, y+ - v_b = -R (y- - v_b) (paper, (4)), and what a mass does that has no speed left on a wall."""

from typing import NamedTuple

import jax
from jax import lax

from . import event, flow
from .lanes import choose, two_sum
from .wall import chosen, course, less, press

LANDED, STUCK, RELEASED = 1.0, 2.0, 3.0


class Meeting(NamedTuple):
    """The event that a step ends with, to rounding: how much later it is, the velocity and the drive there."""

    late: jax.Array
    v: jax.Array
    cosine: jax.Array
    sine: jax.Array


def meet(frame, path, side):
    """Moves the end of a step onto its event: one step of Halley's, from nearer than `event.landing`."""
    values = (frame.force, frame.frequency, frame.damping)
    x, v, cosine, sine = path.x, path.v, path.cosine, path.sine
    pull = frame.force * cosine - x - 2.0 * frame.damping * v
    jerk = -(frame.force * sine) * frame.frequency - v - 2.0 * frame.damping * pull
    lates, releases = [], []
    for wall in frame.walls:
        where, speed, bend, _ = course(wall, frame.frequency, cosine, sine, 3)
        gap = (where - x) - path.x_low
        closing, bending = less(v, speed), less(pull, bend)
        late = gap / closing
        lates.append(late * (1.0 - 0.5 * bending * late / closing))
        push, change = press(wall, *values, cosine, sine, 1)
        releases.append(-push / change)
    late, release = chosen(side, frame.walls, lates), chosen(side, frame.walls, releases)
    stuck = lax.abs(path.contact) == STUCK
    late = choose(side != 0, choose(stuck, release, late), 0.0)
    angle = frame.frequency * late
    cosine, sine = flow.turn(cosine, sine, -0.5 * angle * angle, angle)
    return Meeting(late, v + late * (pull + 0.5 * late * jerk), cosine, sine)


def part(frame, path, meeting, side, time):
    """(the path after the event, the relative speed before it): rebound, rest, release, or nothing at all."""
    stuck, hit = lax.abs(path.contact) == STUCK, side != 0
    wall_side = choose(stuck, path.contact, side)
    where, speed, push, change = surface(frame, wall_side, meeting.cosine, meeting.sine)
    sign = choose(wall_side < 0, lax.full_like(side, -1.0), 1.0)
    closing = sign * (meeting.v - speed)
    leaving = chosen(wall_side, frame.walls, [wall.restitution for wall in frame.walls]) * closing
    state = settle(frame, leaving, sign * push, sign * change)
    state = choose(stuck, RELEASED, state)
    idle = choose(stuck, path.contact, choose(time > 0, 0.0, path.contact))
    contact = choose(hit, sign * state, idle)
    on = hit | stuck
    bounces = hit & (state == LANDED)
    v = choose(bounces, speed - sign * leaving, choose(on, speed, path.v))
    rest, rest_low = two_sum(path.rest, path.rest_low - meeting.late)
    after = path._replace(
        x=choose(on, where, path.x),
        x_low=choose(on, 0.0, path.x_low),
        v=v,
        v_low=choose(on, 0.0, path.v_low),
        cosine=meeting.cosine,
        sine=meeting.sine,
        rest=choose(rest > 0, rest, 0.0),
        rest_low=rest_low,
        contact=contact,
    )
    return after, choose(hit & ~stuck, closing, 0.0)


def surface(frame, side, cosine, sine):
    """Position, speed, press and the press's change of the wall on a side."""
    found = []
    for wall in frame.walls:
        where, speed = course(wall, frame.frequency, cosine, sine, 1)
        speed = lax.full_like(where, 0.0) if speed is None else speed
        push = press(wall, frame.force, frame.frequency, frame.damping, cosine, sine, 1)
        found.append((where, speed, *push))
    return tuple(chosen(side, frame.walls, values) for values in zip(*found, strict=True))


def settle(frame, leaving, push, change):
    """LANDED, STUCK or RELEASED: what follows on a wall from the speed of leaving it, the press and its change.

    A hop lower than rounding, leaving^2 / (2 push), is no hop: the mass rests. Without speed the press decides, then
    its change.
    """
    none = leaving == 0
    pressed = (push > 0) & (leaving * (leaving / frame.size) <= 4.0 * event.rounding(push.dtype) * push)
    held = pressed | (none & (push == 0) & (change >= 0))
    free = choose(none & (push == 0), RELEASED, lax.full_like(push, LANDED))
    return choose(held, STUCK, free)

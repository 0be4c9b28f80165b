"""How close a flight came to a wall without touching it: the clearance at the turning points of x - x_b.

A step that passes a turning point is noted, and measured only when its lane passes the next: a block of lanes would
else measure at nearly every step.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, least, mask, merge, most, stage
from ..scene.codes import Contact
from . import event
from .flight_state import SlowMotion, place
from .flows import flow_of
from .wall import course, course_on, less
from .within_wall import within

BOTH = 4.0  # added to the mark of two turns, in longest steps
TERMS = 9  # of the Taylor polynomial of x, an odd number
ROUNDS = 8  # of Newton's steps on it
NEAR = 1e-3  # of the longest step: how good its root must be
AHEAD = 1.8  # of Newton's first step from an end, no more: between two turns it would lead to the other
BESIDE = 2.2  # times a turn's distance from where the speed turns, a little over 2, is outside of the other turn
DOUBT = 0.05  # how far a cubic through the speeds of a step's ends may be off between, over the accelerations' change


class Turn(NamedTuple):
    """A turning point: the motion at its step's start, the step's time, and a mark.

    mark: the wall's sign times (a guess of the time from there + the longest step), 0 where there is none; BOTH longest
    steps more where the motion turns back from the other wall too within the step.
    """

    motion: SlowMotion
    span: Float[jax.Array, "*lanes"]
    mark: Float[jax.Array, "*lanes"]


class Calls(NamedTuple):
    """The least clearance so far, the turning points not yet measured, and those of the last step."""

    least: Float[jax.Array, "*lanes"]
    noted: Turn
    fresh: Turn


def nothing(lanes):
    """No turning point, for lanes like these."""
    none = jnp.zeros_like(lanes)
    turn = Turn(SlowMotion(*[none] * 6), none, none)
    return Calls(jnp.full_like(lanes, jnp.inf), turn, turn)


def note(frame, path, step, calls):
    """The calls with the turning points of one step more, noted where a lane has no other noted."""
    new = stage(_mark, frame, path, step.flown, step.time)
    take, second = stage(_shared, calls.noted.mark, new)
    first = jax.tree.map(lambda new, old: merge(take, new, old), Turn(path.motion, step.time, new), calls.noted)
    return Calls(calls.least, first, Turn(path.motion, step.time, second))


def _shared(noted, new):
    """The lanes that have no other noted, and the marks of those that have."""
    return mask((noted == 0) & (new != 0), new), choose(noted == 0, 0.0, new)


def is_crowded(calls):
    """The lanes that have passed a turning point while another is noted: then `measure` is due."""
    return calls.fresh.mark != 0


def measure(frame, calls):
    """The calls with what is noted measured; noted is then its turn from the other wall, if it has one, else what is
    fresh.

    The time is found on the speed's Taylor polynomial, then by one of Halley's steps along the flow: the polynomial
    leaves an error below 1e-3 of the longest step, and that of the clearance is its fourth power.
    """
    motion, span, mark = calls.noted
    side, flow = choose(mark < 0, lax.full_like(mark, -1.0), 1.0), flow_of(frame)
    x, _, v = stage(place, frame, motion)
    speeds = stage(_speeds, frame, side, motion, flow.jet(frame, x, v, motion.cosine, motion.sine, TERMS))
    both, time = stage(_told, frame, mark)
    for _ in range(ROUNDS):
        time = stage(_newton, speeds, time)
    other = stage(_other, frame, side, speeds, time, span)
    near = stage(_relative, frame, side, flow.moved(frame, motion, time))
    step = stage(_halley, *near[1:])
    found = -side * (near[0] + step * (near[1] + step * (0.5 * near[2] + step * (near[3] / 6.0))))
    time, edge = time + step, frame.reach * event.rounding(time.dtype) ** 0.5
    close = lax.abs(step) <= frame.reach * NEAR  # short beside a pull of zero too, where the speed is not
    real = (mark != 0) & close & (lax.abs(near[1]) <= 2.0 * frame.reach * NEAR * lax.abs(near[2]))
    real &= side * near[2] < 0
    real &= (time >= -edge) & (time <= span + edge)
    twin, fresh = Turn(motion, span, other), calls.fresh
    noted = jax.tree.map(lambda new, old: choose(both, new, old), twin, fresh)
    fresh = fresh._replace(mark=choose(both, fresh.mark, 0.0))
    return Calls(choose(real, least(found, calls.least), calls.least), noted, fresh)


def _told(frame, mark):
    """Whether a mark is of two turns, and its guess of the time."""
    size = lax.abs(mark)
    both = size > (BOTH - 1.0) * frame.reach
    return both, size - choose(both, lax.full_like(size, 1.0 + BOTH), 1.0) * frame.reach


def _other(frame, side, speeds, time, span):
    """The mark of the turn from the other wall: as far on the other side of where the speed turns."""
    _, pull = event.horner(speeds, time)
    bend = event.horner([k * term for k, term in enumerate(speeds)][1:], time)[1]
    guess = lax.clamp(lax.full_like(time, 0.0), time - BESIDE * pull / bend, span)
    return -side * (guess + frame.reach)


def _speeds(frame, side, motion, derivatives):
    """Taylor coefficients of the speed of x - x_b."""
    way = course_on(frame, side, motion.cosine, motion.sine, TERMS)
    return [less(derivatives[k], way[k]) * (1.0 / math.factorial(k - 1)) for k in range(1, TERMS + 1)]


def _newton(speeds, time):
    speed, pull = event.horner(speeds, time)
    return time - speed / pull


def _mark(frame, path, flown, time):
    """The mark of a step's turning point; of more than one, that nearest to its wall at first.

    The guess is an end from which Newton's steps come down one slope; the secant's where the speed falls throughout;
    or, where x - x_b turns twice within the step, a parabola's.
    """
    free = lax.abs(path.contact) != Contact.STUCK
    inside = within(frame, path.contact)
    if inside is not None:
        free &= ~inside
    mark, nearest = (lax.full_like(time, value) for value in (0.0, jnp.inf))
    turns = lax.full_like(time, 0.0)
    still = all(wall.swing is None for wall in frame.walls)
    for walls in [frame.walls] if still else [(wall,) for wall in frame.walls]:  # still walls see the same speed
        start, end = _closing(frame, walls[0], path), _closing(frame, walls[0], flown)
        way = choose(start[1] > 0, lax.full_like(time, 1.0), -1.0)
        (u, a), (w, b) = ((way * speed, way * pull) for _, speed, pull in (start, end))
        past = 0.5 * (start[0] + end[0])
        near, clear = _nearer(walls, past)
        once = (u > 0) & (w <= 0) & ((a < 0) | (b < 0))
        share = a / (a - b)
        crest = _crest(u, a * time, w, b * time, share)
        twice = (u > 0) & (w > 0) & (a < 0) & (b > 0) & (crest < DOUBT * (b - a) * time)
        single = choose(a < 0, choose(b < 0, u / (u - w), 0.0), 1.0)
        first = near == way
        root = lax.sqrt(lax.abs(crest / (crest - choose(first, u, w))))
        early, late = least(share - share * root, AHEAD * u / (-a * time)), share + (1.0 - share) * root
        late = most(late, 1.0 - AHEAD * w / (b * time))
        sign = choose(once, way, near)
        here = free & (once | twice)
        if len(walls) == 1:
            here &= sign == float(walls[0].sign)
            turns = turns + choose(here, 1.0, 0.0)
        else:
            turns = choose(here & twice, 2.0, turns)
        here &= clear < nearest
        mark = choose(here, sign * (time * choose(once, single, choose(first, early, late)) + frame.reach), mark)
        nearest = choose(here, clear, nearest)
    return choose(turns > 1.5, mark + lax.sign(mark) * (BOTH * frame.reach), mark)


def _nearer(walls, past):
    """(sign of the wall that is nearer, the clearance to it): past, how far x is to the right of the first wall."""
    sign = lax.full_like(past, float(walls[0].sign))
    if len(walls) == 1:
        return sign, -walls[0].sign * past
    clear = walls[1].position - walls[0].position - past
    return choose(clear < past, 1.0, sign), least(clear, past)


def _crest(u, a, w, b, share):
    """The cubic with these values and slopes at 0 and 1 where its slope, were it straight, would pass zero."""
    return u + share * (a + share * (3.0 * (w - u) - 2.0 * a - b + share * (2.0 * (u - w) + a + b)))


def _closing(frame, wall, path):
    """x - x_b, its speed and its acceleration."""
    pull, _ = flow_of(frame).accelerations(frame, path.x, path.v, path.cosine, path.sine)
    where, speed, bend = course(wall, frame.frequency, path.cosine, path.sine, 2)
    return (path.x - where) + path.x_low, less(path.v, speed), less(pull, bend)


def _halley(speed, pull, jerk):
    return -2.0 * speed * pull / (2.0 * pull * pull - speed * jerk)


def _relative(frame, side, motion):
    """x - x_b of the wall on a side, and its first three derivatives."""
    x, x_low, v = place(frame, motion)
    way = course_on(frame, side, motion.cosine, motion.sine, 3)
    free = x, v, *flow_of(frame).accelerations(frame, x, v, motion.cosine, motion.sine)
    found = [less(one, other) for one, other in zip(free, way, strict=True)]
    return [found[0] + x_low, *found[1:]]

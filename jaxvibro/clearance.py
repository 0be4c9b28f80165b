"""How close a flight came to a wall without touching it: the clearance at the turning points of x - x_b.

A step that passes a turning point is noted, and measured only when its lane passes the next: a block of lanes would
else measure at nearly every step.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from . import event, flow, impact
from .lanes import choose, least, stage
from .wall import chosen, course, less

NEWTON = 8  # steps from the guess; the clearance is flat there
DOUBT = 0.01  # how far a cubic through the speeds of a step's ends may be off between, over the accelerations' change


class Call(NamedTuple):
    """A noted turning point: the step's start, a guess of the time from there, the wall's sign (0: none is noted)."""

    x: jax.Array
    x_low: jax.Array
    v: jax.Array
    cosine: jax.Array
    sine: jax.Array
    time: jax.Array
    sign: jax.Array


def nothing(frame):
    """No turning point noted."""
    return Call(*[jnp.zeros_like(frame.force)] * 7)


def note(frame, path, step, call, clearance):
    """(call, clearance) with the turning points of one more step."""
    if not frame.walls:
        return call, clearance
    guess, sign = stage(_spot, frame, path, step.flown, step.time)
    crowded = jnp.any((call.sign != 0) & (sign != 0))
    clearance = lax.cond(crowded, _measured, lambda frame, call, clearance: clearance, frame, call, clearance)
    old = lax.select(jnp.broadcast_to(crowded, sign.shape), jnp.zeros_like(sign), call.sign)
    new = Call(path.x, path.x_low, path.v, path.cosine, path.sine, guess, sign)
    fresh = sign != 0
    return jax.tree.map(lambda a, b: choose(fresh, a, b), new, call._replace(sign=old)), clearance


def close(frame, call, clearance):
    """The least clearance, once the path has ended."""
    return _measured(frame, call, clearance) if frame.walls else clearance


def _spot(frame, path, flown, time):
    """(guess of the time of a turning point towards a wall, that wall's sign or 0), from the speeds at the step's ends.

    The guess is an end from which Newton's steps come down one slope; the secant's where the speed falls throughout;
    or, where x - x_b turns twice within the step, a parabola's. Of two walls' the nearer counts.
    """
    free = lax.abs(path.contact) != impact.STUCK
    guess, sign, nearest = (lax.full_like(time, value) for value in (0.0, 0.0, jnp.inf))
    for wall in frame.walls:
        (past, u, a), (beyond, w, b) = _closing(frame, wall, path), _closing(frame, wall, flown)
        once = (u > 0) & (w <= 0) & ((a < 0) | (b < 0))
        share = a / (a - b)
        crest = _crest(u, a * time, w, b * time, share)
        slack = DOUBT * (lax.abs(a) + lax.abs(b)) * time
        late = (u <= 0) & (w <= 0) & (a > 0) & (b < 0) & (crest > -slack)
        early = (u > 0) & (w > 0) & (a < 0) & (b > 0) & (crest < slack)
        single = choose(a < 0, choose(b < 0, u / (u - w), 0.0), 1.0)
        root = lax.sqrt(lax.abs(crest / (crest - choose(late, w, u))))
        double = choose(late, share + (1.0 - share) * root, share - share * root)
        clear = -0.5 * (past + beyond)
        better = free & (once | late | early) & (clear < nearest)
        guess = choose(better, time * choose(once, single, double), guess)
        sign, nearest = choose(better, float(wall.sign), sign), choose(better, clear, nearest)
    return guess, sign


def _crest(u, a, w, b, share):
    """The cubic with these values and slopes at 0 and 1 where its slope, were it straight, would pass zero."""
    return u + share * (a + share * (3.0 * (w - u) - 2.0 * a - b + share * (2.0 * (u - w) + a + b)))


def _closing(frame, wall, path):
    """Minus the clearance, its speed and its acceleration."""
    pull = frame.force * path.cosine - path.x - 2.0 * frame.damping * path.v
    where, speed, bend = course(wall, frame.frequency, path.cosine, path.sine, 2)
    past = (path.x - where) + path.x_low
    return tuple(wall.sign * each for each in (past, less(path.v, speed), less(pull, bend)))


def _measured(frame, call, clearance):
    """The least of the clearance and that at the noted turning point, by Newton's steps on the Taylor polynomial."""
    values = (frame.force, frame.frequency, frame.damping)
    jet = flow.jet(*values, call.x, call.v, call.cosine, call.sine, flow.ORDER)
    ways = [course(wall, frame.frequency, call.cosine, call.sine, flow.ORDER) for wall in frame.walls]
    for k in range(flow.ORDER + 1):
        if any(way[k] is not None for way in ways):
            where = [lax.full_like(call.x, 0.0) if way[k] is None else way[k] for way in ways]
            jet[k] = jet[k] - chosen(call.sign, frame.walls, where)
    speeds = [jet[k + 1] * (1.0 / math.factorial(k)) for k in range(flow.ORDER)]
    time = call.time
    for _ in range(NEWTON):
        speed, bend = event.horner(speeds, time)
        time = time - speed / bend
    speed, bend = event.horner(speeds, time)
    found = -call.sign * ((jet[0] + call.x_low) + flow.shift(jet, time))
    settled = lax.abs(speed) <= -(call.sign * bend) * frame.reach * event.landing(time.dtype)
    real = (call.sign != 0) & settled & (time >= 0) & (time <= frame.reach)
    return choose(real, least(found, clearance), clearance)

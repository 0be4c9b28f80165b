"""How close a flight came to a wall without touching it: the clearance at the turning points of x - x_b.

A step that passes a turning point is noted, and measured only when the same lane passes the next: few steps do, and a
block of lanes would else measure at each.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from . import flow, impact
from .lanes import choose, least, stage
from .wall import course, less

NEWTON = 5  # from the secant's guess, kept between its ends; the clearance is flat there
ONCE, LATE, EARLY = 1.0, 2.0, 3.0  # x - x_b turns once in the step, or back and away, or away and back


class Call(NamedTuple):
    """A noted turning point: the step's start and length, and how it turns: ONCE, LATE or EARLY (0: none is noted)."""

    x: jax.Array
    x_low: jax.Array
    v: jax.Array
    cosine: jax.Array
    sine: jax.Array
    time: jax.Array
    kind: jax.Array


def nothing(frame):
    """The calls of a path that begins, one for each wall."""
    none = jnp.zeros_like(frame.force)
    return (Call(*[none] * 7),) * len(frame.walls)


def note(frame, path, step, calls, clearance):
    """(calls, clearance) with the turning points of one more step."""
    kinds = stage(_spot, frame, path, step.flown, step.time)
    kept = []
    for wall, old, kind in zip(frame.walls, calls, kinds, strict=True):
        crowded = jnp.any((old.kind != 0) & (kind != 0))
        measure = partial(_measured, wall=wall)
        clearance = lax.cond(crowded, measure, lambda frame, old, least: least, frame, old, clearance)
        rest = lax.select(jnp.broadcast_to(crowded, kind.shape), jnp.zeros_like(kind), old.kind)
        new = Call(path.x, path.x_low, path.v, path.cosine, path.sine, step.time, kind)
        fresh = kind != 0
        kept.append(jax.tree.map(lambda a, b, fresh=fresh: choose(fresh, a, b), new, old._replace(kind=rest)))
    return tuple(kept), clearance


def close(frame, calls, clearance):
    """The least clearance, once the path has ended."""
    for wall, call in zip(frame.walls, calls, strict=True):
        clearance = _measured(frame, call, clearance, wall)
    return clearance


def _spot(frame, path, flown, time):
    """How a step turned towards each wall, by the speeds at its ends and the accelerations there."""
    free = lax.abs(path.contact) != impact.STUCK
    found = []
    for wall in frame.walls:
        (u, a), (w, b) = _closing(frame, wall, path), _closing(frame, wall, flown)
        once = (u > 0) & (w <= 0)
        late = (u <= 0) & (w <= 0) & (a > 0) & (b < 0) & (u + a * time > 0) & (w - b * time > 0)
        early = (u > 0) & (w > 0) & (a < 0) & (b > 0) & (u + a * time < 0) & (w - b * time < 0)
        kind = choose(late, LATE, choose(early, EARLY, choose(once, ONCE, lax.full_like(time, 0.0))))
        found.append(choose(free, kind, 0.0))
    return tuple(found)


def _closing(frame, wall, path):
    """Speed and acceleration towards the wall."""
    pull = frame.force * path.cosine - path.x - 2.0 * frame.damping * path.v
    _, speed, bend = course(wall, frame.frequency, path.cosine, path.sine, 2)
    return wall.sign * less(path.v, speed), wall.sign * less(pull, bend)


def _measured(frame, call, clearance, wall):
    values = (frame.force, frame.frequency, frame.damping)
    jet = flow.jet(*values, call.x, call.v, call.cosine, call.sine, flow.ORDER)
    way = course(wall, frame.frequency, call.cosine, call.sine, flow.ORDER)
    gap = [wall.sign * less(a, b) for a, b in zip(jet, way, strict=True)]
    kind, none = call.kind, lax.full_like(call.time, 0.0)
    middle = _zero(gap[2:], none, call.time, none)
    low, high = choose(kind == LATE, middle, none), choose(kind == EARLY, middle, call.time)
    falls = (gap[1] + flow.shift(gap[1:], low) > 0) & (gap[1] + flow.shift(gap[1:], high) <= 0)
    time = _zero(gap[1:], low, high, kind)
    found = -((gap[0] + wall.sign * call.x_low) + flow.shift(gap, time))
    return choose((kind != 0) & ((kind == ONCE) | falls), least(found, clearance), clearance)


def _zero(series, low, high, kind):
    """Where the function with these derivatives at 0 passes 0 between two times: Newton's steps, else bisection.

    LATE: it is flat at the lower time, EARLY: at the higher one; the first guess is then a parabola's.
    """

    def value(time):
        return series[0] + flow.shift(series, time)

    first, last = value(low), value(high)
    share = first / (first - last)
    share = choose(kind == LATE, lax.sqrt(lax.abs(share)), share)
    share = choose(kind == EARLY, 1.0 - lax.sqrt(lax.abs(1.0 - share)), share)
    time = low + (high - low) * share
    for _ in range(NEWTON):
        here = value(time)
        before = (here > 0) == (first > 0)
        low, high = choose(before, time, low), choose(before, high, time)
        time = time - here / (series[1] + flow.shift(series[1:], time))
        time = choose((time >= low) & (time <= high), time, 0.5 * (low + high))
    return time

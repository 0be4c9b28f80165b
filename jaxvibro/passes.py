"""How close the flights of a cycle come to the walls between their impacts, and how deep behind them.

A flight is sampled; where x - x_b turns back between two samples, the turning point is found by Newton's steps. This
measures; whether an orbit is one is decided by certified flights (`solve`).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from . import flow
from .path import accelerations
from .wall import course, less

TURN = 0.1  # between samples, of the fastest angle: the drive's, a wall's, the free oscillation's, in radians
ROUNDS = 4  # of Newton's steps from a parabola's guess


class Flight(NamedTuple):
    """What is asked of flights: how long they are, x, v and the drive's cosine and sine at their start, (rows,) each.
    `cycle.Flights` have these too."""

    time: jax.Array
    x: jax.Array
    v: jax.Array
    cosine: jax.Array
    sine: jax.Array


def samples(frame, found):
    """How many samples the longest of some flights needs."""
    return jnp.ceil(jnp.max(found.time) / (TURN * frame.reach)).astype(int) + 8


def clearances(frame, found, samples):
    """The least distance to each wall at a turning point of a flight towards it, and its time since the flight's start.

    found: the `cycle.Flights`. Shapes (rows, walls); inf where there is none. Below 0 the flight passes through.
    """
    span = found.time / samples
    cells = _nearest(frame, found, span, samples)
    times, distances = [], []
    for one, (crest, cell, past) in enumerate(cells):

        def nearer(_, carry, one=one, cell=cell):
            time, _ = carry
            distance, closing, bending = relative(frame, found, time)[one]
            step = closing / jnp.where(bending == 0, 1.0, bending)
            return jnp.clip(time - step, cell * span, (cell + 1.0) * span), distance + 0.5 * step * closing

        time, distance = lax.fori_loop(0, ROUNDS, nearer, ((cell + past) * span, jnp.zeros_like(span)))
        times.append(time)
        distances.append(jnp.where(jnp.isfinite(crest), distance, jnp.inf))
    return jnp.stack(distances, -1), jnp.stack(times, -1)


def relative(frame, found, time):
    """For each wall: the distance to it, speed and acceleration towards it, a time after each flight's start."""
    free, forced, angle = flow.doubled(frame.series, frame.frequency, frame.damping, time)
    x, v = flow.flown((free, forced), frame.force * found.cosine, frame.force * found.sine, found.x, found.v)
    return _towards(frame, x, v, *flow.turn(found.cosine, found.sine, *angle))


def _towards(frame, x, v, cosine, sine):
    pull, _ = accelerations(frame, x, v, cosine, sine)
    found = []
    for wall in frame.walls:
        where, pace, bend = course(wall, frame.frequency, cosine, sine, 2)
        found.append((wall.sign * (where - x), wall.sign * less(v, pace), wall.sign * less(pull, bend)))
    return found


def _nearest(frame, found, span, samples):
    """For each wall the nearest turning point, as a parabola sees it: (its distance, inf: none; the samples' cell; how
    far into the cell)."""
    free, forced, (versed, sined) = flow.doubled(frame.series, frame.frequency, frame.damping, span)
    none = jnp.zeros_like(span)

    def advance(k, carry):
        (x, v, cosine, sine), before, best = carry
        x, v = flow.flown((free, forced), frame.force * cosine, frame.force * sine, x, v)
        place = x, v, *flow.turn(cosine, sine, versed, sined)
        after = [each[:2] for each in _towards(frame, *place)]
        best = [_better(k, span, *each) for each in zip(before, after, best, strict=True)]
        return place, after, best

    place = found.x, found.v, found.cosine, found.sine
    start = [each[:2] for each in _towards(frame, *place)]
    best = [(none + jnp.inf, none, none) for _ in frame.walls]
    return lax.fori_loop(0, samples, advance, (place, start, best))[2]


def _better(k, span, before, after, best):
    """The nearer of the best turning point so far and that of a cell."""
    (distance, closing), (_, end) = before, after
    turns = (closing > 0) & (end <= 0)
    past = closing / jnp.where(turns, closing - end, 1.0)
    crest = distance - 0.5 * closing * past * span
    new = (crest, k + jnp.zeros_like(span), past)
    return jax.tree.map(lambda new, old: jnp.where(turns & (crest < best[0]), new, old), new, best)

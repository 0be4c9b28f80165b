"""How close the flights of a cycle come to the walls between their impacts, and how deep behind them.

A flight is sampled; where x - x_b turns back between two samples, the turning point is found by Newton's steps. This
measures; whether an orbit is one is decided by certified flights (`by_impacts`).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from continuation.arrays import Array

from ..flight.flows import flow_of
from ..flight.wall import course, less

TURN = 0.1  # between samples, of the fastest angle: the drive's, a wall's, the free oscillation's, in radians
ROUNDS = 5  # of Newton's steps from a parabola's guess
TOUCH = 1e-8  # of the scene's length: a clearance or a speed (length per t) as small is zero
OVERLAP = 1.0625  # of its periods, that the flight of a motion without impacts is looked at
CLOSE = 1e-3  # of the samples' distance: Newton's last step at a turning point


class Flight(NamedTuple):
    """What is asked of flights: how long they are, x, v and the drive's cosine and sine at their start, (rows,) each.
    `impact_equations.Flights` have these too."""

    time: Float[Array, " rows"]
    x: Float[Array, " rows"]
    v: Float[Array, " rows"]
    cosine: Float[Array, " rows"]
    sine: Float[Array, " rows"]


def without_impacts(frame, phase, periods, x, v):
    """The one `Flight` of a periodic motion that hits no wall, from x, v at a phase: over a little more than its
    periods."""
    start = OVERLAP * periods * frame.period, x, v, jnp.cos(phase), jnp.sin(phase)
    return Flight(*(jnp.reshape(each, 1) for each in start))


def samples(frame, found):
    """How many samples the longest of some flights needs."""
    reach = flow_of(frame).shortest(frame, found)
    return jnp.ceil(jnp.max(found.time) / (TURN * reach)).astype(int) + 8


def clearances(frame, found, samples):
    """The least distance to each wall at a turning point of a flight towards it, and its time since the flight's start.

    found: the `impact_equations.Flights`. Shapes (rows, walls); inf where there is none. Below 0 the flight passes
    through.
    """
    if not frame.walls:
        none = jnp.zeros((len(found.time), 0), found.time.dtype)
        return none, none
    span = found.time / samples
    crest, cell, past = (jnp.stack(each) for each in zip(*_nearest(frame, found, span, samples), strict=True))

    def nearer(_, carry):
        time, _, _ = carry
        every = relative(frame, found, time)
        distance, closing, bending = (jnp.stack([one[k][j] for j, one in enumerate(every)]) for k in range(3))
        step = closing / jnp.where(bending == 0, 1.0, bending)
        turned = jnp.clip(time - step, cell * span, (cell + 1.0) * span)
        return turned, distance + 0.5 * step * closing, (bending < 0) & (abs(step) <= CLOSE * span)

    start = (cell + past) * span, jnp.zeros_like(crest), jnp.zeros_like(crest, bool)
    time, distance, real = lax.fori_loop(0, ROUNDS, nearer, start)
    return jnp.where(jnp.isfinite(crest) & real, distance, jnp.inf).T, time.T


def is_real(frame, found, speeds, grazes=False):
    """Whether flights keep to their walls, and hit them with positive speeds one after the other. grazes:
    whether the first is one that is to have none."""
    clear, _ = clearances(frame, found, samples(frame, found))
    hit = speeds[1:] if grazes else speeds
    slack = TOUCH * frame.size if grazes else 0.0
    return jnp.all(hit > 0) & jnp.all(clear >= -slack) & jnp.all(found.time > 0)


def place(frame, found, time):
    """(x, v, the drive's cosine and sine) a time after each flight's start."""
    return flow_of(frame).fly(frame, found.x, found.v, found.cosine, found.sine, time)


def relative(frame, found, time):
    """For each wall: the distance to it, speed and acceleration towards it, a time after each flight's start."""
    return _towards(frame, *place(frame, found, time))


def _towards(frame, x, v, cosine, sine):
    pull, _ = flow_of(frame).accelerations(frame, x, v, cosine, sine)
    found = []
    for wall in frame.walls:
        where, pace, bend = course(wall, frame.frequency, cosine, sine, 2)
        found.append((wall.sign * (where - x), wall.sign * less(v, pace), wall.sign * less(pull, bend)))
    return found


def _nearest(frame, found, span, samples):
    """For each wall the nearest turning point as the samples see it: (its distance, inf: none; the samples' cell; how
    far into the cell Newton's steps begin)."""
    none, onwards = jnp.zeros_like(span), flow_of(frame).repeated(frame, span)

    def advance(k, carry):
        place, before, best = carry
        there = onwards(*place)
        after = _towards(frame, *there)
        best = [_better(k, span, *each) for each in zip(before, after, best, strict=True)]
        return there, after, best

    start = found.x, found.v, found.cosine, found.sine
    best = [(none + jnp.inf, none, none) for _ in frame.walls]
    return lax.fori_loop(0, samples, advance, (start, _towards(frame, *start), best))[2]


def _better(k, span, before, after, best):
    """The nearer of the best turning point so far and those of a cell: where the speed towards the wall ends, once; or
    where, as its slopes say, it may rise above zero and end within the cell, or end and begin again."""
    (distance, closing, bending), (low, end, slope) = before, after
    once = (closing > 0) & (end <= 0)
    rises = (closing <= 0) & (end <= 0) & (bending > 0) & (slope < 0)
    dips = (closing > 0) & (end > 0) & (bending < 0) & (slope > 0)
    safe = jnp.where(span > 0, span, 1.0)
    bend = jnp.where(rises | dips, (slope - bending) / safe, 1.0)
    height = closing - bending * (end - slope * span - closing) / (bend * safe)  # where the slopes' lines meet
    take = once | (rises & (height > 0)) | (dips & (height < 0))
    # where a parabola through the end with the smaller slope falls through zero
    first = abs(bending) < abs(slope)
    speed, pull, begin = (jnp.where(first, *each) for each in ((closing, end), (bending, slope), (0.0, span)))
    turn = begin - (pull + jnp.sqrt(jnp.maximum(pull * pull - 2.0 * bend * speed, 0.0))) / bend
    mean = closing / jnp.where(once, closing - end, 1.0)
    past = jnp.where(once, mean, jnp.clip(turn / safe, 0.0, 1.0))
    crest = jnp.where(once, distance - 0.5 * closing * mean * span, jnp.minimum(distance, low))
    new = (crest, k + jnp.zeros_like(span), past)
    take &= crest < best[0]
    return jax.tree.map(lambda new, old: jnp.where(take, new, old), new, best)

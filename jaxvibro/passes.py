"""How close the flights of a cycle come to the walls between their impacts, and how deep behind them.

A flight is sampled; where x - x_b turns back between two samples, the turning point is found by Newton's steps. This
measures; whether an orbit is one is decided by certified flights (`solve`).
"""

import jax.numpy as jnp
from jax import lax

from . import flow
from .path import accelerations
from .wall import course, less

SAMPLES = 256  # of a flight
ROUNDS = 6  # of Newton's steps from a parabola's guess


def clearances(frame, found):
    """The least distance to each wall at a turning point of a flight towards it, and its time since the flight's start.

    found: the `cycle.Flights`. Shapes (rows, walls); inf where there is none. Below 0 the flight passes through.
    """
    times = found.time[:, None] * (jnp.arange(SAMPLES + 1) / SAMPLES)
    seen = _towards(frame, *_flown(frame, found, times))
    low, high, guess, turns = (jnp.stack(each, -1) for each in zip(*(_cell(times, *one) for one in seen), strict=True))

    def nearer(_, carry):
        time, _ = carry
        rows = _towards(frame, *_flown(frame, found, time))
        distance, closing, bending = (jnp.stack([one[k][:, j] for j, one in enumerate(rows)], -1) for k in range(3))
        step = closing / jnp.where(bending == 0, 1.0, bending)
        return jnp.clip(time - step, low, high), distance + 0.5 * step * closing

    time, distance = lax.fori_loop(0, ROUNDS, nearer, (guess, jnp.zeros_like(guess)))
    return jnp.where(turns, distance, jnp.inf), time


def _flown(frame, found, times):
    """x, v and the drive's cosine and sine at times (rows, any number) after the starts of the flights."""
    x, v, cosine, sine = (
        jnp.broadcast_to(each[:, None], times.shape) for each in (found.x, found.v, found.cosine, found.sine)
    )
    free, forced, angle = flow.doubled(frame.series, frame.frequency, frame.damping, times)
    x, v = flow.flown((free, forced), frame.force * cosine, frame.force * sine, x, v)
    return x, v, *flow.turn(cosine, sine, *angle)


def _towards(frame, x, v, cosine, sine):
    """For each wall: the distance to it, speed and acceleration towards it."""
    pull, _ = accelerations(frame, x, v, cosine, sine)
    found = []
    for wall in frame.walls:
        where, pace, bend = course(wall, frame.frequency, cosine, sine, 2)
        found.append((wall.sign * (where - x), wall.sign * less(v, pace), wall.sign * less(pull, bend)))
    return found


def _cell(times, distance, closing, _):
    """The turning point nearest to a wall: the samples' times before and after it, a guess, whether there is any."""
    before, after, span = closing[:, :-1], closing[:, 1:], times[:, 1:] - times[:, :-1]
    turns = (before > 0) & (after <= 0)
    past = before / jnp.where(turns, before - after, 1.0)
    crest = jnp.where(turns, distance[:, :-1] - 0.5 * before * past * span, jnp.inf)
    cell = jnp.argmin(crest, axis=1)[:, None]
    low, high, guess = (
        jnp.take_along_axis(each, cell, 1)[:, 0] for each in (times[:, :-1], times[:, 1:], times[:, :-1] + past * span)
    )
    return low, high, guess, jnp.any(turns, axis=1)

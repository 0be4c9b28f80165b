"""A path from step to step: one flat loop over a block of lanes, and what the lanes leave behind.

At each turn every lane flies a step, lands and rebounds, or is done. The loop pauses where a turning point has to be
measured or impacts have to be put into their slots: work that is the same for all lanes and rarely due.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from . import clearance, log
from .flight import micro
from .impact import STUCK
from .lanes import choose
from .path import CAPPED, Path

IMPACTS = 1000  # of one lane in one period, the cap
STEPS = 8  # times the steps that a flight alone would take, the cap on the rest
MOST_STEPS = 1e6  # of one lane in one period: more would be a hang
GOING, FULL, CROWDED = 1, 2, 4  # what a lane may need: another step, its impacts in their slots, a measurement


class Journey(NamedTuple):
    """Where the lanes are, their impacts, their closest calls (none where there is no wall)."""

    path: Path
    log: log.Log
    slots: log.Slots
    calls: clearance.Calls | None


class Cap(NamedTuple):
    """How many impacts a lane may have, and how many steps it may take."""

    impacts: jax.Array
    steps: jax.Array


def begin(frame, path, slots, end, watched=True):
    """A `Journey` that has not begun; end: when the time to go is used up; watched: with closest calls."""
    calls = clearance.nothing(path.x) if frame.walls and watched else None
    return Journey(path, *log.empty(path.x, slots, end), calls)


def cap(frame, periods):
    """The `Cap` for some drive periods."""
    steps = 4.0 * IMPACTS + lax.min(STEPS * frame.period / frame.reach, lax.full_like(frame.period, MOST_STEPS))
    return Cap(lax.full_like(frame.period, IMPACTS * periods), steps * periods)


def run(frame, journey, cap, again=None):
    """The journey when no lane has time to go; again: gives the lanes that have ended a period their next."""
    walls, watched = bool(frame.walls), journey.calls is not None

    def turn(journey):
        step = micro(frame, journey.path)
        stuck = lax.abs(journey.path.contact) == STUCK
        book = log.write(journey.log, step.side, stuck, step.strike, step.path.rest)
        calls = clearance.note(frame, journey.path, step, journey.calls) if watched else None
        journey = journey._replace(path=step.path, log=book, calls=calls)
        journey = again(journey) if again else journey
        over = (journey.log.count >= cap.impacts) | (journey.log.steps > cap.steps)
        rest = choose(over & (journey.path.rest > 0), CAPPED, journey.path.rest)
        return journey._replace(path=journey.path._replace(rest=rest))

    def leg(journey):
        slots, journey = journey.slots, journey._replace(slots=None)
        journey = lax.while_loop(lambda j: _need(j) == GOING, turn, journey)
        need = _need(journey)
        over = (need & GOING) == 0
        pours, measures = over | ((need & FULL) != 0), over | ((need & CROWDED) != 0)
        book, slots = lax.cond(pours, log.pour, lambda *same: same, journey.log, slots)
        calls = journey.calls
        if watched:
            calls = lax.cond(measures, lambda calls: clearance.measure(frame, calls), lambda same: same, calls)
        return journey._replace(log=book, slots=slots, calls=calls)

    def pending(journey):
        return jnp.any((journey.path.rest > 0) | (journey.calls.noted.mark != 0))

    def going(journey):
        return jnp.any(journey.path.rest > 0)

    return lax.while_loop(pending if watched else going, leg if walls else turn, journey)


def _need(journey):
    """What some lane needs: a sum of GOING, FULL and CROWDED."""
    need = choose(journey.path.rest > 0, jnp.int8(GOING), jnp.int8(0))
    need |= choose(log.is_full(journey.log), jnp.int8(FULL), jnp.int8(0))
    if journey.calls is not None:
        need |= choose(clearance.is_crowded(journey.calls), jnp.int8(CROWDED), jnp.int8(0))
    return lax.reduce(need, jnp.int8(0), lax.bitwise_or, tuple(range(need.ndim)))

"""A path from step to step: one flat loop over a block of lanes, and what the lanes leave behind.

At each turn every lane flies a step, lands and rebounds, or is done. The loop pauses where a turning point has to be
measured or impacts have to be put into their slots: work that is the same for all lanes and rarely due.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, mask, merge, stage
from ..scene.codes import Contact
from . import impact_log, soft_long_step, turning_points
from .flight_state import CAPPED, Path
from .soft_contact import is_inside
from .stays import stays_of
from .step import micro

IMPACTS = 1000  # of one lane in one period, the cap
STEPS = 8  # times the steps that a flight alone would take, the cap on the rest
MOST_STEPS = 1e6  # of one lane in one period: more would be a hang
# what a lane may need: another step, its impacts in their slots, a measurement, a long step
GOING, FULL, CROWDED, WAITING = 1, 2, 4, 8


class Journey(NamedTuple):
    """Where the lanes are, their impacts, their closest calls (None where not asked for, or without a wall).

    freed: when the mass was last released from a wall, -1 if never; steps: taken so far, one number for all lanes;
    wait: steps taken within a soft wall since it was entered, or a long one tried; None where there is no soft wall.
    """

    path: Path
    log: impact_log.Log
    slots: impact_log.Slots
    calls: turning_points.Calls | None
    freed: Float[jax.Array, "..."]
    steps: Float[jax.Array, ""]
    wait: Float[jax.Array, "..."] | None = None


class Cap(NamedTuple):
    """How many impacts a lane may have, and how many steps it may take."""

    impacts: Float[jax.Array, "..."]
    steps: Float[jax.Array, "..."]


def begin(frame, path, slots, end, clearance=False, late=0):
    """A `Journey` that has not begun; end: when the time to go is used up; clearance: with closest calls; late: see
    `impact_log.empty`."""
    calls = turning_points.nothing(path.x) if frame.walls and clearance else None
    none = jnp.zeros_like(path.x)
    steps = jnp.zeros((), path.x.dtype)
    wait = stays_of(frame).unbegun(none)
    return Journey(path, *impact_log.empty(path.x, slots, end, late), calls, none - 1.0, steps, wait)


def cap(frame, periods):
    """The `Cap` for some drive periods."""
    reach = stays_of(frame).reach(frame)
    steps = 4.0 * IMPACTS + lax.min(STEPS * frame.period / reach, lax.full_like(frame.period, MOST_STEPS))
    return Cap(lax.full_like(frame.period, IMPACTS * periods), steps * periods)


def run(frame, journey, cap, again=None):
    """The journey when no lane has time to go; again: gives the lanes that have ended a period their next."""
    walls, watched, stays = bool(frame.walls), journey.calls is not None, stays_of(frame)

    def turn(journey):
        step = micro(frame, journey.path)
        rest, contact = step.path.to_go, journey.path.contact
        book, released = journey.log, stage(_freed, step.side, contact)
        freed = merge(released, stage(_ended, book, rest), journey.freed)
        if book.since is not None:
            book = book._replace(since=merge(released, book.count, book.since))
        side = stage(_struck, step.side, contact)
        book = impact_log.write(book, side, step.strike.speed, step.strike.least, rest, freed)
        calls = turning_points.note(frame, journey.path, step, journey.calls) if watched else None
        wait = None if journey.wait is None else stage(_waited, journey.wait, step.path.contact)
        journey = journey._replace(path=step.path, log=book, calls=calls, freed=freed, wait=wait)
        journey = journey._replace(steps=journey.steps + 1.0)
        journey = again(journey) if again else journey
        path = journey.path
        over = ((journey.log.count >= cap.impacts) | (journey.steps > cap.steps)) & (path.to_go > 0)
        # with a low part left, the next step would round CAPPED to a time that has been used up
        to_go, low = choose(over, CAPPED, path.to_go), choose(over, 0.0, path.to_go_low)
        return journey._replace(path=path._replace(to_go=to_go, to_go_low=low))

    def leg(journey):
        slots, journey = journey.slots, journey._replace(slots=None)
        journey = lax.while_loop(lambda journey: _need(stays, journey) == GOING, turn, journey)
        if journey.wait is not None:
            need = _need(stays, journey)
            waits = (need & WAITING) != 0, (need & GOING) == 0
            path, wait = stays.paused(frame, journey.path, journey.wait, *waits)
            journey = journey._replace(path=path, wait=wait)
            journey = again(journey) if again else journey
        need = _need(stays, journey)
        over = (need & GOING) == 0
        pours, measures = over | ((need & FULL) != 0), over | ((need & CROWDED) != 0)
        book, slots = lax.cond(pours, impact_log.pour, lambda *same: same, journey.log, slots)
        calls = journey.calls
        if watched:
            calls = lax.cond(measures, lambda calls: turning_points.measure(frame, calls), lambda same: same, calls)
        return journey._replace(log=book, slots=slots, calls=calls)

    def pending(journey):
        return jnp.any((journey.path.to_go > 0) | (journey.calls.noted.mark != 0))

    def going(journey):
        return jnp.any(journey.path.to_go > 0)

    return lax.while_loop(pending if watched else going, leg if walls else turn, journey)


def _freed(side, contact):
    return mask((lax.abs(contact) == Contact.STUCK) & (side != 0), side)


def _struck(side, contact):
    """The sides of impacts: those of a mass that rested on a wall, or was within one, set it free."""
    return choose((lax.abs(contact) == Contact.STUCK) | is_inside(contact), 0.0, side)


def _ended(log, rest):
    """The time of an event, with so much to go."""
    return log.end - rest


def _waited(wait, contact):
    return choose(is_inside(contact), wait + 1.0, 0.0)


def _need(stays, journey):
    """What some lane needs: a sum of GOING, FULL, CROWDED and WAITING."""
    need = choose(stays.going(journey.path).to_go > 0, jnp.int8(GOING), jnp.int8(0))
    need |= choose(impact_log.is_full(journey.log), jnp.int8(FULL), jnp.int8(0))
    if journey.calls is not None:
        need |= choose(turning_points.is_crowded(journey.calls), jnp.int8(CROWDED), jnp.int8(0))
    if journey.wait is not None:
        need |= choose(soft_long_step.is_due(journey.path, journey.wait), jnp.int8(WAITING), jnp.int8(0))
    return lax.reduce(need, jnp.int8(0), lax.bitwise_or, tuple(range(need.ndim))) if need.ndim else need

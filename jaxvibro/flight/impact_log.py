"""What a path leaves behind: its impacts in slots, and how far it has come."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, least, mask, merge, stage
from ..scene.codes import Contact
from .soft_contact import is_inside

RECENT = 4  # impacts kept at hand; the slots are touched only where a lane has more, and at the end


class Log(NamedTuple):
    """times, speeds: of the recent impacts, the speed with its wall's sign; held: how many of them; count: of all
    (floats like the rest, as mixed types are slow); freed: when the mass was last released from a wall, -1 if never;
    end: when the time to go is used up; steps: taken so far, one number for all lanes."""

    times: tuple[Float[jax.Array, "*lanes"], ...]
    speeds: tuple[Float[jax.Array, "*lanes"], ...]
    held: Float[jax.Array, "*lanes"]
    count: Float[jax.Array, "*lanes"]  # type: ignore[assignment]  # a tuple has a method of this name
    least_speed: Float[jax.Array, "*lanes"]
    freed: Float[jax.Array, "*lanes"]
    end: Float[jax.Array, "..."]
    steps: Float[jax.Array, ""]


class Slots(NamedTuple):
    """Times and speeds of all impacts, lanes first, slots last."""

    times: Float[jax.Array, "*lanes slots"]
    speeds: Float[jax.Array, "*lanes slots"]


def empty(lanes, slots, end):
    """(log, slots) of no impacts for lanes like these."""
    none, never = jnp.zeros_like(lanes), jnp.full_like(lanes, jnp.inf)
    recent = min(RECENT, slots)
    log = Log((never,) * recent, (none,) * recent, none, none, never, none - 1.0, end, jnp.zeros((), lanes.dtype))
    shape = (*lanes.shape, slots)
    return log, Slots(jnp.full(shape, jnp.inf, lanes.dtype), jnp.zeros(shape, lanes.dtype))


def write(log, side, contact, strike, rest):
    """The log with one step more: the `impact.Strike` of each lane with a side, with so much time to go.

    contact: before it. A side is no impact where the mass rested on a wall, or was within one: it is set free.
    """
    freed, side = stage(_freed, side, contact), stage(_struck, side, contact)
    time, signed, slower, *places = stage(_due, log, side, strike, rest)
    return log._replace(
        times=tuple(merge(*each) for each in zip(places, [time] * RECENT, log.times, strict=False)),
        speeds=tuple(merge(*each) for each in zip(places, [signed] * RECENT, log.speeds, strict=False)),
        held=log.held + lax.abs(side),
        count=log.count + lax.abs(side),
        least_speed=slower,
        freed=merge(freed, time, log.freed),
        steps=log.steps + 1.0,
    )


def _freed(side, contact):
    return mask((lax.abs(contact) == Contact.STUCK) & (side != 0), side)


def _struck(side, contact):
    return choose((lax.abs(contact) == Contact.STUCK) | is_inside(contact), 0.0, side)


def _due(log, side, strike, rest):
    hit = side != 0
    places = [mask(hit & (log.held == k), rest) for k in range(len(log.times))]
    return (
        log.end - rest,
        side * strike.speed,
        choose(hit, least(strike.least, log.least_speed), log.least_speed),
        *places,
    )


def is_full(log):
    """The lanes that hold as many impacts as they can: then `pour` is due."""
    return log.held >= RECENT


def pour(log, slots):
    """(log, slots) with the impacts at hand put into their slots, and nothing into those that follow."""
    last = slots.times.ndim - 1
    place = lax.broadcasted_iota(log.count.dtype, slots.times.shape, last)
    place = place - lax.expand_dims(log.count - log.held, [last])

    def put(recent, empty, old):
        for k, each in enumerate(recent):
            old = choose(place == k, lax.expand_dims(choose(log.held > k, each, empty), [last]), old)
        return old

    slots = Slots(put(log.times, jnp.inf, slots.times), put(log.speeds, 0.0, slots.speeds))
    return log._replace(held=jnp.zeros_like(log.held)), slots

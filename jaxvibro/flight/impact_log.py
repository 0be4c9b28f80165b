"""What a path leaves behind: its impacts in slots, and how far it has come."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose, least, mask, merge, stage

RECENT = 4  # impacts kept at hand; the slots are touched only where a lane has more, and at the end


class Log(NamedTuple):
    """times, speeds: of the recent impacts, the speed with its wall's sign; held: how many of them; count: of all
    (floats like the rest, as mixed types are slow); end: when the time to go is used up."""

    times: tuple[Float[jax.Array, "*lanes"], ...]
    speeds: tuple[Float[jax.Array, "*lanes"], ...]
    held: Float[jax.Array, "*lanes"]
    count: Float[jax.Array, "*lanes"]  # type: ignore[assignment]  # a tuple has a method of this name
    least_speed: Float[jax.Array, "*lanes"]
    end: Float[jax.Array, "..."]


class Slots(NamedTuple):
    """Times and signed speeds of all impacts, slots first, lanes last."""

    times: Float[jax.Array, "slots ..."]
    speeds: Float[jax.Array, "slots ..."]


def empty(lanes, slots, end):
    """(log, slots) of no impacts for lanes like these."""
    none, never = jnp.zeros_like(lanes), jnp.full_like(lanes, jnp.inf)
    recent = min(RECENT, slots)
    log = Log((never,) * recent, (none,) * recent, none, none, never, end)
    shape = (slots, *lanes.shape)
    return log, Slots(jnp.full(shape, jnp.inf, lanes.dtype), jnp.zeros(shape, lanes.dtype))


def write(log, side, speed, slowest, rest):
    """The log with one step more: an impact of each lane with a side, at a speed, with so much time to go.

    slowest: the least speed that comes of it.
    """
    time, signed, slower, *places = stage(_due, log, side, speed, slowest, rest)
    return log._replace(
        times=tuple(merge(*each) for each in zip(places, [time] * RECENT, log.times, strict=False)),
        speeds=tuple(merge(*each) for each in zip(places, [signed] * RECENT, log.speeds, strict=False)),
        held=log.held + lax.abs(side),
        count=log.count + lax.abs(side),
        least_speed=slower,
    )


def _due(log, side, speed, slowest, rest):
    hit = side != 0
    places = [mask(hit & (log.held == k), rest) for k in range(len(log.times))]
    least_speed = choose(hit, least(slowest, log.least_speed), log.least_speed)
    return log.end - rest, side * speed, least_speed, *places


def is_full(log):
    """The lanes that hold as many impacts as they can: then `pour` is due."""
    return log.held >= RECENT


def pour(log, slots):
    """(log, slots) with the impacts at hand put into their slots, and nothing into those that follow."""
    place = lax.broadcasted_iota(log.count.dtype, slots.times.shape, 0) - lax.expand_dims(log.count - log.held, [0])

    def put(recent, empty, old):
        for k, each in enumerate(recent):
            old = choose(place == k, lax.expand_dims(choose(log.held > k, each, empty), [0]), old)
        return old

    slots = Slots(put(log.times, jnp.inf, slots.times), put(log.speeds, 0.0, slots.speeds))
    return log._replace(held=jnp.zeros_like(log.held)), slots


def rows(slots):
    """(times, sides, speeds) of the impacts, lanes first, as `Impacts` has them."""
    order = (*range(1, slots.times.ndim), 0)
    sides = (slots.speeds > 0).astype(jnp.int8) - (slots.speeds < 0).astype(jnp.int8)
    return [lax.transpose(each, order) for each in (slots.times, sides, lax.abs(slots.speeds))]

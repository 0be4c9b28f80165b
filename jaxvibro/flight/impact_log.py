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
    (floats like the rest, as mixed types are slow); end: when the time to go is used up. Where a replay is to come,
    else () and None: freed, when the mass was last released from a wall before each recent impact, -1: never; since:
    the count of impacts up to the last release."""

    times: tuple[Float[jax.Array, "*lanes"], ...]
    speeds: tuple[Float[jax.Array, "*lanes"], ...]
    held: Float[jax.Array, "*lanes"]
    count: Float[jax.Array, "*lanes"]  # type: ignore[assignment]  # a tuple has a method of this name
    least_speed: Float[jax.Array, "*lanes"]
    end: Float[jax.Array, "..."]
    freed: tuple[Float[jax.Array, "*lanes"], ...] = ()
    since: Float[jax.Array, "*lanes"] | None = None


class Slots(NamedTuple):
    """Times and signed speeds of the first impacts, slots first, lanes last. Where a replay is to come, else None:
    freed, of each as in the `Log`; late: times and speeds of the first impacts since the last release, with others
    beyond as many as there are."""

    times: Float[jax.Array, "slots ..."]
    speeds: Float[jax.Array, "slots ..."]
    freed: Float[jax.Array, "slots ..."] | None = None
    late: tuple[Float[jax.Array, "late ..."], Float[jax.Array, "late ..."]] | None = None


def empty(lanes, slots, end, late=0):
    """(log, slots) of no impacts for lanes like these; late: slots for those since the last release, 0: no replay."""
    none, never = jnp.zeros_like(lanes), jnp.full_like(lanes, jnp.inf)
    recent = min(RECENT, max(slots, late))
    log = Log((never,) * recent, (none,) * recent, none, none, never, end)

    def rows(count, value):
        return jnp.full((count, *lanes.shape), value, lanes.dtype)

    first = Slots(rows(slots, jnp.inf), rows(slots, 0.0))
    if not late:
        return log, first
    log = log._replace(freed=(none - 1.0,) * recent, since=none)
    return log, first._replace(freed=rows(slots, -1.0), late=(rows(late, jnp.inf), rows(late, 0.0)))


def write(log, side, speed, slowest, rest, freed=None):
    """The log with one step more: an impact of each lane with a side, at a speed, with so much time to go.

    slowest: the least speed that comes of it; freed: when the mass was last released.
    """
    time, signed, slower, *places = stage(_due, log, side, speed, slowest, rest)
    return log._replace(
        times=tuple(merge(*each) for each in zip(places, [time] * RECENT, log.times, strict=False)),
        speeds=tuple(merge(*each) for each in zip(places, [signed] * RECENT, log.speeds, strict=False)),
        freed=tuple(merge(*each) for each in zip(places, [freed] * RECENT, log.freed, strict=False)),
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
    first = log.count - log.held

    def put(recent, empty, old, first):
        if not len(old):
            return old
        place = lax.broadcasted_iota(first.dtype, old.shape, 0) - lax.expand_dims(first, [0])
        for k, each in enumerate(recent):
            old = choose(place == k, lax.expand_dims(choose(log.held > k, each, empty), [0]), old)
        return old

    def pair(rows, first):
        return put(log.times, jnp.inf, rows[0], first), put(log.speeds, 0.0, rows[1], first)

    poured = Slots(*pair(slots[:2], first))
    if slots.late is not None:
        late = pair(slots.late, first - log.since)
        poured = poured._replace(freed=put(log.freed, -1.0, slots.freed, first), late=late)
    return log._replace(held=jnp.zeros_like(log.held)), poured


def late(log, slots):
    """(times, signed speeds, count) of the impacts since the last release, slots first."""
    count = log.count - log.since
    (times, speeds), place = slots.late, lax.broadcasted_iota(log.count.dtype, slots.late[0].shape, 0)
    there = place < lax.expand_dims(count, [0])
    return choose(there, times, jnp.inf), choose(there, speeds, 0.0), count


def rows(slots):
    """(times, sides, speeds) of the impacts, lanes first, as `Impacts` has them."""
    order = (*range(1, slots.times.ndim), 0)
    sides = (slots.speeds > 0).astype(jnp.int8) - (slots.speeds < 0).astype(jnp.int8)
    return [lax.transpose(each, order) for each in (slots.times, sides, lax.abs(slots.speeds))]

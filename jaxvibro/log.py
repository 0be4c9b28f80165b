"""What a path leaves behind: its impacts in slots, its closest calls, and how far it has come."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from .lanes import choose, least

HEAD = 4  # slots that most lanes do with: the others are touched only where one needs more


class Log(NamedTuple):
    """Slots first, then lanes. times, speeds: of the impacts, the speed with its wall's sign; clearance: the least
    measured, call: the turning points still to be (see `clearance`)."""

    times: tuple[jax.Array, ...]
    speeds: tuple[jax.Array, ...]
    count: jax.Array
    least_speed: jax.Array
    clearance: jax.Array
    call: tuple
    periods: jax.Array
    turns: jax.Array
    steps: jax.Array


def empty(lanes, slots, periods, call):
    """A log of no impacts for lanes like these."""
    parts = [part for part in (min(slots, HEAD), slots - min(slots, HEAD)) if part]
    none, whole = jnp.full_like(lanes, jnp.inf), jnp.zeros_like(lanes, dtype=jnp.int32)
    return Log(
        tuple(jnp.full((part, *lanes.shape), jnp.inf, lanes.dtype) for part in parts),
        tuple(jnp.zeros((part, *lanes.shape), lanes.dtype) for part in parts),
        whole,
        none,
        none,
        call,
        whole + periods,
        whole + periods,
        whole,
    )


def write(log, hit, side, speed, time, seen, going):
    """The log with one step more: of each lane that is going, an impact where it hit."""
    times, speeds, start = [], [], 0
    for old_times, old_speeds in zip(log.times, log.speeds, strict=True):
        slots = lax.broadcasted_iota(jnp.int32, old_times.shape, 0) + start
        here = (slots == log.count) & hit

        def put(here=here, old_times=old_times, old_speeds=old_speeds):
            def spread(value):
                return jnp.broadcast_to(value, old_times.shape)

            return lax.select(here, spread(time), old_times), lax.select(here, spread(side * speed), old_speeds)

        def keep(old_times=old_times, old_speeds=old_speeds):
            return old_times, old_speeds

        late = start and lax.cond(jnp.any(hit & (log.count >= start)), put, keep)
        new_times, new_speeds = late or put()
        times.append(new_times)
        speeds.append(new_speeds)
        start += old_times.shape[0]
    return log._replace(
        times=tuple(times),
        speeds=tuple(speeds),
        count=log.count + hit.astype(jnp.int32),
        least_speed=choose(hit, least(speed, log.least_speed), log.least_speed),
        call=seen[0],
        clearance=seen[1],
        steps=log.steps + going.astype(jnp.int32),
    )

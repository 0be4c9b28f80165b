"""What a path leaves behind: its impacts in slots, and how far it has come."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import bit_mask, choose, merge_bits, minimum, stage

MAX_RECENT = 4  # impacts kept at hand; the slots are touched only where a lane has more, and at the end


class ImpactLog(NamedTuple):
    """times, speeds: of the recent impacts, the speed with its wall's sign; n_recent: how many of them; count: of all
    (floats like the rest, as mixed types are slow); end_time: when the time to go is used up. Where a replay is to
    come, else () and None: freed, when the mass was last released from a wall before each recent impact, -1: never;
    since: the count of impacts up to the last release."""

    times: tuple[Float[jax.Array, "*lanes"], ...]
    speeds: tuple[Float[jax.Array, "*lanes"], ...]
    n_recent: Float[jax.Array, "*lanes"]
    count: Float[jax.Array, "*lanes"]  # type: ignore[assignment]  # a tuple has a method of this name
    least_speed: Float[jax.Array, "*lanes"]
    end_time: Float[jax.Array, "..."]
    release_times: tuple[Float[jax.Array, "*lanes"], ...] = ()
    count_at_release: Float[jax.Array, "*lanes"] | None = None


class ImpactSlots(NamedTuple):
    """Times and signed speeds of the first impacts, slots first, lanes last. Where a replay is to come, else None:
    freed, of each as in the `ImpactLog`; since_release: times and speeds of the first impacts since the last release,
    with others beyond as many as there are."""

    times: Float[jax.Array, "slots ..."]
    speeds: Float[jax.Array, "slots ..."]
    release_times: Float[jax.Array, "slots ..."] | None = None
    since_release: tuple[Float[jax.Array, "recent ..."], Float[jax.Array, "recent ..."]] | None = None


def empty_log(template, n_slots, end_time, n_since_release=0):
    """(log, slots) of no impacts for lanes like these; n_since_release: slots for those since the last release, 0: no
    replay."""
    zero, infinity = jnp.zeros_like(template), jnp.full_like(template, jnp.inf)
    n_recent = min(MAX_RECENT, max(n_slots, n_since_release))
    log = ImpactLog((infinity,) * n_recent, (zero,) * n_recent, zero, zero, infinity, end_time)

    def filled_rows(n_rows, value):
        return jnp.full((n_rows, *template.shape), value, template.dtype)

    impact_slots = ImpactSlots(filled_rows(n_slots, jnp.inf), filled_rows(n_slots, 0.0))
    if not n_since_release:
        return log, impact_slots
    log = log._replace(release_times=(zero - 1.0,) * n_recent, count_at_release=zero)
    return log, impact_slots._replace(
        release_times=filled_rows(n_slots, -1.0),
        since_release=(filled_rows(n_since_release, jnp.inf), filled_rows(n_since_release, 0.0)),
    )


def record_impact(log, side, speed, resulting_speed, time_remaining, release_time=None):
    """The log with one step more: an impact of each lane with a side, at a speed, with so much time to go.

    resulting_speed: the least speed that comes of it; release_time: when the mass was last released.
    """
    impact_time, signed_speed, least_speed, *slot_masks = stage(
        _new_entry, log, side, speed, resulting_speed, time_remaining
    )
    return log._replace(
        times=tuple(
            merge_bits(*merge_operands)
            for merge_operands in zip(slot_masks, [impact_time] * MAX_RECENT, log.times, strict=False)
        ),
        speeds=tuple(
            merge_bits(*merge_operands)
            for merge_operands in zip(slot_masks, [signed_speed] * MAX_RECENT, log.speeds, strict=False)
        ),
        release_times=tuple(
            merge_bits(*merge_operands)
            for merge_operands in zip(slot_masks, [release_time] * MAX_RECENT, log.release_times, strict=False)
        ),
        n_recent=log.n_recent + lax.abs(side),
        count=log.count + lax.abs(side),
        least_speed=least_speed,
    )


def _new_entry(log, side, speed, resulting_speed, time_remaining):
    is_impact = side != 0
    slot_masks = [bit_mask(is_impact & (log.n_recent == k), time_remaining) for k in range(len(log.times))]
    least_speed = choose(is_impact, minimum(resulting_speed, log.least_speed), log.least_speed)
    return log.end_time - time_remaining, side * speed, least_speed, *slot_masks


def is_full(log):
    """The lanes that hold as many impacts as they can: then `flush` is due."""
    return log.n_recent >= MAX_RECENT


def flush(log, impact_slots):
    """(log, slots) with the impacts at hand put into their slots, and nothing into those that follow."""
    first_index = log.count - log.n_recent

    def insert_recent(recent_values, fill_value, slot_rows, first_index):
        if not len(slot_rows):
            return slot_rows
        slot_index = lax.broadcasted_iota(first_index.dtype, slot_rows.shape, 0) - lax.expand_dims(first_index, [0])
        for k, value in enumerate(recent_values):
            slot_rows = choose(
                slot_index == k, lax.expand_dims(choose(log.n_recent > k, value, fill_value), [0]), slot_rows
            )
        return slot_rows

    def insert_pair(slot_rows, first_index):
        return insert_recent(log.times, jnp.inf, slot_rows[0], first_index), insert_recent(
            log.speeds, 0.0, slot_rows[1], first_index
        )

    new_slots = ImpactSlots(*insert_pair(impact_slots[:2], first_index))
    if impact_slots.since_release is not None:
        since_release = insert_pair(impact_slots.since_release, first_index - log.count_at_release)
        new_slots = new_slots._replace(
            release_times=insert_recent(log.release_times, -1.0, impact_slots.release_times, first_index),
            since_release=since_release,
        )
    return log._replace(n_recent=jnp.zeros_like(log.n_recent)), new_slots


def impacts_since_release(log, impact_slots):
    """(times, signed speeds, count) of the impacts since the last release, slots first."""
    count = log.count - log.count_at_release
    (times, speeds), slot_index = (
        impact_slots.since_release,
        lax.broadcasted_iota(log.count.dtype, impact_slots.since_release[0].shape, 0),
    )
    is_recorded = slot_index < lax.expand_dims(count, [0])
    return choose(is_recorded, times, jnp.inf), choose(is_recorded, speeds, 0.0), count


def impact_rows(impact_slots):
    """(times, sides, speeds) of the impacts, lanes first, as `Impacts` has them."""
    axes = (*range(1, impact_slots.times.ndim), 0)
    sides = (impact_slots.speeds > 0).astype(jnp.int8) - (impact_slots.speeds < 0).astype(jnp.int8)
    return [lax.transpose(array, axes) for array in (impact_slots.times, sides, lax.abs(impact_slots.speeds))]

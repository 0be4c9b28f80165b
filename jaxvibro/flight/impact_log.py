"""Record the impacts of a path in slots."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import bit_mask, choose, merge_bits, minimum, stage

MAX_RECENT = 4  # recent impacts of a lane; they move to the slots when there are more, and at the end


class ImpactLog(NamedTuple):
    """Log of the impacts of lanes.

    All fields are floats, because mixed types are slow.

    Attributes
    ----------
    times : tuple of array
        Times of the recent impacts.
    speeds : tuple of array
        Speeds of the recent impacts, times the sign of the wall.
    n_recent : array
        Number of recent impacts.
    count : array
        Number of all impacts.
    least_speed : array
        Smallest speed of all impacts.
    end_time : array
        Time at which no time remains.
    release_times : tuple of array
        Time of the last release before each recent impact, -1 if there is none. Empty unless a replay follows.
    count_at_release : array or None
        Number of impacts up to the last release. None unless a replay follows.
    """

    times: tuple[Float[jax.Array, "*lanes"], ...]
    speeds: tuple[Float[jax.Array, "*lanes"], ...]
    n_recent: Float[jax.Array, "*lanes"]
    count: Float[jax.Array, "*lanes"]  # type: ignore[assignment]  # a tuple has a method of this name
    least_speed: Float[jax.Array, "*lanes"]
    end_time: Float[jax.Array, "..."]
    release_times: tuple[Float[jax.Array, "*lanes"], ...] = ()
    count_at_release: Float[jax.Array, "*lanes"] | None = None


class ImpactSlots(NamedTuple):
    """Slots for the first impacts, with the slots as the first axis.

    Attributes
    ----------
    times : array
        Times of the impacts.
    speeds : array
        Speeds of the impacts, times the sign of the wall.
    release_times : array or None
        Time of the last release before each impact. None unless a replay follows.
    since_release : tuple of array or None
        Times and speeds of the first impacts since the last release. Rows beyond their number hold other impacts. None
        unless a replay follows.
    """

    times: Float[jax.Array, "slots ..."]
    speeds: Float[jax.Array, "slots ..."]
    release_times: Float[jax.Array, "slots ..."] | None = None
    since_release: tuple[Float[jax.Array, "recent ..."], Float[jax.Array, "recent ..."]] | None = None


def empty_log(template, n_slots, end_time, n_since_release=0):
    """Create a log and slots without impacts.

    Parameters
    ----------
    template : array
        Array with the shape and type of the lanes.
    n_slots : int
        Number of slots.
    end_time : array
        Time at which no time remains.
    n_since_release : int, optional
        Number of slots for the impacts since the last release. 0 if no replay follows.

    Returns
    -------
    log : ImpactLog
        Empty log.
    impact_slots : ImpactSlots
        Empty slots.
    """
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
    """Return the log after a step, with an impact in each lane whose side is not 0.

    `resulting_speed` is the smallest speed that the impact implies. `release_time` is the time of the last release.
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
    """Return (time, signed speed, smallest speed, masks of the recent impacts) of a new impact."""
    is_impact = side != 0
    slot_masks = [bit_mask(is_impact & (log.n_recent == k), time_remaining) for k in range(len(log.times))]
    least_speed = choose(is_impact, minimum(resulting_speed, log.least_speed), log.least_speed)
    return log.end_time - time_remaining, side * speed, least_speed, *slot_masks


def is_full(log):
    """Return the lanes with the largest number of recent impacts, for which `flush` is due."""
    return log.n_recent >= MAX_RECENT


def flush(log, impact_slots):
    """Return (log, slots) with the recent impacts moved into the slots."""
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
    """Return the impacts since the last release.

    Parameters
    ----------
    log : ImpactLog
        Log of the impacts.
    impact_slots : ImpactSlots
        Slots of the impacts.

    Returns
    -------
    times : array
        Times, slots first. Infinite in unused slots.
    speeds : array
        Speeds times the sign of the wall. 0 in unused slots.
    count : array
        Number of impacts.
    """
    count = log.count - log.count_at_release
    (times, speeds), slot_index = (
        impact_slots.since_release,
        lax.broadcasted_iota(log.count.dtype, impact_slots.since_release[0].shape, 0),
    )
    is_recorded = slot_index < lax.expand_dims(count, [0])
    return choose(is_recorded, times, jnp.inf), choose(is_recorded, speeds, 0.0), count


def impact_rows(impact_slots):
    """Return the recorded impacts with the lanes as the first axes, as in `Impacts`.

    Parameters
    ----------
    impact_slots : ImpactSlots
        Slots of the impacts.

    Returns
    -------
    list of array
        Times, sides (-1, 0 or 1) and speeds.
    """
    axes = (*range(1, impact_slots.times.ndim), 0)
    sides = (impact_slots.speeds > 0).astype(jnp.int8) - (impact_slots.speeds < 0).astype(jnp.int8)
    return [lax.transpose(array, axes) for array in (impact_slots.times, sides, lax.abs(impact_slots.speeds))]

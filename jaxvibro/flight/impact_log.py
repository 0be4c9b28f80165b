"""Record the impacts of a path in slots."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import bit_mask, call_without_inlining, choose, merge_bits, minimum

MAX_RECENT = 4  # recent impacts of a lane; they move to the slots when there are more, and at the end


class ImpactLog(NamedTuple):
    """Log of the impacts of lanes.

    Recent impacts are impacts that are not yet in the `ImpactSlots`. All arrays are of floating-point type, because
    mixed types are slow.

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
        Smallest speed of all impacts. `impact.CHATTER_SPEED` after a complete chatter.
    end_time : array
        Time at the end of the integration.
    release_times : tuple of array
        Time of the last release from sticking before each recent impact; -1 without a release. Empty unless a replay
        follows.
    n_impacts_at_release : array or None
        Number of impacts up to the last release. None unless a replay follows.
    """

    times: tuple[Float[jax.Array, "*lanes"], ...]
    speeds: tuple[Float[jax.Array, "*lanes"], ...]
    n_recent: Float[jax.Array, "*lanes"]
    count: Float[jax.Array, "*lanes"]  # type: ignore[assignment]  # a tuple has a method of this name
    least_speed: Float[jax.Array, "*lanes"]
    end_time: Float[jax.Array, "..."]
    release_times: tuple[Float[jax.Array, "*lanes"], ...] = ()
    n_impacts_at_release: Float[jax.Array, "*lanes"] | None = None


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
    slots_since_release : tuple of array or None
        Times and speeds of the first impacts since the last release. Rows beyond the number of these impacts are
        arbitrary. None unless a replay follows.
    """

    times: Float[jax.Array, "slots ..."]
    speeds: Float[jax.Array, "slots ..."]
    release_times: Float[jax.Array, "slots ..."] | None = None
    slots_since_release: tuple[Float[jax.Array, "recent ..."], Float[jax.Array, "recent ..."]] | None = None


def empty_log(lanes_template, n_impact_slots, end_time, n_slots_since_release=0):
    """Create a log and slots without impacts.

    Parameters
    ----------
    lanes_template : array
        Array with the shape and type of the lanes.
    n_impact_slots : int
        Number of slots.
    end_time : array
        Time at the end of the integration.
    n_slots_since_release : int, optional
        Number of slots for the impacts since the last release. 0 if no replay follows.

    Returns
    -------
    log : ImpactLog
        Empty log.
    impact_slots : ImpactSlots
        Empty slots.
    """
    zero, infinity = jnp.zeros_like(lanes_template), jnp.full_like(lanes_template, jnp.inf)
    n_recent_slots = min(MAX_RECENT, max(n_impact_slots, n_slots_since_release))
    log = ImpactLog((infinity,) * n_recent_slots, (zero,) * n_recent_slots, zero, zero, infinity, end_time)

    def constant_rows(n_rows, fill_value):
        return jnp.full((n_rows, *lanes_template.shape), fill_value, lanes_template.dtype)

    impact_slots = ImpactSlots(constant_rows(n_impact_slots, jnp.inf), constant_rows(n_impact_slots, 0.0))
    if not n_slots_since_release:
        return log, impact_slots
    log = log._replace(release_times=(zero - 1.0,) * n_recent_slots, n_impacts_at_release=zero)
    return log, impact_slots._replace(
        release_times=constant_rows(n_impact_slots, -1.0),
        slots_since_release=(constant_rows(n_slots_since_release, jnp.inf), constant_rows(n_slots_since_release, 0.0)),
    )


def record_impact(log, side, approach_speed, least_implied_speed, time_remaining, release_time=None):
    """Return the log after a step, with an impact in each lane whose side is not 0.

    `least_implied_speed` is the `least_speed` of the `impact.EventOutcome`, or the approach speed on the fast path.
    `release_time` is the time of the last release.
    """
    impact_time, signed_speed, least_speed, *recent_slot_masks = call_without_inlining(
        _new_impact_entry, log, side, approach_speed, least_implied_speed, time_remaining
    )
    return log._replace(
        times=tuple(
            merge_bits(*mask_new_and_old)
            for mask_new_and_old in zip(recent_slot_masks, [impact_time] * MAX_RECENT, log.times, strict=False)
        ),
        speeds=tuple(
            merge_bits(*mask_new_and_old)
            for mask_new_and_old in zip(recent_slot_masks, [signed_speed] * MAX_RECENT, log.speeds, strict=False)
        ),
        release_times=tuple(
            merge_bits(*mask_new_and_old)
            for mask_new_and_old in zip(recent_slot_masks, [release_time] * MAX_RECENT, log.release_times, strict=False)
        ),
        n_recent=log.n_recent + lax.abs(side),
        count=log.count + lax.abs(side),
        least_speed=least_speed,
    )


def _new_impact_entry(log, side, approach_speed, least_implied_speed, time_remaining):
    """Return (time, signed speed, smallest speed, bit masks) of a new impact; the masks select its recent slot."""
    is_impact = side != 0
    recent_slot_masks = [bit_mask(is_impact & (log.n_recent == k), time_remaining) for k in range(len(log.times))]
    least_speed = choose(is_impact, minimum(least_implied_speed, log.least_speed), log.least_speed)
    return log.end_time - time_remaining, side * approach_speed, least_speed, *recent_slot_masks


def is_recent_log_full(log):
    """Return the lanes with `MAX_RECENT` recent impacts, for which `flush_recent_impacts` is due."""
    return log.n_recent >= MAX_RECENT


def flush_recent_impacts(log, impact_slots):
    """Return (log, slots) with the recent impacts moved into the slots."""
    first_recent_index = log.count - log.n_recent

    def insert_recent_values(recent_values, fill_value, slot_rows, first_recent_index):
        if not len(slot_rows):
            return slot_rows
        slot_index = lax.broadcasted_iota(first_recent_index.dtype, slot_rows.shape, 0) - lax.expand_dims(
            first_recent_index, [0]
        )
        for k, value in enumerate(recent_values):
            slot_rows = choose(
                slot_index == k, lax.expand_dims(choose(log.n_recent > k, value, fill_value), [0]), slot_rows
            )
        return slot_rows

    def insert_times_and_speeds(slot_rows, first_recent_index):
        return insert_recent_values(log.times, jnp.inf, slot_rows[0], first_recent_index), insert_recent_values(
            log.speeds, 0.0, slot_rows[1], first_recent_index
        )

    new_impact_slots = ImpactSlots(*insert_times_and_speeds(impact_slots[:2], first_recent_index))
    if impact_slots.slots_since_release is not None:
        rows_since_release = insert_times_and_speeds(
            impact_slots.slots_since_release, first_recent_index - log.n_impacts_at_release
        )
        new_impact_slots = new_impact_slots._replace(
            release_times=insert_recent_values(log.release_times, -1.0, impact_slots.release_times, first_recent_index),
            slots_since_release=rows_since_release,
        )
    return log._replace(n_recent=jnp.zeros_like(log.n_recent)), new_impact_slots


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
    n_impacts = log.count - log.n_impacts_at_release
    (times, speeds), slot_index = (
        impact_slots.slots_since_release,
        lax.broadcasted_iota(log.count.dtype, impact_slots.slots_since_release[0].shape, 0),
    )
    is_recorded = slot_index < lax.expand_dims(n_impacts, [0])
    return choose(is_recorded, times, jnp.inf), choose(is_recorded, speeds, 0.0), n_impacts


def impact_arrays(impact_slots):
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
    axis_order = (*range(1, impact_slots.times.ndim), 0)
    sides = (impact_slots.speeds > 0).astype(jnp.int8) - (impact_slots.speeds < 0).astype(jnp.int8)
    return [
        lax.transpose(slot_array, axis_order)
        for slot_array in (impact_slots.times, sides, lax.abs(impact_slots.speeds))
    ]

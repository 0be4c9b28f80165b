"""Integrate paths in one flat loop over a block of lanes, with the log of their impacts.

In each iteration every lane flies a step, hits a wall and rebounds, or has finished. The loop pauses to measure a
turning point or to move impacts into their slots. This work applies to all lanes and is rarely due.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import bit_mask, choose, merge_bits, stage
from ..scene.codes import Contact
from . import impact_log, soft_long_step, turning_points
from .contact_laws import contact_law_of
from .flight_state import CAPPED, Path
from .soft_contact import is_inside
from .step import certified_step

MAX_PERIOD_IMPACTS = 1000  # largest number of impacts of one lane in one period
STEP_FACTOR = 8  # largest number of further steps, relative to those of a flight without impacts
MAX_STEPS = 1e6  # largest number of such steps of one lane in one period
# needs of a lane: another step, impacts moved to the slots, a measurement, a long step
NEEDS_STEP, NEEDS_FLUSH, NEEDS_MEASUREMENT, NEEDS_LONG_STEP = 1, 2, 4, 8


class LoopState(NamedTuple):
    """State of the integration loop.

    Attributes
    ----------
    path : Path
        Paths of the lanes.
    log : ImpactLog
        Log of the impacts.
    impact_slots : ImpactSlots
        Slots of the impacts.
    closest_approaches : ClosestApproaches or None
        Smallest clearances. None if not computed or without walls.
    release_time : array
        Time of the last release from a wall, -1 if there is none.
    n_steps : array
        Number of steps, one number for all lanes.
    wait_count : array or None
        Steps inside a soft wall since the entry or the last attempt at a long step. None without soft walls.
    """

    path: Path
    log: impact_log.ImpactLog
    impact_slots: impact_log.ImpactSlots
    closest_approaches: turning_points.ClosestApproaches | None
    release_time: Float[jax.Array, "..."]
    n_steps: Float[jax.Array, ""]
    wait_count: Float[jax.Array, "..."] | None = None


class LoopLimits(NamedTuple):
    """Largest number of impacts and of steps of a lane."""

    max_impacts: Float[jax.Array, "..."]
    max_steps: Float[jax.Array, "..."]


def initial_loop_state(coeffs, path, n_slots, end_time, with_clearance=False, n_since_release=0):
    """Create the initial state of the integration loop.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    path : Path
        Paths of the lanes.
    n_slots : int
        Number of slots for impacts.
    end_time : array
        Time at which no time remains.
    with_clearance : bool, optional
        True computes the smallest clearance.
    n_since_release : int, optional
        Number of slots for the impacts since the last release, see `impact_log.empty_log`.

    Returns
    -------
    LoopState
        Initial state.
    """
    closest_approaches = turning_points.no_turning_points(path.x) if coeffs.walls and with_clearance else None
    zero = jnp.zeros_like(path.x)
    n_steps = jnp.zeros((), path.x.dtype)
    wait_count = contact_law_of(coeffs).initial_wait(zero)
    return LoopState(
        path,
        *impact_log.empty_log(path.x, n_slots, end_time, n_since_release),
        closest_approaches,
        zero - 1.0,
        n_steps,
        wait_count,
    )


def loop_limits(coeffs, periods):
    """Return the limits on the impacts and steps of a lane.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    periods : int or array
        Number of drive periods.

    Returns
    -------
    LoopLimits
        Largest numbers of impacts and of steps.
    """
    max_step = contact_law_of(coeffs).max_step(coeffs)
    max_steps = 4.0 * MAX_PERIOD_IMPACTS + lax.min(
        STEP_FACTOR * coeffs.period / max_step, lax.full_like(coeffs.period, MAX_STEPS)
    )
    return LoopLimits(lax.full_like(coeffs.period, MAX_PERIOD_IMPACTS * periods), max_steps * periods)


def run_loop(coeffs, loop, limits, restart=None):
    """Integrate until no lane has time remaining.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    loop : LoopState
        Initial state.
    limits : LoopLimits
        Limits. A lane that exceeds them has the remaining time `flight_state.CAPPED`.
    restart : callable, optional
        Function from a `LoopState` to one in which the lanes at the end of a period start their next.

    Returns
    -------
    LoopState
        Final state.
    """
    has_walls, tracks_clearance, contact_law = (
        bool(coeffs.walls),
        loop.closest_approaches is not None,
        contact_law_of(coeffs),
    )

    def step_lanes(loop):
        step = certified_step(coeffs, loop.path)
        remaining_after, contact = step.path.time_remaining, loop.path.contact
        log, release_mask = loop.log, stage(_release_mask, step.side, contact)
        release_time = merge_bits(release_mask, stage(_event_time, log, remaining_after), loop.release_time)
        if log.count_at_release is not None:
            log = log._replace(count_at_release=merge_bits(release_mask, log.count, log.count_at_release))
        impact_side = stage(_impact_side, step.side, contact)
        log = impact_log.record_impact(
            log, impact_side, step.outcome.approach_speed, step.outcome.least_speed, remaining_after, release_time
        )
        closest_approaches = (
            turning_points.record_turning_point(coeffs, loop.path, step, loop.closest_approaches)
            if tracks_clearance
            else None
        )
        wait_count = None if loop.wait_count is None else stage(_count_wait, loop.wait_count, step.path.contact)
        loop = loop._replace(
            path=step.path,
            log=log,
            closest_approaches=closest_approaches,
            release_time=release_time,
            wait_count=wait_count,
        )
        loop = loop._replace(n_steps=loop.n_steps + 1.0)
        loop = restart(loop) if restart else loop
        path = loop.path
        exceeds_limits = ((loop.log.count >= limits.max_impacts) | (loop.n_steps > limits.max_steps)) & (
            path.time_remaining > 0
        )
        # with a nonzero low part, the next step would round CAPPED to a remaining time of zero
        time_remaining, time_remaining_low = (
            choose(exceeds_limits, CAPPED, path.time_remaining),
            choose(exceeds_limits, 0.0, path.time_remaining_low),
        )
        return loop._replace(path=path._replace(time_remaining=time_remaining, time_remaining_low=time_remaining_low))

    def run_until_pause(loop):
        impact_slots, loop = loop.impact_slots, loop._replace(impact_slots=None)
        loop = lax.while_loop(lambda loop: _need_code(contact_law, loop) == NEEDS_STEP, step_lanes, loop)
        if loop.wait_count is not None:
            need_code = _need_code(contact_law, loop)
            wait_flags = (need_code & NEEDS_LONG_STEP) != 0, (need_code & NEEDS_STEP) == 0
            path, wait_count = contact_law.advance_waiting(coeffs, loop.path, loop.wait_count, *wait_flags)
            loop = loop._replace(path=path, wait_count=wait_count)
            loop = restart(loop) if restart else loop
        need_code = _need_code(contact_law, loop)
        is_finished = (need_code & NEEDS_STEP) == 0
        flush_due, measure_due = (
            is_finished | ((need_code & NEEDS_FLUSH) != 0),
            is_finished | ((need_code & NEEDS_MEASUREMENT) != 0),
        )
        log, impact_slots = lax.cond(flush_due, impact_log.flush, lambda *operands: operands, loop.log, impact_slots)
        closest_approaches = loop.closest_approaches
        if tracks_clearance:
            closest_approaches = lax.cond(
                measure_due,
                lambda approaches: turning_points.measure_pending(coeffs, approaches),
                lambda approaches: approaches,
                closest_approaches,
            )
        return loop._replace(log=log, impact_slots=impact_slots, closest_approaches=closest_approaches)

    def is_pending(loop):
        return jnp.any((loop.path.time_remaining > 0) | (loop.closest_approaches.pending.guess_code != 0))

    def is_going(loop):
        return jnp.any(loop.path.time_remaining > 0)

    return lax.while_loop(
        is_pending if tracks_clearance else is_going, run_until_pause if has_walls else step_lanes, loop
    )


def _release_mask(side, contact):
    """Return the bit mask of the lanes that are released from sticking."""
    return bit_mask((lax.abs(contact) == Contact.STUCK) & (side != 0), side)


def _impact_side(side, contact):
    """Return the sides of impacts; the end of sticking or of a contact phase is not an impact."""
    return choose((lax.abs(contact) == Contact.STUCK) | is_inside(contact), 0.0, side)


def _event_time(log, time_remaining):
    """Return the time of an event from the remaining time."""
    return log.end_time - time_remaining


def _count_wait(wait_count, contact):
    """Return the wait count after a step."""
    return choose(is_inside(contact), wait_count + 1.0, 0.0)


def _need_code(contact_law, loop):
    """Return the needs of any lane: a sum of NEEDS_STEP, NEEDS_FLUSH, NEEDS_MEASUREMENT and NEEDS_LONG_STEP."""
    need_code = choose(contact_law.active_path(loop.path).time_remaining > 0, jnp.int8(NEEDS_STEP), jnp.int8(0))
    need_code |= choose(impact_log.is_full(loop.log), jnp.int8(NEEDS_FLUSH), jnp.int8(0))
    if loop.closest_approaches is not None:
        need_code |= choose(
            turning_points.needs_measurement(loop.closest_approaches), jnp.int8(NEEDS_MEASUREMENT), jnp.int8(0)
        )
    if loop.wait_count is not None:
        need_code |= choose(soft_long_step.is_due(loop.path, loop.wait_count), jnp.int8(NEEDS_LONG_STEP), jnp.int8(0))
    return (
        lax.reduce(need_code, jnp.int8(0), lax.bitwise_or, tuple(range(need_code.ndim)))
        if need_code.ndim
        else need_code
    )

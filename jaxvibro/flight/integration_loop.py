"""Integrate paths in one flat loop over a block of lanes, with the log of their impacts.

In each iteration every unfinished lane takes one step, with or without an event at the end. The loop pauses to measure
turning points and to move impacts into their slots. These operations apply to all lanes and are rarely due.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import bit_mask, call_without_inlining, choose, merge_bits
from ..scene.state import Contact
from . import impact_log, recorded_turns, soft_wall_long_step, turning_points
from .flight_state import CAPPED, Path
from .flight_step import certified_step
from .motion_in_soft_wall import is_inside_soft_wall

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
        Smallest clearances and recorded turning points. None if clearances are not computed or there are no walls.
    release_time : array
        Time of the last release from a wall, -1 if there is none.
    n_steps : array
        Number of steps, a scalar that all lanes share.
    n_waiting_steps : array or None
        Steps inside a soft wall since the entry or the last attempt at a long step. None without soft walls.
    """

    path: Path
    log: impact_log.ImpactLog
    impact_slots: impact_log.ImpactSlots
    closest_approaches: recorded_turns.ClosestApproaches | None
    release_time: Float[jax.Array, "..."]
    n_steps: Float[jax.Array, ""]
    n_waiting_steps: Float[jax.Array, "..."] | None = None


class LoopLimits(NamedTuple):
    """Limits of the integration loop for one lane.

    Attributes
    ----------
    max_impacts : array
        Largest number of impacts.
    max_steps : array
        Largest number of steps.
    """

    max_impacts: Float[jax.Array, "..."]
    max_steps: Float[jax.Array, "..."]


def initial_loop_state(coeffs, path, n_impact_slots, end_time, with_clearance=False, n_slots_since_release=0):
    """Create the initial state of the integration loop.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    path : Path
        Paths of the lanes.
    n_impact_slots : int
        Number of slots for impacts.
    end_time : array
        Time at the end of the integration.
    with_clearance : bool, optional
        True computes the smallest clearance.
    n_slots_since_release : int, optional
        Number of slots for the impacts since the last release, see `impact_log.empty_log`.

    Returns
    -------
    LoopState
        Initial state.
    """
    closest_approaches = turning_points.empty_approaches(path.x) if coeffs.walls and with_clearance else None
    zero = jnp.zeros_like(path.x)
    n_steps = jnp.zeros((), path.x.dtype)
    n_waiting_steps = coeffs.contact.initial_waiting_steps(zero)
    return LoopState(
        path,
        *impact_log.empty_log(path.x, n_impact_slots, end_time, n_slots_since_release),
        closest_approaches,
        zero - 1.0,
        n_steps,
        n_waiting_steps,
    )


def loop_limits(coeffs, n_periods):
    """Return the limits on the impacts and steps of a lane.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    n_periods : int or array
        Number of drive periods.

    Returns
    -------
    LoopLimits
        Largest numbers of impacts and of steps.
    """
    max_step = coeffs.contact.max_step(coeffs)
    max_steps = 4.0 * MAX_PERIOD_IMPACTS + lax.min(
        STEP_FACTOR * coeffs.period / max_step, lax.full_like(coeffs.period, MAX_STEPS)
    )
    return LoopLimits(lax.full_like(coeffs.period, MAX_PERIOD_IMPACTS * n_periods), max_steps * n_periods)


def run_loop(coeffs, loop_state, loop_limits, start_next_period=None):
    """Integrate until no lane has time remaining.

    Parameters
    ----------
    coeffs : FlowCoefficients
        Coefficients of the scene.
    loop_state : LoopState
        Initial state.
    loop_limits : LoopLimits
        Limits. A lane that exceeds them has the remaining time `flight_state.CAPPED`.
    start_next_period : callable, optional
        Function that returns a `LoopState` in which the lanes at the end of a period have started the next period.

    Returns
    -------
    LoopState
        Final state.
    """
    step_lanes = partial(_step_lanes, coeffs, loop_limits, start_next_period)
    run_until_pause = partial(_run_until_pause, coeffs, step_lanes, start_next_period)
    return lax.while_loop(
        _is_any_lane_running if loop_state.closest_approaches is None else _is_any_lane_pending,
        run_until_pause if coeffs.walls else step_lanes,
        loop_state,
    )


def _step_lanes(coeffs, loop_limits, start_next_period, loop_state):
    """Take one step of each lane and record its event."""
    step_result = certified_step(coeffs, loop_state.path)
    log, release_time = _record_event(loop_state, step_result)
    closest_approaches, n_waiting_steps = loop_state.closest_approaches, loop_state.n_waiting_steps
    if closest_approaches is not None:
        closest_approaches = turning_points.record_turning_point(
            coeffs, loop_state.path, step_result, closest_approaches
        )
    if n_waiting_steps is not None:
        n_waiting_steps = call_without_inlining(_next_waiting_steps, n_waiting_steps, step_result.path.contact)
    loop_state = loop_state._replace(
        path=step_result.path,
        log=log,
        closest_approaches=closest_approaches,
        release_time=release_time,
        n_waiting_steps=n_waiting_steps,
        n_steps=loop_state.n_steps + 1.0,
    )
    loop_state = start_next_period(loop_state) if start_next_period else loop_state
    return loop_state._replace(path=_stop_beyond_limits(loop_state, loop_limits))


def _record_event(loop_state, step_result):
    """Return (`ImpactLog`, release times) after the event of a step."""
    time_after_step, contact = step_result.path.time_remaining, loop_state.path.contact
    log, release_mask = loop_state.log, call_without_inlining(_release_mask, step_result.side, contact)
    release_time = merge_bits(
        release_mask, call_without_inlining(_event_time, log, time_after_step), loop_state.release_time
    )
    if log.n_impacts_at_release is not None:
        log = log._replace(n_impacts_at_release=merge_bits(release_mask, log.count, log.n_impacts_at_release))
    impact_side = call_without_inlining(_impact_side, step_result.side, contact)
    log = impact_log.record_impact(
        log,
        impact_side,
        step_result.event_outcome.approach_speed,
        step_result.event_outcome.least_speed,
        time_after_step,
        release_time,
    )
    return log, release_time


def _stop_beyond_limits(loop_state, loop_limits):
    """Return the paths; lanes that exceed a limit have the remaining time CAPPED."""
    path = loop_state.path
    exceeds_limits = (
        (loop_state.log.count >= loop_limits.max_impacts) | (loop_state.n_steps > loop_limits.max_steps)
    ) & (path.time_remaining > 0)
    # with a nonzero low part, the next step would round CAPPED to a remaining time of zero
    return path._replace(
        time_remaining=choose(exceeds_limits, CAPPED, path.time_remaining),
        time_remaining_low_part=choose(exceeds_limits, 0.0, path.time_remaining_low_part),
    )


def _run_until_pause(coeffs, step_lanes, start_next_period, loop_state):
    """Step the lanes until one of them needs more than a step; then meet these needs."""
    impact_slots, loop_state = loop_state.impact_slots, loop_state._replace(impact_slots=None)
    loop_state = lax.while_loop(
        lambda loop: _combined_need_flags(coeffs.contact, loop) == NEEDS_STEP, step_lanes, loop_state
    )
    if loop_state.n_waiting_steps is not None:
        need_flags = _combined_need_flags(coeffs.contact, loop_state)
        due_and_idle_flags = (need_flags & NEEDS_LONG_STEP) != 0, (need_flags & NEEDS_STEP) == 0
        path, n_waiting_steps = coeffs.contact.advance_waiting_lanes(
            coeffs, loop_state.path, loop_state.n_waiting_steps, *due_and_idle_flags
        )
        loop_state = loop_state._replace(path=path, n_waiting_steps=n_waiting_steps)
        loop_state = start_next_period(loop_state) if start_next_period else loop_state
    need_flags = _combined_need_flags(coeffs.contact, loop_state)
    is_finished = (need_flags & NEEDS_STEP) == 0
    is_flush_due, is_measurement_due = (
        is_finished | ((need_flags & NEEDS_FLUSH) != 0),
        is_finished | ((need_flags & NEEDS_MEASUREMENT) != 0),
    )
    log, impact_slots = lax.cond(
        is_flush_due, impact_log.flush_recent_impacts, lambda *operands: operands, loop_state.log, impact_slots
    )
    closest_approaches = loop_state.closest_approaches
    if closest_approaches is not None:
        closest_approaches = lax.cond(
            is_measurement_due,
            lambda approaches: turning_points.measure_pending_turns(coeffs, approaches),
            lambda approaches: approaches,
            closest_approaches,
        )
    return loop_state._replace(log=log, impact_slots=impact_slots, closest_approaches=closest_approaches)


def _is_any_lane_running(loop_state):
    """Return True if a lane has time remaining."""
    return jnp.any(loop_state.path.time_remaining > 0)


def _is_any_lane_pending(loop_state):
    """Return True if a lane has time remaining or a turning point to measure."""
    has_pending_turn = recorded_turns.has_pending_turn(loop_state.closest_approaches)
    return jnp.any((loop_state.path.time_remaining > 0) | has_pending_turn)


def _release_mask(side, contact):
    """Return the bit mask of the lanes that are released from sticking."""
    return bit_mask((lax.abs(contact) == Contact.STUCK) & (side != 0), side)


def _impact_side(side, contact):
    """Return the sides of impacts; the end of sticking or of a contact phase is not an impact."""
    return choose((lax.abs(contact) == Contact.STUCK) | is_inside_soft_wall(contact), 0.0, side)


def _event_time(log, time_remaining):
    """Return the time of an event from the remaining time."""
    return log.end_time - time_remaining


def _next_waiting_steps(n_waiting_steps, contact):
    """Return the number of waiting steps after a step, see `LoopState`."""
    return choose(is_inside_soft_wall(contact), n_waiting_steps + 1.0, 0.0)


def _combined_need_flags(contact_kind, loop_state):
    """Return the combined needs of lanes: a sum of NEEDS_STEP, NEEDS_FLUSH, NEEDS_MEASUREMENT and NEEDS_LONG_STEP."""
    need_flags = choose(
        contact_kind.path_of_stepping_lanes(loop_state.path).time_remaining > 0, jnp.int8(NEEDS_STEP), jnp.int8(0)
    )
    need_flags |= choose(impact_log.is_recent_log_full(loop_state.log), jnp.int8(NEEDS_FLUSH), jnp.int8(0))
    if loop_state.closest_approaches is not None:
        need_flags |= choose(
            recorded_turns.needs_measurement(loop_state.closest_approaches), jnp.int8(NEEDS_MEASUREMENT), jnp.int8(0)
        )
    if loop_state.n_waiting_steps is not None:
        need_flags |= choose(
            soft_wall_long_step.is_long_step_due(loop_state.path, loop_state.n_waiting_steps),
            jnp.int8(NEEDS_LONG_STEP),
            jnp.int8(0),
        )
    return (
        lax.reduce(need_flags, jnp.int8(0), lax.bitwise_or, tuple(range(need_flags.ndim)))
        if need_flags.ndim
        else need_flags
    )

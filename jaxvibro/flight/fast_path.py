"""Fly certified steps between rigid walls on the fast path, for lanes whose events are beyond doubt.

A step is a simplified `flight_step.certified_step`. The margin of each test is much wider than any rounding error of a
flight. The fast path gives up a lane in doubt, for example at a near grazing, a slow impact, a contact at the end
of a period or a start on a wall. The reference path then repeats the period of this lane (docs/numbers.md).

The unit of time is the longest step, so that all coefficients of the oscillator are small. A velocity is then a length,
the displacement in one longest step.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import call_without_inlining, choose, maximum, minimum, positive_part
from ..scene.state import Contact
from . import fast_event, fast_motion, fast_tangent, fast_turning_points, flow, impact_log, recorded_turns
from .fast_coefficients import GIVEN_UP, LaneStates
from .fast_event import DOUBT_MARGIN
from .wall_motion import subtract_optional, wall_jet

SLOW_FRACTION = 2.0**-9  # least rebound speed beyond doubt, in largest lengths of a lane per longest step


def start_lanes(coeffs, path, is_active):
    """Start lanes on the fast path.

    Parameters
    ----------
    coeffs : FastCoefficients
        Coefficients of the scene.
    path : Path
        Path at the start of a period.
    is_active : array of bool
        Lanes to compute.

    Returns
    -------
    LaneStates
        States of the lanes. Lanes whose start is in doubt are given up; inactive lanes have no time remaining.
    """
    return call_without_inlining(_start_lanes, coeffs, path.x, path.v, path.cosine, path.sine, path.contact, is_active)


def _start_lanes(coeffs, x, v, cosine, sine, contact, is_active):
    zero = lax.full_like(x, 0.0)
    v = v * coeffs.max_step
    lanes = LaneStates(x, v, cosine + zero, sine + zero, zero, coeffs.length_scale + lax.abs(x) + lax.abs(v))
    clearance = lax.full_like(x, jnp.inf)
    is_leaving = lax.full_like(x, False, dtype=bool)
    for wall in coeffs.walls:
        wall_position, wall_velocity = wall_jet(wall, coeffs.frequency, cosine, sine, 1)
        recession_speed = -wall.sign * subtract_optional(v, wall_velocity)
        is_leaving |= (contact == wall.sign * Contact.LANDED) & (recession_speed > SLOW_FRACTION * lanes.largest_length)
        clearance_to_wall = choose(contact == wall.sign * Contact.LANDED, jnp.inf, wall.sign * (wall_position - x))
        clearance = minimum(clearance, clearance_to_wall)
    is_certain = (clearance > DOUBT_MARGIN * lanes.largest_length) & ((contact == 0) | is_leaving)
    return lanes._replace(time_remaining=choose(is_active, choose(is_certain, coeffs.period, GIVEN_UP), 0.0))


def run_lanes(coeffs, lanes, log, impact_slots, directions=(), tangents=(), with_clearance=False):
    """Run lanes on the fast path until no lane has time remaining.

    Parameters
    ----------
    coeffs : FastCoefficients
        Coefficients of the scene.
    lanes : LaneStates
        Result of `start_lanes`.
    log : ImpactLog
        Log of the impacts.
    impact_slots : ImpactSlots
        Slots of the impacts.
    directions : sequence of ParameterDirection, optional
        Directions of the derivatives to compute.
    tangents : sequence of Tangent, optional
        Initial derivatives, one for each direction.
    with_clearance : bool, optional
        True computes the smallest clearance.

    Returns
    -------
    lanes : LaneStates
        Final states. A lane that needs too many steps is given up.
    log : ImpactLog
        Log with the new impacts.
    impact_slots : ImpactSlots
        Slots with the new impacts.
    tangents : tuple of Tangent
        Derivatives at the end of the period.
    least_clearance : array or None
        Smallest clearance, None if not computed.
    """
    log_holds_all_impacts = len(impact_slots.times) <= impact_log.MAX_RECENT
    closest_approaches = fast_turning_points.empty_approaches(lanes.x) if with_clearance else None
    if with_clearance:
        lanes = fast_turning_points.reject_doubtful_starts(coeffs, lanes)
    loop_state = _LoopState(lanes, log, jnp.zeros((), lanes.x.dtype), tangents, closest_approaches)
    advance = partial(_advance, coeffs, directions)
    if log_holds_all_impacts and not with_clearance:
        loop_state = lax.while_loop(lambda state: jnp.any(_is_unfinished(state)), advance, loop_state)
    else:
        loop_state, impact_slots = lax.while_loop(
            lambda state_and_slots: jnp.any(_is_unfinished(state_and_slots[0])),
            partial(_run_until_pause, coeffs, advance, log_holds_all_impacts),
            (loop_state, impact_slots),
        )
    lanes, log, _, tangents, closest_approaches = loop_state
    if log_holds_all_impacts:
        log, impact_slots = impact_log.flush_recent_impacts(log, impact_slots)
    return (
        lanes,
        log,
        impact_slots,
        fast_tangent.add_period_derivative(coeffs, directions, tangents, lanes),
        closest_approaches.least_clearance if with_clearance else None,
    )


class _LoopState(NamedTuple):
    """State of the loop of `run_lanes`; `closest_approaches` is None if no clearances are computed."""

    lanes: LaneStates
    log: impact_log.ImpactLog
    n_steps: Float[jax.Array, ""]
    tangents: tuple[fast_tangent.Tangent, ...]
    closest_approaches: recorded_turns.ClosestApproaches | None


def _advance(coeffs, directions, loop_state):
    """Take one step of each lane and record its impact."""
    lanes, tangents, closest_approaches, hit_side, approach_speed = step_lanes(
        coeffs,
        loop_state.lanes,
        loop_state.n_steps,
        directions,
        loop_state.tangents,
        loop_state.closest_approaches,
    )
    log = impact_log.record_impact(
        loop_state.log,
        hit_side,
        approach_speed,
        approach_speed,
        call_without_inlining(_unscaled_time, coeffs, lanes.time_remaining),
    )
    return _LoopState(lanes, log, loop_state.n_steps + 1.0, tangents, closest_approaches)


def _run_until_pause(coeffs, advance, log_holds_all_impacts, state_and_slots):
    """Step the lanes until the log is full or a turning point must be measured; then do so."""
    loop_state, impact_slots = state_and_slots

    def can_continue(loop_state):
        must_pause = (
            lax.full_like(loop_state.lanes.time_remaining, False, dtype=bool)
            if log_holds_all_impacts
            else impact_log.is_recent_log_full(loop_state.log)
        )
        if loop_state.closest_approaches is not None:
            must_pause |= recorded_turns.needs_measurement(loop_state.closest_approaches)
        return jnp.any(loop_state.lanes.time_remaining > 0) & ~jnp.any(must_pause)

    lanes, log, n_steps, tangents, closest_approaches = lax.while_loop(can_continue, advance, loop_state)
    if not log_holds_all_impacts:
        log, impact_slots = impact_log.flush_recent_impacts(log, impact_slots)
    if closest_approaches is not None:
        closest_approaches, time_remaining = fast_turning_points.measure_pending_turns(
            coeffs, lanes.time_remaining, closest_approaches
        )
        lanes = lanes._replace(time_remaining=time_remaining)
    return _LoopState(lanes, log, n_steps, tangents, closest_approaches), impact_slots


def _is_unfinished(loop_state):
    """Return the mask of the lanes that have time remaining or a turning point to measure."""
    has_time_remaining = loop_state.lanes.time_remaining > 0
    if loop_state.closest_approaches is None:
        return has_time_remaining
    return has_time_remaining | recorded_turns.has_pending_turn(loop_state.closest_approaches)


def step_lanes(coeffs, lanes, n_steps, directions=(), tangents=(), closest_approaches=None):
    """Take one step: return (lanes, tangents, approaches, hit side, approach speed).

    The hit side is 0 without an impact. The approach speed is in lengths per unit of t. `n_steps` counts the earlier
    steps of the period. `closest_approaches` is None if no clearances are computed. Lanes without remaining time and
    lanes that are given up do not change."""
    lanes_before = lanes = lanes._replace(largest_length=call_without_inlining(_largest_length, coeffs, lanes))
    drive_forces = call_without_inlining(fast_motion.drive_forces, coeffs, lanes.cosine, lanes.sine)
    hit_side, contact_time, safe_time, remainder_bound = fast_event.certify_next_event(coeffs, lanes, drive_forces)
    step_time = call_without_inlining(_step_time, lanes, hit_side, contact_time, safe_time)
    propagator = call_without_inlining(flow.step_propagator, coeffs.economised_series, coeffs.frequency, step_time)
    x, v = call_without_inlining(fast_motion.propagate_free_flight, coeffs, lanes.x, lanes.v, drive_forces, propagator)
    tangents = fast_tangent.propagate_tangents(coeffs, directions, tangents, lanes, drive_forces, propagator, step_time)
    phasor = call_without_inlining(
        flow.rotate_phasor, lanes.cosine, lanes.sine, propagator.cos_less_1, propagator.sin_angle
    )
    delay = call_without_inlining(fast_motion.event_delay, coeffs, x, v, phasor, hit_side)
    impact_velocity = call_without_inlining(fast_motion.impact_velocity, coeffs, x, v, phasor, delay)
    cosine, sine = call_without_inlining(fast_motion.rotate_drive_phasor, coeffs, phasor, delay)
    approach_speed = call_without_inlining(_approach_speed, coeffs, cosine, sine, hit_side, impact_velocity)
    time_remaining = call_without_inlining(
        _time_after_step, coeffs, lanes, n_steps, safe_time, step_time, hit_side, approach_speed, delay
    )
    flight_end_state = x, v, *phasor, delay
    x, v = call_without_inlining(fast_motion.apply_rebound, coeffs, x, v, (cosine, sine), hit_side, impact_velocity)
    lanes = LaneStates(x, v, cosine, sine, time_remaining, lanes.largest_length)
    if closest_approaches is not None:
        closest_approaches, time_remaining = fast_turning_points.record_turning_point(
            coeffs,
            lanes_before,
            lanes,
            impact_velocity,
            step_time,
            delay,
            hit_side,
            remainder_bound,
            closest_approaches,
        )
        lanes = lanes._replace(time_remaining=time_remaining)
    return (
        lanes,
        fast_tangent.apply_saltation(coeffs, directions, tangents, lanes, flight_end_state, hit_side, impact_velocity),
        closest_approaches,
        hit_side,
        approach_speed,
    )


def _largest_length(coeffs, lanes):
    """Return the largest length of each lane since the start of the period."""
    return maximum(lanes.largest_length, coeffs.length_scale + lax.abs(lanes.x) + lax.abs(lanes.v))


def _unscaled_time(coeffs, time_remaining):
    """Return the remaining time in units of t."""
    return time_remaining * coeffs.max_step


def _step_time(lanes, hit_side, contact_time, safe_time):
    """Return the duration of the step; 0 for a lane without time remaining."""
    return choose(lanes.time_remaining > 0, choose(hit_side != 0, contact_time, positive_part(safe_time)), 0.0)


def _approach_speed(coeffs, cosine, sine, hit_side, impact_velocity):
    """Return the speed relative to the wall on a side before impact, in lengths per unit of t."""
    return hit_side * (
        subtract_optional(impact_velocity, fast_motion.wall_state(coeffs, cosine, sine, hit_side)[1])
        * coeffs.inverse_max_step
    )


def _time_after_step(coeffs, lanes, n_steps, safe_time, step_time, hit_side, approach_speed, delay):
    """Return the remaining time after a step, GIVEN_UP for a lane in doubt."""
    is_hit, time_remaining = hit_side != 0, (lanes.time_remaining - step_time) - delay
    certainty_margin = choose(
        is_hit,
        fast_motion.restitution_of(coeffs, hit_side) * approach_speed
        - SLOW_FRACTION * coeffs.inverse_max_step * lanes.largest_length,
        safe_time,
    )
    time_remaining = choose(
        (time_remaining >= 0) & (certainty_margin > 0) & (n_steps < coeffs.max_steps), time_remaining, GIVEN_UP
    )
    return choose(lanes.time_remaining > 0, time_remaining, lanes.time_remaining)

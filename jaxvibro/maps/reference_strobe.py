"""Reference path of the stroboscopic map: final states, impacts and data for a replay."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.kernel_calls import call_as_kernel
from ..compiled.lane_arithmetic import call_without_inlining, choose, positive_part
from ..compiled.lane_blocks import run_in_blocks
from ..contact.kinds import make_flow_coefficients
from ..flight import impact_log, integration_loop
from ..flight.flight_state import CAPPED, absolute_state
from ..flight.motion_in_soft_wall import is_inside_soft_wall
from ..flight.path_start import start_path
from ..scene.state import Contact, Impacts, State, Status

REPLAY_SLOTS = 32  # impacts per period that a replay can differentiate


class ReplayHistory(NamedTuple):
    """Data that a replay needs in addition to the recorded impacts; all fields but the first are None without a replay.

    Attributes
    ----------
    release_time : array
        Time of the last release from a wall; -1 without a release.
    count : array or None
        Number of impacts since the last release.
    times, sides : array or None
        Times and sides of the impacts since the last release.
    last_releases : array or None
        Time of the last release before each recorded impact.
    """

    release_time: Float[jax.Array, "*lanes"]
    count: Float[jax.Array, "*lanes"] | None = None  # type: ignore[assignment]  # a tuple has a method of this name
    times: Float[jax.Array, "*lanes late"] | None = None
    sides: Float[jax.Array, "*lanes late"] | None = None
    last_releases: Float[jax.Array, "*lanes slots"] | None = None


def reference_strobe(scene, state, periods, slots, min_lanes, clearance=False, n_lanes_due=None):
    """Return (State, Impacts) for arguments that broadcast, in blocks of at least `min_lanes` lanes.

    `n_lanes_due` is the number of lanes to compute, as in `run_in_blocks`.
    """
    return strobe_and_history(scene, state, periods, slots, min_lanes, clearance, n_lanes_due=n_lanes_due)[0]


def strobe_and_history(scene, state, periods, slots, min_lanes, clearance=False, history_slots=0, n_lanes_due=None):
    """Return ((State, Impacts), `ReplayHistory`); the arguments are those of `reference_strobe`."""
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))
    options = {"slots": slots, "clearance": clearance, "history_slots": history_slots}

    def run_block(arguments):
        return call_as_kernel(strobe_with_history, *arguments, periods=periods, **options)

    def make_block_results(n_lanes):
        results = make_empty_results(n_lanes, slots, scene.dtype, clearance)
        return results, make_empty_history(n_lanes, slots, scene.dtype, history_slots)

    return run_in_blocks(
        run_block,
        (scene, replace(state, x=jnp.broadcast_to(state.x, shape))),
        make_block_results,
        min_lanes,
        n_lanes_due=n_lanes_due,
    )


def strobe_with_history(scene, state, periods, slots, clearance=False, history_slots=0):
    """Return ((State, Impacts), `ReplayHistory`) of a block of lanes.

    The fields of `scene` and `state` are scalars or have the shape of `state.x`. The least clearance is measured if
    `clearance` is true, and None otherwise. `history_slots` is the number of slots for impacts in the `ReplayHistory`.
    If `history_slots` is 0, the `ReplayHistory` has the release time only.
    """
    coeffs = make_flow_coefficients(scene)
    path, start_status = call_without_inlining(start_path, coeffs, state)
    start_motion = path.motion
    path = path._replace(time_remaining=choose(start_status == Status.OK, coeffs.period, 0.0))
    first_period_end = coeffs.period if periods == 1 else coeffs.period + lax.full_like(path.x, 0.0)
    loop_limits = integration_loop.loop_limits(coeffs, periods)
    begin_next_period = (
        partial(_begin_next_period, coeffs, start_motion, (periods - 0.5) * coeffs.period) if periods > 1 else None
    )
    loop_state = integration_loop.run_loop(
        coeffs,
        integration_loop.initial_loop_state(coeffs, path, slots, first_period_end, clearance, history_slots),
        loop_limits,
        begin_next_period,
    )
    history = _collect_replay_history(loop_state) if history_slots else ReplayHistory(loop_state.release_time)
    return state_and_impacts(coeffs, loop_state, state, start_status, clearance), history


def _collect_replay_history(loop_state):
    times, speeds, n_impacts = impact_log.impacts_since_release(loop_state.log, loop_state.impact_slots)
    times, sides, last_release_times = (
        jnp.moveaxis(rows, 0, -1) for rows in (times, jnp.sign(speeds), loop_state.impact_slots.release_times)
    )
    return ReplayHistory(loop_state.release_time, n_impacts, times, sides, last_release_times)


def _begin_next_period(coeffs, start_motion, last_period_start, loop_state):
    """Begin the next period of a path; the drive phase is corrected by the rounding error of the last period."""
    path, log = loop_state.path, loop_state.log
    is_next_period_due = (path.time_remaining == 0) & (log.end_time < last_period_start)
    time_remaining_low = path.time_remaining_low_part + coeffs.period_low_part
    correction_angle = -coeffs.frequency * time_remaining_low
    drive_cosine, drive_sine = (
        start_motion.cosine - correction_angle * start_motion.sine,
        start_motion.sine + correction_angle * start_motion.cosine,
    )
    motion = path.motion._replace(
        cosine=choose(is_next_period_due, drive_cosine, path.cosine),
        sine=choose(is_next_period_due, drive_sine, path.sine),
    )
    time_remaining, time_remaining_low = (
        choose(is_next_period_due, coeffs.period, path.time_remaining),
        choose(is_next_period_due, time_remaining_low, path.time_remaining_low_part),
    )
    path = path._replace(motion=motion, time_remaining=time_remaining, time_remaining_low_part=time_remaining_low)
    end_time = choose(is_next_period_due, log.end_time + coeffs.period, log.end_time)
    return loop_state._replace(path=path, log=log._replace(end_time=end_time))


def fly_once(coeffs, state, path, start_status, duration):
    """Return (State, Impacts) after a flight of at most one period; impacts are counted but not recorded."""
    path = path._replace(time_remaining=choose(start_status == Status.OK, duration, 0.0))
    loop_state = integration_loop.initial_loop_state(coeffs, path, 0, duration)
    loop_state = integration_loop.run_loop(coeffs, loop_state, integration_loop.loop_limits(coeffs, 1))
    return state_and_impacts(coeffs, loop_state, state, start_status)


def state_and_impacts(coeffs, loop_state, state, start_status, clearance=False):
    """Return (State, Impacts) at the end of a loop, with the least clearance if requested."""
    path, log, impact_slots, turning_points = loop_state[:4]
    x, v = absolute_state(coeffs, path)
    has_unrecorded_impacts = (log.count > len(impact_slots.times)) | (log.least_speed < 0)
    status = choose(has_unrecorded_impacts, lax.full_like(log.count, Status.FULL), Status.OK)
    status = choose(path.time_remaining == CAPPED, Status.CAP, status)
    is_finite = jnp.isfinite(x) & jnp.isfinite(v) & jnp.isfinite(path.cosine)
    status = choose(is_finite, status, Status.NONFINITE)
    status = choose(start_status == Status.OK, status, start_status)
    has_end_state = status < Status.CAP
    contact_code = reported_contact_code(path)
    phase = jnp.broadcast_to(state.phase, status.shape)
    end_state = State(
        choose(has_end_state, x, jnp.nan),
        choose(has_end_state, v, jnp.nan),
        phase,
        choose(has_end_state, contact_code, 0.0),
    )
    times, sides, speeds = impact_log.impact_arrays(impact_slots)
    min_clearance = jnp.full_like(path.x, jnp.inf) if turning_points is None else turning_points.least_clearance
    return end_state, Impacts(
        time=times,
        side=sides,
        speed=speeds,
        count=log.count.astype(jnp.int32),
        least_speed=positive_part(log.least_speed),
        least_clearance=min_clearance if clearance else None,
        status=status.astype(jnp.int32),
    )


def reported_contact_code(path):
    """Return the contact code for a `State`: ENTERED is replaced by WITHIN, and RELEASED by LANDED."""
    nonsticking_code = choose(is_inside_soft_wall(path.contact), Contact.WITHIN, abs(jnp.sign(path.contact)))
    return jnp.sign(path.contact) * choose(abs(path.contact) == Contact.STUCK, Contact.STUCK, nonsticking_code)


def make_empty_history(n_lanes, n_recorded_impacts, dtype, history_slots):
    """Return the initial content of a `ReplayHistory`."""
    zero = jnp.zeros(n_lanes, dtype)
    if not history_slots:
        return ReplayHistory(zero)
    times, sides = jnp.full((n_lanes, history_slots), jnp.inf, dtype), jnp.zeros((n_lanes, history_slots), dtype)
    return ReplayHistory(zero, zero, times, sides, jnp.full((n_lanes, n_recorded_impacts), -1.0, dtype))


def history_without_release(impacts, history_slots):
    """Return the `ReplayHistory` of lanes that never stick."""
    times, zero = impacts.time, jnp.zeros_like(impacts.least_speed)
    if not history_slots:
        return ReplayHistory(zero - 1.0)
    n_impacts, sides = impacts.count.astype(zero.dtype), impacts.side.astype(zero.dtype)
    return ReplayHistory(
        zero - 1.0, n_impacts, times[..., :history_slots], sides[..., :history_slots], jnp.full_like(times, -1.0)
    )


def make_empty_results(n_lanes, slots, dtype, clearance=False):
    """Return the initial (State, Impacts) of a loop; times are inf, so that XLA does not share equal arrays."""
    zero = jnp.zeros(n_lanes, dtype)
    zero_int = jnp.zeros(n_lanes, jnp.int32)
    times, speeds = jnp.full((n_lanes, slots), jnp.inf, dtype), jnp.zeros((n_lanes, slots), dtype)
    sides = jnp.zeros((n_lanes, slots), jnp.int8)
    return State(zero, zero, zero, zero), Impacts(
        times, sides, speeds, zero_int, zero, zero if clearance else None, zero_int
    )

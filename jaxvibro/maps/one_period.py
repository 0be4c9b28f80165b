"""Compute drive periods of lanes by the reference path: final states and impacts."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.blocks import run_in_blocks
from ..compiled.compiler_hints import choose, positive_part, stage
from ..compiled.kernels import call_as_kernel
from ..flight import impact_log, integrate
from ..flight.coefficients import compute_coefficients
from ..flight.entry import start_path
from ..flight.flight_state import CAPPED, absolute_state
from ..flight.soft_contact import is_inside
from ..scene.codes import Contact, Status
from ..scene.state import Impacts, State

REPLAY_SLOTS = 32  # impacts per period that a replay can differentiate


class ReplayHistory(NamedTuple):
    """Data of a path that a replay needs besides the impacts.

    `release_time` is the time of the last release from a wall, -1 without one. The other fields are None unless a
    replay needs them: `count`, `times` and `sides` of the impacts since then, and `last_releases`, the time of the last
    release before each impact from the start.
    """

    release_time: Float[jax.Array, "*lanes"]
    count: Float[jax.Array, "*lanes"] | None = None  # type: ignore[assignment]  # a tuple has a method of this name
    times: Float[jax.Array, "*lanes late"] | None = None
    sides: Float[jax.Array, "*lanes late"] | None = None
    last_releases: Float[jax.Array, "*lanes slots"] | None = None


def strobe(scene, state, periods, slots, min_lanes, clearance=False, n_due=None):
    """Return (State, Impacts) for numbers that broadcast, in blocks of `min_lanes` lanes or more.

    `n_due` is that of `run_in_blocks`.
    """
    return _strobe_in_blocks(_strobe_alone, scene, state, periods, slots, min_lanes, clearance, n_due)


def strobe_with_record(scene, state, periods, slots, min_lanes, clearance=False, history_slots=0):
    """Return ((State, Impacts), `ReplayHistory`); arguments as for `strobe`."""
    return _strobe_in_blocks(
        strobe_with_history, scene, state, periods, slots, min_lanes, clearance, history_slots=history_slots
    )


def _strobe_in_blocks(function, scene, state, periods, slots, min_lanes, clearance, n_due=None, **options):
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))

    def run(arguments):
        return call_as_kernel(function, *arguments, periods=periods, slots=slots, clearance=clearance, **options)

    def make_empty(n_lanes):
        results = empty_results(n_lanes, slots, scene.dtype, clearance)
        return (
            results if function is _strobe_alone else (results, empty_history(n_lanes, slots, scene.dtype, **options))
        )

    return run_in_blocks(
        run, (scene, replace(state, x=jnp.broadcast_to(state.x, shape))), make_empty, min_lanes, n_due=n_due
    )


def _strobe_alone(scene, state, periods, slots, clearance):
    return strobe_with_history(scene, state, periods, slots, clearance)[0]


def strobe_with_history(scene, state, periods, slots, clearance=False, history_slots=0):
    """Return ((State, Impacts), `ReplayHistory`) of a block; numbers are scalars or have the shape of `state.x`.

    With `clearance` the least clearance is measured, else it is None. `history_slots` are the slots of the
    `ReplayHistory`.
    """
    coeffs = compute_coefficients(scene)
    path, entry_status = stage(start_path, coeffs, state)
    start_motion = path.motion
    path = path._replace(time_remaining=choose(entry_status == Status.OK, coeffs.period, 0.0))
    end_time = coeffs.period if periods == 1 else coeffs.period + lax.full_like(path.x, 0.0)
    step_limit = integrate.loop_limits(coeffs, periods)
    begin_next = (
        partial(_begin_next_period, coeffs, start_motion, (periods - 0.5) * coeffs.period) if periods > 1 else None
    )
    loop = integrate.run_loop(
        coeffs,
        integrate.initial_loop_state(coeffs, path, slots, end_time, clearance, history_slots),
        step_limit,
        begin_next,
    )
    history = _replay_history(loop) if history_slots else ReplayHistory(loop.release_time)
    return state_and_impacts(coeffs, loop, state, entry_status, clearance), history


def _replay_history(loop):
    times, speeds, n_impacts = impact_log.impacts_since_release(loop.log, loop.impact_slots)
    times, sides, last_releases = (
        jnp.moveaxis(rows, 0, -1) for rows in (times, jnp.sign(speeds), loop.impact_slots.release_times)
    )
    return ReplayHistory(loop.release_time, n_impacts, times, sides, last_releases)


def _begin_next_period(coeffs, start_motion, last_period_start, loop):
    """Begin the next period of a path; the drive is turned back by the rounding error of the last period."""
    path, log = loop.path, loop.log
    has_period_ended = (path.time_remaining == 0) & (log.end_time < last_period_start)
    time_remaining_low = path.time_remaining_low + coeffs.period_low
    angle = -coeffs.frequency * time_remaining_low
    cosine, sine = start_motion.cosine - angle * start_motion.sine, start_motion.sine + angle * start_motion.cosine
    motion = path.motion._replace(
        cosine=choose(has_period_ended, cosine, path.cosine), sine=choose(has_period_ended, sine, path.sine)
    )
    time_remaining, time_remaining_low = (
        choose(has_period_ended, coeffs.period, path.time_remaining),
        choose(has_period_ended, time_remaining_low, path.time_remaining_low),
    )
    path = path._replace(motion=motion, time_remaining=time_remaining, time_remaining_low=time_remaining_low)
    end_time = choose(has_period_ended, log.end_time + coeffs.period, log.end_time)
    return loop._replace(path=path, log=log._replace(end_time=end_time))


def state_and_impacts(coeffs, loop, state, entry_status, clearance=False):
    """Return (State, Impacts) at the end of a loop, with the least clearance if requested."""
    path, log, slots, turning_points = loop[:4]
    x, v = absolute_state(coeffs, path)
    is_full = (log.count > len(slots.times)) | (log.least_speed < 0)
    status = choose(is_full, lax.full_like(log.count, Status.FULL), Status.OK)
    status = choose(path.time_remaining == CAPPED, Status.CAP, status)
    is_finite = jnp.isfinite(x) & jnp.isfinite(v) & jnp.isfinite(path.cosine)
    status = choose(is_finite, status, Status.NONFINITE)
    status = choose(entry_status == Status.OK, status, entry_status)
    is_valid = status < Status.CAP
    contact = reported_contact(path)
    phase = jnp.broadcast_to(state.phase, status.shape)
    end = State(choose(is_valid, x, jnp.nan), choose(is_valid, v, jnp.nan), phase, choose(is_valid, contact, 0.0))
    times, sides, speeds = impact_log.impact_rows(slots)
    min_clearance = jnp.full_like(path.x, jnp.inf) if turning_points is None else turning_points.least_clearance
    return end, Impacts(
        time=times,
        side=sides,
        speed=speeds,
        count=log.count.astype(jnp.int32),
        least_speed=positive_part(log.least_speed),
        least_clearance=min_clearance if clearance else None,
        status=status.astype(jnp.int32),
    )


def reported_contact(path):
    """Return the contact as a `State` reports it: after an entry it is WITHIN, after a release LANDED."""
    contact_code = choose(is_inside(path.contact), Contact.WITHIN, abs(jnp.sign(path.contact)))
    return jnp.sign(path.contact) * choose(abs(path.contact) == Contact.STUCK, Contact.STUCK, contact_code)


def empty_history(n_lanes, slots, dtype, history_slots=0):
    """Return a `ReplayHistory` to fill in."""
    zero = jnp.zeros(n_lanes, dtype)
    if not history_slots:
        return ReplayHistory(zero)
    times, sides = jnp.full((n_lanes, history_slots), jnp.inf, dtype), jnp.zeros((n_lanes, history_slots), dtype)
    return ReplayHistory(zero, zero, times, sides, jnp.full((n_lanes, slots), -1.0, dtype))


def history_without_release(impacts, history_slots):
    """Return the `ReplayHistory` of lanes that never stick."""
    times, zero = impacts.time, jnp.zeros_like(impacts.least_speed)
    if not history_slots:
        return ReplayHistory(zero - 1.0)
    n_impacts, sides = impacts.count.astype(zero.dtype), impacts.side.astype(zero.dtype)
    return ReplayHistory(
        zero - 1.0, n_impacts, times[..., :history_slots], sides[..., :history_slots], jnp.full_like(times, -1.0)
    )


def empty_results(n_lanes, slots, dtype, clearance=False):
    """Return results to fill in; times start with their final empty value, because equal arrays would be shared."""
    zero = jnp.zeros(n_lanes, dtype)
    zero_int = jnp.zeros(n_lanes, jnp.int32)
    times, speeds = jnp.full((n_lanes, slots), jnp.inf, dtype), jnp.zeros((n_lanes, slots), dtype)
    sides = jnp.zeros((n_lanes, slots), jnp.int8)
    return State(zero, zero, zero, zero), Impacts(
        times, sides, speeds, zero_int, zero, zero if clearance else None, zero_int
    )

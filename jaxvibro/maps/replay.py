"""Replay recorded impacts as smooth functions of state and scene.

Each flight takes its recorded time, a constant, and ends at the recorded time of the impact. The impact itself is later
by a delay that is 0 and has derivatives. The delay is computed, and its effect is transported back to the recorded
time, by Taylor polynomials up to the order of the derivatives. So flights stay linear in the state, and the only
differentiated iteration is Newton's method on these polynomials: k steps are exact to order 2^k - 1.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float, Real

from ..compiled.compiler_hints import choose, stage
from ..flight import flow, taylor
from ..flight.flows import flow_of
from ..flight.soft_contact import restitution_of
from ..flight.taylor import ExpansionPoint
from ..flight.wall_motion import select_lists_by_side, subtract, wall_jet_on_side
from ..scene.codes import Contact
from .contact_replays import contact_replay_of
from .path_end import PathEnd


class RecordedImpacts(NamedTuple):
    """Impacts of a simulation, to be replayed.

    `times` and `sides` (-1, 0, 1) have the shape (slots, lanes), with inf and 0 in empty slots. `count` is the number
    of impacts, negative where a replay is not possible. `release_time` is the time of the last release from a wall, -1
    without one. `end_contact` is the contact at the end of a mass that sticks or is within a soft wall, 0 otherwise.
    `last_releases` has the time of the last release before each impact; None means that all impacts are after
    `release_time`.
    """

    times: Float[jax.Array, "..."]
    sides: Float[jax.Array, "..."]
    count: Real[jax.Array, "*lanes"]  # type: ignore[assignment]  # a tuple has a method of this name
    release_time: Float[jax.Array, "*lanes"]
    end_contact: Float[jax.Array, "*lanes"]
    last_releases: Float[jax.Array, "..."] | None = None


def replay_periods(coeffs, state, impacts, periods, order):
    """Return ((x, v) at the end, times, speeds of the impacts) with derivatives up to an order; slots first."""
    start, end, _, times, speeds = _replay_path(coeffs, state, impacts, periods * coeffs.period, order)
    final = _hold_on_wall(coeffs, start._replace(x=end.x, v=end.v), _sticking_side(impacts.end_contact))
    return (final.x, final.v), times, speeds


def replay_duration(coeffs, state, impacts, duration, order):
    """Return (x, v) after any time, with derivatives up to an order, also with respect to the time."""
    _, end, delay, _, _ = _replay_path(coeffs, state, impacts, duration, order)
    cosine, sine = flow.rotate_by_angle(end.cosine, end.sine, coeffs.frequency * delay)
    final = _hold_on_wall(coeffs, end._replace(cosine=cosine, sine=sine), _sticking_side(impacts.end_contact))
    return final.x, final.v


def _replay_path(coeffs, state, impacts, duration, order):
    """Return (start, end after the duration, delay of the end, times, speeds of the impacts)."""
    zero = lax.full_like(impacts.release_time, 0.0)
    cosine, sine = jnp.cos(state.phase) + zero, jnp.sin(state.phase) + zero
    start = _hold_on_wall(
        coeffs, ExpansionPoint(state.x + zero, state.v + zero, cosine, sine, zero), _sticking_side(state.contact) + zero
    )
    total_time = lax.stop_gradient(duration) + zero
    contact_replay = contact_replay_of(coeffs)
    path_end = PathEnd(total_time, impacts.end_contact)
    start, pending_contact = contact_replay.start_in_contact(coeffs, start, state.contact, path_end, order)
    if coeffs.walls:
        end, times, speeds = _replay_impacts(coeffs, start, pending_contact, impacts, path_end, order)
    else:
        end, times, speeds = _fly(coeffs, start, total_time), impacts.times, jnp.zeros_like(impacts.times)
    delay = duration - total_time
    free_state = flow_of(coeffs).jet_at_point(coeffs, end, order)
    free_state = taylor.evaluate_taylor(free_state, delay, order), taylor.evaluate_taylor(free_state[1:], delay, order)
    x, v = contact_replay.shift_state(coeffs, end, impacts.end_contact, free_state, delay, order)
    return start, end._replace(x=x, v=v), delay, times, speeds


def _replay_impacts(coeffs, start, pending_contact, impacts, path_end, order):
    """Return (state at the `PathEnd`, times, speeds of the impacts) from the results of `start_in_contact`."""
    contact_replay, total_time = contact_replay_of(coeffs), path_end.time
    n_impacts = lax.min(jnp.max(impacts.count).astype(jnp.int32), jnp.int32(len(impacts.times)))

    def replay_event(carry):
        """Advance to the next impact, or to a release before it, or, after all impacts, to the end."""
        k, last_release, current, pending_contact, *time_speed_rows = carry
        current = contact_replay.complete_contact(coeffs, current, pending_contact, path_end, order)
        time, side = (lax.dynamic_index_in_dim(row, k, keepdims=False) for row in (impacts.times, impacts.sides))
        is_last = k == n_impacts
        time, side = choose(is_last, total_time, time), choose(is_last, 0.0, side)
        release_time = impacts.release_time
        if impacts.last_releases is not None:
            release_time = choose(
                is_last, release_time, lax.dynamic_index_in_dim(impacts.last_releases, k, keepdims=False)
            )
        is_due = release_time > last_release
        any_release = jnp.any(is_due)
        is_impact = (side != 0) & ~any_release
        target_time = choose(~any_release & (is_impact | is_last), time, current.time)
        current = _fly(coeffs, current, target_time - current.time)
        current = lax.cond(
            any_release,
            lambda current: _release_from_wall(coeffs, current, is_due, release_time, order),
            lambda current: current,
            current,
        )
        delay, speed, x, v = stage(_rebound, coeffs, current, side, order=order)
        time_speed_rows = [
            _update_row(*row, k, is_impact) for row in zip(time_speed_rows, (time + delay, speed), strict=True)
        ]
        current = current._replace(x=choose(is_impact, x, current.x), v=choose(is_impact, v, current.v))
        current, pending_contact = contact_replay.enter_wall(
            coeffs, current, choose(is_impact, side, 0.0), delay, path_end, order
        )
        return (
            k + (~any_release).astype(jnp.int32),
            choose(is_due, release_time, last_release),
            current,
            pending_contact,
            *time_speed_rows,
        )

    no_release = lax.full_like(impacts.release_time, -1.0)
    carry = (jnp.int32(0), no_release, start, pending_contact, impacts.times, jnp.zeros_like(impacts.times))
    _, _, current, _, *time_speed_rows = lax.while_loop(lambda carry: carry[0] <= n_impacts, replay_event, carry)
    return current, *time_speed_rows


def _update_row(rows, values, k, mask):
    """Replace some lanes of row k."""
    old_values = lax.dynamic_index_in_dim(rows, k, keepdims=False)
    return lax.dynamic_update_index_in_dim(rows, choose(mask, values, old_values), k, 0)


def _sticking_side(contact):
    return choose(lax.abs(contact) == Contact.STUCK, jnp.sign(contact), 0.0)


def _fly(coeffs, current, time):
    """Fly freely for a time."""
    end_point = flow_of(coeffs).fly(coeffs, current.x, current.v, current.cosine, current.sine, time)
    return ExpansionPoint(*end_point, current.time + time)


def _hold_on_wall(coeffs, current, side):
    """Set position and velocity to those of the wall on a side; side 0 leaves them unchanged."""
    if not coeffs.walls:
        return current
    wall_position, wall_velocity = wall_jet_on_side(coeffs, side, current.cosine, current.sine, 1)
    is_sticking = side != 0
    return current._replace(
        x=choose(is_sticking, wall_position, current.x),
        v=choose(is_sticking, 0.0 if wall_velocity is None else wall_velocity, current.v),
    )


def _release_from_wall(coeffs, current, is_due, release_time, order):
    """Move the lanes that are due to their release, where the contact force vanishes; no earlier state matters.

    If there are two walls, it is the one with the smaller contact force.
    """
    time = choose(is_due, release_time, current.time)
    phasor = flow.rotate_by_angle(current.cosine, current.sine, coeffs.frequency * (time - current.time))
    current = ExpansionPoint(
        current.x,
        current.v,
        *(choose(is_due, *new_and_old) for new_and_old in zip(phasor, current[2:4], strict=True)),
        time,
    )
    contact_forces = [
        flow_of(coeffs).contact_force(coeffs, wall, current.cosine, current.sine, order) for wall in coeffs.walls
    ]
    side = lax.full_like(current.x, float(coeffs.walls[0].sign))
    if len(contact_forces) == 2:
        side = choose(lax.abs(contact_forces[1][0]) < lax.abs(contact_forces[0][0]), 1.0, side)
    delay = taylor.locate_root(select_lists_by_side(side, coeffs.walls, contact_forces), order)
    wall_derivs = taylor.wall_derivatives(coeffs, current, side, order)
    x, v = flow_of(coeffs).propagate_back(coeffs, current, *taylor.wall_state(wall_derivs, delay, order), delay, order)
    return current._replace(x=choose(is_due, x, current.x), v=choose(is_due, v, current.v))


def _rebound(coeffs, current, side, order):
    """Return (delay, speed relative to the wall, x, v) of an impact about now, transported back to now."""
    jet, wall_derivs = (
        flow_of(coeffs).jet_at_point(coeffs, current, order),
        taylor.wall_derivatives(coeffs, current, side, order),
    )
    delay = taylor.locate_root(
        [subtract(mass_term, wall_term) for mass_term, wall_term in zip(jet[: order + 1], wall_derivs, strict=False)],
        order,
    )
    (wall_position, wall_velocity), v = (
        taylor.wall_state(wall_derivs, delay, order),
        taylor.evaluate_taylor(jet[1:], delay, order),
    )
    approach_velocity = v - wall_velocity
    velocity_after = v - (1.0 + restitution_of(coeffs, side)) * approach_velocity
    return (
        delay,
        side * approach_velocity,
        *flow_of(coeffs).propagate_back(coeffs, current, wall_position, velocity_after, delay, order),
    )

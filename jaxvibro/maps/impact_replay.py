"""Replay recorded impacts as smooth functions of state and scene, and differentiate a replay.

Each flight ends at the recorded time of the impact, a constant. The impact itself is later by a delay, which is 0 but
has derivatives. Taylor polynomials up to the order of the derivatives give the delay and transport its effect back to
the recorded time. Flights therefore remain linear in the state. The only differentiated iteration is Newton's method on
these polynomials: k steps are exact to order 2^k - 1.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float, Real

from ..compiled.lane_arithmetic import call_without_inlining, choose, value_and_gradient
from ..contact.end_time_and_contact import EndTimeAndContact
from ..contact.kinds import make_flow_coefficients
from ..flight import flow, taylor_polynomials
from ..flight.motion_in_soft_wall import restitution_of
from ..flight.taylor_polynomials import ExpansionPoint
from ..flight.wall_motion import select_lists_by_side, subtract_optional, wall_jet_on_side
from ..scene.state import Contact, Status


class RecordedImpacts(NamedTuple):
    """Recorded impacts of a simulation, the input of a replay.

    Attributes
    ----------
    times : array of shape (slots, lanes)
        Times of the impacts; inf in empty slots.
    sides : array of shape (slots, lanes)
        Sides -1 or 1 of the impacts; 0 in empty slots.
    count : array
        Number of impacts; negative if a replay is not possible.
    release_time : array
        Time of the last release from a wall; -1 without a release.
    end_contact : array
        Contact code at the end if the mass sticks or is within a soft wall, 0 otherwise.
    last_releases : array of shape (slots, lanes) or None
        Time of the last release before each impact. None if all impacts follow `release_time`.
    """

    times: Float[jax.Array, "..."]
    sides: Float[jax.Array, "..."]
    count: Real[jax.Array, "*lanes"]  # type: ignore[assignment]  # a tuple has a method of this name
    release_time: Float[jax.Array, "*lanes"]
    end_contact: Float[jax.Array, "*lanes"]
    last_releases: Float[jax.Array, "..."] | None = None


def replay_periods(coeffs, state, impacts, periods, order):
    """Replay whole periods and return ((x, v) at the end, impact times, impact speeds), slots first.

    The results have derivatives up to `order`.
    """
    start_state, end_state, _, times, speeds = _replay_path(coeffs, state, impacts, periods * coeffs.period, order)
    final_state = _hold_on_wall(
        coeffs, start_state._replace(x=end_state.x, v=end_state.v), _sticking_side(impacts.end_contact)
    )
    return (final_state.x, final_state.v), times, speeds


def replay_duration(coeffs, state, impacts, duration, order):
    """Return (x, v) after a duration, with derivatives up to `order`, also with respect to the duration."""
    _, end_state, end_delay, _, _ = _replay_path(coeffs, state, impacts, duration, order)
    drive_cosine, drive_sine = flow.rotate_phasor_by_angle(
        end_state.cosine, end_state.sine, coeffs.frequency * end_delay
    )
    final_state = _hold_on_wall(
        coeffs, end_state._replace(cosine=drive_cosine, sine=drive_sine), _sticking_side(impacts.end_contact)
    )
    return final_state.x, final_state.v


def _replay_path(coeffs, state, impacts, duration, order):
    """Return (initial state, final state, delay of the end, impact times, impact speeds)."""
    zero = lax.full_like(impacts.release_time, 0.0)
    drive_cosine, drive_sine = jnp.cos(state.phase) + zero, jnp.sin(state.phase) + zero
    start_state = _hold_on_wall(
        coeffs,
        ExpansionPoint(state.x + zero, state.v + zero, drive_cosine, drive_sine, zero),
        _sticking_side(state.contact) + zero,
    )
    end_time = lax.stop_gradient(duration) + zero
    path_end = EndTimeAndContact(end_time, impacts.end_contact)
    start_state, pending_contact = coeffs.contact.replay_initial_contact(
        coeffs, start_state, state.contact, path_end, order
    )
    if coeffs.walls:
        end_state, times, speeds = _replay_impacts(coeffs, start_state, pending_contact, impacts, path_end, order)
    else:
        end_state, times, speeds = (
            _fly_freely(coeffs, start_state, end_time),
            impacts.times,
            jnp.zeros_like(impacts.times),
        )
    end_delay = duration - end_time
    free_flight_state = coeffs.flow.jet_at_point(coeffs, end_state, order)
    free_flight_state = (
        taylor_polynomials.evaluate_taylor(free_flight_state, end_delay, order),
        taylor_polynomials.evaluate_taylor(free_flight_state[1:], end_delay, order),
    )
    x, v = coeffs.contact.state_after_delay(coeffs, end_state, impacts.end_contact, free_flight_state, end_delay, order)
    return start_state, end_state._replace(x=x, v=v), end_delay, times, speeds


def _replay_impacts(coeffs, start_state, pending_contact, impacts, path_end, order):
    """Return (state at the `EndTimeAndContact`, impact times, impact speeds) from the results of
    `replay_initial_contact`."""
    contact, end_time = coeffs.contact, path_end.time
    n_impacts = lax.min(jnp.max(impacts.count).astype(jnp.int32), jnp.int32(len(impacts.times)))

    def replay_next_event(carry):
        """Advance to the next event: a release, an impact, or the end after the last impact."""
        impact_index, last_release_time, current_state, pending_contact, *time_and_speed_rows = carry
        current_state = contact.complete_pending_contact(coeffs, current_state, pending_contact, path_end, order)
        impact_time, side = (
            lax.dynamic_index_in_dim(row, impact_index, keepdims=False) for row in (impacts.times, impacts.sides)
        )
        is_after_last_impact = impact_index == n_impacts
        impact_time, side = choose(is_after_last_impact, end_time, impact_time), choose(is_after_last_impact, 0.0, side)
        release_time = impacts.release_time
        if impacts.last_releases is not None:
            release_time = choose(
                is_after_last_impact,
                release_time,
                lax.dynamic_index_in_dim(impacts.last_releases, impact_index, keepdims=False),
            )
        is_release_due = release_time > last_release_time
        is_any_release_due = jnp.any(is_release_due)
        is_impact = (side != 0) & ~is_any_release_due
        target_time = choose(~is_any_release_due & (is_impact | is_after_last_impact), impact_time, current_state.time)
        current_state = _fly_freely(coeffs, current_state, target_time - current_state.time)
        current_state = lax.cond(
            is_any_release_due,
            lambda current_state: _release_from_wall(coeffs, current_state, is_release_due, release_time, order),
            lambda current_state: current_state,
            current_state,
        )
        delay, speed, x, v = call_without_inlining(_delayed_rebound, coeffs, current_state, side, order=order)
        time_and_speed_rows = [
            _update_row(*row, impact_index, is_impact)
            for row in zip(time_and_speed_rows, (impact_time + delay, speed), strict=True)
        ]
        current_state = current_state._replace(
            x=choose(is_impact, x, current_state.x), v=choose(is_impact, v, current_state.v)
        )
        current_state, pending_contact = contact.replay_wall_entry(
            coeffs, current_state, choose(is_impact, side, 0.0), delay, path_end, order
        )
        return (
            impact_index + (~is_any_release_due).astype(jnp.int32),
            choose(is_release_due, release_time, last_release_time),
            current_state,
            pending_contact,
            *time_and_speed_rows,
        )

    no_release_time = lax.full_like(impacts.release_time, -1.0)
    carry = (jnp.int32(0), no_release_time, start_state, pending_contact, impacts.times, jnp.zeros_like(impacts.times))
    _, _, current_state, _, *time_and_speed_rows = lax.while_loop(
        lambda carry: carry[0] <= n_impacts, replay_next_event, carry
    )
    return current_state, *time_and_speed_rows


def _update_row(slot_rows, new_values, slot_index, lane_mask):
    """Replace the values of the masked lanes in one row and return all rows."""
    old_values = lax.dynamic_index_in_dim(slot_rows, slot_index, keepdims=False)
    return lax.dynamic_update_index_in_dim(slot_rows, choose(lane_mask, new_values, old_values), slot_index, 0)


def _sticking_side(contact_code):
    return choose(lax.abs(contact_code) == Contact.STUCK, jnp.sign(contact_code), 0.0)


def _fly_freely(coeffs, current_state, duration):
    """Return the `ExpansionPoint` after a free flight of the given duration."""
    end_values = coeffs.flow.fly(
        coeffs, current_state.x, current_state.v, current_state.cosine, current_state.sine, duration
    )
    return ExpansionPoint(*end_values, current_state.time + duration)


def _hold_on_wall(coeffs, current_state, side):
    """Set the position and the velocity of lanes to those of the wall on `side`; side 0 means no change."""
    if not coeffs.walls:
        return current_state
    wall_position, wall_velocity = wall_jet_on_side(coeffs, side, current_state.cosine, current_state.sine, 1)
    is_sticking = side != 0
    return current_state._replace(
        x=choose(is_sticking, wall_position, current_state.x),
        v=choose(is_sticking, 0.0 if wall_velocity is None else wall_velocity, current_state.v),
    )


def _release_from_wall(coeffs, current_state, is_release_due, release_time, order):
    """Move the selected lanes to the release from the wall, at which the contact force vanishes.

    The state after a release does not depend on earlier states. With two walls, the mass leaves the wall whose contact
    force is smaller in magnitude.
    """
    next_time = choose(is_release_due, release_time, current_state.time)
    drive_phasor = flow.rotate_phasor_by_angle(
        current_state.cosine, current_state.sine, coeffs.frequency * (next_time - current_state.time)
    )
    current_state = ExpansionPoint(
        current_state.x,
        current_state.v,
        *(choose(is_release_due, *new_and_old) for new_and_old in zip(drive_phasor, current_state[2:4], strict=True)),
        next_time,
    )
    contact_force_jets = [
        coeffs.flow.contact_force(coeffs, wall, current_state.cosine, current_state.sine, order)
        for wall in coeffs.walls
    ]
    side = lax.full_like(current_state.x, float(coeffs.walls[0].sign))
    if len(contact_force_jets) == 2:
        side = choose(lax.abs(contact_force_jets[1][0]) < lax.abs(contact_force_jets[0][0]), 1.0, side)
    release_delay = taylor_polynomials.locate_root_near_zero(
        select_lists_by_side(side, coeffs.walls, contact_force_jets), order
    )
    wall_derivatives = taylor_polynomials.wall_derivatives(coeffs, current_state, side, order)
    x, v = coeffs.flow.state_before_delay(
        coeffs,
        current_state,
        *taylor_polynomials.wall_state(wall_derivatives, release_delay, order),
        release_delay,
        order,
    )
    return current_state._replace(
        x=choose(is_release_due, x, current_state.x), v=choose(is_release_due, v, current_state.v)
    )


def _delayed_rebound(coeffs, current_state, side, order):
    """Return (delay, relative speed, x, v) of an impact; (x, v) is transported back to the current time."""
    mass_jet, wall_derivatives = (
        coeffs.flow.jet_at_point(coeffs, current_state, order),
        taylor_polynomials.wall_derivatives(coeffs, current_state, side, order),
    )
    impact_delay = taylor_polynomials.locate_root_near_zero(
        [
            subtract_optional(mass_derivative, wall_derivative)
            for mass_derivative, wall_derivative in zip(mass_jet[: order + 1], wall_derivatives, strict=False)
        ],
        order,
    )
    (wall_position, wall_velocity), v = (
        taylor_polynomials.wall_state(wall_derivatives, impact_delay, order),
        taylor_polynomials.evaluate_taylor(mass_jet[1:], impact_delay, order),
    )
    approach_velocity = v - wall_velocity
    velocity_after = v - (1.0 + restitution_of(coeffs, side)) * approach_velocity
    return (
        impact_delay,
        side * approach_velocity,
        *coeffs.flow.state_before_delay(coeffs, current_state, wall_position, velocity_after, impact_delay, order),
    )


class ReplayData(NamedTuple):
    """Impacts of a strobe that are replayed for derivatives.

    Attributes
    ----------
    impacts_since_release : RecordedImpacts
        Impacts since the last release, on which the final state depends.
    recorded_impacts : RecordedImpacts
        All recorded impacts.
    slowest_impact_index : array
        Index of the slowest impact among `recorded_impacts`; -1 if the slowest impact is not recorded.
    """

    impacts_since_release: RecordedImpacts
    recorded_impacts: RecordedImpacts
    slowest_impact_index: Float[jax.Array, "*lanes"]


def collect_replay_data(end_state, impacts, replay_history):
    """Return the `ReplayData` of a strobe, slots last, from the final state, the impacts and the `ReplayHistory`.

    If the mass sticks at the end, the wall determines the final state, and no impact is replayed for this state.
    """
    end_contact_code = jnp.where(abs(end_state.contact) >= Contact.STUCK, end_state.contact, 0.0)
    has_no_end_state, is_sticking = impacts.status >= Status.CAP, abs(end_contact_code) == Contact.STUCK
    n_since_release = jnp.where(replay_history.count > replay_history.times.shape[-1], -1.0, replay_history.count)
    n_since_release = jnp.where(has_no_end_state, -1.0, jnp.where(is_sticking, 0.0, n_since_release))
    n_impacts = jnp.where(has_no_end_state, -1.0, impacts.count)
    sides = impacts.side.astype(impacts.time.dtype)
    recorded_since_release = RecordedImpacts(
        replay_history.times, replay_history.sides, n_since_release, replay_history.release_time, end_contact_code
    )
    return ReplayData(
        recorded_since_release,
        RecordedImpacts(
            impacts.time, sides, n_impacts, replay_history.release_time, end_contact_code, replay_history.last_releases
        ),
        _slowest_index(impacts),
    )


def move_slots_first(impacts):
    """Move the slots of `RecordedImpacts` from the last axis to the first."""
    slot_rows = {name: getattr(impacts, name) for name in ("times", "sides", "last_releases")}
    return impacts._replace(
        **{name: None if slot_row is None else jnp.moveaxis(slot_row, -1, 0) for name, slot_row in slot_rows.items()}
    )


def _slowest_index(impacts):
    """Return the index of the slowest impact; -1 if this impact is not recorded, as after complete chatter."""
    if not impacts.speed.shape[-1]:
        return jnp.full_like(impacts.least_speed, -1.0)
    speeds = jnp.where(impacts.side != 0, impacts.speed, jnp.inf)
    is_slowest_recorded = jnp.isfinite(impacts.least_speed) & (jnp.min(speeds, axis=-1) == impacts.least_speed)
    return jnp.where(is_slowest_recorded, jnp.argmin(speeds, axis=-1), -1.0)


def truncate_slots(impacts, slots):
    """Truncate the recorded impacts to a smaller number of slots."""
    has_truncated_impacts = (impacts.status == Status.OK) & (impacts.count > slots)
    slot_rows = {name: getattr(impacts, name)[..., :slots] for name in ("time", "side", "speed")}
    status = jnp.where(has_truncated_impacts, Status.FULL, impacts.status).astype(impacts.status.dtype)
    return replace(impacts, status=status, **slot_rows)


def replay_derivatives(leaves, impacts, tree, argnums, periods, order, of_state):
    """Compute the derivatives of orders 1 to `order` with respect to the leaves `argnums`.

    If `of_state` is true, x and v at the end are differentiated, otherwise the times and speeds of the impacts. Results
    have lanes first and one trailing axis for each differentiation. They are nan where a replay is not possible.
    `impacts` has slots first.
    """

    def replay_outputs(*active_values):
        replaced_leaves = list(leaves)
        for argnum, value in zip(argnums, active_values, strict=True):
            replaced_leaves[argnum] = value
        scene, state = tree.unflatten(replaced_leaves)
        end_state, times, speeds = replay_periods(make_flow_coefficients(scene), state, impacts, periods, order)
        return end_state if of_state else (times, speeds)

    all_derivatives = make_with_derivatives(replay_outputs, order)(*(leaves[argnum] for argnum in argnums))[1:]
    n_lane_axes = impacts.count.ndim

    def nan_where_invalid(derivative):
        derivative = derivative if of_state else jnp.moveaxis(derivative, 0, n_lane_axes)
        has_no_replay = jnp.reshape(impacts.count < 0, (*impacts.count.shape, *[1] * (derivative.ndim - n_lane_axes)))
        return jnp.where(has_no_replay, jnp.nan, derivative)

    return jax.tree.map(nan_where_invalid, all_derivatives)


def make_with_derivatives(function, order):
    """Return a function that computes the value and the derivatives of `function` up to an order, lane by lane."""
    if order == 0:
        return lambda *args: (function(*args),)
    lower_order_function = make_with_derivatives(function, order - 1)

    def value_and_derivatives(*args):
        values, derivatives = value_and_gradient(lower_order_function, args, -1)
        return (*values, derivatives[-1])

    return value_and_derivatives

"""Replay of a contact phase within a soft wall under a user-defined force or contact law.

The contact phase is computed by `force_law_phase.fly_contact_phase`. The functions are those of a replay in
`protocols.Contact`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import choose
from ..flight import flow, taylor_polynomials
from ..flight.force_law_motion_series import ContactState
from ..flight.force_law_passage import traverse_contact
from ..flight.motion_in_soft_wall import is_inside_soft_wall, is_soft_side
from ..flight.taylor_polynomials import ExpansionPoint
from ..scene.state import Contact
from . import initial_contact
from .end_time_and_contact import exits_wall_before_end
from .force_law_phase import depth_after_delay, entry_state, fly_contact_phase, inward_acceleration
from .phase_ends import entry_rate, point_after_contact, side_of_contact


class PendingContact(NamedTuple):
    """Contact phase that is still to be replayed.

    Attributes
    ----------
    side : array
        Side of the wall, 0 for lanes outside the walls.
    start_in_wall : ContactState
        State at the start within the wall, arbitrary for lanes outside the walls.
    delay : array
        Time until the start of the contact phase: 0, with derivatives.
    """

    side: Float[jax.Array, "*lanes"]
    start_in_wall: ContactState
    delay: Float[jax.Array, "*lanes"]


def replay_initial_contact(coeffs, current_state, start_contact_code, path_end, order):
    """Return (current state, `PendingContact` of lanes that start within a soft wall)."""
    contact_code, relative_displacement, relative_velocity = initial_contact.initial_relative_state(
        coeffs, current_state, start_contact_code, order
    )
    is_within_wall, side = is_inside_soft_wall(contact_code), side_of_contact(contact_code)
    depth, depth_rate = side * relative_displacement, side * relative_velocity
    is_at_entry = is_within_wall & (lax.stop_gradient(depth) <= 0)
    entry_delay = choose(
        is_at_entry, -depth / choose(is_at_entry, depth_rate, 1.0), 0.0
    )  # exact to first order, and so are all results
    is_past_entry = is_within_wall & ~is_at_entry
    depth_rate_change = entry_delay * inward_acceleration(
        coeffs, side, depth_rate, current_state.cosine, current_state.sine
    )
    entry_contact_state = entry_state(
        depth_rate + depth_rate_change, current_state.cosine, current_state.sine, is_at_entry
    )
    start_in_wall = ContactState(
        choose(is_past_entry, lax.sqrt(choose(is_past_entry, depth, 1.0)), entry_contact_state.scaled_depth_root),
        choose(is_past_entry, depth_rate, entry_contact_state.scaled_depth_rate),
        choose(is_past_entry, 1.0, entry_contact_state.scale),
        *(
            choose(is_at_entry, delayed_value, current_value)
            for delayed_value, current_value in zip(
                _drive_phasor_after(coeffs, current_state, entry_delay),
                (current_state.cosine, current_state.sine),
                strict=True,
            )
        ),
    )
    return current_state, PendingContact(choose(is_within_wall, side, 0.0), start_in_wall, entry_delay)


def replay_wall_entry(coeffs, current_state, side, entry_delay, path_end, order):
    """Return (current state, `PendingContact` of lanes that enter a soft wall after a delay); side 0 means none."""
    is_within_wall = is_soft_side(coeffs, side) & (side != 0)
    side = choose(is_within_wall, side, 1.0)
    depth_rate = entry_rate(coeffs, current_state, side, entry_delay, order)
    start_in_wall = entry_state(depth_rate, *_drive_phasor_after(coeffs, current_state, entry_delay), is_within_wall)
    return current_state, PendingContact(
        choose(is_within_wall, side, 0.0), start_in_wall, choose(is_within_wall, entry_delay, 0.0)
    )


def complete_pending_contact(coeffs, current_state, pending_contact, path_end, order):
    """Move lanes with a pending contact phase to the exit from the wall, or to the end of the path."""
    is_within_wall, delay = pending_contact.side != 0, pending_contact.delay
    side, time_remaining = (
        choose(is_within_wall, pending_contact.side, 1.0),
        choose(is_within_wall, path_end.time - current_state.time, 0.0),
    )
    contact_passage = traverse_contact(
        *lax.stop_gradient((coeffs, side, pending_contact.start_in_wall, time_remaining))
    )
    exits_wall = exits_wall_before_end(
        coeffs,
        path_end,
        current_state,
        pending_contact.side * Contact.WITHIN,
        time_remaining - contact_passage.time_remaining,
    )
    contact_passage = contact_passage._replace(
        has_exited=exits_wall,
        time_remaining=choose(contact_passage.has_exited & ~exits_wall, 0.0, contact_passage.time_remaining),
    )
    contact_result = fly_contact_phase(
        coeffs, side, pending_contact.start_in_wall, time_remaining, delay, order, contact_passage
    )
    end_point = point_after_contact(coeffs, current_state, side, contact_result, delay, time_remaining, order)
    return ExpansionPoint(
        *(choose(is_within_wall, new, old) for new, old in zip(end_point, current_state, strict=True))
    )


def state_after_delay(coeffs, current_state, contact_code, free_flight_state, delay, order):
    """Return (x, v) after a delay, which is 0 but has derivatives; see `rigid.state_after_delay`."""
    is_within_wall, side = is_inside_soft_wall(contact_code), side_of_contact(contact_code)
    wall_position, wall_velocity = taylor_polynomials.wall_state(
        taylor_polynomials.wall_derivatives(coeffs, current_state, side, order), 0.0 * delay, order
    )
    depth, depth_rate = (
        choose(is_within_wall, side * (current_state.x - wall_position), 1.0),
        side * (current_state.v - wall_velocity),
    )
    contact_state_before = ContactState(
        depth, depth_rate, jnp.ones_like(depth), current_state.cosine, current_state.sine
    )
    depth, depth_rate = depth_after_delay(coeffs, side, contact_state_before, depth, depth_rate, delay, order)
    wall_position, wall_velocity = taylor_polynomials.wall_state(
        taylor_polynomials.wall_derivatives(coeffs, current_state, side, order), delay, order
    )
    return tuple(
        choose(is_within_wall, *contact_and_free_value)
        for contact_and_free_value in zip(
            (wall_position + side * depth, wall_velocity + side * depth_rate), free_flight_state, strict=True
        )
    )


def _drive_phasor_after(coeffs, current_state, duration):
    return flow.rotate_phasor_by_angle(current_state.cosine, current_state.sine, coeffs.frequency * duration)

"""Replay of a contact phase within a soft wall under a user-defined force, by `force_law_contact.fly_contact_phase`.

The interface is that of `linear_contact_replay`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from ..flight import flow, taylor
from ..flight.flows import flow_of
from ..flight.force_law_contact import depth_after_delay, entry_state, fly_contact_phase, inward_acceleration
from ..flight.force_law_flow import traverse_contact
from ..flight.force_law_series import ContactState
from ..flight.soft_contact import is_inside, is_soft_side
from ..flight.taylor import ExpansionPoint
from ..scene.codes import Contact
from . import initial_contact
from .path_end import exits_before_end


class PendingContact(NamedTuple):
    """Contact phase that lanes have yet to pass.

    `side` is that of the wall, 0 for lanes outside the walls. `start` is the state within the wall. Its values are
    arbitrary in lanes outside. `delay`, the time from now to the start of the phase, is 0 but has derivatives.
    """

    side: Float[jax.Array, "*lanes"]
    start: ContactState
    delay: Float[jax.Array, "*lanes"]


def start_in_contact(coeffs, current, start_contact, path_end, order):
    """Return (current state, `PendingContact` of lanes that start within a soft wall)."""
    contact, y, v = initial_contact.initial_relative_state(coeffs, current, start_contact, order)
    inside, side = is_inside(contact), _contact_side(contact)
    depth, rate = side * y, side * v
    is_at_entry = inside & (lax.stop_gradient(depth) <= 0)
    delay = choose(
        is_at_entry, -depth / choose(is_at_entry, rate, 1.0), 0.0
    )  # exact to first order, and so are all results
    is_inside_wall = inside & ~is_at_entry
    rate_change = delay * inward_acceleration(coeffs, side, rate, current.cosine, current.sine)
    entry = entry_state(rate + rate_change, current.cosine, current.sine, is_at_entry)
    start = ContactState(
        choose(is_inside_wall, lax.sqrt(choose(is_inside_wall, depth, 1.0)), entry.scaled_root),
        choose(is_inside_wall, rate, entry.scaled_rate),
        choose(is_inside_wall, 1.0, entry.scale),
        *(
            choose(is_at_entry, new, old)
            for new, old in zip(_advance_phasor(coeffs, current, delay), (current.cosine, current.sine), strict=True)
        ),
    )
    return current, PendingContact(choose(inside, side, 0.0), start, delay)


def enter_wall(coeffs, current, side, delay, path_end, order):
    """Return (current state, `PendingContact` of lanes that enter a soft wall after a delay); side 0 means none."""
    inside = is_soft_side(coeffs, side) & (side != 0)
    side = choose(inside, side, 1.0)
    _, wall_velocity = taylor.wall_state(taylor.wall_derivatives(coeffs, current, side, order), delay, order)
    rate = side * (
        taylor.evaluate_taylor(flow_of(coeffs).jet_at_point(coeffs, current, order)[1:], delay, order) - wall_velocity
    )
    start = entry_state(rate, *_advance_phasor(coeffs, current, delay), inside)
    return current, PendingContact(choose(inside, side, 0.0), start, choose(inside, delay, 0.0))


def complete_contact(coeffs, current, pending_contact, path_end, order):
    """Move lanes with a pending contact phase to the exit from the wall, or to the end of the path."""
    inside, delay = pending_contact.side != 0, pending_contact.delay
    side, time_remaining = choose(inside, pending_contact.side, 1.0), choose(inside, path_end.time - current.time, 0.0)
    passage = traverse_contact(*lax.stop_gradient((coeffs, side, pending_contact.start, time_remaining)))
    exits = exits_before_end(
        coeffs, path_end, current, pending_contact.side * Contact.WITHIN, time_remaining - passage.time_remaining
    )
    passage = passage._replace(exits=exits, time_remaining=choose(passage.exits & ~exits, 0.0, passage.time_remaining))
    contact_result = fly_contact_phase(coeffs, side, pending_contact.start, time_remaining, delay, order, passage)
    contact_time = choose(contact_result.exits, lax.stop_gradient(contact_result.duration), time_remaining)
    delay = choose(contact_result.exits, delay + (contact_result.duration - contact_time), 0.0)
    cosine, sine = _advance_phasor(coeffs, current, contact_time)
    exit_state = ExpansionPoint(current.x, current.v, cosine, sine, current.time + contact_time)
    wall_position, wall_velocity = taylor.wall_state(
        taylor.wall_derivatives(coeffs, exit_state, side, order), delay, order
    )
    x, v = wall_position + side * contact_result.depth, wall_velocity + side * contact_result.depth_rate
    free_state = flow_of(coeffs).propagate_back(coeffs, exit_state, wall_position, v, delay, order)
    x, v = (choose(contact_result.exits, *free_and_inside) for free_and_inside in zip(free_state, (x, v), strict=True))
    return ExpansionPoint(
        *(choose(inside, new, old) for new, old in zip(exit_state._replace(x=x, v=v), current, strict=True))
    )


def shift_state(coeffs, current, contact, free_state, delay, order):
    """Return (x, v) after a delay that is 0 and has derivatives; see `rigid_replay.shift_state`."""
    inside, side = is_inside(contact), _contact_side(contact)
    wall_position, wall_velocity = taylor.wall_state(
        taylor.wall_derivatives(coeffs, current, side, order), 0.0 * delay, order
    )
    depth, rate = choose(inside, side * (current.x - wall_position), 1.0), side * (current.v - wall_velocity)
    start = ContactState(depth, rate, jnp.ones_like(depth), current.cosine, current.sine)
    depth, rate = depth_after_delay(coeffs, side, start, depth, rate, delay, order)
    wall_position, wall_velocity = taylor.wall_state(
        taylor.wall_derivatives(coeffs, current, side, order), delay, order
    )
    return tuple(
        choose(inside, *inside_and_free)
        for inside_and_free in zip((wall_position + side * depth, wall_velocity + side * rate), free_state, strict=True)
    )


def _contact_side(contact):
    return choose(contact < 0, lax.full_like(contact, -1.0), 1.0)


def _advance_phasor(coeffs, current, duration):
    return flow.rotate_by_angle(current.cosine, current.sine, coeffs.frequency * duration)

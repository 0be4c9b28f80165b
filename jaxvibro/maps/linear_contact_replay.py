"""Replay of a contact phase within a linear soft wall, for derivatives (`replay`).

The phase takes its recorded time, a constant, and its end is moved by Taylor polynomials.
"""

from jax import lax

from ..compiled.compiler_hints import choose
from ..flight import flow, soft_contact, taylor
from ..flight.flows import flow_of
from ..flight.soft_contact import is_inside
from ..flight.taylor import ExpansionPoint
from ..scene.codes import Contact
from . import initial_contact
from .contact_duration import MEMORY_STEPS, contact_time_of, solve_contact_end
from .path_end import exits_before_end


def start_in_contact(coeffs, current, start_contact, path_end, order):
    """Return (state at the exit or at the end of the path, None) of lanes that start within a soft wall."""
    contact, y, v = initial_contact.initial_relative_state(coeffs, current, start_contact, order)
    return _fly_in_contact(
        coeffs, current, contact, y, v, *_contact_time_and_exit(coeffs, contact, y, v, current, path_end), order
    ), None


def complete_contact(coeffs, current, pending_contact, path_end, order):
    """Return the lanes unchanged: nothing is pending."""
    return current


def enter_wall(coeffs, current, side, delay, path_end, order):
    """Return (state at the exit or at the end of the path, None) of lanes that enter a soft wall after a delay.

    `side` is the side of the wall, 0 without an entry. Lanes at a rigid wall are unchanged.
    """
    contact = choose(soft_contact.is_soft_side(coeffs, side), side * Contact.ENTERED, 0.0)
    _, wall_velocity = taylor.wall_state(taylor.wall_derivatives(coeffs, current, side, order), delay, order)
    entry_velocity = (
        taylor.evaluate_taylor(flow_of(coeffs).jet_at_point(coeffs, current, order)[1:], delay, order) - wall_velocity
    )
    cosine, sine = _advance_drive(coeffs, current, delay)[2:4]
    zero = lax.full_like(entry_velocity, 0.0)
    contact_time, exits = _contact_time_and_exit(coeffs, contact, zero, entry_velocity, current, path_end)
    contact_coeffs = soft_contact.coeffs_by_lane(coeffs, contact)
    bias = soft_contact.extra_force_derivs(coeffs, contact, current.cosine, current.sine, order)
    long_exit = _fly_in_contact(
        coeffs,
        current,
        contact,
        *flow_of(contact_coeffs).propagate_back(contact_coeffs, current, zero, entry_velocity, delay, order, bias),
        contact_time,
        exits,
        order,
    )
    is_short = exits & (contact_time < MEMORY_STEPS * contact_coeffs.max_step)
    entry = choose(is_short, side, 0.0), cosine, sine, choose(is_short, side * entry_velocity, 1.0)
    short_exit = _state_after_contact(
        coeffs,
        current,
        delay,
        contact_time,
        solve_contact_end(coeffs, *entry, choose(is_short, contact_time, 0.0), order),
        side,
        order,
    )
    return ExpansionPoint(
        *(
            choose(is_short, short_value, long_value)
            for short_value, long_value in zip(short_exit, long_exit, strict=True)
        )
    ), None


def _contact_time_and_exit(coeffs, contact, y, v, current, path_end):
    """Return (constant duration of the contact phase, at most to the end of the path; lanes that exit by then)."""
    time_remaining = path_end.time - current.time
    contact_time = contact_time_of(
        *lax.stop_gradient((coeffs, contact, y, v, current.cosine, current.sine, time_remaining))
    )
    contact_time = lax.stop_gradient(choose(is_inside(contact), contact_time, 0.0))
    exits = exits_before_end(coeffs, path_end, current, contact, contact_time)
    return choose(is_inside(contact) & ~exits, time_remaining, contact_time), exits


def _state_after_contact(coeffs, current, delay, contact_time, contact_end, side, order):
    """Return the state of lanes that leave a wall after a delayed contact phase of about `contact_time`."""
    exit_state = _advance_drive(coeffs, current, contact_time)
    delay = delay + (contact_end.time - contact_time)
    wall_position, wall_velocity = taylor.wall_state(
        taylor.wall_derivatives(coeffs, exit_state, side, order), delay, order
    )
    x, v = flow_of(coeffs).propagate_back(
        coeffs, exit_state, wall_position, wall_velocity + contact_end.v, delay, order
    )
    return exit_state._replace(x=x, v=v)


def _advance_drive(coeffs, current, duration):
    """Advance the drive by a time."""
    cosine, sine = flow.rotate_by_angle(current.cosine, current.sine, coeffs.frequency * duration)
    return current._replace(cosine=cosine, sine=sine, time=current.time + duration)


def _fly_in_contact(coeffs, current, contact, y, v, contact_time, exits, order):
    """Move lanes within a wall through `contact_time`, to their exit or to the end of the path."""
    inside = is_inside(contact)
    contact_coeffs = soft_contact.coeffs_by_lane(coeffs, contact)
    y, v = soft_contact.apply_response(
        contact_coeffs,
        contact,
        soft_contact.contact_response(contact_coeffs, contact, contact_time),
        (y, v),
        current.cosine,
        current.sine,
    )
    final = _advance_drive(coeffs, current, contact_time)._replace(x=y, v=v)
    jet = _contact_jet(coeffs, contact_coeffs, contact, final, order)
    exit_jet = [jet[0], choose(exits, jet[1], 1.0), *jet[2 : order + 1]]
    delay = choose(exits, taylor.locate_root(exit_jet, order), 0.0)
    x, v = _absolute_state(coeffs, final, contact, jet, delay, order)
    free_state = flow_of(coeffs).propagate_back(coeffs, final, x, v, delay, order)
    x, v = choose(exits, free_state[0], x), choose(exits, free_state[1], v)
    return ExpansionPoint(*(choose(inside, new, old) for new, old in zip((x, v, *final[2:]), current, strict=True)))


def _contact_jet(coeffs, contact_coeffs, contact, current, order):
    """Return y and its derivatives up to one more than the order."""
    return flow_of(contact_coeffs).jet_at_point(
        contact_coeffs,
        current,
        order,
        soft_contact.extra_force_derivs(coeffs, contact, current.cosine, current.sine, order),
    )


def _absolute_state(coeffs, current, contact, jet, delay, order):
    """Return (x, v) after a delay for a mass within a wall; `jet` holds y and its derivatives."""
    wall_position, wall_velocity = taylor.wall_state(
        taylor.wall_derivatives(coeffs, current, contact, order), delay, order
    )
    return wall_position + taylor.evaluate_taylor(jet, delay, order), wall_velocity + taylor.evaluate_taylor(
        jet[1:], delay, order
    )


def shift_state(coeffs, current, contact, free_state, delay, order):
    """Return (x, v) after a delay; see `rigid_replay.shift_state`."""
    inside_contact = choose(is_inside(contact), contact, 0.0)
    contact_coeffs = soft_contact.coeffs_by_lane(coeffs, inside_contact)
    wall_position, wall_velocity = taylor.wall_state(
        taylor.wall_derivatives(coeffs, current, inside_contact, order), 0.0 * delay, order
    )
    jet = _contact_jet(
        coeffs,
        contact_coeffs,
        inside_contact,
        current._replace(x=current.x - wall_position, v=current.v - wall_velocity),
        order,
    )
    contact_state = _absolute_state(coeffs, current, inside_contact, jet, delay, order)
    return tuple(
        choose(is_inside(inside_contact), contact_value, free_value)
        for contact_value, free_value in zip(contact_state, free_state, strict=True)
    )

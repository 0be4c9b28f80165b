"""Relative state of lanes that start within a soft wall."""

from jax import lax

from ..compiled.compiler_hints import choose
from ..flight import taylor
from ..scene.codes import Contact


def initial_relative_state(coeffs, current, start_contact, order=1):
    """Return (contact, y, y') of lanes that start within a soft wall; contact 0 for other lanes."""
    contact = lax.full_like(current.x, 0.0)
    start_contact = start_contact + contact
    for wall, soft_flow in zip(coeffs.walls, coeffs.soft_flows, strict=True):
        if soft_flow is not None:
            wall_position, wall_velocity = taylor.wall_state(
                taylor.wall_derivatives(coeffs, current, contact + wall.sign, 1), 0.0 * contact, 1
            )
            depth, approach_speed = wall.sign * (current.x - wall_position), wall.sign * (current.v - wall_velocity)
            is_at_entry = (start_contact * wall.sign == Contact.WITHIN) & (depth <= 0) & (approach_speed >= 0)
            contact = choose(
                (start_contact * wall.sign != Contact.LANDED) & (depth > 0), wall.sign * Contact.WITHIN, contact
            )
            contact = choose(is_at_entry, wall.sign * Contact.ENTERED, contact)
    wall_position, wall_velocity = taylor.wall_state(
        taylor.wall_derivatives(coeffs, current, contact, order), 0.0 * contact, order
    )
    return contact, current.x - wall_position, current.v - wall_velocity

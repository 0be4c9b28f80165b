"""State relative to the wall of lanes that start within a soft wall."""

from jax import lax

from ..compiled.lane_arithmetic import choose
from ..flight import taylor_polynomials
from ..flight.motion_in_soft_wall import soft_walls
from ..scene.state import Contact


def initial_relative_state(coeffs, current_state, start_contact_code, order=1):
    """Return (contact code, displacement, velocity), relative to the wall, of lanes that start within a soft wall.

    The contact code of other lanes is 0.
    """
    contact_code = lax.full_like(current_state.x, 0.0)
    start_contact_code = start_contact_code + contact_code
    for wall, _ in soft_walls(coeffs):
        wall_position, wall_velocity = taylor_polynomials.wall_state(
            taylor_polynomials.wall_derivatives(coeffs, current_state, contact_code + wall.sign, 1),
            0.0 * contact_code,
            1,
        )
        depth, depth_rate = (
            wall.sign * (current_state.x - wall_position),
            wall.sign * (current_state.v - wall_velocity),
        )
        is_at_entry = (start_contact_code * wall.sign == Contact.WITHIN) & (depth <= 0) & (depth_rate >= 0)
        contact_code = choose(
            (start_contact_code * wall.sign != Contact.LANDED) & (depth > 0),
            wall.sign * Contact.WITHIN,
            contact_code,
        )
        contact_code = choose(is_at_entry, wall.sign * Contact.ENTERED, contact_code)
    wall_position, wall_velocity = taylor_polynomials.wall_state(
        taylor_polynomials.wall_derivatives(coeffs, current_state, contact_code, order), 0.0 * contact_code, order
    )
    return contact_code, current_state.x - wall_position, current_state.v - wall_velocity

"""Matrix of a contact phase within a soft wall under a user-defined force, for `monodromy`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from ..flight import flow
from ..flight.flows import flow_of
from ..flight.force_law_contact import entry_state, fly_contact_phase, inward_acceleration
from ..flight.force_law_flow import traverse_contact
from ..flight.force_law_series import ContactState, select_lanes
from ..flight.soft_contact import is_inside
from ..flight.wall_motion import subtract, wall_jet_on_side
from ..scene.codes import Contact
from .contact_duration import matrix_product
from .monodromy_state import MonodromyState, add_contact_time
from .path_end import exits_before_end


class ContactTransition(NamedTuple):
    """Effect of a contact phase: duration, state and drive at its end, and the derivative of (x, v) by rows."""

    time: Float[jax.Array, "*lanes"]
    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    matrix: tuple[Float[jax.Array, "*lanes"], ...]


def pass_contact_phase(coeffs, relative_state, from_outside, path_end, current):
    """Return the `MonodromyState` after the contact phase of lanes within a wall, at the exit or at the `PathEnd`.

    `relative_state` is (contact, y, y'); `from_outside` is true for lanes that have just entered.
    """
    inside = is_inside(relative_state[0])
    transition = _contact_transition(coeffs, relative_state, from_outside, path_end, current)
    contact_times = add_contact_time(
        coeffs, relative_state[0], choose(inside, transition.time, 0.0), current.contact_times
    )
    new_fields = (
        current.time + transition.time,
        (transition.x, transition.v),
        transition.cosine,
        transition.sine,
        matrix_product(transition.matrix, current.matrix),
        contact_times,
    )
    return jax.tree.map(lambda new, old: choose(inside, new, old), MonodromyState(*new_fields), current)


def _contact_transition(coeffs, relative_state, from_outside, path_end, current):
    """Compute the `ContactTransition` of lanes within a soft wall.

    `relative_state` is (contact, y, y'); its y and y' are arbitrary for lanes outside the walls. `from_outside` is true
    for lanes that have just entered. A later or faster entry changes the time and the speed of the exit. The
    accelerations on both sides of the wall convert this into a change at a fixed time (saltation matrix).
    """
    (contact, y, v), cosine, sine = relative_state, current.cosine, current.sine
    inside, side = is_inside(contact), choose(contact < 0, lax.full_like(contact, -1.0), 1.0)
    is_at_entry = inside & (lax.abs(contact) == Contact.ENTERED)
    time_remaining = choose(inside, path_end.time - current.time, 0.0)
    depth = choose(inside & ~is_at_entry, side * y, 1.0)
    rate = choose(inside, side * v, 0.0)
    entry_acceleration = choose(
        from_outside,
        *(
            acceleration_of(coeffs, side, rate, cosine, sine)
            for acceleration_of in (_inward_acceleration, inward_acceleration)
        ),
    )
    speed = choose(is_at_entry, rate, 1.0)
    start = ContactState(lax.sqrt(depth), rate, jnp.ones_like(depth), cosine, sine)
    start = select_lanes(is_at_entry, entry_state(rate, cosine, sine, is_at_entry), start)
    passage = traverse_contact(coeffs, side, start, time_remaining)
    exits = exits_before_end(coeffs, path_end, current, contact, time_remaining - passage.time_remaining)
    passage = passage._replace(exits=exits, time_remaining=choose(passage.exits & ~exits, 0.0, passage.time_remaining))

    def perturbed_end(depth_change, rate_change):
        """Return (time, depth, rate) at the end of a contact phase for a change of its initial depth and rate."""
        delay = choose(is_at_entry, -depth_change / speed, 0.0)
        new_rate = rate + rate_change
        phasor = flow.rotate_by_angle(cosine, sine, coeffs.frequency * delay)
        entry_start = entry_state(new_rate + entry_acceleration * delay, *phasor, is_at_entry)
        inside_start = ContactState(lax.sqrt(depth + depth_change), new_rate, jnp.ones_like(depth), cosine, sine)
        contact_result = fly_contact_phase(
            coeffs, side, select_lanes(is_at_entry, entry_start, inside_start), time_remaining, delay, 1, passage
        )
        return delay + contact_result.duration, contact_result.depth, contact_result.depth_rate

    def directional_derivative(depth_change, rate_change):
        zero = jnp.zeros_like(rate)
        return jax.jvp(perturbed_end, (zero, zero), (depth_change + zero, rate_change + zero))

    basis = jnp.eye(2, dtype=jnp.result_type(rate))
    (contact_time, end_depth, end_rate), tangents = jax.vmap(directional_derivative, out_axes=(None, 0))(
        basis[0], basis[1]
    )
    phasor = flow.rotate_by_angle(cosine, sine, coeffs.frequency * contact_time)
    exit_acceleration = _inward_acceleration(coeffs, side, end_rate, *phasor)
    time_tangent, depth_tangent, rate_tangent = tangents
    depth_row = choose(passage.exits, -end_rate * time_tangent, depth_tangent)
    rate_row = choose(passage.exits, rate_tangent - exit_acceleration * time_tangent, rate_tangent)
    wall_position, wall_velocity = _wall_state(coeffs, side, *phasor)
    matrix = depth_row[0], depth_row[1], rate_row[0], rate_row[1]
    return ContactTransition(
        contact_time, wall_position + side * end_depth, wall_velocity + side * end_rate, *phasor, matrix
    )


def _inward_acceleration(coeffs, side, rate, cosine, sine):
    """Compute the acceleration into the wall of a mass at the wall, without contact force."""
    wall_position, wall_velocity, wall_acceleration = wall_jet_on_side(coeffs, side, cosine, sine, 2)
    v = side * rate if wall_velocity is None else wall_velocity + side * rate
    acceleration, _ = flow_of(coeffs).acceleration_and_jerk(coeffs, wall_position + 0.0 * rate, v, cosine, sine)
    return side * subtract(acceleration, wall_acceleration)


def _wall_state(coeffs, side, cosine, sine):
    wall_position, wall_velocity = wall_jet_on_side(coeffs, side, cosine, sine, 1)
    return wall_position, jnp.zeros_like(cosine) if wall_velocity is None else wall_velocity

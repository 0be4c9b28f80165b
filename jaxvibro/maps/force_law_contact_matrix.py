"""Matrix of a contact phase within a soft wall under a user-defined force or contact law, for `monodromy`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from ..compiled.lane_arithmetic import choose
from ..flight import flow
from ..flight.flow_dispatch import flow_of
from ..flight.force_law_contact import entry_state, fly_contact_phase, inward_acceleration
from ..flight.force_law_motion_series import ContactState, select_lanes
from ..flight.force_law_passage import traverse_contact
from ..flight.motion_in_soft_wall import is_inside_soft_wall
from ..flight.wall_motion import subtract_optional, wall_jet_on_side
from ..scene.codes import Contact
from .contact_duration import multiply_2x2_matrices
from .end_time_and_contact import exits_wall_before_end
from .monodromy_state import MonodromyState, add_contact_time


class ContactPhaseEffect(NamedTuple):
    """Effect of a contact phase on the state of a lane.

    Attributes
    ----------
    time : array
        Duration of the contact phase.
    x, v : array
        Position and velocity at the end.
    cosine, sine : array
        Cosine and sine of the drive phase at the end.
    matrix : tuple of array
        Entries, by rows, of the derivative of the final (x, v) with respect to the initial (x, v).
    """

    time: Float[jax.Array, "*lanes"]
    x: Float[jax.Array, "*lanes"]
    v: Float[jax.Array, "*lanes"]
    cosine: Float[jax.Array, "*lanes"]
    sine: Float[jax.Array, "*lanes"]
    matrix: tuple[Float[jax.Array, "*lanes"], ...]


def propagate_contact_phase(coeffs, relative_state, is_entry_from_outside, path_end, current_state):
    """Return the `MonodromyState` after the contact phase of lanes within a wall, at the exit or at the
    `EndTimeAndContact`.

    `relative_state` is (contact code, displacement, velocity) relative to the wall. `is_entry_from_outside` is true for
    lanes that have just entered the wall.
    """
    is_within_wall = is_inside_soft_wall(relative_state[0])
    contact_transition = _contact_transition(coeffs, relative_state, is_entry_from_outside, path_end, current_state)
    total_contact_times = add_contact_time(
        coeffs,
        relative_state[0],
        choose(is_within_wall, contact_transition.time, 0.0),
        current_state.total_contact_times,
    )
    new_state_fields = (
        current_state.time + contact_transition.time,
        (contact_transition.x, contact_transition.v),
        contact_transition.cosine,
        contact_transition.sine,
        multiply_2x2_matrices(contact_transition.matrix, current_state.matrix),
        total_contact_times,
    )
    return jax.tree.map(
        lambda new, old: choose(is_within_wall, new, old), MonodromyState(*new_state_fields), current_state
    )


def _contact_transition(coeffs, relative_state, is_entry_from_outside, path_end, current_state):
    """Compute the `ContactPhaseEffect` of lanes within a soft wall.

    `relative_state` is (contact code, displacement, velocity) relative to the wall. Displacement and velocity are
    arbitrary for lanes outside the walls. `is_entry_from_outside` is true for lanes that have just entered the wall. A
    later or faster entry changes the time and the speed of the exit. The accelerations inside and outside the wall
    convert this change into a change at a fixed time (saltation matrix).
    """
    (contact_code, relative_displacement, relative_velocity), drive_cosine, drive_sine = (
        relative_state,
        current_state.cosine,
        current_state.sine,
    )
    is_within_wall, side = (
        is_inside_soft_wall(contact_code),
        choose(contact_code < 0, lax.full_like(contact_code, -1.0), 1.0),
    )
    is_at_entry = is_within_wall & (lax.abs(contact_code) == Contact.ENTERED)
    time_remaining = choose(is_within_wall, path_end.time - current_state.time, 0.0)
    depth = choose(is_within_wall & ~is_at_entry, side * relative_displacement, 1.0)
    depth_rate = choose(is_within_wall, side * relative_velocity, 0.0)
    entry_inward_accel = choose(
        is_entry_from_outside,
        *(
            inward_acceleration_of(coeffs, side, depth_rate, drive_cosine, drive_sine)
            for inward_acceleration_of in (_force_free_acceleration, inward_acceleration)
        ),
    )
    entry_speed = choose(is_at_entry, depth_rate, 1.0)
    start_in_wall = ContactState(lax.sqrt(depth), depth_rate, jnp.ones_like(depth), drive_cosine, drive_sine)
    start_in_wall = select_lanes(
        is_at_entry, entry_state(depth_rate, drive_cosine, drive_sine, is_at_entry), start_in_wall
    )
    contact_passage = traverse_contact(coeffs, side, start_in_wall, time_remaining)
    exits_wall = exits_wall_before_end(
        coeffs, path_end, current_state, contact_code, time_remaining - contact_passage.time_remaining
    )
    contact_passage = contact_passage._replace(
        has_exited=exits_wall,
        time_remaining=choose(contact_passage.has_exited & ~exits_wall, 0.0, contact_passage.time_remaining),
    )

    def end_after_perturbation(depth_change, depth_rate_change):
        """Return (time, depth, depth rate) at the end of the contact phase after changes of the initial values."""
        entry_delay = choose(is_at_entry, -depth_change / entry_speed, 0.0)
        new_depth_rate = depth_rate + depth_rate_change
        drive_phasor = flow.rotate_phasor_by_angle(drive_cosine, drive_sine, coeffs.frequency * entry_delay)
        entry_contact_state = entry_state(new_depth_rate + entry_inward_accel * entry_delay, *drive_phasor, is_at_entry)
        inner_contact_state = ContactState(
            lax.sqrt(depth + depth_change), new_depth_rate, jnp.ones_like(depth), drive_cosine, drive_sine
        )
        contact_result = fly_contact_phase(
            coeffs,
            side,
            select_lanes(is_at_entry, entry_contact_state, inner_contact_state),
            time_remaining,
            entry_delay,
            1,
            contact_passage,
        )
        return entry_delay + contact_result.duration, contact_result.depth, contact_result.depth_rate

    def end_derivative_along(depth_change, depth_rate_change):
        zero = jnp.zeros_like(depth_rate)
        return jax.jvp(end_after_perturbation, (zero, zero), (depth_change + zero, depth_rate_change + zero))

    unit_vectors = jnp.eye(2, dtype=jnp.result_type(depth_rate))
    (contact_duration, end_depth, end_depth_rate), end_tangents = jax.vmap(end_derivative_along, out_axes=(None, 0))(
        unit_vectors[0], unit_vectors[1]
    )
    drive_phasor = flow.rotate_phasor_by_angle(drive_cosine, drive_sine, coeffs.frequency * contact_duration)
    exit_inward_accel = _force_free_acceleration(coeffs, side, end_depth_rate, *drive_phasor)
    time_tangent, depth_tangent, depth_rate_tangent = end_tangents
    depth_matrix_row = choose(contact_passage.has_exited, -end_depth_rate * time_tangent, depth_tangent)
    depth_rate_matrix_row = choose(
        contact_passage.has_exited, depth_rate_tangent - exit_inward_accel * time_tangent, depth_rate_tangent
    )
    wall_position, wall_velocity = _wall_position_velocity(coeffs, side, *drive_phasor)
    matrix = depth_matrix_row[0], depth_matrix_row[1], depth_rate_matrix_row[0], depth_rate_matrix_row[1]
    return ContactPhaseEffect(
        contact_duration, wall_position + side * end_depth, wall_velocity + side * end_depth_rate, *drive_phasor, matrix
    )


def _force_free_acceleration(coeffs, side, depth_rate, drive_cosine, drive_sine):
    """Compute the acceleration of a mass at the wall into the wall, relative to the wall, without contact force."""
    wall_position, wall_velocity, wall_acceleration = wall_jet_on_side(coeffs, side, drive_cosine, drive_sine, 2)
    v = side * depth_rate if wall_velocity is None else wall_velocity + side * depth_rate
    acceleration, _ = flow_of(coeffs).acceleration_and_jerk(
        coeffs, wall_position + 0.0 * depth_rate, v, drive_cosine, drive_sine
    )
    return side * subtract_optional(acceleration, wall_acceleration)


def _wall_position_velocity(coeffs, side, drive_cosine, drive_sine):
    wall_position, wall_velocity = wall_jet_on_side(coeffs, side, drive_cosine, drive_sine, 1)
    return wall_position, jnp.zeros_like(drive_cosine) if wall_velocity is None else wall_velocity

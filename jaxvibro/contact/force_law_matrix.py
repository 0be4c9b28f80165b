"""Matrix of a contact phase within a soft wall under a user-defined force or contact law, for `monodromy`."""

import jax.numpy as jnp
from jax import lax

from ..compiled.lane_arithmetic import choose
from ..flight import flow
from ..flight.force_law_motion_series import ContactState, select_lanes
from ..flight.force_law_passage import traverse_contact
from ..flight.motion_in_soft_wall import is_inside_soft_wall
from ..scene.state import Contact
from .end_time_and_contact import exits_wall_before_end
from .force_law_phase import entry_state, fly_contact_phase, inward_acceleration
from .phase_ends import effect_of_phase, force_free_acceleration


def contact_phase_effect(coeffs, relative_state, is_entry_from_outside, path_end, current_state):
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
            for inward_acceleration_of in (force_free_acceleration, inward_acceleration)
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

    return effect_of_phase(coeffs, side, contact_passage.has_exited, end_after_perturbation, drive_cosine, drive_sine)

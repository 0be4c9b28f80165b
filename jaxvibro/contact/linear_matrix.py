"""Matrix of a contact phase within a soft wall with a spring and a damper, for `monodromy`."""

import jax.numpy as jnp

from ..compiled.lane_arithmetic import choose
from ..flight import flow
from ..flight.motion_in_soft_wall import apply_response, coeffs_by_lane, contact_response, is_inside_soft_wall
from ..flight.wall_motion import select_by_side, wall_jet
from .contact_duration import (
    contact_phase_matrix,
    flow_matrix_in_contact,
    linear_contact_duration,
    multiply_2x2_matrices,
    v_over_relative_velocity,
)
from .end_time_and_contact import exits_wall_before_end
from .monodromy_state import MonodromyState, add_contact_time


def propagate_contact_phase(coeffs, relative_state, is_entry_from_outside, path_end, current_state):
    """Return the `MonodromyState` at the exit from the wall or at the `EndTimeAndContact`, for lanes within a soft
    wall.

    `relative_state` is (contact code, displacement, velocity) relative to the wall. `is_entry_from_outside` is true if
    the mass has just entered the wall.
    """
    contact_code, relative_displacement, relative_velocity = relative_state
    is_within_wall, time_remaining = is_inside_soft_wall(contact_code), path_end.time - current_state.time
    entry_phasor = current_state.cosine, current_state.sine
    contact_duration = linear_contact_duration(
        coeffs, contact_code, relative_displacement, relative_velocity, *entry_phasor, time_remaining
    )
    contact_duration = choose(is_within_wall, contact_duration, 0.0)
    exits_wall = exits_wall_before_end(coeffs, path_end, current_state, contact_code, contact_duration)
    contact_duration = choose(is_within_wall & ~exits_wall, time_remaining, contact_duration)
    contact_coeffs = coeffs_by_lane(coeffs, contact_code)
    drive_angle = coeffs.frequency * contact_duration
    exit_drive_phasor = flow.rotate_phasor(*entry_phasor, jnp.cos(drive_angle) - 1.0, jnp.sin(drive_angle))
    wall_flow_response = contact_response(contact_coeffs, contact_code, contact_duration)
    _, exit_velocity = apply_response(
        contact_coeffs,
        contact_code,
        wall_flow_response,
        (relative_displacement, relative_velocity),
        *entry_phasor,
    )
    entry_ratio = _v_over_relative_velocity_at(coeffs, contact_code, entry_phasor, relative_velocity)
    exit_ratio = _v_over_relative_velocity_at(coeffs, contact_code, exit_drive_phasor, exit_velocity)
    flow_matrix_entries = flow_matrix_in_contact(
        contact_coeffs,
        contact_code,
        contact_duration,
        wall_flow_response,
        (exits_wall & is_entry_from_outside, relative_velocity, *entry_phasor),
    )
    matrix = multiply_2x2_matrices(
        contact_phase_matrix(
            coeffs,
            contact_code,
            contact_duration,
            flow_matrix_entries,
            choose(is_entry_from_outside, entry_ratio, 0.0),
            choose(exits_wall, exit_ratio, 0.0),
        )[0],
        current_state.matrix,
    )
    matrix = tuple(
        choose(is_within_wall, matrix_entry, old_matrix_entry)
        for matrix_entry, old_matrix_entry in zip(matrix, current_state.matrix, strict=True)
    )
    return MonodromyState(
        current_state.time + contact_duration,
        current_state.xv,
        *exit_drive_phasor,
        matrix,
        add_contact_time(coeffs, contact_code, contact_duration, current_state.total_contact_times),
    )


def _v_over_relative_velocity_at(coeffs, contact_code, phasor, relative_velocity):
    """Return the ratio of the mass's velocity to its velocity relative to the wall, at an angle of the drive."""
    zero = 0.0 * relative_velocity
    velocity_by_wall = [wall_jet(wall, coeffs.frequency, *phasor, 1)[1] for wall in coeffs.walls]
    wall_velocity = select_by_side(
        contact_code, coeffs.walls, [zero if velocity is None else velocity + zero for velocity in velocity_by_wall]
    )
    return v_over_relative_velocity(wall_velocity, relative_velocity)

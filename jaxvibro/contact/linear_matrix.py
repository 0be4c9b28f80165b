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
    contact_duration = choose(
        is_within_wall,
        linear_contact_duration(
            coeffs,
            contact_code,
            relative_displacement,
            relative_velocity,
            current_state.cosine,
            current_state.sine,
            time_remaining,
        ),
        0.0,
    )
    exits_wall = exits_wall_before_end(coeffs, path_end, current_state, contact_code, contact_duration)
    contact_duration = choose(is_within_wall & ~exits_wall, time_remaining, contact_duration)
    contact_coeffs = coeffs_by_lane(coeffs, contact_code)
    drive_angle = coeffs.frequency * contact_duration
    exit_drive_phasor = flow.rotate_phasor(
        current_state.cosine, current_state.sine, jnp.cos(drive_angle) - 1.0, jnp.sin(drive_angle)
    )
    wall_flow_response = contact_response(contact_coeffs, contact_code, contact_duration)
    _, exit_velocity = apply_response(
        contact_coeffs,
        contact_code,
        wall_flow_response,
        (relative_displacement, relative_velocity),
        current_state.cosine,
        current_state.sine,
    )
    v_over_relative_v_list = []
    for entry_or_exit_phasor, entry_or_exit_relative_v in (
        ((current_state.cosine, current_state.sine), relative_velocity),
        (exit_drive_phasor, exit_velocity),
    ):
        velocity_by_wall = [wall_jet(wall, coeffs.frequency, *entry_or_exit_phasor, 1)[1] for wall in coeffs.walls]
        wall_velocity = select_by_side(
            contact_code,
            coeffs.walls,
            [
                0.0 * relative_velocity
                if optional_wall_velocity is None
                else optional_wall_velocity + 0.0 * relative_velocity
                for optional_wall_velocity in velocity_by_wall
            ],
        )
        v_over_relative_v_list.append(v_over_relative_velocity(wall_velocity, entry_or_exit_relative_v))
    entry_v_over_relative_v, exit_v_over_relative_v = (
        choose(is_entry_from_outside, v_over_relative_v_list[0], 0.0),
        choose(exits_wall, v_over_relative_v_list[1], 0.0),
    )
    flow_matrix_entries = flow_matrix_in_contact(
        contact_coeffs,
        contact_code,
        contact_duration,
        wall_flow_response,
        (exits_wall & is_entry_from_outside, relative_velocity, current_state.cosine, current_state.sine),
    )
    matrix = multiply_2x2_matrices(
        contact_phase_matrix(
            coeffs, contact_code, contact_duration, flow_matrix_entries, entry_v_over_relative_v, exit_v_over_relative_v
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

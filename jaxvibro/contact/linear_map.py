"""Contact phase within a linear soft wall, for the equations of the impacts (`contact_maps`).

`exit_map` and `contact_matrix` are arguments of functions of `phase_maps`.
"""

from functools import reduce

import jax.numpy as jnp

from ..compiled.lane_arithmetic import choose
from ..flight import flow, motion_in_soft_wall
from ..scene.state import Contact
from .contact_duration import contact_phase_matrix, v_over_relative_velocity
from .contact_phase import guess_contact_time, solve_contact_phase
from .wall_at_contact import wall_derivatives


def exit_map(coeffs, sides, is_soft, speed, contact_map, min_contact_time=None):
    """Return the fields of a `ContactMap` that contact phases change.

    The result is ((state, phasor, state_by_time, state_by_speed, exit_velocity, contact_time), free_flow).
    """
    soft_side = choose(is_soft, sides, 0.0)
    entry_values = contact_map.cosine, contact_map.sine, speed
    contact_phase = solve_contact_phase(
        coeffs, soft_side, *entry_values, guess_contact_time(coeffs, soft_side, *entry_values, min_contact_time)
    )
    wall_position, wall_velocity, _ = wall_derivatives(coeffs, sides, contact_phase.cosine, contact_phase.sine)
    contact_coeffs, (p00, p01, p11) = (
        motion_in_soft_wall.coeffs_by_lane(coeffs, soft_side * Contact.ENTERED),
        contact_phase.free_flow,
    )
    # the damping jumps back at the exit, and with it the acceleration
    acceleration_jump = 2.0 * (coeffs.damping - contact_coeffs.damping) * (wall_velocity + contact_phase.v)
    flow_by_entry_delay = (
        p00 * contact_map.approach_velocity + p01 * contact_phase.entry_acceleration,
        p11 * contact_phase.entry_acceleration - contact_coeffs.stiffness * p01 * contact_map.approach_velocity,
    )
    exit_fields = (
        (wall_position, wall_velocity + contact_phase.v),
        (contact_phase.cosine, contact_phase.sine),
        (-flow_by_entry_delay[0], acceleration_jump * contact_phase.time_by_time - flow_by_entry_delay[1]),
        (sides * p01, sides * (p11 + acceleration_jump * contact_phase.time_by_velocity)),
        contact_phase.v,
        contact_phase.time,
    )
    return exit_fields, contact_phase.free_flow


def contact_matrix(coeffs, sides, contact_map, acceleration_before, acceleration_after):
    """Return (matrix by rows, determinant) of contact phases for (x, v) at a fixed time."""
    within_wall_code, contact_time = (
        choose(contact_map.is_soft, sides * float(Contact.WITHIN), 0.0),
        jnp.maximum(contact_map.contact_time, 0.0),
    )
    _, wall_velocity, _ = wall_derivatives(coeffs, sides, *contact_map.phasor)
    return contact_phase_matrix(
        coeffs,
        within_wall_code,
        contact_time,
        contact_map.free_flow,
        v_over_relative_velocity(contact_map.wall_velocity, contact_map.approach_velocity),
        v_over_relative_velocity(wall_velocity, contact_map.exit_velocity),
    )


def state_in_contact(coeffs, contact_map, sides, row_indices, elapsed_time, free_state):
    """Return (x, v) some time after the impacts in rows `row_indices`, or `free_state` outside contact phases."""
    within_wall_code = choose(contact_map.is_soft, sides * float(Contact.WITHIN), 0.0)[row_indices]
    contact_coeffs = motion_in_soft_wall.coeffs_by_lane(coeffs, within_wall_code)
    is_inside = (within_wall_code != 0) & (elapsed_time < contact_map.contact_time[row_indices])
    time_inside = choose(is_inside, elapsed_time, 0.0)
    cosine, sine = contact_map.cosine[row_indices], contact_map.sine[row_indices]
    relative_displacement, relative_velocity = motion_in_soft_wall.apply_response(
        contact_coeffs,
        within_wall_code,
        motion_in_soft_wall.contact_response(contact_coeffs, within_wall_code, time_inside),
        (0.0 * time_inside, contact_map.approach_velocity[row_indices]),
        cosine,
        sine,
    )
    wall_position, wall_velocity, _ = wall_derivatives(
        coeffs, sides[row_indices], *flow.rotate_phasor_by_angle(cosine, sine, coeffs.frequency * time_inside)
    )
    return choose(is_inside, wall_position + relative_displacement, free_state[0]), choose(
        is_inside, wall_velocity + relative_velocity, free_state[1]
    )


def max_oscillation_rate(coeffs, contact_map, sides):
    """Return an upper bound of the oscillation rate within soft walls, a scalar."""
    return reduce(
        jnp.maximum,
        [flow.MAX_SCALED_STEP / soft_flow.max_step for _, soft_flow in motion_in_soft_wall.soft_walls(coeffs)],
    )


def max_contact_step(coeffs, contact_map, sides):
    """Return the longest step within contact phases, a scalar."""
    return jnp.min(motion_in_soft_wall.lane_coefficients(coeffs, sides * float(Contact.WITHIN))["max_step"])

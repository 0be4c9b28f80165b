"""Matrix of a contact phase within a soft wall with a spring and a damper, for `monodromy`."""

import jax.numpy as jnp

from ..compiled.compiler_hints import choose
from ..flight import flow
from ..flight.soft_contact import apply_response, coeffs_by_lane, contact_response, is_inside
from ..flight.wall_motion import select_by_side, wall_jet
from .contact_duration import contact_phase_matrix, contact_time_of, matrix_product, velocity_ratio, wall_to_wall_flow
from .monodromy_state import MonodromyState, add_contact_time
from .path_end import exits_before_end


def pass_contact_phase(coeffs, relative_state, from_outside, path_end, current):
    """Return the `MonodromyState` after the contact phase of lanes within a wall, at the exit or at the `PathEnd`.

    `relative_state` is (contact, y, y'); `from_outside` is true for lanes that have just entered.
    """
    contact, y, v = relative_state
    inside, time_remaining = is_inside(contact), path_end.time - current.time
    contact_time = choose(
        inside, contact_time_of(coeffs, contact, y, v, current.cosine, current.sine, time_remaining), 0.0
    )
    exits = exits_before_end(coeffs, path_end, current, contact, contact_time)
    contact_time = choose(inside & ~exits, time_remaining, contact_time)
    contact_coeffs = coeffs_by_lane(coeffs, contact)
    drive_angle = coeffs.frequency * contact_time
    exit_phasor = flow.rotate(current.cosine, current.sine, jnp.cos(drive_angle) - 1.0, jnp.sin(drive_angle))
    flow_response = contact_response(contact_coeffs, contact, contact_time)
    _, exit_velocity = apply_response(contact_coeffs, contact, flow_response, (y, v), current.cosine, current.sine)
    velocity_ratios = []
    for phasor, relative_velocity in (((current.cosine, current.sine), v), (exit_phasor, exit_velocity)):
        wall_velocities = [wall_jet(wall, coeffs.frequency, *phasor, 1)[1] for wall in coeffs.walls]
        wall_velocity = select_by_side(
            contact, coeffs.walls, [0.0 * v if velocity is None else velocity + 0.0 * v for velocity in wall_velocities]
        )
        velocity_ratios.append(velocity_ratio(wall_velocity, relative_velocity))
    entry_ratio, exit_ratio = choose(from_outside, velocity_ratios[0], 0.0), choose(exits, velocity_ratios[1], 0.0)
    free_flow = wall_to_wall_flow(
        contact_coeffs, contact, contact_time, flow_response, (exits & from_outside, v, current.cosine, current.sine)
    )
    matrix = matrix_product(
        contact_phase_matrix(coeffs, contact, contact_time, free_flow, entry_ratio, exit_ratio)[0], current.matrix
    )
    matrix = tuple(choose(inside, entry, old_entry) for entry, old_entry in zip(matrix, current.matrix, strict=True))
    return MonodromyState(
        current.time + contact_time,
        current.xv,
        *exit_phasor,
        matrix,
        add_contact_time(coeffs, contact, contact_time, current.contact_times),
    )

"""Rigid walls, a `protocols.Contact` without contact phases.

Other kinds take the functions in which they do not differ from a rigid wall from here.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from ..flight.path_start import start_at_rigid_wall as start_at_wall  # noqa: F401
from ..scene import check
from ..scene.state import Contact

CODE_AFTER_IMPACT: int = Contact.LANDED


def wall_fields(scene, side, as_array):
    """Return the restitution, of the wall or else of the scene."""
    restitution = getattr(scene, side).restitution
    return {"restitution": as_array(scene.restitution if restitution is None else restitution)}


def wall_flow(wall, amplitude, frequency, drive_terms, is_any_soft_wall_moving):
    """Return None: there is no flow inside a rigid wall."""


def is_valid_wall(wall):
    """Return True in lanes where the restitution is between 0 and 1."""
    return (wall.restitution >= 0) & (wall.restitution <= 1)


def rates(scene, side):
    """Return no rates."""
    return []


def is_linear():
    """Return False: there is no motion inside the wall."""
    return False


def require_reversible(scene, side):
    """Raise an error if the wall takes all of the speed."""
    restitution = scene.bounce(side)
    if restitution == 0:
        raise check.ArgumentError(f"{side}.restitution", "must be greater than 0 for the inverse map", restitution)


def reverse_wall(wall):
    """Return the wall with the restitution 1 / R."""
    return replace(wall, restitution=1.0 / wall.restitution)


def reverse_wall_flow(coeffs, wall, wall_flow):
    """Return None: there is no flow inside a rigid wall."""


def wall_force(scene, side, depth, depth_rate, v):
    """Return nan: a rigid wall exerts no finite force."""
    return np.full(np.shape(depth), np.nan)


def grazing_exponent(wall):
    """Return the exponent of the speed of an impact, which is proportional to the root of the depth."""
    return 0.5


def inside_mask(contact):
    """Return None, because no lane is inside a wall."""


def prepare_step(coeffs, path):
    """Return (coefficients of each lane, path, no additional force)."""
    return coeffs, path, ()


def path_of_stepping_lanes(path):
    """Return the path of the lanes that take a step: all lanes."""
    return path


def target_wall(coeffs, contact_on_side, side, wall_derivs, is_leaving, wall_remainder_bound):
    """Return the description of the wall that a lane moves towards.

    The result is (wall derivatives, `is_leaving`, bound on the remainder, side, Taylor weights). The derivatives are
    the result of `soft_wall_lanes.wall_jet_in_lane_frame`. `is_leaving` is True in lanes where the mass is on the wall
    and moves away from it. The bound limits the omitted terms of the motion of the wall. The side is the sign of the
    velocity relative to the wall at the event. The weights are max_step^k / k! for the longest step of each lane.
    """
    return wall_derivs, is_leaving, wall_remainder_bound, side, coeffs.taylor_weights


def frame_force(coeffs, path):
    """Return the additional force and its time derivative, see `flow.extend_jet`: None, which stands for zero."""
    return None, None


def advance_motion(coeffs, path, time, lookahead):
    """Return the motion of a path after a step of the flow."""
    return coeffs.flow.advance_motion(coeffs, path.motion, time, lookahead)


def max_step(coeffs):
    """Return the longest step."""
    return coeffs.max_step


def initial_waiting_steps(zeros):
    """Return the initial number of waiting steps: None for rigid walls."""


def advance_waiting_lanes(coeffs, path, n_waiting_steps, is_any_lane_due, is_loop_idle):
    """Return (path, number of waiting steps) after the lanes that wait inside a wall have advanced.

    `is_any_lane_due` is True if a lane has waited long enough. `is_loop_idle` is True if no lane can take another step.
    """
    return path, n_waiting_steps


def replay_initial_contact(coeffs, current_state, start_contact_code, path_end, order):
    """Return (current state, pending contact) for an initial state with a contact code."""
    return current_state, None


def complete_pending_contact(coeffs, current_state, pending_contact, path_end, order):
    """Return the state at the end of the pending contact phase; rigid walls have none, so that nothing changes."""
    return current_state


def replay_wall_entry(coeffs, current_state, side, entry_delay, path_end, order):
    """Return (current state, pending contact) of lanes that hit a wall after a delay; side 0 means none."""
    return current_state, None


def state_after_delay(coeffs, current_state, contact_code, free_flight_state, delay, order):
    """Return (x, v) after a delay; `free_flight_state` is (x, v) after the delay for lanes outside soft walls."""
    return free_flight_state


def initial_phase(coeffs, current_state, start_contact_code, order=1):
    """Return the empty tuple: there is no contact phase."""
    return ()


def propagate_contact_phase(coeffs, relative_state, is_entry_from_outside, path_end, current_state):
    """Return the state unchanged: there is no contact phase."""
    return current_state


def contact_duration(
    coeffs, contact_code, relative_displacement, relative_velocity, drive_cosine, drive_sine, max_duration
):
    """Return the duration 0."""
    return 0.0 * max_duration


def complete_contact_map(coeffs, sides, speed, contact_map, grazing_mask, min_contact_time):
    """Return the contact map of the impacts: there is no contact phase."""
    return contact_map


def saltation(coeffs, sides, contact_map, shear, acceleration_before, acceleration_after):
    """Return (matrix by rows, determinant) of impacts (paper, (35))."""
    restitution = contact_map.restitution
    return (-restitution, jnp.zeros_like(shear), shear, -restitution), restitution * restitution


def state_in_contact(coeffs, contact_map, sides, row_indices, elapsed_time, free_state):
    """Return `free_state`: there is no contact phase."""
    return free_state


def max_oscillation_rate(coeffs, contact_map, sides):
    """Return the rate 0: there is no motion inside a wall."""
    return 0.0 * coeffs.frequency


def max_contact_step(coeffs, contact_map, sides):
    """Return the longest step of the flow: there is no contact phase."""
    return coeffs.max_step

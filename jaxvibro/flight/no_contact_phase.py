"""Implement the interface of `linear_contact` and `force_law_contact` for rigid walls, without contact phases."""


def prepare_step(coeffs, path):
    """Return (coefficients of each lane, path, contact of the lanes, additional force and its derivatives).

    The contact is None and the force is empty, because the flow depends on neither.
    """
    return coeffs, path, None, ()


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


def max_step(coeffs):
    """Return the longest step, including steps inside walls."""
    return coeffs.max_step


def initial_waiting_steps(zeros):
    """Return the initial number of waiting steps: None for rigid walls."""


def advance_waiting_lanes(coeffs, path, n_waiting_steps, is_any_lane_due, is_loop_idle):
    """Return (path, number of waiting steps) after the lanes that wait inside a wall have advanced.

    `is_any_lane_due` is True if a lane has waited long enough. `is_loop_idle` is True if no lane can take another step.
    """
    return path, n_waiting_steps

"""Rigid walls: a mass is never inside a wall. The interface is that of `linear_contact` and `force_law_contact`."""


def prepare_step(coeffs, path):
    """Return (coefficients of each lane, path, contact of the lanes if the flow depends on it, extra force)."""
    return coeffs, path, None, ()


def active_path(path):
    """Return the path of the lanes that take a step; other lanes get no remaining time."""
    return path


def target_wall(coeffs, contact, side, wall_derivs, is_leaving, wall_remainder):
    """Return the wall that a lane moves towards.

    The result is (wall derivatives, is_leaving, wall remainder, side, Taylor weights). The derivatives are relative as
    in `soft_wall_lanes.relative_wall_derivs`. `is_leaving` marks lanes that are on the wall. The remainder bounds the
    motion of the wall. The side is that from which the mass comes. The weights max_step^k / k! belong to each lane.
    """
    return wall_derivs, is_leaving, wall_remainder, side, coeffs.taylor_weights


def extra_force(coeffs, path):
    """Return the additional force and its rate, see `flow.extend_jet`."""
    return None, None


def max_step(coeffs):
    """Return the longest step, including steps inside walls."""
    return coeffs.max_step


def initial_wait(zero):
    """Return the initial wait count of the lanes, given 0 for each lane; None for rigid walls."""


def advance_waiting(coeffs, path, wait_count, is_due, is_idle):
    """Return (path, wait count) after the lanes that wait inside a wall have advanced.

    `is_due` is True if one has waited long enough, `is_idle` if no lane can do anything else.
    """
    return path, wait_count

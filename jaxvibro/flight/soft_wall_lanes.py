"""Select the lanes inside a soft wall, and express the motion of the wall in the coordinates of these lanes."""

from ..compiled.lane_arithmetic import choose
from .motion_in_soft_wall import is_inside_soft_wall


def inside_soft_wall_mask(coeffs, contact):
    """Return the lanes inside a soft wall, None without soft walls."""
    return is_inside_soft_wall(contact) if any(soft_flow is not None for soft_flow in coeffs.soft_flows) else None


def wall_jet_in_lane_frame(is_inside_wall, side, wall_derivs):
    """Return the derivatives of a wall's position in the coordinates of each lane.

    They are zero for lanes inside the wall, whose x and v are relative to the wall. `is_inside_wall` is the result of
    `inside_soft_wall_mask`.
    """
    if is_inside_wall is None:
        return wall_derivs
    return [
        None if derivative is None else choose(is_inside_wall, 0.0, derivative + 0.0 * side)
        for derivative in wall_derivs
    ]

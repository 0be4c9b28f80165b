"""Express the motion of a wall in the coordinates of the lanes inside a soft wall."""

from ..compiled.lane_arithmetic import choose


def wall_jet_in_lane_frame(is_inside_wall, side, wall_derivs):
    """Return the derivatives of a wall's position in the coordinates of each lane.

    They are zero for lanes inside the wall, whose x and v are relative to the wall. `is_inside_wall` is the result of
    `protocols.Contact.inside_mask`.
    """
    if is_inside_wall is None:
        return wall_derivs
    return [
        None if derivative is None else choose(is_inside_wall, 0.0, derivative + 0.0 * side)
        for derivative in wall_derivs
    ]

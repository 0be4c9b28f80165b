"""Select the lanes inside a soft wall, and express the motion of a wall relative to them."""

from ..compiled.compiler_hints import choose
from .soft_contact import is_inside


def in_soft_wall(coeffs, contact):
    """Return the lanes inside a soft wall, None without soft walls."""
    return is_inside(contact) if any(soft_flow is not None for soft_flow in coeffs.soft_flows) else None


def relative_wall_derivs(inside, side, wall_derivs):
    """Return position and derivatives of a wall relative to its lanes: zero for lanes inside it.

    `inside` is the result of `in_soft_wall`.
    """
    if inside is None:
        return wall_derivs
    return [None if derivative is None else choose(inside, 0.0, derivative + 0.0 * side) for derivative in wall_derivs]

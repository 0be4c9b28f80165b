"""Which lanes are within a soft wall, where there may be none, and where a wall is to them."""

from ..compiled.compiler_hints import choose
from .soft_contact import is_inside


def in_soft_wall(coeffs, contact):
    """The lanes that are within a soft wall; None where there is none."""
    return is_inside(contact) if any(soft_flow is not None for soft_flow in coeffs.soft_flows) else None


def relative_wall_derivs(inside, side, wall_derivs):
    """Where a wall is, and how it moves, as its lanes count it: at rest at 0 for those within it; inside:
    `in_soft_wall`."""
    if inside is None:
        return wall_derivs
    return [None if derivative is None else choose(inside, 0.0, derivative + 0.0 * side) for derivative in wall_derivs]

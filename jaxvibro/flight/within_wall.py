"""Which lanes are within a soft wall, where there may be none, and where a wall is to them."""

from ..compiled.compiler_hints import choose
from .soft_contact import is_inside


def within(frame, contact):
    """The lanes that are within a soft wall; None where there is none."""
    return is_inside(contact) if any(each is not None for each in frame.contacts) else None


def counted(lanes, side, way):
    """Where a wall is, and how it moves, as its lanes count it: at rest at 0 for those within it; lanes: `within`."""
    if lanes is None:
        return way
    return [None if each is None else choose(lanes, 0.0, each + 0.0 * side) for each in way]

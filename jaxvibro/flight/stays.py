"""What a stay within a soft wall is to a path: each kind is a file with the same functions.

`begin` and `going`: of a step; `facing`: the wall that it meets; `bias`: of an acceleration; `reach`: the longest step;
`unbegun` and `paused`: of lanes that wait within a wall.
"""

from . import no_stay, pushed_stay, spring_stay
from .coefficients import Stays

KINDS = {Stays.NONE: no_stay, Stays.SPRING: spring_stay, Stays.PUSHED: pushed_stay}


def stays_of(frame):
    """The kind of a frame: a file with the functions above."""
    return KINDS[frame.stays]

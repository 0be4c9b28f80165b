"""What a stay within a soft wall is to a replay: each kind is a file with the same functions, see `no_replay`."""

from ..flight.coefficients import Stays
from . import contact_replay, no_replay, pushed_replay

KINDS = {Stays.NONE: no_replay, Stays.SPRING: contact_replay, Stays.PUSHED: pushed_replay}


def replay_of(frame):
    """The kind of a frame."""
    return KINDS[frame.stays]

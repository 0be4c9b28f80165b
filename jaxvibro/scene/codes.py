"""The codes of the lanes: how a strobe ended, and what contact a mass has with a wall."""

from enum import IntEnum


class Status(IntEnum):
    """How a strobe ended (`Impacts.status`): from CAP on the state is nan.

    FULL: more impacts than slots, or infinitely many before a rest (complete chatter); the state is right.
    """

    OK = 0
    FULL = 1
    CAP = 2
    INVALID = 3
    NONFINITE = 4

    @property
    def word(self) -> str:
        """As it stands in messages and in saved data."""
        return self.name.lower()


class Contact(IntEnum):
    """The contact of a mass with a wall, times the wall's sign; 0 is free.

    LANDED: leaves a wall that it has hit; STUCK: rests on it; WITHIN: is within a soft one. Along a path there are
    also ENTERED: has just met a soft wall, and is not yet past it; RELEASED: not pressed any more on the wall that it
    rested on.
    """

    LANDED = 1
    STUCK = 2
    WITHIN = 3
    ENTERED = 4
    RELEASED = 5


class SolutionStatus(IntEnum):
    """What became of a solution that was asked for, an orbit or a special point. OK: it is there. JUMPED: what was
    found may be another: the way from the known one was lost, and Newton's method has led to it from there. VIRTUAL:
    its orbit passes through a wall, or hits one from behind. NONE: none was found, the numbers are nan."""

    OK = 0
    JUMPED = 1
    VIRTUAL = 2
    NONE = 3

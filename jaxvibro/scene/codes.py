"""Define the integer codes of lanes: the status of a strobe, the contact with a wall, the status of a solution."""

from enum import IntEnum


class Status(IntEnum):
    """Status of a strobe, as in `Impacts.status`; from CAP on the state is nan.

    OK: all impacts are recorded. FULL: there are more impacts than slots, or the mass sticks after complete chatter.
    The state is right. CAP: too many impacts or steps. INVALID: an invalid scene or start. NONFINITE: a number that is
    not finite.
    """

    OK = 0
    FULL = 1
    CAP = 2
    INVALID = 3
    NONFINITE = 4

    @property
    def word(self) -> str:
        """Word for the status in messages and in saved data."""
        return self.name.lower()


class Contact(IntEnum):
    """Contact of the mass with a wall, multiplied by the sign of the wall; 0 is free.

    LANDED: leaving a wall after an impact. STUCK: sticking. WITHIN: inside a soft wall. Two more codes occur along a
    path only. ENTERED: at a soft wall at the instant of entry. RELEASED: at the wall at the instant at which the
    contact force vanishes.
    """

    LANDED = 1
    STUCK = 2
    WITHIN = 3
    ENTERED = 4
    RELEASED = 5


class SolutionStatus(IntEnum):
    """Status of a solution, an orbit or a special point.

    Attributes
    ----------
    OK : int
        0: the solution is the requested one.
    JUMPED : int
        1: the solution may be another one. The continuation from the known solution failed and Newton's method
        converged to this one.
    VIRTUAL : int
        2: the orbit is inadmissible. It passes through a wall or hits one from behind.
    NONE : int
        3: there is no solution; the numbers are nan.

    Examples
    --------
    >>> jv.SolutionStatus(2).name
    'VIRTUAL'
    >>> int(jv.SolutionStatus.OK)
    0
    """

    OK = 0
    JUMPED = 1
    VIRTUAL = 2
    NONE = 3

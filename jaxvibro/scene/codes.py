"""Define the integer codes of results: status of a strobe, contact with a wall, status of a solution."""

from enum import IntEnum


class Status(IntEnum):
    """Status of a strobe, as in `Impacts.status`; from CAP on the state is nan.

    Attributes
    ----------
    OK : int
        0: all impacts are recorded.
    FULL : int
        1: there are more impacts than slots, or the mass sticks after complete chatter. The final state is correct.
    CAP : int
        2: there are too many impacts or steps.
    INVALID : int
        3: the scene or the initial state is invalid.
    NONFINITE : int
        4: a number is not finite.
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
    """Contact of the mass with a wall; a state stores the code times the sign of the wall, or 0 for no contact.

    Attributes
    ----------
    LANDED : int
        1: at a wall just after an impact.
    STUCK : int
        2: sticking to a wall.
    WITHIN : int
        3: inside a soft wall.
    ENTERED : int
        4: at a soft wall at the instant of entry. Occurs only during a simulation.
    RELEASED : int
        5: at a wall at the instant at which the contact force vanishes. Occurs only during a simulation.
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
        1: the solution may differ from the requested one. The continuation from the known solution failed, and
        Newton's method converged to a solution that may be on another branch.
    VIRTUAL : int
        2: the orbit is inadmissible. It passes through a wall or hits a wall from behind.
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

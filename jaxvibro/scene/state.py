"""Define the state of the mass, the record of the impacts of a strobe, and the integer codes of results."""

from dataclasses import dataclass
from enum import IntEnum

import jax
import numpy as np
from jaxtyping import ArrayLike, Float, Int, Real

from continuation.array_type import Array

from . import check
from .scene import Scene, rigid_wall_positions


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


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class State:
    """State of the mass at a phase of the drive.

    Parameters
    ----------
    x : array_like
        Position, in lengths of the scene.
    v : array_like
        Velocity, in lengths of the scene per unit of time 1/w0.
    phase : array_like, optional
        Phase of the drive, in rad.
    contact : array_like, optional
        Contact with a wall, negative for the left one and positive for the right one: 0 free, 1 leaving a rigid wall
        after an impact, 2 sticking, 3 inside a soft wall. A free state beyond a soft wall is inside it as well.

    Examples
    --------
    >>> state = jv.State(x=0.9, v=-1.1)
    >>> after, impacts = jv.strobe(scene, state)[:2]
    >>> int(impacts.count) > 0
    True
    """

    x: Real[ArrayLike, "..."]
    v: Real[ArrayLike, "..."]
    phase: Real[ArrayLike, "..."] = 0.0
    contact: Real[ArrayLike, "..."] = 0.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Impacts:
    """Impacts of a strobe in their order; the last axis holds the slots.

    Attributes
    ----------
    time : Array of shape (..., slots)
        Time since the start of the strobe, in 1/w0. An empty slot is inf.
    side : Array of shape (..., slots)
        Wall: -1 left, 1 right, 0 for an empty slot.
    speed : Array of shape (..., slots)
        Impact speed relative to the wall, ``|y- - v_b|``. An empty slot is 0.
    count : Array of shape (...)
        Number of all impacts, recorded or not.
    least_speed : Array of shape (...)
        Smallest impact speed, inf without impacts.
    least_clearance : Array of shape (...) or None
        Smallest distance from a wall at x_b at the turning points of x - x_b at which the mass ceases to approach the
        wall; inf without such a point. None if the strobe does not compute the distance.
    status : Array of shape (...)
        0 OK, 1 FULL, 2 CAP (1,000 impacts or a million steps in a period), 3 INVALID (an invalid scene, or a start
        beyond a wall), 4 NONFINITE (a number that is not finite, or lengths outside 1e-123 to 1e123). From CAP on the
        state is nan.

    See Also
    --------
    strobe : Compute the stroboscopic map and its impacts.

    Notes
    -----
    With status FULL some impacts are not recorded: there are more impacts than slots, or the mass sticks after complete
    chatter. The state, `count`, `least_speed` and `least_clearance` are right.

    Complete chatter is an infinite sequence of bounces in a finite time. A mass whose bounces certainly all end in this
    way sticks to its wall. The bounces up to the time of this decision are recorded and counted, `least_speed` is 0 and
    the status is FULL for any number of slots. The number of these bounces depends on the time left in the call:
    `simulate` and `sample`, which stop more often, record more.

    Examples
    --------
    >>> _, impacts = jv.strobe(scene, state)[:2]
    >>> int(impacts.status), impacts.time.shape == impacts.speed.shape
    (0, True)
    """

    time: Float[Array, "*lanes slots"]
    side: Int[Array, "*lanes slots"]
    speed: Float[Array, "*lanes slots"]
    count: Int[Array, "*lanes"] | int
    least_speed: Float[Array, "*lanes"] | float
    least_clearance: Float[Array, "*lanes"] | float | None
    status: Int[Array, "*lanes"] | int


def make_state_arrays(scene, state):
    """Convert a state to arrays of the scene's type.

    Parameters
    ----------
    scene : Scene
        The scene.
    state : State
        The state.

    Returns
    -------
    State
        State of NumPy arrays (tracers stay tracers).

    Raises
    ------
    ArgumentError
        If an argument has the wrong class, a number is not real, or the shapes do not broadcast.
    """
    for key, argument_value, expected_class in (("scene", scene, Scene), ("state", state, State)):
        if not isinstance(argument_value, expected_class):
            raise check.ArgumentError(key, f"must be a {expected_class.__name__}", argument_value)
    dtype = scene.dtype
    component_arrays = {
        key: check.check_real_array(f"state.{key}", getattr(state, key), dtype)
        for key in ("x", "v", "phase", "contact")
    }
    check.require_broadcast(
        [("scene", np.empty(scene.shape)), *((f"state.{key}", array) for key, array in component_arrays.items())]
    )
    return State(**component_arrays)


def check_start_within_walls(scene, state, rule_end="at its phase"):
    """Check, before compilation, that an initial state is finite and between the rigid walls.

    The position of a state in contact is not checked.

    Parameters
    ----------
    scene : Scene
        The scene.
    state : State
        Initial state without traced numbers.
    rule_end : str, optional
        End of the rule in the message.

    Raises
    ------
    ArgumentError
        If a number is not finite, or the mass is free and beyond a rigid wall.
    """
    for key in ("x", "v", "phase", "contact"):
        value = np.asarray(getattr(state, key))
        check.require(f"state.{key}", "must be finite", value, np.isfinite(value))
    x_min, x_max = rigid_wall_positions(scene, state.phase)
    max_abs_wall_position = np.maximum(
        *(np.where(np.isfinite(position), abs(position), 0.0) for position in (x_min, x_max))
    )
    position_tolerance = 8.0 * np.finfo(scene.dtype).eps * max_abs_wall_position
    x = np.asarray(state.x)
    is_allowed = ((x >= x_min - position_tolerance) & (x <= x_max + position_tolerance)) | (
        np.asarray(state.contact) != 0
    )
    check.require("state.x", f"must lie between the walls {rule_end}", x, is_allowed)

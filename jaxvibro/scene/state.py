"""A state, and what a strobe says of the impacts on its way."""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import ArrayLike, Float, Int, Real

from continuation.array_type import Array

from . import check
from .scene import Scene, rigid_wall_positions


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class State:
    """A state at a phase of the drive: x, v (lengths of the scene, lengths per t), phase (rad), contact.

    contact: 0 free, -1 or +1 has landed on the left or right wall and leaves it, -2 or +2 rests on it, -3 or +3 is
    within it, a soft one. A free state that is beyond a soft wall is within it too.
    """

    x: Real[ArrayLike, "..."]
    v: Real[ArrayLike, "..."]
    phase: Real[ArrayLike, "..."] = 0.0
    contact: Real[ArrayLike, "..."] = 0.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Impacts:
    """The impacts of a strobe, in order; slots are the last axis.

    Status FULL: some impacts are not recorded, because there were more than slots or because the mass came to rest by
    complete chatter (see below). The state, the count and the least values are right.

    time: since the strobe's start, in t (inf: empty); side: -1 left, +1 right, 0 empty; speed: abs(y- - v_b), 0 empty;
    count: of all impacts; least_speed: of them, inf if none; least_clearance: the smallest distance to a wall at a
    turning point of x - x_b towards it, inf if none, None where it was not asked for; status: 0 OK, 1 FULL, 2 CAP
    (1,000 impacts or a million steps in a period), 3 INVALID (a bad scene, or a start beyond a wall), 4 NONFINITE (a
    number that is not finite, or lengths beyond 1e-123 to 1e123); from CAP on the state is nan.

    A mass whose hops certainly all end, infinitely many in a finite time, is put to rest on its wall: complete chatter.
    The hops up to there are recorded and counted, least_speed is 0, the status FULL, however many slots there are. How
    many hops that is depends on the time left in the call: `simulate` and `sample`, which stop more often, see more.
    """

    time: Float[Array, "*lanes slots"]
    side: Int[Array, "*lanes slots"]
    speed: Float[Array, "*lanes slots"]
    count: Int[Array, "*lanes"] | int
    least_speed: Float[Array, "*lanes"] | float
    least_clearance: Float[Array, "*lanes"] | float | None
    status: Int[Array, "*lanes"] | int


def state_arrays(scene, state):
    """The state with every number an array of the scene's type, NumPy's but where it is traced; refused where it is
    none, or fits no batch."""
    for key, argument, expected_class in (("scene", scene, Scene), ("state", state, State)):
        if not isinstance(argument, expected_class):
            raise check.ArgumentError(key, f"must be a {expected_class.__name__}", argument)
    dtype = scene.dtype
    arrays = {
        key: check.real_array(f"state.{key}", getattr(state, key), dtype) for key in ("x", "v", "phase", "contact")
    }
    check.require_broadcast(
        [("scene", np.empty(scene.shape)), *((f"state.{key}", array) for key, array in arrays.items())]
    )
    return State(**arrays)


def check_start(scene, state, when_text="at its phase"):
    """Refuse a known start that is not finite, or is free and beyond a rigid wall, before anything is compiled.

    One in contact with a wall is that wall's. Raises ArgumentError.
    """
    for key in ("x", "v", "phase", "contact"):
        value = np.asarray(getattr(state, key))
        check.require(f"state.{key}", "must be finite", value, np.isfinite(value))
    x_min, x_max = rigid_wall_positions(scene, state.phase)
    wall_scale = np.maximum(*(np.where(np.isfinite(position), abs(position), 0.0) for position in (x_min, x_max)))
    slack = 8.0 * np.finfo(scene.dtype).eps * wall_scale
    x = np.asarray(state.x)
    is_inside = ((x >= x_min - slack) & (x <= x_max + slack)) | (np.asarray(state.contact) != 0)
    check.require("state.x", f"must lie between the walls {when_text}", x, is_inside)

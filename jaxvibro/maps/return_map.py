"""The sections at the walls: the maps P2 on L and P3 on R, from an impact to the next on the same wall (paper, 1)."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import ArrayLike, Bool, Float, Int, Real

from continuation.array_type import Array

from ..flight.wall_positions import WALL_SIGNS, wall_states
from ..scene import check
from ..scene.codes import Contact
from ..scene.scene import SIDES, Scene
from ..scene.state import State
from .strobe import strobe


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Return:
    """The next impact on the wall. phase: of the drive, rad, from 0 to 2 pi; velocity: after it, y+, at a soft wall
    that of entering it; time: since the impact before, in t; between: impacts on the other wall on the way; found:
    whether there is one within the periods; if not, phase, velocity and time are nan; status: as in `Impacts`."""

    phase: Float[jax.Array, "*lanes"]
    velocity: Float[jax.Array, "*lanes"]
    time: Float[jax.Array, "*lanes"]
    between: Int[jax.Array, "*lanes"]
    found: Bool[jax.Array, "*lanes"]
    status: Int[Array, "*lanes"] | int


@check.check_types
def return_map(
    scene: Scene,
    side: str,
    phase: Real[ArrayLike, "..."],
    velocity: Real[ArrayLike, "..."],
    periods: int = 2,
    slots: int = 32,
) -> Return:
    """From an impact on a wall to the next on it: a `Return`; P2 of the paper for "left", P3 for "right".

    side: "left" or "right"; phase (rad), velocity (after the impact, away from the wall; at a soft wall that with which
    the mass enters it, into the wall): numbers that broadcast with the scene's. A stay within a soft wall is on the way
    to the next entry. periods: drive periods in which the next impact is looked for; slots: impacts recorded in them.
    Has the derivatives of `strobe`: in (phase, velocity) their eigenvalues at an orbit are its multipliers.

    Raises ArgumentError for a wall that is not there, and as `strobe` does.
    """
    if side not in SIDES or getattr(scene, side) is None:
        raise check.ArgumentError("side", "must be a wall of the scene, left or right", side)
    wall_index = SIDES.index(side)
    sign, phase = WALL_SIGNS[wall_index], jnp.asarray(check.real_array("phase", phase, scene.dtype))
    start_contact = Contact.WITHIN if getattr(scene, side).soft else Contact.LANDED
    start = State(wall_states(scene, phase)[wall_index][0], velocity, phase, start_contact * sign)
    _, impacts = strobe(scene, start, periods, slots)
    is_on_wall = impacts.side == sign
    has_return, first_index = jnp.any(is_on_wall, axis=-1), jnp.argmax(is_on_wall, axis=-1)
    time, speed = (
        jnp.take_along_axis(values, first_index[..., None], -1)[..., 0] for values in (impacts.time, impacts.speed)
    )
    time = jnp.where(has_return, time, jnp.nan)
    end_phase = phase + scene.frequency * time
    velocity_after = wall_states(scene, end_phase)[wall_index][1] - scene.bounce(side) * sign * speed
    n_between = jnp.sum((impacts.side != 0) & (jnp.arange(slots) < first_index[..., None]), axis=-1)
    return Return(
        jnp.mod(end_phase, 2.0 * jnp.pi),
        velocity_after,
        time,
        jnp.where(has_return, n_between, 0),
        has_return,
        impacts.status,
    )

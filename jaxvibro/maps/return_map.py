"""Return maps from an impact to the next impact on the same wall: P2 on the left wall, P3 on the right (paper, 1)."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import ArrayLike, Bool, Float, Int, Real

from continuation.array_type import Array

from ..contact.kinds import contact_of_wall
from ..flight.wall_positions import WALL_SIGNS, wall_states
from ..scene import check
from ..scene.scene import SIDES, Scene
from ..scene.state import State
from .strobe import strobe


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Return:
    """Next impact on the same wall, the result of `return_map`.

    Attributes
    ----------
    phase : Array
        Phase of the drive at the impact, in rad, from 0 to 2 pi; nan without an impact.
    velocity : Array
        Velocity after the impact, y+, in lengths per t. At a soft wall it is the velocity at the entry. It is nan
        without an impact.
    time : Array
        Time since the first impact, in t; nan without a next impact.
    between : Array of int
        Number of impacts on the other wall before the next impact; 0 without a next impact.
    found : Array of bool
        True if there is a next impact on the same wall within the periods and the recorded impacts.
    status : Array of int
        Status of the lanes, as in `Impacts`.

    See Also
    --------
    return_map : Compute the next impact.

    Examples
    --------
    >>> result = jv.return_map(scene, "left", phase=0.3, velocity=1.2)
    >>> bool(result.found), int(result.between), int(result.status)
    (True, 1, 0)
    """

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
    """Map an impact on a wall to the next impact on the same wall.

    This is the map P2 of the paper for the left wall and P3 for the right.

    Parameters
    ----------
    scene : Scene
        Oscillator, drive and walls. A single scene or a batch.
    side : {"left", "right"}
        Wall on which the impacts lie. The scene must have it.
    phase : array_like
        Phase of the drive at the first impact, in rad. Broadcasts with `velocity` and `scene`.
    velocity : array_like
        Velocity after the first impact, away from the wall, in lengths per t. At a soft wall it is the velocity at the
        entry, into the wall.
    periods : int, optional
        Number of drive periods in which the next impact is searched, at least 1.
    slots : int, optional
        Number of impacts recorded in these periods, on both walls. Later impacts are not found.

    Returns
    -------
    Return
        The next impact. Its `found` field is False if there is none.

    Raises
    ------
    ArgumentError
        If the scene has no such wall, or if the other arguments are invalid, as for `strobe`.

    See Also
    --------
    sections : Points of a motion on all three sections.
    strobe : The map at a fixed phase.

    Notes
    -----
    The map has the derivatives of `strobe`. At a periodic orbit with one impact on this wall, the eigenvalues of the
    derivative with respect to (phase, velocity) are the multipliers. A contact phase within a soft wall is part of the
    motion to the next entry.

    Examples
    --------
    >>> result = jv.return_map(scene, "left", phase=0.3, velocity=1.2)
    >>> round(float(result.phase), 4), round(float(result.velocity), 4)
    (4.9595, 1.4438)
    """
    if side not in SIDES or getattr(scene, side) is None:
        raise check.ArgumentError("side", "must be a wall of the scene, left or right", side)
    wall_index = SIDES.index(side)
    wall_sign, phase = WALL_SIGNS[wall_index], jnp.asarray(check.check_real_array("phase", phase, scene.dtype))
    start_contact_code = contact_of_wall(scene, side).CODE_AFTER_IMPACT
    start_state = State(wall_states(scene, phase)[wall_index][0], velocity, phase, start_contact_code * wall_sign)
    _, impacts = strobe(scene, start_state, periods, slots)
    is_impact_on_wall = impacts.side == wall_sign
    has_return, return_impact_index = jnp.any(is_impact_on_wall, axis=-1), jnp.argmax(is_impact_on_wall, axis=-1)
    time, speed = (
        jnp.take_along_axis(times_or_speeds, return_impact_index[..., None], -1)[..., 0]
        for times_or_speeds in (impacts.time, impacts.speed)
    )
    time = jnp.where(has_return, time, jnp.nan)
    return_phase = phase + scene.frequency * time
    velocity_after = wall_states(scene, return_phase)[wall_index][1] - scene.bounce(side) * wall_sign * speed
    n_other_wall_impacts = jnp.sum((impacts.side != 0) & (jnp.arange(slots) < return_impact_index[..., None]), axis=-1)
    return Return(
        jnp.mod(return_phase, 2.0 * jnp.pi),
        velocity_after,
        time,
        jnp.where(has_return, n_other_wall_impacts, 0),
        has_return,
        impacts.status,
    )

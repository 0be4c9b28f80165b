"""With what part of its speed a mass leaves a soft wall (paper, section 4): z is the wall's share of critical damping.

    R_eff = exp(-pi z / sqrt(1 - z^2)),  z = gamma2 / sqrt(1 + k2)

as y'' + 2 gamma2 y' + (1 + k2) y = 0 from y = 0 is back there after half a swing, pi / sqrt(1 + k2 - gamma2^2).
"""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Real

from continuation.arrays import Array

from . import check
from .scene import Scene
from .scene_rules import obey


@check.typed
def effective_restitution(
    stiffness: Real[ArrayLike, "..."], damping: Real[ArrayLike, "..."]
) -> Float[Array, "..."] | np.floating:
    """R_eff of a soft wall: the speed at which a mass leaves it over that at which it came, where nothing else pulls.

    stiffness k2 > 0, damping gamma2 >= 0, as of a `Wall`: numbers or arrays that broadcast. From critical damping on
    (z >= 1) the mass never comes back by itself: 0. Raises ArgumentError for a number that breaks its rule.
    """
    xp, k2, gamma2 = _numbers(stiffness=stiffness, damping=damping)
    spare = 1.0 + k2 - gamma2 * gamma2
    swings = spare > 0
    found = xp.exp(-np.pi * gamma2 / xp.sqrt(xp.where(swings, spare, 1.0)))
    return xp.where(swings, found, 0.0)


@check.typed
def contact_damping(
    stiffness: Real[ArrayLike, "..."], restitution: Real[ArrayLike, "..."]
) -> Float[Array, "..."] | np.floating:
    """The damping gamma2 with which a soft wall has this effective restitution.

        gamma2 = z sqrt(1 + k2),  z = abs(ln R) / sqrt(pi^2 + ln(R)^2)

    stiffness k2 > 0, 0 <= restitution R <= 1: numbers or arrays that broadcast. R = 0 takes critical damping, z = 1,
    the least that has it. Raises ArgumentError for a number that breaks its rule.
    """
    xp, k2, r = _numbers(stiffness=stiffness, restitution=restitution)
    bounces = r > 0
    loss = -xp.log(xp.where(bounces, r, 1.0))
    return xp.where(bounces, loss / xp.hypot(np.pi, loss), 1.0) * xp.sqrt(1.0 + k2)


@check.of_scene
@check.typed
def soften(scene: Scene, stiffness: Real[ArrayLike, "..."]) -> Scene:
    """The scene with each rigid wall replaced by a soft one that gives back the same part of the speed.

    stiffness k2 > 0, a number or an array that broadcasts with the scene; each wall's damping is the `contact_damping`
    of its restitution, so that the motions tend to those of the rigid scene like k2^(-1/2). Soft walls stay as they
    are; `scene.replace(hardness=...)` changes the stiffness of all of them afterwards.

    Raises SceneError for a stiffness that breaks its rule, and where no wall is rigid.
    """
    rigid = {side: wall for side, wall in scene.walls.items() if not wall.soft}
    if not rigid:
        raise check.SceneError("scene", "must have a rigid wall", "none")
    changes: dict[str, Any] = {}
    stiffness = check.quantity("stiffness", stiffness, scene.dtype)
    for side, wall in rigid.items():
        damping = contact_damping(stiffness, scene.bounce(side))
        changes[side] = replace(wall, restitution=None, stiffness=stiffness, damping=damping)
    return replace(scene, **changes).replace()


def _numbers(**given):
    """(jnp where a number is traced, else np; the numbers), checked."""
    numbers = []
    for key, value in given.items():
        if not check.is_traced(value):
            value = check.number(key, value, np.float64)
            obey(key, value)
        numbers.append(value)
    return (jnp if check.is_traced(*numbers) else np), *numbers

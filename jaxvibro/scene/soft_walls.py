"""With what part of its speed a mass leaves a soft wall (paper, section 4): z is the wall's share of critical damping.

    R_eff = exp(-pi z / sqrt(1 - z^2)),  z = gamma2 / sqrt(1 + k2)

as y'' + 2 gamma2 y' + (1 + k2) y = 0 from y = 0 is back there after half a swing, pi / sqrt(1 + k2 - gamma2^2).
"""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Real

from continuation.array_type import Array

from . import check
from .scene import Scene
from .scene_rules import check_value


@check.check_types
def effective_restitution(
    stiffness: Real[ArrayLike, "..."], damping: Real[ArrayLike, "..."]
) -> Float[Array, "..."] | np.floating:
    """R_eff of a soft wall: the speed at which a mass leaves it over that at which it came, where nothing else pulls.

    stiffness k2 > 0, damping gamma2 >= 0, as of a `Wall`: numbers or arrays that broadcast. From critical damping on
    (z >= 1) the mass never comes back by itself: 0. Raises ArgumentError for a number that breaks its rule.
    """
    xp, k2, gamma2 = _check_numbers(stiffness=stiffness, damping=damping)
    squared_frequency = 1.0 + k2 - gamma2 * gamma2
    is_oscillatory = squared_frequency > 0
    restitution = xp.exp(-np.pi * gamma2 / xp.sqrt(xp.where(is_oscillatory, squared_frequency, 1.0)))
    return xp.where(is_oscillatory, restitution, 0.0)


@check.check_types
def contact_damping(
    stiffness: Real[ArrayLike, "..."], restitution: Real[ArrayLike, "..."]
) -> Float[Array, "..."] | np.floating:
    """The damping gamma2 with which a soft wall has this effective restitution.

        gamma2 = z sqrt(1 + k2),  z = abs(ln R) / sqrt(pi^2 + ln(R)^2)

    stiffness k2 > 0, 0 <= restitution R <= 1: numbers or arrays that broadcast. R = 0 takes critical damping, z = 1,
    the least that has it. Raises ArgumentError for a number that breaks its rule.
    """
    xp, k2, r = _check_numbers(stiffness=stiffness, restitution=restitution)
    is_positive = r > 0
    log_decrement = -xp.log(xp.where(is_positive, r, 1.0))
    return xp.where(is_positive, log_decrement / xp.hypot(np.pi, log_decrement), 1.0) * xp.sqrt(1.0 + k2)


@check.raise_scene_errors
@check.check_types
def soften(scene: Scene, stiffness: Real[ArrayLike, "..."]) -> Scene:
    """The scene with each rigid wall replaced by a soft one that gives back the same part of the speed.

    stiffness k2 > 0, a number or an array that broadcasts with the scene; each wall's damping is the `contact_damping`
    of its restitution, so that the motions tend to those of the rigid scene like k2^(-1/2). Soft walls stay as they
    are; `scene.replace(hardness=...)` changes the stiffness of all of them afterwards.

    Raises SceneError for a stiffness that breaks its rule, and where no wall is rigid.
    """
    rigid_walls = {side: wall for side, wall in scene.walls.items() if not wall.soft}
    if not rigid_walls:
        raise check.SceneError("scene", "must have a rigid wall", "none")
    changes: dict[str, Any] = {}
    stiffness = check.scene_quantity("stiffness", stiffness, scene.dtype)
    for side, wall in rigid_walls.items():
        damping = contact_damping(stiffness, scene.bounce(side))
        changes[side] = replace(wall, restitution=None, stiffness=stiffness, damping=damping)
    return replace(scene, **changes).replace()


def _check_numbers(**arguments):
    """(jnp where a number is traced, else np; the numbers), checked."""
    numbers = []
    for key, value in arguments.items():
        if not check.is_traced(value):
            value = check.finite_array(key, value, np.float64)
            check_value(key, value)
        numbers.append(value)
    return (jnp if check.is_traced(*numbers) else np), *numbers

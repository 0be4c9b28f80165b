"""With what part of its speed a mass leaves a soft wall (paper, section 4): z is the wall's share of critical damping.

    R_eff = exp(-pi z / sqrt(1 - z^2)),  z = gamma2 / sqrt(1 + k2)

as y'' + 2 gamma2 y' + (1 + k2) y = 0 from y = 0 is back there after half a swing, pi / sqrt(1 + k2 - gamma2^2).
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from . import check


def effective_restitution(stiffness, damping):
    """R_eff of a soft wall: the speed at which a mass leaves it over that at which it came, where nothing else pulls.

    stiffness k2 > 0, damping gamma2 >= 0, as of a `Wall`: numbers or arrays that broadcast. From critical damping on
    (z >= 1) the mass never comes back by itself: 0. Raises ArgumentError for a number that breaks its rule.
    """
    xp, stiffness, damping = _numbers(stiffness=stiffness, damping=damping)
    spare = 1.0 + stiffness - damping * damping
    swings = spare > 0
    found = xp.exp(-np.pi * damping / xp.sqrt(xp.where(swings, spare, 1.0)))
    return xp.where(swings, found, 0.0)


def contact_damping(stiffness, restitution):
    """The damping gamma2 with which a soft wall has this effective restitution.

        gamma2 = z sqrt(1 + k2),  z = abs(ln R) / sqrt(pi^2 + ln(R)^2)

    stiffness k2 > 0, 0 <= restitution R <= 1: numbers or arrays that broadcast. R = 0 takes critical damping, z = 1,
    the least that has it. Raises ArgumentError for a number that breaks its rule.
    """
    xp, stiffness, restitution = _numbers(stiffness=stiffness, restitution=restitution)
    bounces = restitution > 0
    loss = -xp.log(xp.where(bounces, restitution, 1.0))
    return xp.where(bounces, loss / xp.hypot(np.pi, loss), 1.0) * xp.sqrt(1.0 + stiffness)


@check.of_scene
def soften(scene, stiffness):
    """The scene with each rigid wall replaced by a soft one that gives back the same part of the speed.

    stiffness k2 > 0, a number or an array that broadcasts with the scene; each wall's damping is the `contact_damping`
    of its restitution, so that the motions tend to those of the rigid scene like k2^(-1/2). Soft walls stay as they
    are; `scene.replace(hardness=...)` changes the stiffness of all of them afterwards.

    Raises SceneError for a stiffness that breaks its rule, and where no wall is rigid.
    """
    rigid = {side: wall for side, wall in scene.walls.items() if not wall.soft}
    if not rigid:
        raise check.SceneError("scene", "must have a rigid wall", "none")
    stiffness, changes = check.quantity("stiffness", stiffness, scene.dtype), {}
    for side, wall in rigid.items():
        damping = contact_damping(stiffness, scene.bounce(side))
        changes[side] = replace(wall, restitution=None, stiffness=stiffness, damping=damping)
    return replace(scene, **changes).replace()


def hardened(stiffness, damping, harder):
    """(k2, gamma2) of a wall 10^harder times as stiff that has the same z, and with it the same R_eff."""
    xp = jnp if check.is_traced(stiffness, damping, harder) else np
    with np.errstate(over="ignore", under="ignore"):  # a wall's own rules refuse what comes of it
        found = stiffness * 10.0**harder
        return found, damping * xp.sqrt((1.0 + found) / (1.0 + stiffness))


def _numbers(**given):
    """(jnp where a number is traced, else np; the numbers), checked."""
    numbers = []
    for key, value in given.items():
        if not check.is_traced(value):
            value = check.number(key, value, np.float64)
            check.obey(key, value)
        numbers.append(value)
    return (jnp if check.is_traced(*numbers) else np), *numbers

"""Relate stiffness and damping of a soft wall to its effective restitution (paper, section 4).

The effective restitution is the ratio of the speeds at exit and at entry. With the damping ratio z of the wall it is:

    R_eff = exp(-pi z / sqrt(1 - z^2)),  z = gamma2 / sqrt(1 + k2)

A mass with y'' + 2 gamma2 y' + (1 + k2) y = 0 that starts at y = 0 is back there after half a period of its free
oscillation, pi / sqrt(1 + k2 - gamma2^2).
"""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Real

from continuation.array_type import Array

from . import check
from .scene import Scene
from .scene_checks import check_value


@check.check_types
def effective_restitution(
    stiffness: Real[ArrayLike, "..."], damping: Real[ArrayLike, "..."]
) -> Float[Array, "..."] | np.floating:
    """Compute the effective restitution of a soft wall: exit speed over entry speed without other forces.

    Parameters
    ----------
    stiffness : array_like
        Stiffness k2 > 0 of the wall.
    damping : array_like
        Damping gamma2 >= 0 of the wall. Broadcasts with `stiffness`.

    Returns
    -------
    Array
        ``R_eff = exp(-pi z / sqrt(1 - z^2))`` with ``z = gamma2 / sqrt(1 + k2)``. It is 0 from critical damping on
        (z >= 1), because the mass does not return by itself.

    Raises
    ------
    ArgumentError
        If a number breaks its rule.

    See Also
    --------
    contact_damping : Compute the damping for a given effective restitution.

    Examples
    --------
    >>> round(float(jv.effective_restitution(400.0, 3.0)), 6)
    0.621249
    """
    array_module, k2, gamma2 = _check_wall_numbers(stiffness=stiffness, damping=damping)
    squared_frequency = 1.0 + k2 - gamma2 * gamma2
    is_oscillatory = squared_frequency > 0
    undercritical_value = array_module.exp(
        -np.pi * gamma2 / array_module.sqrt(array_module.where(is_oscillatory, squared_frequency, 1.0))
    )
    return array_module.where(is_oscillatory, undercritical_value, 0.0)


@check.check_types
def contact_damping(
    stiffness: Real[ArrayLike, "..."], restitution: Real[ArrayLike, "..."]
) -> Float[Array, "..."] | np.floating:
    """Compute the damping of a soft wall that has a given effective restitution.

    Parameters
    ----------
    stiffness : array_like
        Stiffness k2 > 0 of the wall.
    restitution : array_like
        Effective restitution R from 0 to 1. Broadcasts with `stiffness`.

    Returns
    -------
    Array
        ``gamma2 = z sqrt(1 + k2)`` with ``z = |ln R| / sqrt(pi^2 + ln(R)^2)``. For R = 0 it is the critical damping
        (z = 1), the smallest damping with the effective restitution 0.

    Raises
    ------
    ArgumentError
        If a number breaks its rule.

    See Also
    --------
    effective_restitution : Compute the effective restitution for a given damping.

    Examples
    --------
    >>> damping = jv.contact_damping(400.0, 0.7)
    >>> round(float(jv.effective_restitution(400.0, damping)), 6)
    0.7
    """
    array_module, k2, checked_restitution = _check_wall_numbers(stiffness=stiffness, restitution=restitution)
    is_restitution_positive = checked_restitution > 0
    log_decrement = -array_module.log(array_module.where(is_restitution_positive, checked_restitution, 1.0))
    return array_module.where(
        is_restitution_positive, log_decrement / array_module.hypot(np.pi, log_decrement), 1.0
    ) * array_module.sqrt(1.0 + k2)


@check.convert_to_scene_errors
@check.check_types
def soften(scene: Scene, stiffness: Real[ArrayLike, "..."]) -> Scene:
    """Replace each rigid wall by a soft one with the same effective restitution.

    Soft walls stay unchanged. Change the stiffness of all soft walls afterwards with ``scene.replace(hardness=...)``.

    Parameters
    ----------
    scene : Scene
        Scene with at least one rigid wall.
    stiffness : array_like
        Stiffness k2 > 0 of the new walls. Broadcasts with the scene.

    Returns
    -------
    Scene
        Scene with soft walls. The damping of each is the `contact_damping` of its restitution.

    Raises
    ------
    SceneError
        If the stiffness breaks its rule, or no wall is rigid.

    Notes
    -----
    As k2 increases, the motions tend to those of the rigid scene. Their difference is of the order ``k2^(-1/2)``.

    Examples
    --------
    >>> soft = jv.soften(scene, 1e4)
    >>> soft.soft_sides
    ('left', 'right')
    >>> round(float(soft.parameter("hardness")), 6)
    4.0
    """
    rigid_walls = {side: wall for side, wall in scene.walls.items() if not wall.soft}
    if not rigid_walls:
        raise check.SceneError("scene", "must have a rigid wall", "none")
    new_walls: dict[str, Any] = {}
    stiffness = check.check_number_or_array("stiffness", stiffness, scene.dtype)
    for side, wall in rigid_walls.items():
        damping = contact_damping(stiffness, scene.bounce(side))
        new_walls[side] = replace(wall, restitution=None, stiffness=stiffness, damping=damping)
    return replace(scene, **new_walls).replace()


def _check_wall_numbers(**arguments):
    """Check named numbers; return (jnp if a number is traced, else np; the checked numbers in order)."""
    checked_numbers = []
    for key, value in arguments.items():
        if not check.is_traced(value):
            value = check.check_finite_array(key, value, np.float64)
            check_value(key, value)
        checked_numbers.append(value)
    return (jnp if check.is_traced(*checked_numbers) else np), *checked_numbers

"""Where the walls are at a phase of the drive, and the state that a moved wall leaves behind."""

import jax.numpy as jnp

from continuation.persistent_jit import persistent_jit

from ..scene.codes import Contact
from ..scene.scene import SIDES
from ..scene.state import State

WALL_SIGNS = (-1.0, 1.0)


@persistent_jit(numpy_first=True)
def wall_states(scene, phase):
    """Position and velocity of the left and of the right wall at a phase: ((x, v), (x, v)).

    A wall that is not there is infinitely far away, at rest. phase: rad, of the drive; it broadcasts with the scene.
    """
    return tuple(
        _wall_state(getattr(scene, side), sign, scene, phase) for side, sign in zip(SIDES, WALL_SIGNS, strict=True)
    )


def _wall_state(wall, sign, scene, phase):
    if wall is None:
        return jnp.full_like(scene.amplitude, sign * jnp.inf), jnp.zeros_like(scene.amplitude)
    if wall.motion is None:
        return wall.position, jnp.zeros_like(wall.position)
    harmonic, angle = float(wall.motion.harmonic), wall.motion.harmonic * phase + wall.motion.phase
    wall_amplitude = wall.motion.amplitude
    return wall.position + wall_amplitude * jnp.cos(angle), -wall_amplitude * harmonic * scene.frequency * jnp.sin(
        angle
    )


def clamp_to_walls(scene, state):
    """The state where it keeps between the scene's walls, else the nearest that does.

    A mass beyond a rigid wall is put on it with the velocity that it has. One that is in contact goes along with its
    wall; one that rests there takes the wall's velocity, and one that has landed and is met again by the wall is free
    to rebound. A mass within a soft wall stays where it is, and is free where the wall has gone away from it. Where the
    walls are as they were, this changes nothing.
    """
    x, v, contact = state.x, state.v, state.contact
    is_sticking = abs(contact) == Contact.STUCK
    walls = (getattr(scene, side) for side in SIDES)
    for sign, wall, (wall_position, wall_velocity) in zip(
        WALL_SIGNS, walls, wall_states(scene, state.phase), strict=True
    ):
        if wall is not None and wall.soft:
            is_within = contact * sign == Contact.WITHIN
            contact = jnp.where(is_within & (sign * (x - wall_position) < 0), 0.0, contact)
            is_landed = contact * sign == Contact.LANDED
            x = jnp.where(is_landed, wall_position, x)
            contact = jnp.where(is_landed & (sign * (v - wall_velocity) > 0), 0.0, contact)
            continue
        is_touching = contact * sign > 0
        x = jnp.where(is_touching | (sign * (x - wall_position) > 0), wall_position, x)
        v = jnp.where(is_touching & is_sticking, wall_velocity, v)
        contact = jnp.where(is_touching & ~is_sticking & (sign * (v - wall_velocity) > 0), 0.0, contact)
    return State(x, v, state.phase, contact)

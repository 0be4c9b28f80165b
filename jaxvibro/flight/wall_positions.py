"""Compute wall positions at a phase of the drive, and adapt states to walls that have moved."""

import jax.numpy as jnp

from continuation.hostcall import persistent_jit

from ..scene.scene import SIDES
from ..scene.state import Contact, State

WALL_SIGNS = (-1.0, 1.0)


@persistent_jit(numpy_first=True)
def wall_states(scene, phase):
    """Compute the states of both walls at a phase.

    Parameters
    ----------
    scene : Scene
        Scene.
    phase : array
        Phase of the drive, in rad. Broadcasts with the scene.

    Returns
    -------
    tuple of tuple of array
        Position and velocity of the left wall, then of the right wall. A missing wall is at rest at infinity.
    """
    return tuple(
        _wall_state(getattr(scene, side), sign, scene, phase) for side, sign in zip(SIDES, WALL_SIGNS, strict=True)
    )


def _wall_state(wall, wall_sign, scene, phase):
    """Return position and velocity of one wall."""
    if wall is None:
        return jnp.full_like(scene.amplitude, wall_sign * jnp.inf), jnp.zeros_like(scene.amplitude)
    if wall.motion is None:
        return wall.position, jnp.zeros_like(wall.position)
    harmonic, angle = float(wall.motion.harmonic), wall.motion.harmonic * phase + wall.motion.phase
    wall_amplitude = wall.motion.amplitude
    return wall.position + wall_amplitude * jnp.cos(angle), -wall_amplitude * harmonic * scene.frequency * jnp.sin(
        angle
    )


def adapt_to_moved_walls(scene, state):
    """Move a state between the walls of a scene if it is outside.

    Parameters
    ----------
    scene : Scene
        Scene.
    state : State
        State, for example from another scene.

    Returns
    -------
    State
        Closest state between the walls, equal to `state` if the walls have not moved.

    Notes
    -----
    A mass beyond a rigid wall moves onto the wall and keeps its velocity. A mass in contact moves with its wall. A
    sticking mass takes the velocity of the wall. A mass that has landed becomes free and rebounds if the wall moves
    faster towards the mass than the mass moves away. A mass beyond the position of a soft wall keeps its position. A
    mass inside a soft wall becomes free if the wall has receded beyond the mass.
    """
    x, v, contact = state.x, state.v, state.contact
    is_sticking = abs(contact) == Contact.STUCK
    walls = (getattr(scene, side) for side in SIDES)
    for wall_sign, wall, (wall_position, wall_velocity) in zip(
        WALL_SIGNS, walls, wall_states(scene, state.phase), strict=True
    ):
        if wall is not None and wall.soft:
            has_within_code = contact * wall_sign == Contact.WITHIN
            contact = jnp.where(has_within_code & (wall_sign * (x - wall_position) < 0), 0.0, contact)
            has_landed = contact * wall_sign == Contact.LANDED
            x = jnp.where(has_landed, wall_position, x)
            contact = jnp.where(has_landed & (wall_sign * (v - wall_velocity) > 0), 0.0, contact)
            continue
        has_contact_code = contact * wall_sign > 0
        x = jnp.where(has_contact_code | (wall_sign * (x - wall_position) > 0), wall_position, x)
        v = jnp.where(has_contact_code & is_sticking, wall_velocity, v)
        contact = jnp.where(has_contact_code & ~is_sticking & (wall_sign * (v - wall_velocity) > 0), 0.0, contact)
    return State(x, v, state.phase, contact)

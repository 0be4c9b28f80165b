"""Test and enforce the symmetry of a scene, (x, v, phase) -> (-x, -v, phase + pi) with the walls exchanged."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from .force_checks import is_force_odd
from .scene import replace_unchecked


def is_symmetric(scene):
    """Return True if the mirror image of every motion of a single scene is a motion of the same scene.

    Parameters
    ----------
    scene : Scene
        Single scene.

    Returns
    -------
    bool
        True if the walls are opposite, of one kind with equal parameters, and move oppositely half a period apart, or
        if there are no walls. A user-defined force must be odd, and the drive must have odd harmonics only.
    """
    if scene.force is not None and not is_force_odd(scene):
        return False
    if any(term.harmonic % 2 == 0 and term.amplitude != 0 for term in scene.drive):
        return False
    left_wall, right_wall = scene.left, scene.right
    if left_wall is None and right_wall is None:
        return True
    if left_wall is None or right_wall is None:
        return False
    if float(left_wall.position) != -float(right_wall.position) or left_wall.soft != right_wall.soft:
        return False
    if jax.tree.structure(left_wall.law) != jax.tree.structure(right_wall.law):
        return False
    if left_wall.own != right_wall.own:
        return False
    if any(scene.parameter(f"left.{name}") != scene.parameter(f"right.{name}") for name in left_wall.own):
        return False
    (left_harmonic, left_phasor), (right_harmonic, right_phasor) = (
        _motion_phasor(wall.motion) for wall in (left_wall, right_wall)
    )
    if left_phasor == 0 or right_phasor == 0:
        return bool(left_phasor == right_phasor)
    tolerance = 8.0 * np.finfo(scene.dtype).eps * abs(left_phasor)
    return left_harmonic == right_harmonic and bool(
        abs(left_phasor + right_phasor * (-1) ** right_harmonic) <= tolerance
    )


def stays_symmetric(scene, *names):
    """Return True if a scene is symmetric for all values of some parameters.

    Parameters
    ----------
    scene : Scene
        Single scene.
    *names : str
        Names of the parameters.

    Returns
    -------
    bool
        True if the scene is symmetric and remains symmetric when each parameter changes to one other value.
    """
    perturbed_values = {name: float(scene.parameter(name)) * 0.99 + 0.001 for name in names}
    return is_symmetric(scene) and is_symmetric(replace_unchecked(scene, perturbed_values))


def _motion_phasor(motion):
    """Return the harmonic and the complex amplitude of a wall motion."""
    if motion is None:
        return 1, 0.0
    return motion.harmonic, complex(motion.amplitude * np.exp(1j * float(motion.phase)))


def symmetrise_scene(scene):
    """Return the symmetric scene whose walls are the means of the walls and their mirror images.

    Parameters
    ----------
    scene : Scene
        Scene with two walls of one kind.

    Returns
    -------
    Scene
        Symmetric scene; equal to `scene` if this is symmetric. Each wall stores its restitution or
        damping, even if the wall takes this value from `scene`. The drive has no even
        harmonics. The result is smooth in all parameters except where walls cease to move.
    """
    left_wall, right_wall = scene.left, scene.right
    for name in left_wall.own:
        mean_value = 0.5 * (scene.parameter(f"left.{name}") + scene.parameter(f"right.{name}"))
        scene = replace_unchecked(scene, {f"left.{name}": mean_value, f"right.{name}": mean_value})
    half_wall_distance = 0.5 * (right_wall.position - left_wall.position)
    opposite_motions = _opposite_motions(left_wall.motion, right_wall.motion)
    new_wall_data = zip(
        ("left", "right"),
        (scene.left, scene.right),
        (-half_wall_distance, half_wall_distance),
        opposite_motions,
        strict=True,
    )
    drive = (term if term.harmonic % 2 else replace(term, amplitude=0.0 * term.amplitude) for term in scene.drive)
    walls = {side: replace(wall, position=position, motion=motion) for side, wall, position, motion in new_wall_data}
    return replace(scene, drive=tuple(drive), **walls)


def _opposite_motions(left_motion, right_motion):
    """Return the mean motions of two walls, opposite and half a period apart.

    The result is (None, None) if a wall has no motion or the harmonics differ. In these cases the walls of the
    symmetric scene are at rest.
    """
    if left_motion is None or right_motion is None or left_motion.harmonic != right_motion.harmonic:
        return None, None
    phase_difference, opposition_sign = left_motion.phase - right_motion.phase, -((-1.0) ** right_motion.harmonic)
    cosine_amplitude = 0.5 * (
        right_motion.amplitude + opposition_sign * left_motion.amplitude * jnp.cos(phase_difference)
    )
    sine_amplitude = 0.5 * opposition_sign * left_motion.amplitude * jnp.sin(phase_difference)
    tangent_of_shift = sine_amplitude / jnp.where(cosine_amplitude == 0, 1.0, cosine_amplitude)
    amplitude, phase_shift = (
        cosine_amplitude * jnp.sqrt(1.0 + tangent_of_shift * tangent_of_shift),
        jnp.arctan(tangent_of_shift),
    )
    phase = right_motion.phase + phase_shift
    return replace(left_motion, amplitude=opposition_sign * amplitude, phase=phase), replace(
        right_motion, amplitude=amplitude, phase=phase
    )

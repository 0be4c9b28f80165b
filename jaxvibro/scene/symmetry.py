"""Test and enforce the symmetry of a scene, (x, v, phase) -> (-x, -v, phase + pi) with the walls exchanged."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from .force_rules import is_odd
from .scene import replace_unchecked


def is_symmetric(scene):
    """Return True if the mirror image of every motion of a single scene is a motion of it.

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
    if scene.force is not None and not is_odd(scene):
        return False
    if any(term.harmonic % 2 == 0 and term.amplitude != 0 for term in scene.drive):
        return False
    left, right = scene.left, scene.right
    if left is None and right is None:
        return True
    if left is None or right is None:
        return False
    if float(left.position) != -float(right.position) or left.soft != right.soft:
        return False
    if (left.law and left.law.function) is not (right.law and right.law.function):
        return False
    if left.own != right.own:
        return False
    if any(scene.parameter(f"left.{name}") != scene.parameter(f"right.{name}") for name in left.own):
        return False
    (left_harmonic, left_phasor), (right_harmonic, right_phasor) = (
        _motion_phasor(wall.motion) for wall in (left, right)
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
        True if the scene is symmetric and stays so.
    """
    shifted_values = {name: float(scene.parameter(name)) * 0.99 + 0.001 for name in names}
    return is_symmetric(scene) and is_symmetric(replace_unchecked(scene, shifted_values))


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
        Symmetric scene; the scene itself if it is symmetric. Each wall has its own parameters. The drive has no even
        harmonics. The result is smooth in all parameters except where walls cease to move.
    """
    left, right = scene.left, scene.right
    for name in left.own:
        mean = 0.5 * (scene.parameter(f"left.{name}") + scene.parameter(f"right.{name}"))
        scene = replace_unchecked(scene, {f"left.{name}": mean, f"right.{name}": mean})
    half_distance = 0.5 * (right.position - left.position)
    motions = _opposite_motions(left.motion, right.motion)
    sides = zip(("left", "right"), (scene.left, scene.right), (-half_distance, half_distance), motions, strict=True)
    drive = (term if term.harmonic % 2 else replace(term, amplitude=0.0 * term.amplitude) for term in scene.drive)
    walls = {side: replace(wall, position=position, motion=motion) for side, wall, position, motion in sides}
    return replace(scene, drive=tuple(drive), **walls)


def _opposite_motions(left, right):
    """Return the mean motions of two walls, opposite and half a period apart.

    There is none if one wall has none, or their harmonics differ: the walls of a symmetric scene are then at rest.
    """
    if left is None or right is None or left.harmonic != right.harmonic:
        return None, None
    phase_difference, sign = left.phase - right.phase, -((-1.0) ** right.harmonic)
    cosine_part = 0.5 * (right.amplitude + sign * left.amplitude * jnp.cos(phase_difference))
    sine_part = 0.5 * sign * left.amplitude * jnp.sin(phase_difference)
    ratio = sine_part / jnp.where(cosine_part == 0, 1.0, cosine_part)
    amplitude, phase_shift = cosine_part * jnp.sqrt(1.0 + ratio * ratio), jnp.arctan(ratio)
    phase = right.phase + phase_shift
    return replace(left, amplitude=sign * amplitude, phase=phase), replace(right, amplitude=amplitude, phase=phase)

"""Whether a scene is its own mirror image: (x, v, phase) -> (-x, -v, phase + pi), the walls exchanged."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from .force_rules import is_odd
from .scene import replace_unchecked


def is_symmetric(scene):
    """Whether the mirror image of every motion of a single scene is a motion of it.

    So it is where the walls lie opposite, are of one kind with equal numbers, and move oppositely half a period apart;
    and without walls. A force of the user's own is to be odd, and so are the harmonics of the drive.
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
    """Whether a scene is symmetric, and stays so whatever the parameters of these names are."""
    shifted_values = {name: float(scene.parameter(name)) * 0.99 + 0.001 for name in names}
    return is_symmetric(scene) and is_symmetric(replace_unchecked(scene, shifted_values))


def _motion_phasor(motion):
    if motion is None:
        return 1, 0.0
    return motion.harmonic, complex(motion.amplitude * np.exp(1j * float(motion.phase)))


def symmetrise_scene(scene):
    """The scene whose walls are the means of its walls and of their mirror images, itself where it is symmetric.

    Both walls are of one kind; each gets its own numbers. Smooth in all of them, except where walls cease to swing. Of
    the drive the even harmonics are left out.
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
    """The motions of two walls with which they swing oppositely, half a period apart: the means; none where one has
    none, or another harmonic: then a symmetric scene has no swing."""
    if left is None or right is None or left.harmonic != right.harmonic:
        return None, None
    phase_difference, sign = left.phase - right.phase, -((-1.0) ** right.harmonic)
    cosine_part = 0.5 * (right.amplitude + sign * left.amplitude * jnp.cos(phase_difference))
    sine_part = 0.5 * sign * left.amplitude * jnp.sin(phase_difference)
    ratio = sine_part / jnp.where(cosine_part == 0, 1.0, cosine_part)
    amplitude, phase_shift = cosine_part * jnp.sqrt(1.0 + ratio * ratio), jnp.arctan(ratio)
    phase = right.phase + phase_shift
    return replace(left, amplitude=sign * amplitude, phase=phase), replace(right, amplitude=amplitude, phase=phase)

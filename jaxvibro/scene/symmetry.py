"""Whether a scene is its own mirror image: (x, v, phase) -> (-x, -v, phase + pi), the walls exchanged."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from .force_rules import is_odd
from .scene import changed


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
    (m, swing), (k, opposite) = (_swing(wall.motion) for wall in (left, right))
    if swing == 0 or opposite == 0:
        return bool(swing == opposite)
    near = 8.0 * np.finfo(scene.dtype).eps * abs(swing)
    return m == k and bool(abs(swing + opposite * (-1) ** k) <= near)


def stays_symmetric(scene, *names):
    """Whether a scene is symmetric, and stays so whatever the parameters of these names are."""
    other = {name: float(scene.parameter(name)) * 0.99 + 0.001 for name in names}
    return is_symmetric(scene) and is_symmetric(changed(scene, other))


def _swing(motion):
    if motion is None:
        return 1, 0.0
    return motion.harmonic, complex(motion.amplitude * np.exp(1j * float(motion.phase)))


def symmetric_part(scene):
    """The scene whose walls are the means of its walls and of their mirror images, itself where it is symmetric.

    Both walls are of one kind; each gets its own numbers. Smooth in all of them, except where walls cease to swing. Of
    the drive the even harmonics are left out.
    """
    left, right = scene.left, scene.right
    for name in left.own:
        mean = 0.5 * (scene.parameter(f"left.{name}") + scene.parameter(f"right.{name}"))
        scene = changed(scene, {f"left.{name}": mean, f"right.{name}": mean})
    away = 0.5 * (right.position - left.position)
    motions = _opposite(left.motion, right.motion)
    sides = zip(("left", "right"), (scene.left, scene.right), (-away, away), motions, strict=True)
    drive = (term if term.harmonic % 2 else replace(term, amplitude=0.0 * term.amplitude) for term in scene.drive)
    walls = {side: replace(wall, position=where, motion=motion) for side, wall, where, motion in sides}
    return replace(scene, drive=tuple(drive), **walls)


def _opposite(left, right):
    """The motions of two walls with which they swing oppositely, half a period apart: the means; none where one has
    none, or another harmonic: then a symmetric scene has no swing."""
    if left is None or right is None or left.harmonic != right.harmonic:
        return None, None
    late, sign = left.phase - right.phase, -((-1.0) ** right.harmonic)
    along = 0.5 * (right.amplitude + sign * left.amplitude * jnp.cos(late))
    across = 0.5 * sign * left.amplitude * jnp.sin(late)
    share = across / jnp.where(along == 0, 1.0, along)
    amplitude, turned = along * jnp.sqrt(1.0 + share * share), jnp.arctan(share)
    phase = right.phase + turned
    return replace(left, amplitude=sign * amplitude, phase=phase), replace(right, amplitude=amplitude, phase=phase)

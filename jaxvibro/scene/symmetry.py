"""Whether a scene is its own mirror image: (x, v, phase) -> (-x, -v, phase + pi), the walls exchanged."""

import numpy as np

from .scene import changed


def is_symmetric(scene):
    """Whether the mirror image of every motion of a single scene is a motion of it.

    So it is where the walls lie opposite, are of one kind with equal numbers, and move oppositely half a period apart;
    and without walls.
    """
    left, right = scene.left, scene.right
    if left is None and right is None:
        return True
    if left is None or right is None:
        return False
    if float(left.position) != -float(right.position) or left.soft != right.soft:
        return False
    own = ("stiffness", "damping") if left.soft else ("restitution",)
    if any(scene.parameter(f"left.{name}") != scene.parameter(f"right.{name}") for name in own):
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

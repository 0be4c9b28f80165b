"""Random starts: where a mass may be at phase 0, and how fast it may go."""

import jax
import numpy as np

from ..flight.wall_positions import places
from ..output.units import LENGTH, SPEED, range_text
from ..scene.state import State

LEAST_DIVISOR = 1e-3  # of A, sqrt(D): at resonance without damping there is no steady motion


def forced_amplitude(scene):
    """A / sqrt(D), the amplitude of the steady motion that meets no wall (paper, (8)); sqrt(D) at least 1e-3.

    Under a force of the user's own that of a free mass, A / omega^2, or A where that is less. The sum of those of all
    terms of the drive.
    """
    return sum(size for size, _ in _forced(scene))


def _forced(scene):
    """(amplitude, frequency) of the steady motion under each term of the drive."""
    frequency = np.asarray(scene.frequency, float)
    for a, w in ((scene.amplitude, frequency), *((term.amplitude, term.harmonic * frequency) for term in scene.drive)):
        a = abs(np.asarray(a, float))
        if scene.force is not None:
            yield a / np.maximum(1.0, w**2), w
        else:
            c = np.asarray(scene.damping, float)
            yield a / np.maximum(np.hypot((1.0 - w) * (1.0 + w), 2.0 * c * w), LEAST_DIVISOR), w


def box(scene):
    """(lowest x, highest x, highest speed) of the starts at phase 0, of the scene's shape.

    x lies between the walls; where one is missing, at most 2 forced amplitudes, at least 2, from the origin and from
    the other wall. The speed is at most 3 max(1, forced speed).
    """
    (low, _), (high, _) = jax.tree.map(lambda leaf: np.asarray(leaf, float), places(scene, 0.0))
    forced = forced_amplitude(scene)
    far = np.maximum(2.0, 2.0 * forced)
    left = np.where(np.isinf(low), np.minimum(-far, high - far), low)
    right = np.where(np.isinf(high), np.maximum(far, low + far), high)
    return left, right, 3.0 * np.maximum(1.0, sum(w * size for size, w in _forced(scene)))


def random_starts(scene, count, seed):
    """Starts drawn uniformly from the `box`, a `State` of shape (count,): more of them begin with the same ones.

    scene: a single one, or one with a number for each start.
    """
    return placed(scene, np.random.default_rng(seed).random((count, 2)))


def placed(scene, draws):
    """Starts at places of the `box`, each two numbers from 0 to 1, (starts, 2): a `State` of shape (starts,)."""
    left, right, fast = box(scene)
    x, v = left + (right - left) * draws[:, 0], fast * (2.0 * draws[:, 1] - 1.0)
    zero = np.zeros(len(draws), scene.dtype)
    return State(np.clip(x, left, right).astype(scene.dtype), v.astype(scene.dtype), zero, zero)


def box_text(scene, scales=None):
    """The box of starts of a single scene for reading, with `Scales` in physical units."""
    left, right, fast = (float(edge) for edge in box(scene))
    x, v = range_text(scales, LENGTH, left, right), range_text(scales, SPEED, -fast, fast)
    return f"x {x}, v {v}"

"""Random starts: where a mass may be at phase 0, and how fast it may go."""

import jax
import numpy as np

from .place import places
from .state import State

LEAST_DIVISOR = 1e-3  # of A, sqrt(D): at resonance without damping there is no steady motion


def forced_amplitude(scene):
    """A / sqrt(D), the amplitude of the steady motion that meets no wall (paper, (8)); sqrt(D) at least 1e-3."""
    a, w, c = (float(getattr(scene, name)) for name in ("amplitude", "frequency", "damping"))
    return abs(a) / max(np.hypot((1.0 - w) * (1.0 + w), 2.0 * c * w), LEAST_DIVISOR)


def box(scene):
    """(lowest x, highest x, highest speed) of the starts of a single scene at phase 0.

    x lies between the walls; where one is missing, at most 2 forced amplitudes, at least 2, from the origin and from
    the other wall. The speed is at most 3 max(1, forced speed).
    """
    (low, _), (high, _) = jax.tree.map(float, places(scene, 0.0))
    far = max(2.0, 2.0 * forced_amplitude(scene))
    left = min(-far, high - far) if np.isinf(low) else low
    right = max(far, low + far) if np.isinf(high) else high
    return left, right, 3.0 * max(1.0, float(scene.frequency) * forced_amplitude(scene))


def random_starts(scene, count, seed):
    """Starts drawn uniformly from the `box`, a `State` of shape (count,): more of them begin with the same ones."""
    left, right, fast = box(scene)
    draws = np.random.default_rng(seed).random((count, 2))
    x, v = left + (right - left) * draws[:, 0], fast * (2.0 * draws[:, 1] - 1.0)
    zero = np.zeros(count, scene.dtype)
    return State(np.clip(x, left, right).astype(scene.dtype), v.astype(scene.dtype), zero, zero)

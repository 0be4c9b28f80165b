"""Random starts: where a mass may be at phase 0, and how fast it may go."""

import jax
import numpy as np

from ..flight.wall_positions import wall_states
from ..output.units import LENGTH, SPEED, range_text
from ..scene.state import State

MIN_DENOMINATOR = 1e-3  # of A, sqrt(D): at resonance without damping there is no steady motion


def forced_amplitude(scene):
    """A / sqrt(D), the amplitude of the steady motion that meets no wall (paper, (8)); sqrt(D) at least 1e-3.

    Under a force of the user's own that of a free mass, A / omega^2, or A where that is less. The sum of those of all
    terms of the drive.
    """
    return sum(amplitude for amplitude, _ in _forced_responses(scene))


def _forced_responses(scene):
    """(amplitude, frequency) of the steady motion under each term of the drive."""
    frequency = np.asarray(scene.frequency, float)
    for amplitude, omega in (
        (scene.amplitude, frequency),
        *((term.amplitude, term.harmonic * frequency) for term in scene.drive),
    ):
        amplitude = abs(np.asarray(amplitude, float))
        if scene.force is not None:
            yield amplitude / np.maximum(1.0, omega**2), omega
        else:
            damping = np.asarray(scene.damping, float)
            yield (
                amplitude / np.maximum(np.hypot((1.0 - omega) * (1.0 + omega), 2.0 * damping * omega), MIN_DENOMINATOR),
                omega,
            )


def initial_box(scene):
    """(lowest x, highest x, highest speed) of the starts at phase 0, of the scene's shape.

    x lies between the walls; where one is missing, at most 2 forced amplitudes, at least 2, from the origin and from
    the other wall. The speed is at most 3 max(1, forced speed).
    """
    (left_wall, _), (right_wall, _) = jax.tree.map(lambda leaf: np.asarray(leaf, float), wall_states(scene, 0.0))
    amplitude = forced_amplitude(scene)
    max_distance = np.maximum(2.0, 2.0 * amplitude)
    lower = np.where(np.isinf(left_wall), np.minimum(-max_distance, right_wall - max_distance), left_wall)
    upper = np.where(np.isinf(right_wall), np.maximum(max_distance, left_wall + max_distance), right_wall)
    return (
        lower,
        upper,
        3.0 * np.maximum(1.0, sum(omega * term_amplitude for term_amplitude, omega in _forced_responses(scene))),
    )


def draw_initial_states(scene, n_states, seed):
    """Starts drawn uniformly from the `initial_box`, a `State` of shape (count,): more of them begin with the same
    ones.

    scene: a single one, or one with a number for each start.
    """
    return states_in_box(scene, np.random.default_rng(seed).random((n_states, 2)))


def states_in_box(scene, uniform_draws):
    """Starts at places of the `initial_box`, each two numbers from 0 to 1, (starts, 2): a `State` of shape
    (starts,)."""
    lower, upper, max_speed = initial_box(scene)
    x, v = lower + (upper - lower) * uniform_draws[:, 0], max_speed * (2.0 * uniform_draws[:, 1] - 1.0)
    zero = np.zeros(len(uniform_draws), scene.dtype)
    return State(np.clip(x, lower, upper).astype(scene.dtype), v.astype(scene.dtype), zero, zero)


def box_text(scene, scales=None):
    """The box of starts of a single scene for reading, with `Scales` in physical units."""
    lower, upper, max_speed = (float(bound) for bound in initial_box(scene))
    x_text, v_text = range_text(scales, LENGTH, lower, upper), range_text(scales, SPEED, -max_speed, max_speed)
    return f"x {x_text}, v {v_text}"

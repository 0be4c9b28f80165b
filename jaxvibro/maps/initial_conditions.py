"""Random initial states: a box of positions and velocities at phase 0."""

import jax
import numpy as np

from ..flight.wall_positions import wall_states
from ..output.units import LENGTH, SPEED, range_text
from ..scene.state import State

MIN_DENOMINATOR = 1e-3  # lower bound of sqrt(D): at resonance without damping there is no steady motion


def forced_amplitude(scene):
    """Return A / sqrt(D), the amplitude of the steady motion without impacts (paper, (8)); sqrt(D) is at least 1e-3.

    For a user-defined force it is that of a free mass, A / omega^2, or A if this is smaller. It is the sum over all
    terms of the drive.
    """
    return sum(amplitude for amplitude, _ in _forced_responses(scene))


def _forced_responses(scene):
    """Yield (amplitude, frequency) of the steady motion under each term of the drive."""
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
    """Compute the box from which initial states at phase 0 are drawn.

    x lies between the walls. If one is missing, x is at most max(2, 2 forced amplitudes) from the origin and from the
    other wall. The speed is at most 3 max(1, forced speed).

    Parameters
    ----------
    scene : Scene
        A single scene or a batch.

    Returns
    -------
    lower, upper : numpy.ndarray
        Bounds of x, of the shape of the scene.
    max_speed : numpy.ndarray
        Largest speed.
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
    """Draw initial states uniformly from the `initial_box`.

    Parameters
    ----------
    scene : Scene
        A single scene, or one with a number for each state.
    n_states : int
        Number of states. A larger number begins with the same states.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    State
        States at phase 0, of shape (n_states,).
    """
    return states_in_box(scene, np.random.default_rng(seed).random((n_states, 2)))


def states_in_box(scene, uniform_draws):
    """Scale numbers in the unit square to states in the `initial_box`.

    Parameters
    ----------
    scene : Scene
        A single scene, or one with a number for each state.
    uniform_draws : numpy.ndarray
        Numbers from 0 to 1, of shape (states, 2).

    Returns
    -------
    State
        States at phase 0, of shape (states,).
    """
    lower, upper, max_speed = initial_box(scene)
    x, v = lower + (upper - lower) * uniform_draws[:, 0], max_speed * (2.0 * uniform_draws[:, 1] - 1.0)
    zero = np.zeros(len(uniform_draws), scene.dtype)
    return State(np.clip(x, lower, upper).astype(scene.dtype), v.astype(scene.dtype), zero, zero)


def box_text(scene, scales=None):
    """Format the `initial_box` of a single scene.

    Parameters
    ----------
    scene : Scene
        A single scene.
    scales : Scales, optional
        Scales for physical units.

    Returns
    -------
    str
        Ranges of x and v.
    """
    lower, upper, max_speed = (float(bound) for bound in initial_box(scene))
    x_text, v_text = range_text(scales, LENGTH, lower, upper), range_text(scales, SPEED, -max_speed, max_speed)
    return f"x {x_text}, v {v_text}"

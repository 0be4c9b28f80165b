"""Random initial states in a box of positions and velocities at phase 0."""

import jax
import numpy as np

from ..contact.kinds import flow_of_scene
from ..flight.wall_positions import wall_states
from ..output.units import LENGTH, SPEED, range_text
from ..scene.state import State


def forced_amplitude(scene):
    """Return A / sqrt(D), the amplitude of the steady motion without impacts (paper, (8)).

    D = (1 - omega^2)^2 + 4 gamma^2 omega^2. If sqrt(D) is less than 1e-3, the value 1e-3 is used instead. With a
    user-defined force the amplitude of a free mass is used, A / max(1, omega^2). The amplitudes of all terms of the
    drive are added.
    """
    return sum(term_amplitude for term_amplitude, _ in _forced_amplitudes(scene))


def _forced_amplitudes(scene):
    """Yield (amplitude, frequency) of the steady motion under each term of the drive."""
    drive_frequency, flow = np.asarray(scene.frequency, float), flow_of_scene(scene)
    for amplitude, term_frequency in (
        (scene.amplitude, drive_frequency),
        *((drive_term.amplitude, drive_term.harmonic * drive_frequency) for drive_term in scene.drive),
    ):
        amplitude = abs(np.asarray(amplitude, float))
        yield flow.steady_amplitude(scene, amplitude, term_frequency), term_frequency


def initial_box(scene):
    """Compute the box from which initial states at phase 0 are drawn.

    x lies between the walls. If a wall is missing, the box extends on this side to the distance max(2, 2 a) from the
    origin, or from the other wall if that bound is farther, where a is the `forced_amplitude`. The speed is at most
    3 max(1, v), where v is the sum of frequency times forced amplitude over the terms of the drive.

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
    (left_wall_position, _), (right_wall_position, _) = jax.tree.map(
        lambda leaf: np.asarray(leaf, float), wall_states(scene, 0.0)
    )
    total_forced_amplitude = forced_amplitude(scene)
    bound_without_wall = np.maximum(2.0, 2.0 * total_forced_amplitude)
    lower_x = np.where(
        np.isinf(left_wall_position),
        np.minimum(-bound_without_wall, right_wall_position - bound_without_wall),
        left_wall_position,
    )
    upper_x = np.where(
        np.isinf(right_wall_position),
        np.maximum(bound_without_wall, left_wall_position + bound_without_wall),
        right_wall_position,
    )
    return (
        lower_x,
        upper_x,
        3.0
        * np.maximum(
            1.0,
            sum(
                term_frequency * response_amplitude for response_amplitude, term_frequency in _forced_amplitudes(scene)
            ),
        ),
    )


def draw_initial_states(scene, n_states, seed):
    """Draw initial states uniformly from the `initial_box`.

    Parameters
    ----------
    scene : Scene
        A single scene, or a batch with one scene for each state.
    n_states : int
        Number of states. The first states do not depend on this number.
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
        A single scene, or a batch with one scene for each state.
    uniform_draws : numpy.ndarray
        Numbers from 0 to 1, of shape (states, 2).

    Returns
    -------
    State
        States at phase 0, of shape (states,).
    """
    lower_x, upper_x, max_speed = initial_box(scene)
    x, v = lower_x + (upper_x - lower_x) * uniform_draws[:, 0], max_speed * (2.0 * uniform_draws[:, 1] - 1.0)
    zeros = np.zeros(len(uniform_draws), scene.dtype)
    return State(np.clip(x, lower_x, upper_x).astype(scene.dtype), v.astype(scene.dtype), zeros, zeros)


def format_initial_box(scene, scales=None):
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
    lower_x, upper_x, max_speed = (float(box_bound) for box_bound in initial_box(scene))
    x_text, v_text = range_text(scales, LENGTH, lower_x, upper_x), range_text(scales, SPEED, -max_speed, max_speed)
    return f"x {x_text}, v {v_text}"

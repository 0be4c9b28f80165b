"""Closed forms of orbits with one impact a wall (paper, section 2), for the claims and as a check of what is continued.

With E the free flow from one impact to the next and u the speed before each, (x, y/omega) of the forced motion at an
impact is (s - a u, -b u / omega), whose length is A / sqrt(D). The double root in u is where two such orbits meet.
"""

import jax
import jax.numpy as jnp
import numpy as np

from ..flight.flow import flight_responses
from ..scene.state import State


def forced_motion(amplitude, frequency, damping):
    """(x, v) at phase 0 of the motion without impacts."""
    complex_amplitude = amplitude / (1.0 - frequency**2 + 2j * damping * frequency)
    return complex_amplitude.real, (1j * frequency * complex_amplitude).real


def grazing_amplitude(frequency, damping, distance=1.0):
    """The amplitude A = s sqrt(D) at which P100 grazes a wall at distance s (8)."""
    return distance * jnp.hypot(1.0 - frequency**2, 2.0 * damping * frequency)


def symmetric_fold(frequency, damping, restitution):
    """(A_c, u) of the double root of the symmetric P111 between walls at -1 and 1 (19); a saddle-node where u > 0."""
    return _double_root(*_symmetric_coefficients(frequency, damping, restitution), frequency, damping, 1.0)


def _symmetric_coefficients(frequency, damping, restitution):
    """(a, b) of the symmetric P111."""
    flow_matrix, identity = _flow_matrix(frequency, damping, jnp.pi / frequency), jnp.eye(2)
    return jnp.linalg.solve(
        flow_matrix + identity, jnp.array([0.0, -1.0]) + flow_matrix @ jnp.stack([0.0 * restitution, restitution])
    )


def symmetric_start(scene):
    """The `State` after an impact on the right wall of a scene's symmetric P111, of two the one that hits harder.

    The scene is single, with walls at -1 and 1, A above A_c, and a double root with u > 0."""
    params = [float(getattr(scene, key)) for key in ("frequency", "damping", "restitution", "amplitude")]
    frequency, damping, restitution, amplitude = params
    a, b = (float(value) for value in _symmetric_coefficients(frequency, damping, restitution))
    squared_length, amplitude_ratio = (
        a**2 + (b / frequency) ** 2,
        amplitude / float(grazing_amplitude(frequency, damping)),
    )
    speed = (a + np.sqrt(a**2 - squared_length * (1.0 - amplitude_ratio**2))) / squared_length
    x, v = forced_motion(amplitude, frequency, damping)
    start_phase = np.angle(complex(1.0 - a * speed, b * speed / frequency)) - np.angle(complex(x, -v / frequency))
    return State(1.0, -restitution * speed, start_phase % (2.0 * np.pi))


def single_fold(frequency, damping, restitution, distance=1.0, periods=1):
    """(A_c, u) of the double root of an orbit with one impact in some periods, on a wall at a distance from 0."""
    flow_matrix, identity = _flow_matrix(frequency, damping, 2.0 * jnp.pi * periods / frequency), jnp.eye(2)
    a, b = jnp.linalg.solve(
        identity - flow_matrix, jnp.array([0.0, -1.0]) - flow_matrix @ jnp.stack([0.0 * restitution, restitution])
    )
    return _double_root(a, b, frequency, damping, distance)


def _double_root(a, b, frequency, damping, distance):
    squared_length = a**2 + (b / frequency) ** 2
    return grazing_amplitude(frequency, damping, distance) * abs(b) / frequency / jnp.sqrt(
        squared_length
    ), distance * a / squared_length


def _flow_matrix(frequency, damping, time):
    (p00, p01, p11), _ = flight_responses(*jnp.broadcast_arrays(frequency + 0.0 * time, damping + 0.0 * time, time))
    return jnp.stack([jnp.stack([p00, p01]), jnp.stack([-p01, p11])])


def equivalent_amplitude(effective_amplitude, frequency, damping, motion):
    """The larger drive amplitude that acts like another one on a fixed wall, where the wall moves with the drive.

    Seen from a wall at s + B cos(omega t + phase) the drive is A - B exp(i phase) (1 - omega^2 + 2 i gamma omega).
    """
    wall_drive = motion.amplitude * np.exp(1j * motion.phase) * (1.0 - frequency**2 + 2j * damping * frequency)
    return wall_drive.real + np.sqrt(effective_amplitude**2 - wall_drive.imag**2)


def meeting_frequency(damping):
    """The highest frequency at which the saddle-node's curve meets the grazing's: sin(pi r / omega) = 0, r = omega."""
    return jnp.sqrt((1.0 - damping) * (1.0 + damping))


@jax.jit
def coexistence_width(frequency, damping, restitution):
    """sqrt(D) - A_c: how far P100 and P111 exist together."""
    return grazing_amplitude(frequency, damping) - symmetric_fold(frequency, damping, restitution)[0]


def coexistence_area(damping, restitution, max_frequency, n_nodes):
    """The area in (A, omega) between the curves, from where they meet up to a frequency (Gauss and Legendre)."""
    abscissae, weights = np.polynomial.legendre.leggauss(n_nodes)
    min_frequency = meeting_frequency(damping)
    half_range = 0.5 * (max_frequency - min_frequency)
    widths = jax.vmap(coexistence_width, (0, None, None))(
        min_frequency + half_range * (abscissae + 1.0), damping, restitution
    )
    return half_range * (widths @ weights)

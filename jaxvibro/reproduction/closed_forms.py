"""Evaluate closed forms of orbits with one impact per wall (paper, section 2), to check claims and continued curves.

Let E be the free flow from one impact to the next and u the speed before each impact. Then (x, y/omega) of the forced
motion at an impact is (s - a u, -b u / omega), whose length is A / sqrt(D). At the double root in u two such orbits
meet.
"""

import jax
import jax.numpy as jnp
import numpy as np

from ..flight.flow import flight_responses
from ..scene.state import State


def forced_motion(amplitude, frequency, damping):
    """Return (x, v) at phase 0 of the motion without impacts."""
    complex_amplitude = amplitude / (1.0 - frequency**2 + 2j * damping * frequency)
    return complex_amplitude.real, (1j * frequency * complex_amplitude).real


def grazing_amplitude(frequency, damping, distance=1.0):
    """Return the amplitude A = s sqrt(D) at which P100 grazes a wall (8).

    Parameters
    ----------
    frequency : float
        Drive frequency omega.
    damping : float
        Damping gamma.
    distance : float, optional
        Distance s of the wall from 0.

    Returns
    -------
    Array
        Amplitude.
    """
    return distance * jnp.hypot(1.0 - frequency**2, 2.0 * damping * frequency)


def symmetric_fold(frequency, damping, restitution):
    """Return the double root of the symmetric P111 between walls at -1 and 1 (19).

    Parameters
    ----------
    frequency : float
        Drive frequency omega.
    damping : float
        Damping gamma.
    restitution : float
        Restitution R.

    Returns
    -------
    tuple of Array
        Amplitude A_c and speed u before the impacts. The root is a saddle-node if u > 0.
    """
    return _double_root(*_symmetric_coefficients(frequency, damping, restitution), frequency, damping, 1.0)


def _symmetric_coefficients(frequency, damping, restitution):
    """Return (a, b) of the symmetric P111."""
    flow_matrix, identity = _flow_matrix(frequency, damping, jnp.pi / frequency), jnp.eye(2)
    return jnp.linalg.solve(
        flow_matrix + identity, jnp.array([0.0, -1.0]) + flow_matrix @ jnp.stack([0.0 * restitution, restitution])
    )


def symmetric_start(scene):
    """Return a state on the symmetric P111 of a scene.

    Parameters
    ----------
    scene : Scene
        Single scene, with walls at -1 and 1, A above A_c, and a double root with u > 0.

    Returns
    -------
    State
        State after an impact on the right wall. Of the two orbits it belongs to the one with the faster impacts.
    """
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
    """Return the double root of an orbit with one impact in some periods, on one wall.

    Parameters
    ----------
    frequency : float
        Drive frequency omega.
    damping : float
        Damping gamma.
    restitution : float
        Restitution R.
    distance : float, optional
        Distance of the wall from 0.
    periods : int, optional
        Drive periods of the orbit.

    Returns
    -------
    tuple of Array
        Amplitude A_c and speed u before the impact. The root is a saddle-node if u > 0.
    """
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
    """Return the larger drive amplitude with a moving wall that is equivalent to another amplitude with a fixed wall.

    Seen from a wall at s + B cos(omega t + phase) the drive is A - B exp(i phase) (1 - omega^2 + 2 i gamma omega).
    """
    wall_drive = motion.amplitude * np.exp(1j * motion.phase) * (1.0 - frequency**2 + 2j * damping * frequency)
    return wall_drive.real + np.sqrt(effective_amplitude**2 - wall_drive.imag**2)


def meeting_frequency(damping):
    """Return the highest frequency at which saddle-node and grazing meet: sin(pi r / omega) = 0, r = omega."""
    return jnp.sqrt((1.0 - damping) * (1.0 + damping))


@jax.jit
def coexistence_width(frequency, damping, restitution):
    """Return sqrt(D) - A_c, the range of amplitudes in which P100 and P111 coexist."""
    return grazing_amplitude(frequency, damping) - symmetric_fold(frequency, damping, restitution)[0]


def coexistence_area(damping, restitution, max_frequency, n_nodes):
    """Return the area in (A, omega) between the loci up to a frequency, by Gauss-Legendre quadrature."""
    abscissae, weights = np.polynomial.legendre.leggauss(n_nodes)
    min_frequency = meeting_frequency(damping)
    half_range = 0.5 * (max_frequency - min_frequency)
    widths = jax.vmap(coexistence_width, (0, None, None))(
        min_frequency + half_range * (abscissae + 1.0), damping, restitution
    )
    return half_range * (widths @ weights)

"""Evaluate closed forms of orbits with one impact per wall (paper, section 2), to check claims and continued curves.

The drive has amplitude A and frequency omega, the oscillator has damping gamma, and the walls have restitution R. Let u
be the speed before each impact, s the distance of the wall from 0, and D = (1 - omega^2)^2 + (2 gamma omega)^2. The
forced motion without impacts has position x and velocity y. At an impact, (x, y / omega) = (s - a u, -b u / omega). The
free flow from one impact to the next determines the coefficients a and b. The length of this vector is A / sqrt(D),
which is a quadratic equation for u. At a double root two orbits meet, and the amplitude there is A_c.
"""

import jax
import jax.numpy as jnp
import numpy as np

from ..flight.flow import flight_responses
from ..scene.state import State


def forced_motion_state(amplitude, frequency, damping):
    """Return the state (x, v) at phase 0 of the forced motion without impacts."""
    complex_amplitude = amplitude / (1.0 - frequency**2 + 2j * damping * frequency)
    return complex_amplitude.real, (1j * frequency * complex_amplitude).real


def grazing_amplitude(frequency, damping, wall_distance=1.0):
    """Return the amplitude A = s sqrt(D) at which P100 grazes a wall (equation 8).

    Parameters
    ----------
    frequency : float
        Drive frequency omega.
    damping : float
        Damping gamma.
    wall_distance : float, optional
        Distance s of the wall from 0.

    Returns
    -------
    Array
        Amplitude.
    """
    return wall_distance * jnp.hypot(1.0 - frequency**2, 2.0 * damping * frequency)


def symmetric_fold(frequency, damping, restitution):
    """Return the saddle-node of the symmetric P111 between walls at -1 and 1 (equation 19).

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
        Amplitude A_c and speed u before the impacts, at the double root, which is a saddle-node if u > 0.
    """
    return _fold_from_coefficients(*_symmetric_orbit_coeffs(frequency, damping, restitution), frequency, damping, 1.0)


def _symmetric_orbit_coeffs(frequency, damping, restitution):
    """Return the coefficients (a, b) of the symmetric P111."""
    flow_matrix, identity = _flow_matrix(frequency, damping, jnp.pi / frequency), jnp.eye(2)
    return jnp.linalg.solve(
        flow_matrix + identity, jnp.array([0.0, -1.0]) + flow_matrix @ jnp.stack([0.0 * restitution, restitution])
    )


def symmetric_orbit_state(scene):
    """Return a state on the symmetric P111 of a scene.

    Parameters
    ----------
    scene : Scene
        Single scene with walls at -1 and 1. Its amplitude must be above A_c, and the double root must have u > 0 (see
        `symmetric_fold`).

    Returns
    -------
    State
        State after an impact on the right wall, on the orbit with the faster impacts.
    """
    frequency, damping, restitution, amplitude = (
        float(getattr(scene, key)) for key in ("frequency", "damping", "restitution", "amplitude")
    )
    position_coeff, velocity_coeff = (
        float(value) for value in _symmetric_orbit_coeffs(frequency, damping, restitution)
    )
    squared_norm, amplitude_over_grazing = (
        position_coeff**2 + (velocity_coeff / frequency) ** 2,
        amplitude / float(grazing_amplitude(frequency, damping)),
    )
    impact_speed = (
        position_coeff + np.sqrt(position_coeff**2 - squared_norm * (1.0 - amplitude_over_grazing**2))
    ) / squared_norm
    x, v = forced_motion_state(amplitude, frequency, damping)
    start_phase = np.angle(
        complex(1.0 - position_coeff * impact_speed, velocity_coeff * impact_speed / frequency)
    ) - np.angle(complex(x, -v / frequency))
    return State(1.0, -restitution * impact_speed, start_phase % (2.0 * np.pi))


def single_wall_fold(frequency, damping, restitution, wall_distance=1.0, periods=1):
    """Return the saddle-node of the orbit with one impact on a single wall in a number of drive periods.

    Parameters
    ----------
    frequency : float
        Drive frequency omega.
    damping : float
        Damping gamma.
    restitution : float
        Restitution R.
    wall_distance : float, optional
        Distance of the wall from 0.
    periods : int, optional
        Number of drive periods of the orbit.

    Returns
    -------
    tuple of Array
        Amplitude A_c and speed u before the impact, at the double root, which is a saddle-node if u > 0.
    """
    flow_matrix, identity = _flow_matrix(frequency, damping, 2.0 * jnp.pi * periods / frequency), jnp.eye(2)
    position_coeff, velocity_coeff = jnp.linalg.solve(
        identity - flow_matrix, jnp.array([0.0, -1.0]) - flow_matrix @ jnp.stack([0.0 * restitution, restitution])
    )
    return _fold_from_coefficients(position_coeff, velocity_coeff, frequency, damping, wall_distance)


def _fold_from_coefficients(position_coeff, velocity_coeff, frequency, damping, wall_distance):
    squared_norm = position_coeff**2 + (velocity_coeff / frequency) ** 2
    return grazing_amplitude(frequency, damping, wall_distance) * abs(velocity_coeff) / frequency / jnp.sqrt(
        squared_norm
    ), wall_distance * position_coeff / squared_norm


def _flow_matrix(frequency, damping, duration):
    (p00, p01, p11), _ = flight_responses(
        *jnp.broadcast_arrays(frequency + 0.0 * duration, damping + 0.0 * duration, duration)
    )
    return jnp.stack([jnp.stack([p00, p01]), jnp.stack([-p01, p11])])


def moving_wall_amplitude(fixed_wall_amplitude, frequency, damping, wall_motion):
    """Return the drive amplitude A for a moving wall that is equivalent to the amplitude for a fixed wall.

    The two amplitudes are equivalent if the motions relative to the wall are equal. Relative to a
    wall at s + B cos(omega t + phase), the complex amplitude of the drive is
    A - B exp(i phase) (1 - omega^2 + 2 i gamma omega). Its modulus is `fixed_wall_amplitude`. The larger of the two
    solutions A is returned.
    """
    wall_drive_phasor = (
        wall_motion.amplitude * np.exp(1j * wall_motion.phase) * (1.0 - frequency**2 + 2j * damping * frequency)
    )
    return wall_drive_phasor.real + np.sqrt(fixed_wall_amplitude**2 - wall_drive_phasor.imag**2)


def meeting_frequency(damping):
    """Return the highest frequency at which the saddle-node of P111 and the grazing of P100 coincide.

    This frequency is omega = r = sqrt(1 - gamma^2), where sin(pi r / omega) = 0.
    """
    return jnp.sqrt((1.0 - damping) * (1.0 + damping))


@jax.jit
def coexistence_width(frequency, damping, restitution):
    """Return sqrt(D) - A_c, the width of the amplitude interval in which P100 and P111 coexist."""
    return grazing_amplitude(frequency, damping) - symmetric_fold(frequency, damping, restitution)[0]


def coexistence_area(damping, restitution, max_frequency, n_nodes):
    """Return the area of the coexistence region in (A, omega) from `meeting_frequency` to `max_frequency`.

    The integral of `coexistence_width` is computed by Gauss-Legendre quadrature with `n_nodes` nodes.
    """
    node_abscissae, node_weights = np.polynomial.legendre.leggauss(n_nodes)
    min_frequency = meeting_frequency(damping)
    half_frequency_range = 0.5 * (max_frequency - min_frequency)
    widths = jax.vmap(coexistence_width, (0, None, None))(
        min_frequency + half_frequency_range * (node_abscissae + 1.0), damping, restitution
    )
    return half_frequency_range * (widths @ node_weights)

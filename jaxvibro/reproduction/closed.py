"""Closed forms of orbits with one impact a wall (paper, section 2), for the claims and as a check of what is continued.

With E the free flow from one impact to the next and u the speed before each, (x, y/omega) of the forced motion at an
impact is (s - a u, -b u / omega), whose length is A / sqrt(D). The double root in u is where two such orbits meet.
"""

import jax
import jax.numpy as jnp
import numpy as np

from ..flight.flow import responses
from ..scene.state import State


def forced(amplitude, frequency, damping):
    """(x, v) at phase 0 of the motion without impacts."""
    found = amplitude / (1.0 - frequency**2 + 2j * damping * frequency)
    return found.real, (1j * frequency * found).real


def grazing(frequency, damping, distance=1.0):
    """The amplitude A = s sqrt(D) at which P100 grazes a wall at distance s (8)."""
    return distance * jnp.hypot(1.0 - frequency**2, 2.0 * damping * frequency)


def symmetric_fold(frequency, damping, restitution):
    """(A_c, u) of the double root of the symmetric P111 between walls at -1 and 1 (19); a saddle-node where u > 0."""
    return _double(*_symmetric(frequency, damping, restitution), frequency, damping, 1.0)


def _symmetric(frequency, damping, restitution):
    """(a, b) of the symmetric P111."""
    flow, one = _flow(frequency, damping, jnp.pi / frequency), jnp.eye(2)
    return jnp.linalg.solve(flow + one, jnp.array([0.0, -1.0]) + flow @ jnp.stack([0.0 * restitution, restitution]))


def symmetric_start(scene):
    """The `State` after an impact on the right wall of a scene's symmetric P111, of two the one that hits harder.

    The scene is single, with walls at -1 and 1, A above A_c, and a double root with u > 0."""
    numbers = [float(getattr(scene, key)) for key in ("frequency", "damping", "restitution", "amplitude")]
    w, damping, bounce, force = numbers
    a, b = (float(each) for each in _symmetric(w, damping, bounce))
    whole, size = a**2 + (b / w) ** 2, force / float(grazing(w, damping))
    speed = (a + np.sqrt(a**2 - whole * (1.0 - size**2))) / whole
    x, v = forced(force, w, damping)
    late = np.angle(complex(1.0 - a * speed, b * speed / w)) - np.angle(complex(x, -v / w))
    return State(1.0, -bounce * speed, late % (2.0 * np.pi))


def single_fold(frequency, damping, restitution, distance=1.0, periods=1):
    """(A_c, u) of the double root of an orbit with one impact in some periods, on a wall at a distance from 0."""
    flow, one = _flow(frequency, damping, 2.0 * jnp.pi * periods / frequency), jnp.eye(2)
    a, b = jnp.linalg.solve(one - flow, jnp.array([0.0, -1.0]) - flow @ jnp.stack([0.0 * restitution, restitution]))
    return _double(a, b, frequency, damping, distance)


def _double(a, b, frequency, damping, distance):
    whole = a**2 + (b / frequency) ** 2
    return grazing(frequency, damping, distance) * abs(b) / frequency / jnp.sqrt(whole), distance * a / whole


def _flow(frequency, damping, time):
    (p00, p01, p11), _ = responses(*jnp.broadcast_arrays(frequency + 0.0 * time, damping + 0.0 * time, time))
    return jnp.stack([jnp.stack([p00, p01]), jnp.stack([-p01, p11])])


def amplitude_at(effective, frequency, damping, motion):
    """The larger drive amplitude that acts like another one on a fixed wall, where the wall moves with the drive.

    Seen from a wall at s + B cos(omega t + phase) the drive is A - B exp(i phase) (1 - omega^2 + 2 i gamma omega).
    """
    felt = motion.amplitude * np.exp(1j * motion.phase) * (1.0 - frequency**2 + 2j * damping * frequency)
    return felt.real + np.sqrt(effective**2 - felt.imag**2)


def meeting(damping):
    """The highest frequency at which the saddle-node's curve meets the grazing's: sin(pi r / omega) = 0, r = omega."""
    return jnp.sqrt((1.0 - damping) * (1.0 + damping))


@jax.jit
def width(frequency, damping, restitution):
    """sqrt(D) - A_c: how far P100 and P111 exist together."""
    return grazing(frequency, damping) - symmetric_fold(frequency, damping, restitution)[0]


def area(damping, restitution, high, nodes):
    """The area in (A, omega) between the curves, from where they meet up to a frequency (Gauss and Legendre)."""
    points, weights = np.polynomial.legendre.leggauss(nodes)
    low = meeting(damping)
    half = 0.5 * (high - low)
    widths = jax.vmap(width, (0, None, None))(low + half * (points + 1.0), damping, restitution)
    return half * (widths @ weights)

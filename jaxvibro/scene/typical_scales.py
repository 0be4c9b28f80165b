"""Estimate length and rate scales of the motion of a scene before any simulation."""

from functools import lru_cache

import jax
import numpy as np

from .force_operations import depends_on_time

N_TIMES = 16  # times per period at which the derivatives of a force are evaluated


def fast_part_amplitude(frequency, damping, force_amplitude):
    """Return the amplitude of the fast part of the response to a harmonic force.

    At a high frequency the response is about ``-force / frequency^2``. The other terms of the denominator bound the
    amplitude at low frequencies and at resonance.

    Parameters
    ----------
    frequency : array_like
        Frequency of the force.
    damping : array_like
        Damping ratio.
    force_amplitude : array_like
        Amplitude of the force.

    Returns
    -------
    array_like
        ``-force / (1 + frequency^2 + 2 damping frequency)``.
    """
    return -force_amplitude / (1.0 + frequency * frequency + 2.0 * damping * frequency)


def typical_length(scene):
    """Return a typical length of a single scene, a scale for lengths and speeds.

    Parameters
    ----------
    scene : Scene
        Single scene.

    Returns
    -------
    float
        Distance of the farther wall from 0. If this distance is small compared with the motion, or there is no wall,
        the result is the sum of the amplitudes of the fast part of the response to the drive (`fast_part_amplitude`)
        and of the wall motions. The result is 1 if this sum is 0.
    """
    walls = scene.walls.values()
    max_wall_distance = max((abs(float(wall.position)) for wall in walls), default=0.0)
    damping, frequency = 0.0 if scene.force is not None else float(scene.damping), float(scene.frequency)
    motion_amplitude = abs(fast_part_amplitude(frequency, damping, float(scene.amplitude)))
    for term in scene.drive:
        motion_amplitude += abs(fast_part_amplitude(term.harmonic * frequency, damping, float(term.amplitude)))
    motion_amplitude += sum(abs(float(wall.motion.amplitude)) for wall in walls if wall.motion is not None)
    return max_wall_distance if max_wall_distance > 0.3 * motion_amplitude else (motion_amplitude or 1.0)


def is_driven(scene):
    """Return True if the equation of motion of a single scene depends on time.

    Parameters
    ----------
    scene : Scene
        Single scene.

    Returns
    -------
    bool
        True if the drive, a wall motion or the force depends on time.
    """
    motions = [*scene.drive, *(wall.motion for wall in scene.walls.values() if wall.motion is not None)]
    if float(scene.amplitude) != 0 or any(float(motion.amplitude) != 0 and motion.harmonic for motion in motions):
        return True
    force = scene.force
    return force is not None and depends_on_time(force.function, tuple(force.numbers), np.dtype(scene.dtype))


@lru_cache(256)
def _compile_force_gradient(function):
    """Return the compiled derivatives of a force with respect to x and v at many states."""
    return jax.jit(jax.vmap(jax.grad(function, (1, 2)), (0, 0, None, None)))


def frequency_and_damping(scene):
    """Estimate the rates of a motion from the derivatives of the force at the walls (or at x = 0) and v = 0.

    Parameters
    ----------
    scene : Scene
        Single scene with a `Force`.

    Returns
    -------
    frequency : float
        Angular frequency of the linearised motion, at least 1.
    damping : float
        Largest magnitude of the derivative of the force with respect to v.
    """
    force, dtype = scene.force, scene.dtype
    times = np.linspace(0.0, 2.0 * np.pi / float(scene.frequency), N_TIMES, endpoint=False)
    positions = [float(wall.position) for wall in scene.walls.values()] or [0.0]
    t, x = (array.ravel().astype(dtype) for array in np.meshgrid(times, positions))
    force_gradients = _compile_force_gradient(force.function)(t, x, np.zeros((), dtype), force.numbers)
    stiffness, damping = (float(abs(np.asarray(array)).max()) for array in force_gradients)
    return max(1.0, stiffness**0.5), damping

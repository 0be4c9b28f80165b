"""Estimate length and rate scales of the motion of a scene in advance."""

from functools import lru_cache

import jax
import numpy as np

from .force_trace import depends_on_time

N_TIMES = 16  # times per period at which the derivatives of a force are evaluated


def fast_part_amplitude(frequency, damping, force):
    """Return the amplitude of the fast part of the response to a harmonic force.

    Parameters
    ----------
    frequency : array_like
        Frequency of the force.
    damping : array_like
        Damping ratio.
    force : array_like
        Amplitude of the force.

    Returns
    -------
    array_like
        ``-force / (1 + frequency^2 + 2 damping frequency)``.
    """
    return -force / (1.0 + frequency * frequency + 2.0 * damping * frequency)


def scene_length(scene):
    """Return a typical length of a single scene, a scale for lengths and speeds.

    Parameters
    ----------
    scene : Scene
        Single scene.

    Returns
    -------
    float
        Distance of the farther wall. If that is small compared with the motion, or there is no wall, the amplitude of
        the fast part of the response to the drive (`fast_part_amplitude`) plus the amplitudes of the walls' motions, or
        1 if these are 0.
    """
    walls = scene.walls.values()
    wall_distance = max((abs(float(wall.position)) for wall in walls), default=0.0)
    damping, frequency = 0.0 if scene.force is not None else float(scene.damping), float(scene.frequency)
    motion_size = abs(fast_part_amplitude(frequency, damping, float(scene.amplitude)))
    for term in scene.drive:
        motion_size += abs(fast_part_amplitude(term.harmonic * frequency, damping, float(term.amplitude)))
    motion_size += sum(abs(float(wall.motion.amplitude)) for wall in walls if wall.motion is not None)
    return wall_distance if wall_distance > 0.3 * motion_size else (motion_size or 1.0)


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
def _force_gradient(function):
    """Return the compiled derivatives of a force with respect to x and v at many states."""
    return jax.jit(jax.vmap(jax.grad(function, (1, 2)), (0, 0, None, None)))


def force_rates(scene):
    """Estimate the rates of a motion from the derivatives of the force at rest, at the walls or at 0.

    Parameters
    ----------
    scene : Scene
        Single scene with a `Force`.

    Returns
    -------
    frequency : float
        Rate at which the mass turns, at least 1.
    damping : float
        Rate at which its speed decays.
    """
    force, dtype = scene.force, scene.dtype
    times = np.linspace(0.0, 2.0 * np.pi / float(scene.frequency), N_TIMES, endpoint=False)
    positions = [float(wall.position) for wall in scene.walls.values()] or [0.0]
    t, x = (array.ravel().astype(dtype) for array in np.meshgrid(times, positions))
    gradients = _force_gradient(force.function)(t, x, np.zeros((), dtype), force.numbers)
    stiffness, damping = (float(abs(np.asarray(array)).max()) for array in gradients)
    return max(1.0, stiffness**0.5), damping

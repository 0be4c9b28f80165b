"""How large and how swift the motion of a scene is, before any of it is known."""

from functools import lru_cache

import jax
import numpy as np

from .force_trace import depends_on_time

N_TIMES = 16  # in a period, at which a force's slopes are looked at


def fast_part_amplitude(frequency, damping, force):
    """The amplitude of the swift part."""
    return -force / (1.0 + frequency * frequency + 2.0 * damping * frequency)


def scene_length(scene):
    """A length to measure speeds and lengths by: the farther wall's distance; where that is small beside the motion, or
    there is none, the size of the swift part of the response to the drive (`fast_part_amplitude`) and of the walls'
    swings, 1 at rest."""
    walls = scene.walls.values()
    wall_distance = max((abs(float(wall.position)) for wall in walls), default=0.0)
    damping, frequency = 0.0 if scene.force is not None else float(scene.damping), float(scene.frequency)
    motion_size = abs(fast_part_amplitude(frequency, damping, float(scene.amplitude)))
    for term in scene.drive:
        motion_size += abs(fast_part_amplitude(term.harmonic * frequency, damping, float(term.amplitude)))
    motion_size += sum(abs(float(wall.motion.amplitude)) for wall in walls if wall.motion is not None)
    return wall_distance if wall_distance > 0.3 * motion_size else (motion_size or 1.0)


def is_driven(scene):
    """Whether the equation of motion of a single scene depends on time: by a drive, a moving wall, or its force."""
    motions = [*scene.drive, *(wall.motion for wall in scene.walls.values() if wall.motion is not None)]
    if float(scene.amplitude) != 0 or any(float(motion.amplitude) != 0 and motion.harmonic for motion in motions):
        return True
    force = scene.force
    return force is not None and depends_on_time(force.function, tuple(force.numbers), np.dtype(scene.dtype))


@lru_cache(256)
def _force_gradient(function):
    return jax.jit(jax.vmap(jax.grad(function, (1, 2)), (0, 0, None, None)))


def force_rates(scene):
    """How fast a mass turns, and how fast it loses speed, by the slopes of the force of a single scene, at rest on its
    walls or at 0: two floats."""
    force, dtype = scene.force, scene.dtype
    times = np.linspace(0.0, 2.0 * np.pi / float(scene.frequency), N_TIMES, endpoint=False)
    positions = [float(wall.position) for wall in scene.walls.values()] or [0.0]
    t, x = (array.ravel().astype(dtype) for array in np.meshgrid(times, positions))
    gradients = _force_gradient(force.function)(t, x, np.zeros((), dtype), force.numbers)
    stiffness, damping = (float(abs(np.asarray(array)).max()) for array in gradients)
    return max(1.0, stiffness**0.5), damping

"""How large and how swift the motion of a scene is, before any of it is known."""

from functools import lru_cache

import jax
import numpy as np

from .force_trace import depends_on_time

PLACES = 16  # in a period, at which a force's slopes are looked at


def swift(frequency, damping, force):
    """The amplitude of the swift part."""
    return -force / (1.0 + frequency * frequency + 2.0 * damping * frequency)


def scene_length(scene):
    """A length to measure speeds and lengths by: the farther wall's distance; where that is small beside the motion, or
    there is none, the size of the swift part of the response to the drive (`swift`) and of the walls' swings, 1 at
    rest."""
    walls = scene.walls.values()
    found = max((abs(float(wall.position)) for wall in walls), default=0.0)
    damping, frequency = 0.0 if scene.force is not None else float(scene.damping), float(scene.frequency)
    size = abs(swift(frequency, damping, float(scene.amplitude)))
    for term in scene.drive:
        size += abs(swift(term.harmonic * frequency, damping, float(term.amplitude)))
    size += sum(abs(float(wall.motion.amplitude)) for wall in walls if wall.motion is not None)
    return found if found > 0.3 * size else (size or 1.0)


def is_driven(scene):
    """Whether the equation of motion of a single scene depends on time: by a drive, a moving wall, or its force."""
    motions = [*scene.drive, *(wall.motion for wall in scene.walls.values() if wall.motion is not None)]
    if float(scene.amplitude) != 0 or any(float(each.amplitude) != 0 and each.harmonic for each in motions):
        return True
    force = scene.force
    return force is not None and depends_on_time(force.function, tuple(force.numbers), np.dtype(scene.dtype))


@lru_cache(256)
def _slopes(function):
    return jax.jit(jax.vmap(jax.grad(function, (1, 2)), (0, 0, None, None)))


def force_rates(scene):
    """How fast a mass turns, and how fast it loses speed, by the slopes of the force of a single scene, at rest on its
    walls or at 0: two floats."""
    force, dtype = scene.force, scene.dtype
    times = np.linspace(0.0, 2.0 * np.pi / float(scene.frequency), PLACES, endpoint=False)
    places = [float(wall.position) for wall in scene.walls.values()] or [0.0]
    t, x = (each.ravel().astype(dtype) for each in np.meshgrid(times, places))
    slopes = _slopes(force.function)(t, x, np.zeros((), dtype), force.numbers)
    pull, drag = (float(abs(np.asarray(each)).max()) for each in slopes)
    return max(1.0, pull**0.5), drag

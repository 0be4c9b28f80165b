"""Derive properties from a scene: its symmetry, and the typical scales of its motion."""

from dataclasses import replace
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np

from .force_operations import depends_on_time
from .scene import replace_unchecked


def is_symmetric(scene):
    """Return True if the mirror image of every motion of a single scene is a motion of the same scene.

    Parameters
    ----------
    scene : Scene
        Single scene.

    Returns
    -------
    bool
        True if the walls are opposite, of one kind with equal parameters, and move oppositely half a period apart, or
        if there are no walls. A user-defined force must be odd, and the drive must have odd harmonics only.
    """
    if not scene.flow_kind.is_odd(scene):
        return False
    if any(term.harmonic % 2 == 0 and term.amplitude != 0 for term in scene.drive):
        return False
    left_wall, right_wall = scene.left, scene.right
    if len(scene.walls) < 2:
        return not scene.walls
    if float(left_wall.position) != -float(right_wall.position):
        return False
    if left_wall.own != right_wall.own or jax.tree.structure(left_wall.law) != jax.tree.structure(right_wall.law):
        return False
    if any(scene.parameter(f"left.{name}") != scene.parameter(f"right.{name}") for name in left_wall.own):
        return False
    (left_harmonic, left_phasor), (right_harmonic, right_phasor) = (
        _motion_phasor(wall.motion) for wall in (left_wall, right_wall)
    )
    if left_phasor == 0 or right_phasor == 0:
        return bool(left_phasor == right_phasor)
    tolerance = 8.0 * np.finfo(scene.dtype).eps * abs(left_phasor)
    return left_harmonic == right_harmonic and bool(
        abs(left_phasor + right_phasor * (-1) ** right_harmonic) <= tolerance
    )


def stays_symmetric(scene, *names):
    """Return True if a scene is symmetric for all values of some parameters.

    Parameters
    ----------
    scene : Scene
        Single scene.
    *names : str
        Names of the parameters.

    Returns
    -------
    bool
        True if the scene is symmetric and remains symmetric when each parameter changes to one other value.
    """
    perturbed_values = {name: float(scene.parameter(name)) * 0.99 + 0.001 for name in names}
    return is_symmetric(scene) and is_symmetric(replace_unchecked(scene, perturbed_values))


def _motion_phasor(motion):
    """Return the harmonic and the complex amplitude of a wall motion."""
    if motion is None:
        return 1, 0.0
    return motion.harmonic, complex(motion.amplitude * np.exp(1j * float(motion.phase)))


def symmetrise_scene(scene):
    """Return the symmetric scene whose walls are the means of the walls and their mirror images.

    Parameters
    ----------
    scene : Scene
        Scene with two walls of one kind.

    Returns
    -------
    Scene
        Symmetric scene; equal to `scene` if this is symmetric. Each wall stores its restitution or
        damping, even if the wall takes this value from `scene`. The drive has no even
        harmonics. The result is smooth in all parameters except where walls cease to move.
    """
    left_wall, right_wall = scene.left, scene.right
    for name in left_wall.own:
        mean_value = 0.5 * (scene.parameter(f"left.{name}") + scene.parameter(f"right.{name}"))
        scene = replace_unchecked(scene, {f"left.{name}": mean_value, f"right.{name}": mean_value})
    half_wall_distance = 0.5 * (right_wall.position - left_wall.position)
    opposite_motions = _opposite_motions(left_wall.motion, right_wall.motion)
    new_wall_data = zip(
        ("left", "right"),
        (scene.left, scene.right),
        (-half_wall_distance, half_wall_distance),
        opposite_motions,
        strict=True,
    )
    drive = (term if term.harmonic % 2 else replace(term, amplitude=0.0 * term.amplitude) for term in scene.drive)
    walls = {side: replace(wall, position=position, motion=motion) for side, wall, position, motion in new_wall_data}
    return replace(scene, drive=tuple(drive), **walls)


def _opposite_motions(left_motion, right_motion):
    """Return the mean motions of two walls, opposite and half a period apart.

    The result is (None, None) if a wall has no motion or the harmonics differ. In these cases the walls of the
    symmetric scene are at rest.
    """
    if left_motion is None or right_motion is None or left_motion.harmonic != right_motion.harmonic:
        return None, None
    phase_difference, opposition_sign = left_motion.phase - right_motion.phase, -((-1.0) ** right_motion.harmonic)
    cosine_amplitude = 0.5 * (
        right_motion.amplitude + opposition_sign * left_motion.amplitude * jnp.cos(phase_difference)
    )
    sine_amplitude = 0.5 * opposition_sign * left_motion.amplitude * jnp.sin(phase_difference)
    tangent_of_shift = sine_amplitude / jnp.where(cosine_amplitude == 0, 1.0, cosine_amplitude)
    amplitude, phase_shift = (
        cosine_amplitude * jnp.sqrt(1.0 + tangent_of_shift * tangent_of_shift),
        jnp.arctan(tangent_of_shift),
    )
    phase = right_motion.phase + phase_shift
    return replace(left_motion, amplitude=opposition_sign * amplitude, phase=phase), replace(
        right_motion, amplitude=amplitude, phase=phase
    )


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
    damping, frequency = 0.0 if scene.damping is None else float(scene.damping), float(scene.frequency)
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

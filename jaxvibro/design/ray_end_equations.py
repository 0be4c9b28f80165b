"""Set up the equations of the special point that ends a ray."""

import jax.numpy as jnp
import numpy as np

from ..orbits.orbit_comparison import impacts_as_points, is_same_orbit, mirror_points
from ..problem import soft_wall_grazing
from ..scene.symmetry import is_symmetric
from .parameter_rays import RayEnd
from .special_point_equations import SpecialPointEquations, grazing_equations, null_vector_at

SAME_IMPACT_TOLERANCE = 1e-6  # relative to the largest speed: impacts closer than this coincide


def equations_at_ray_end(scene_treedef, sequence, scene_vector, ray):
    """Return (kind, `SpecialPointEquations`, approximate unknowns) of the special point that ends a `RayResult`.

    `sequence` is the `ImpactSequence` of the orbit at the start of the ray. `scene_vector` holds the numbers of the
    scene at the end of the ray. The unknown distance is set to 0. The caller must replace this value.
    """
    unknowns, n_impacts = np.asarray(ray.unknowns), len(sequence.sides)
    columns = [*np.split(unknowns, 2), np.asarray(sequence.sides)] if n_impacts else [np.zeros(0)] * 3
    sequence = sequence._replace(**dict(zip(("times", "speeds", "sides"), map(jnp.asarray, columns), strict=True)))
    if ray.end in (RayEnd.TOUCH, RayEnd.ZERO_SPEED):
        return _grazing_at_ray_end(scene_treedef, sequence, scene_vector, ray)
    kind = "SN" if ray.end == RayEnd.FOLD else "PD"
    if kind == "SN" and _is_symmetric_orbit(scene_treedef, sequence, scene_vector):
        null_vector = null_vector_at(SpecialPointEquations("SN", False, scene_treedef, sequence), scene_vector)
        null_vector_halves = null_vector.reshape(2, 2, -1)  # axes: times or speeds, first or second half, impact
        if np.sum(null_vector_halves[:, 0] * null_vector_halves[:, 1]) < 0:
            kind, n_half_impacts = "SB", n_impacts // 2
            half_columns = {
                "times": sequence.times[:n_half_impacts],
                "speeds": sequence.speeds[:n_half_impacts],
                "sides": sequence.sides[:n_half_impacts],
            }
            sequence = sequence._replace(**half_columns, periods=0.5 * sequence.periods, closure_sign=jnp.asarray(-1.0))
    equations = SpecialPointEquations(kind, False, scene_treedef, sequence)
    null_vector = null_vector_at(equations, scene_vector)
    start_unknowns = np.concatenate([np.asarray(sequence.times), np.asarray(sequence.speeds), [0.0], null_vector])
    return kind, equations, start_unknowns


def _is_symmetric_orbit(scene_treedef, sequence, scene_vector):
    """Check that the orbit is its own mirror image."""
    scene = scene_treedef.unflatten([np.asarray(scene_number) for scene_number in scene_vector])
    if len(sequence.sides) % 2 or not is_symmetric(scene):
        return False
    speeds = np.asarray(sequence.speeds)
    impact_points = impacts_as_points(
        float(scene.frequency), np.asarray(sequence.times), np.asarray(sequence.sides), speeds, speeds.max()
    )
    return is_same_orbit(impact_points, mirror_points(impact_points), SAME_IMPACT_TOLERANCE)


def _grazing_at_ray_end(scene_treedef, sequence, scene_vector, ray):
    """Return ("GR", `SpecialPointEquations`, unknowns) with the grazing contact as an impact with zero speed."""
    scene = scene_treedef.unflatten([np.asarray(number_or_column) for number_or_column in scene_vector])
    times, speeds, sides = (
        np.asarray(number_or_column) for number_or_column in (sequence.times, sequence.speeds, sequence.sides)
    )
    if ray.end == RayEnd.ZERO_SPEED:
        grazing_row, speeds = int(ray.row), np.where(np.arange(len(times)) == int(ray.row), 0.0, speeds)
    else:
        wall_side_codes = [side for side, wall in ((-1.0, scene.left), (1.0, scene.right)) if wall is not None]
        duration = float(sequence.periods) * 2.0 * np.pi / float(scene.frequency)
        grazing_time = float(ray.time) % duration
        grazing_row = int(np.searchsorted(times, grazing_time))
        times, speeds = np.insert(times, grazing_row, grazing_time), np.insert(speeds, grazing_row, 0.0)
        sides = np.insert(sides, grazing_row, wall_side_codes[int(ray.wall)])
    sequence = sequence._replace(times=times, speeds=speeds, sides=sides)
    if soft_wall_grazing.is_smooth_soft_wall(scene, sides[grazing_row]):
        sequence = sequence._replace(grazing=np.eye(len(times))[grazing_row])
    return "GR", *grazing_equations(scene_treedef, sequence, grazing_row, 0.0, float(scene.frequency))

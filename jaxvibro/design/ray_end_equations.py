"""Set up the equations of the special point that ends a ray."""

import jax.numpy as jnp
import numpy as np

from ..orbits.orbit_comparison import impacts_as_points, is_same_orbit, mirror_points
from ..problem import soft_grazing
from ..scene.symmetry import is_symmetric
from .point_equations import PointEquations, grazing_equations, null_vector_at
from .rays import RayEnd

SAME_IMPACT_TOLERANCE = 1e-6  # relative to the largest speed: impacts closer than this coincide


def equations_at_ray_end(treedef, sequence, scene_vector, ray_result):
    """Return (kind, `PointEquations`, unknowns) near the end of a `Ray` in the scene with these numbers.

    `sequence` is that of the orbit that was followed. The distance along a direction is set to 0 and is left to the
    caller.
    """
    unknowns, n_impacts = np.asarray(ray_result.unknowns), len(sequence.sides)
    columns = [*np.split(unknowns, 2), np.asarray(sequence.sides)] if n_impacts else [np.zeros(0)] * 3
    sequence = sequence._replace(**dict(zip(("times", "speeds", "sides"), map(jnp.asarray, columns), strict=True)))
    if ray_result.end in (RayEnd.TOUCH, RayEnd.ZERO_SPEED):
        return _grazing_point(treedef, sequence, scene_vector, ray_result)
    kind = "SN" if ray_result.end == RayEnd.FOLD else "PD"
    if kind == "SN" and _is_symmetric_orbit(treedef, sequence, scene_vector):
        null_vector = null_vector_at(PointEquations("SN", False, treedef, sequence), scene_vector)
        halves = null_vector.reshape(2, 2, -1)  # axes: times or speeds, first or second half, impact
        if np.sum(halves[:, 0] * halves[:, 1]) < 0:
            kind, half_count = "SB", n_impacts // 2
            half_columns = {
                "times": sequence.times[:half_count],
                "speeds": sequence.speeds[:half_count],
                "sides": sequence.sides[:half_count],
            }
            sequence = sequence._replace(**half_columns, periods=0.5 * sequence.periods, closure_sign=jnp.asarray(-1.0))
    equations = PointEquations(kind, False, treedef, sequence)
    null_vector = null_vector_at(equations, scene_vector)
    start_unknowns = np.concatenate([np.asarray(sequence.times), np.asarray(sequence.speeds), [0.0], null_vector])
    return kind, equations, start_unknowns


def _is_symmetric_orbit(treedef, sequence, scene_vector):
    """Check that the orbit is its own mirror image."""
    scene = treedef.unflatten([np.asarray(number) for number in scene_vector])
    if len(sequence.sides) % 2 or not is_symmetric(scene):
        return False
    speeds = np.asarray(sequence.speeds)
    contact_points = impacts_as_points(
        float(scene.frequency), np.asarray(sequence.times), np.asarray(sequence.sides), speeds, speeds.max()
    )
    return is_same_orbit(contact_points, mirror_points(contact_points), SAME_IMPACT_TOLERANCE)


def _grazing_point(treedef, sequence, scene_vector, ray_result):
    """Return the GR with the grazing contact as an impact with zero speed."""
    scene = treedef.unflatten([np.asarray(array) for array in scene_vector])
    times, speeds, sides = (np.asarray(array) for array in (sequence.times, sequence.speeds, sequence.sides))
    if ray_result.end == RayEnd.ZERO_SPEED:
        grazing_row, speeds = int(ray_result.row), np.where(np.arange(len(times)) == int(ray_result.row), 0.0, speeds)
    else:
        wall_sides = [side for side, wall in ((-1.0, scene.left), (1.0, scene.right)) if wall is not None]
        duration = float(sequence.periods) * 2.0 * np.pi / float(scene.frequency)
        time = float(ray_result.time) % duration
        grazing_row = int(np.searchsorted(times, time))
        times, speeds = np.insert(times, grazing_row, time), np.insert(speeds, grazing_row, 0.0)
        sides = np.insert(sides, grazing_row, wall_sides[int(ray_result.wall)])
    sequence = sequence._replace(times=times, speeds=speeds, sides=sides)
    if soft_grazing.is_smooth_wall(scene, sides[grazing_row]):
        sequence = sequence._replace(grazing=np.eye(len(times))[grazing_row])
    return "GR", *grazing_equations(treedef, sequence, grazing_row, 0.0, float(scene.frequency))

"""From what ended a ray to the equations of the special point there."""

import jax.numpy as jnp
import numpy as np

from ..orbits.orbit_comparison import is_same_orbit, meetings, mirrored
from ..problem import soft_grazing
from ..scene.symmetry import is_symmetric
from .point_equations import PointEquations, grazing, null_at
from .rays import RayEnd

SAME = 1e-6  # of the largest speed: two impacts as near are one


def point_at(tree, cycle, numbers, end):
    """(kind, `PointEquations`, unknowns) near the end of a ray, of the scene with these numbers. end: the `Ray`; cycle:
    of the orbit that was followed. How far along a direction the point lies is left to the caller, 0."""
    unknowns, count = np.asarray(end.unknowns), len(cycle.sides)
    rows = [*np.split(unknowns, 2), np.asarray(cycle.sides)] if count else [np.zeros(0)] * 3
    cycle = cycle._replace(**dict(zip(("times", "speeds", "sides"), map(jnp.asarray, rows), strict=True)))
    if end.end in (RayEnd.TOUCH, RayEnd.SLOW):
        return _grazing(tree, cycle, numbers, end)
    kind = "SN" if end.end == RayEnd.FOLD else "PD"
    if kind == "SN" and _is_symmetric(tree, cycle, numbers):
        null = null_at(PointEquations("SN", False, tree, cycle), numbers)
        halves = null.reshape(2, 2, -1)  # times and speeds, of the first half and of the second
        if np.sum(halves[:, 0] * halves[:, 1]) < 0:
            kind, half = "SB", count // 2
            parts = {"times": cycle.times[:half], "speeds": cycle.speeds[:half], "sides": cycle.sides[:half]}
            cycle = cycle._replace(**parts, periods=0.5 * cycle.periods, turn=jnp.asarray(-1.0))
    point = PointEquations(kind, False, tree, cycle)
    null = null_at(point, numbers)
    start = np.concatenate([np.asarray(cycle.times), np.asarray(cycle.speeds), [0.0], null])
    return kind, point, start


def _is_symmetric(tree, cycle, numbers):
    """Whether the orbit is its own mirror image."""
    scene = tree.unflatten([np.asarray(each) for each in numbers])
    if len(cycle.sides) % 2 or not is_symmetric(scene):
        return False
    speeds = np.asarray(cycle.speeds)
    points = meetings(float(scene.frequency), np.asarray(cycle.times), np.asarray(cycle.sides), speeds, speeds.max())
    return is_same_orbit(points, mirrored(points), SAME)


def _grazing(tree, cycle, numbers, end):
    """The touch as an impact without speed."""
    scene = tree.unflatten([np.asarray(each) for each in numbers])
    times, speeds, sides = (np.asarray(each) for each in (cycle.times, cycle.speeds, cycle.sides))
    if end.end == RayEnd.SLOW:
        touch, speeds = int(end.row), np.where(np.arange(len(times)) == int(end.row), 0.0, speeds)
    else:
        walls = [side for side, wall in ((-1.0, scene.left), (1.0, scene.right)) if wall is not None]
        span = float(cycle.periods) * 2.0 * np.pi / float(scene.frequency)
        time = float(end.time) % span
        touch = int(np.searchsorted(times, time))
        times, speeds = np.insert(times, touch, time), np.insert(speeds, touch, 0.0)
        sides = np.insert(sides, touch, walls[int(end.wall)])
    cycle = cycle._replace(times=times, speeds=speeds, sides=sides)
    if soft_grazing.is_smooth(scene, sides[touch]):
        cycle = cycle._replace(still=np.eye(len(times))[touch])
    return "GR", *grazing(tree, cycle, touch, 0.0, float(scene.frequency))

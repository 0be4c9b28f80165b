"""Detect that a branch of periodic orbits returns to its start, with any phase: the equations do not fix it.

At the parameter value of the start, the orbit equals the start if it passes through the first point of the start.
"""

import jax
import jax.numpy as jnp
import numpy as np

from .driver import EventDetector
from .event_search import SAME_POINT_DISTANCE
from .intermediate_points import point_at_length
from .multiple_shooting import points_and_period
from .persistent_jit import persistent_jit
from .problem import ORBITS
from .roots import find_sign_change

SAMPLES_PER_SEGMENT = 8  # samples of a shooting segment among which the nearest point is selected
NEWTON_STEPS = 8  # Newton steps that refine it


class SystemEventDetector(EventDetector):
    """Detector for branches of a `System` in parameters of the given names."""

    def __init__(self, system, names):
        self.system, self.names = system, names

    def find_closure(self, task, points):
        if self.system.kind == ORBITS:
            return _find_closure(self.system, self.names, task, points)
        return super().find_closure(task, points)


def _find_closure(system, names, task, points):
    """Return (row before, length from it) where the branch returns to one of the task's starts, or None."""
    for start in task.starts:
        offsets = points.z[:, -1] - start[-1]
        for row_before in np.flatnonzero(offsets[:-1] * offsets[1:] < 0).tolist():
            length = _length_to_value(task, points, row_before, start[-1])
            point = None if length is None else point_at_length(task, points, row_before, length)
            if point is not None and _is_same_orbit(system, names, start, point.z, task.args):
                return row_before, length
    return None


def _length_to_value(task, points, row_before, value):
    """Return the length from a point to where the last parameter has a value; None if Newton's method fails."""

    def offset(length):
        point = point_at_length(task, points, row_before, length)
        return np.nan if point is None else point.z[-1] - value

    step_length = float(points.step[row_before + 1])
    return find_sign_change(offset, step_length) if np.isfinite(offset(0.5 * step_length)) else None


def _is_same_orbit(system, names, start, z, constants):
    """Return True if two orbits have equal periods and parameters and the first point of one lies on the other."""
    n_unknowns = len(z) - len(names)
    # Compare the periods and the parameters.
    max_difference = max(abs(start[n_unknowns - 1 :] - z[n_unknowns - 1 :]) / (1.0 + abs(z[n_unknowns - 1 :])))
    if max_difference > SAME_POINT_DISTANCE:
        return False
    first_point = points_and_period(z[:n_unknowns], system.segments * system.times)[0][0]
    return float(_distance_to_orbit(system, names, start, first_point, constants)) < SAME_POINT_DISTANCE * (
        1.0 + abs(first_point).max()
    )


@persistent_jit(static_argnums=(0, 1))
def _distance_to_orbit(system, names, z, target, constants):
    """Return the distance from the periodic orbit of z to a point of shape (n,)."""
    n_unknowns, n_segments = len(z) - len(names), system.segments * system.times
    points, period = points_and_period(z[:n_unknowns], n_segments)
    p = {**constants.fixed_params, **{name: z[n_unknowns + index] for index, name in enumerate(names)}}

    def fly(x, time):
        return system.fly(x, time, p, constants.args)

    times = period / n_segments * jnp.arange(SAMPLES_PER_SEGMENT) / SAMPLES_PER_SEGMENT
    samples = jax.vmap(lambda x: jax.vmap(lambda time: fly(x, time))(times))(points)
    segment_index, sample_index = jnp.unravel_index(
        jnp.argmin(jnp.sum((samples - target) ** 2, axis=-1)), (n_segments, SAMPLES_PER_SEGMENT)
    )

    def newton_step(time, _):
        point = fly(points[segment_index], time)
        field_vector = jnp.asarray(system.function(point, p, constants.args))
        return time - field_vector @ (point - target) / (field_vector @ field_vector), None

    time, _ = jax.lax.scan(newton_step, times[sample_index], None, length=NEWTON_STEPS)
    return jnp.linalg.norm(fly(points[segment_index], time) - target)

"""Detect that a branch of periodic orbits returns to its starting orbit.

The equations do not fix the phase of an orbit, so that the branch may return with another phase. Two orbits with equal
periods and parameters coincide if the first point of one orbit lies on the other.
"""

import jax
import jax.numpy as jnp
import numpy as np

from .continuation_loop import EventDetector
from .event_search import SAME_POINT_DISTANCE, find_bracketed_root, point_at_length
from .hostcall import persistent_jit
from .problem import ORBITS, points_and_period

SAMPLES_PER_SEGMENT = 8  # samples of a shooting segment among which the nearest point is selected
NEWTON_STEPS = 8  # Newton steps that refine it


class SystemEventDetector(EventDetector):
    """Event detector for branches of a `System` in named parameters, which recognises closed branches of orbits."""

    def __init__(self, system, param_names):
        self.system, self.names = system, param_names

    def find_closure(self, task, points):
        if self.system.kind == ORBITS:
            return _find_orbit_closure(self.system, self.names, task, points)
        return super().find_closure(task, points)


def _find_orbit_closure(system, param_names, task, points):
    """Return (row before, length from this row) where the branch returns to a start of the task, or None."""
    for start_z in task.starts:
        parameter_offsets = points.z[:, -1] - start_z[-1]
        for row_before in np.flatnonzero(parameter_offsets[:-1] * parameter_offsets[1:] < 0).tolist():
            length = _length_to_parameter(task, points, row_before, start_z[-1])
            point = None if length is None else point_at_length(task, points, row_before, length)
            if point is not None and _is_same_orbit(system, param_names, start_z, point.z, task.args):
                return row_before, length
    return None


def _length_to_parameter(task, points, row_before, parameter_value):
    """Return the length from a row to the point with a given value of the last parameter.

    Returns None if Newton's method fails.
    """

    def parameter_offset(length):
        point = point_at_length(task, points, row_before, length)
        return np.nan if point is None else point.z[-1] - parameter_value

    interval_length = float(points.step[row_before + 1])
    return (
        find_bracketed_root(parameter_offset, interval_length)
        if np.isfinite(parameter_offset(0.5 * interval_length))
        else None
    )


def _is_same_orbit(system, param_names, start_z, z, constants):
    """Return True if the orbits at `start_z` and z have equal periods and parameters and coincide."""
    n_unknowns = len(z) - len(param_names)
    # Compare the periods and the parameters.
    period_param_mismatch = max(abs(start_z[n_unknowns - 1 :] - z[n_unknowns - 1 :]) / (1.0 + abs(z[n_unknowns - 1 :])))
    if period_param_mismatch > SAME_POINT_DISTANCE:
        return False
    first_point = points_and_period(z[:n_unknowns], system.segments * system.times)[0][0]
    return float(_distance_to_orbit(system, param_names, start_z, first_point, constants)) < SAME_POINT_DISTANCE * (
        1.0 + abs(first_point).max()
    )


@persistent_jit(static_argnums=(0, 1))
def _distance_to_orbit(system, param_names, z, target_point, constants):
    """Return the distance from the periodic orbit of z to a point of shape (n,)."""
    n_unknowns, n_segments = len(z) - len(param_names), system.segments * system.times
    points, period = points_and_period(z[:n_unknowns], n_segments)
    p = {**constants.fixed_params, **{name: z[n_unknowns + index] for index, name in enumerate(param_names)}}

    def flow_from(start_point, time):
        return system.fly(start_point, time, p, constants.args)

    sample_times = period / n_segments * jnp.arange(SAMPLES_PER_SEGMENT) / SAMPLES_PER_SEGMENT
    sample_points = jax.vmap(lambda x: jax.vmap(lambda time: flow_from(x, time))(sample_times))(points)
    segment_index, sample_index = jnp.unravel_index(
        jnp.argmin(jnp.sum((sample_points - target_point) ** 2, axis=-1)), (n_segments, SAMPLES_PER_SEGMENT)
    )

    def newton_step(time, unused_scan_input):
        point = flow_from(points[segment_index], time)
        field_vector = jnp.asarray(system.function(point, p, constants.args))
        return time - field_vector @ (point - target_point) / (field_vector @ field_vector), None

    time, _ = jax.lax.scan(newton_step, sample_times[sample_index], None, length=NEWTON_STEPS)
    return jnp.linalg.norm(flow_from(points[segment_index], time) - target_point)

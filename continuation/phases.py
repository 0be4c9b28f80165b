"""Whether a branch of periodic orbits comes back to its start, with whatever phase: the equations keep none.

At the start's value of the last parameter the orbit is the start's where this flies through its first point.
"""

import jax
import jax.numpy as jnp
import numpy as np

from .cycles import points_of
from .driver import Watch
from .event_search import SAME
from .persistent_jit import persistent_jit
from .points import between
from .problem import ORBITS
from .roots import sign_change

LOOKS = 8  # in each flight of an orbit, for the nearest place
POLISH = 8  # Newton's steps from there


class SystemWatch(Watch):
    """What is watched along a branch of a system, in parameters of these names."""

    def __init__(self, system, names):
        self.system, self.names = system, names

    def comes_back(self, task, points):
        if self.system.kind == ORBITS:
            return _comes_back(self.system, self.names, task, points)
        return super().comes_back(task, points)


def _comes_back(system, names, task, points):
    """(place of the point before, length from it) where a row of orbits is one of the task's starts again, or None."""
    for start in task.starts:
        gaps = points.z[:, -1] - start[-1]
        for after in np.flatnonzero(gaps[:-1] * gaps[1:] < 0).tolist():
            length = _length(task, points, after, start[-1])
            one = None if length is None else between(task, points, after, length)
            if one is not None and _is_same(system, names, start, one.z, task.args):
                return after, length
    return None


def _length(task, points, after, value):
    """From a point to where the last parameter has a value; None where the branch cannot be followed there."""

    def gap(length):
        one = between(task, points, after, length)
        return np.nan if one is None else one.z[-1] - value

    end = float(points.step[after + 1])
    return sign_change(gap, end) if np.isfinite(gap(0.5 * end)) else None


def _is_same(system, names, start, z, given):
    size = len(z) - len(names)
    others = max(abs(start[size - 1 :] - z[size - 1 :]) / (1.0 + abs(z[size - 1 :])))  # the period, and parameters
    if others > SAME:
        return False
    place = points_of(z[:size], system.segments * system.times)[0][0]
    return float(_distance(system, names, start, place, given)) < SAME * (1.0 + abs(place).max())


@persistent_jit(static_argnums=(0, 1))
def _distance(system, names, z, place, given):
    """How near an orbit z flies to a place, (n,)."""
    size, count = len(z) - len(names), system.segments * system.times
    points, period = points_of(z[:size], count)
    p = {**given.others, **{name: z[size + k] for k, name in enumerate(names)}}

    def fly(x, time):
        return system.fly(x, time, p, given.args)

    times = period / count * jnp.arange(LOOKS) / LOOKS
    seen = jax.vmap(lambda x: jax.vmap(lambda time: fly(x, time))(times))(points)
    first, second = jnp.unravel_index(jnp.argmin(jnp.sum((seen - place) ** 2, axis=-1)), (count, LOOKS))

    def nearer(time, _):
        here = fly(points[first], time)
        way = jnp.asarray(system.function(here, p, given.args))
        return time - way @ (here - place) / (way @ way), None

    time, _ = jax.lax.scan(nearer, times[second], None, length=POLISH)
    return jnp.linalg.norm(fly(points[first], time) - place)

"""The motion that meets no wall, in closed form: the free response to the drive, as a state and as an orbit."""

import jax
import jax.numpy as jnp
import numpy as np

from ..flight import flow
from ..maps.strobe import strobe
from ..scene.codes import Status
from ..scene.state import State
from .by_shooting import by_state
from .orbit import OrbitError


def free_response(scene):
    """The `State` at phase 0 of the motion that is periodic if there are no walls; nan where, at resonance, none is.

    scene: a single one.
    """
    period = jnp.asarray(2.0 * jnp.pi / scene.frequency)
    (p00, p01, p11), ((x, v), _) = flow.responses(scene.frequency, scene.damping, period)
    matrix = np.array([[1.0 - p00, -p01], [p01, 1.0 - p11]])
    force = float(scene.amplitude)
    try:
        state = np.linalg.solve(matrix, force * np.array([x, v]))
    except np.linalg.LinAlgError:
        state = np.full(2, np.nan)
    return State(float(state[0]), float(state[1]))


def free_orbit(scene):
    """The free response as an `Orbit`, P100, where it keeps off the walls all the way round; else None."""
    state = free_response(scene)
    end, impacts = jax.device_get(strobe(scene, state))
    near = float(np.finfo(scene.dtype).eps) ** 0.5 * max(1.0, abs(state.x), abs(state.v))
    comes_back = max(abs(end.x - state.x), abs(end.v - state.v)) <= near  # not so from within a soft wall
    if impacts.status != Status.OK or impacts.count or end.contact or not comes_back:
        return None
    try:
        return by_state(scene, state, 1)
    except OrbitError:  # singular: without damping
        return None

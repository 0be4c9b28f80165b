"""The motion that meets no wall: the free response to the drive, as a state and as an orbit; in closed form but under a
force of the user's own."""

import jax
import jax.numpy as jnp
import numpy as np

from continuation.persistent_jit import SOON, persistent_jit

from ..flight import flow
from ..flight.response import by_rows, of_scene
from ..scene.codes import Status
from ..scene.state import State
from .by_shooting import by_state, period
from .orbit import OrbitError

ROUNDS = 20  # of Newton's steps
NEAR = 1e-12  # of 1 + the largest of x and v: a step as small is the last


def free_response(scene):
    """The `State` at phase 0 of the motion that is periodic if there are no walls; nan where, at resonance, none is.

    scene: a single one. Under a force of the user's own that to which Newton's method leads from rest at 0; of the
    linear flow under several terms of the drive its first step is the motion.
    """
    if scene.force is not None or scene.drive:
        return _from_rest(scene)
    (p00, p01, p11), ((x, v), _) = _responses(scene)
    matrix = np.array([[1.0 - p00, -p01], [p01, 1.0 - p11]])
    force = float(scene.amplitude)
    try:
        state = np.linalg.solve(matrix, force * np.array([x, v]))
    except np.linalg.LinAlgError:
        state = np.full(2, np.nan)
    return State(float(state[0]), float(state[1]))


def _from_rest(scene):
    state = np.zeros(2)
    for _ in range(ROUNDS):
        (x, v), matrix = jax.device_get(_around(scene, state))
        p00, p01, p10, p11 = by_rows(matrix)
        try:
            step = np.linalg.solve(np.array([[1.0 - p00, -p01], [-p10, 1.0 - p11]]), state - np.array([x, v]))
        except np.linalg.LinAlgError:
            break
        state = state - step
        if abs(step).max() <= NEAR * (1.0 + abs(state).max()):
            return State(float(state[0]), float(state[1]))
    return State(np.nan, np.nan)


@persistent_jit
def _around(scene, state):
    """((x, v), the matrix) a drive period later, walls not looked at."""
    return of_scene(scene, *state, jnp.zeros(()), 2.0 * jnp.pi / scene.frequency)


@persistent_jit(compiler_options=SOON, numpy_first=True)
def _responses(scene):
    """The `flow.responses` over a drive period."""
    return flow.responses(scene.frequency, scene.damping, jnp.asarray(2.0 * jnp.pi / scene.frequency))


def free_orbit(scene):
    """The free response as an `Orbit`, P100, where it keeps off the walls all the way round; else None."""
    state = free_response(scene)
    end, impacts, _ = period(scene, state)
    near = float(np.finfo(scene.dtype).eps) ** 0.5 * max(1.0, abs(state.x), abs(state.v))
    comes_back = max(abs(end.x - state.x), abs(end.v - state.v)) <= near  # not so from within a soft wall
    if impacts.status != Status.OK or impacts.count or end.contact or not comes_back:
        return None
    try:
        return by_state(scene, state, 1)
    except OrbitError:  # singular: without damping
        return None

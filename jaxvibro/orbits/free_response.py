"""Compute the periodic response to the drive without impacts, as a state and as an orbit.

The response is the solution of two linear equations, except under a user-defined force.
"""

import jax
import jax.numpy as jnp
import numpy as np

from continuation.hostcall import FAST_COMPILE, persistent_jit

from ..contact.kinds import flow_of_scene, fly_with_matrix
from ..flight import flow
from ..flight.flow_matrix import matrix_by_rows
from ..scene.codes import Status
from ..scene.state import State
from .orbit import OrbitError
from .shooting import orbit_from_state, strobe_period

MAX_NEWTON_STEPS = 20
STEP_TOLERANCE = 1e-12  # relative to 1 + the largest of x and v: size of the last step


def free_response(scene):
    """Return the `State` at phase 0 of the periodic motion without walls.

    `scene` is a single scene. Under a user-defined force, Newton's method starts from rest at 0. For the linear flow
    with several drive terms the first Newton step gives the motion. The result is nan at a resonance without damping,
    where no such motion exists, or if Newton's method does not converge.
    """
    if not flow_of_scene(scene).has_unique_free_response() or scene.drive:
        return _newton_solve_from_rest(scene)
    (p00, p01, p11), ((x, v), _) = _period_responses(scene)
    matrix = np.array([[1.0 - p00, -p01], [p01, 1.0 - p11]])
    drive_amplitude = float(scene.amplitude)
    try:
        state = np.linalg.solve(matrix, drive_amplitude * np.array([x, v]))
    except np.linalg.LinAlgError:
        state = np.full(2, np.nan)
    return State(float(state[0]), float(state[1]))


def _newton_solve_from_rest(scene):
    """Solve for the free response by Newton's method from rest at 0."""
    state = np.zeros(2)
    for _ in range(MAX_NEWTON_STEPS):
        (x, v), matrix = jax.device_get(_fly_free_period(scene, state))
        p00, p01, p10, p11 = matrix_by_rows(matrix)
        try:
            newton_step = np.linalg.solve(np.array([[1.0 - p00, -p01], [-p10, 1.0 - p11]]), state - np.array([x, v]))
        except np.linalg.LinAlgError:
            break
        state = state - newton_step
        if abs(newton_step).max() <= STEP_TOLERANCE * (1.0 + abs(state).max()):
            return State(float(state[0]), float(state[1]))
    return State(np.nan, np.nan)


@persistent_jit()
def _fly_free_period(scene, state):
    """Return ((x, v), flight matrix) after a flight of one drive period without walls."""
    return fly_with_matrix(scene, *state, jnp.zeros(()), 2.0 * jnp.pi / scene.frequency)


@persistent_jit(compiler_options=FAST_COMPILE, numpy_first=True)
def _period_responses(scene):
    """Return the `flow.flight_responses` over a drive period."""
    return flow.flight_responses(scene.frequency, scene.damping, jnp.asarray(2.0 * jnp.pi / scene.frequency))


def free_orbit(scene):
    """Return the free response as an orbit, P100, if it does not reach a wall.

    Parameters
    ----------
    scene : Scene
        A single scene.

    Returns
    -------
    Orbit or None
        The orbit; None if the free response does not exist or reaches a wall, or if the Jacobian is singular for lack
        of damping.
    """
    state = free_response(scene)
    end_state, impacts, _ = strobe_period(scene, state)
    tolerance = float(np.finfo(scene.dtype).eps) ** 0.5 * max(1.0, abs(state.x), abs(state.v))
    is_periodic = (
        max(abs(end_state.x - state.x), abs(end_state.v - state.v)) <= tolerance
    )  # false for a start within a soft wall
    if impacts.status != Status.OK or impacts.count or end_state.contact or not is_periodic:
        return None
    try:
        return orbit_from_state(scene, state, 1)
    except OrbitError:  # the Jacobian is singular: there is no damping
        return None

"""States a part of a drive period later: from the section at one phase to that at another."""

import jax
import jax.numpy as jnp
import numpy as np

from ..compiled.compiler_hints import choose
from ..flight import integrate
from ..flight.coefficients import compute_coefficients
from ..flight.entry import start_path
from ..scene.codes import Status
from ..scene.state import State
from .one_period import state_and_impacts


def shift_phase(scene, state, phase):
    """The state where the drive next comes to a phase, from 0 to less than 2 pi later: (State, status).

    scene: a single one; state: leaves of shape (lanes,), all at one phase; phase: rad. An impact at the end belongs to
    the way there, as with `strobe`; status: as in `Impacts`.
    """
    angle = np.mod(phase - float(state.phase[0]), 2.0 * np.pi)
    if angle == 0.0:
        return state, np.zeros(np.shape(state.x), np.int32)
    end, status = jax.device_get(_fly_angle(scene, state, angle))
    return State(end.x, end.v, np.full_like(end.x, phase), end.contact), status


@jax.jit
def _fly_angle(scene, state, angle):
    coeffs = compute_coefficients(scene)
    path, entry_status = start_path(coeffs, state)
    duration = choose(entry_status == Status.OK, angle / coeffs.frequency, 0.0)
    loop = integrate.initial_loop_state(coeffs, path._replace(time_remaining=duration), 0, duration)
    end, impacts = state_and_impacts(
        coeffs, integrate.run_loop(coeffs, loop, integrate.loop_limits(coeffs, 1)), state, entry_status
    )
    return end, jnp.asarray(impacts.status)

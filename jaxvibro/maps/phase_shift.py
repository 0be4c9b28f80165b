"""Advance states by part of a drive period, to another phase of the section."""

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
    """Advance states to the next time at which the drive has a given phase.

    Parameters
    ----------
    scene : Scene
        A single scene.
    state : State
        States with leaves of shape (lanes,), all at one phase.
    phase : float
        New phase of the drive, in rad. The angle to it is from 0 to less than 2 pi.

    Returns
    -------
    end : State
        States at the new phase. An impact at the end belongs to the flight to it, as for `strobe`.
    status : numpy.ndarray of int
        Status of each lane, as in `Impacts`.
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

"""Advance states by part of a drive period, to another phase of the stroboscopic section."""

import jax
import jax.numpy as jnp
import numpy as np

from ..contact.kinds import make_flow_coefficients
from ..flight.path_start import start_path
from ..scene.state import State
from .reference_strobe import fly_once


def shift_phase(scene, state, phase):
    """Advance states to the next time at which the drive has a given phase.

    Parameters
    ----------
    scene : Scene
        A single scene.
    state : State
        States with leaves of shape (lanes,), all at one phase.
    phase : float
        New phase of the drive, in rad. The phase increases by an angle from 0 to less than 2 pi.

    Returns
    -------
    end : State
        States at the new phase. An impact at the new phase has already happened, as for `strobe`.
    status : numpy.ndarray of int
        Status of each lane, as in `Impacts`.
    """
    drive_angle = np.mod(phase - float(state.phase[0]), 2.0 * np.pi)
    if drive_angle == 0.0:
        return state, np.zeros(np.shape(state.x), np.int32)
    end_state, status = jax.device_get(_fly_through_angle(scene, state, drive_angle))
    return State(end_state.x, end_state.v, np.full_like(end_state.x, phase), end_state.contact), status


@jax.jit
def _fly_through_angle(scene, state, drive_angle):
    coeffs = make_flow_coefficients(scene)
    path, start_status = start_path(coeffs, state)
    end_state, impacts = fly_once(coeffs, state, path, start_status, drive_angle / coeffs.frequency)
    return end_state, jnp.asarray(impacts.status)

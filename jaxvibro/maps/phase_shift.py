"""States a part of a drive period later: from the section at one phase to that at another."""

import jax
import jax.numpy as jnp
import numpy as np

from ..compiled.compiler_hints import choose
from ..flight import integrate
from ..flight.coefficients import frame
from ..flight.entry import enter
from ..scene.codes import Status
from ..scene.state import State
from .one_period import finish


def shift_phase(scene, state, phase):
    """The state where the drive next comes to a phase, from 0 to less than 2 pi later: (State, status).

    scene: a single one; state: leaves of shape (lanes,), all at one phase; phase: rad. An impact at the end belongs to
    the way there, as with `strobe`; status: as in `Impacts`.
    """
    angle = np.mod(phase - float(state.phase[0]), 2.0 * np.pi)
    if angle == 0.0:
        return state, np.zeros(np.shape(state.x), np.int32)
    end, status = jax.device_get(_carried(scene, state, angle))
    return State(end.x, end.v, np.full_like(end.x, phase), end.contact), status


@jax.jit
def _carried(scene, state, angle):
    built = frame(scene)
    path, fault = enter(built, state)
    span = choose(fault == Status.OK, angle / built.frequency, 0.0)
    told = integrate.begin(built, path._replace(to_go=span), 0, span)
    end, impacts = finish(built, integrate.run(built, told, integrate.cap(built, 1)), state, fault)
    return end, jnp.asarray(impacts.status)

"""An `Orbit` as a point of a branch: its impacts and releases in rows, brought to a value of the parameter."""

import jax.numpy as jnp
import numpy as np

from continuation.arclength import Control
from continuation.event_search import pinned

from ..flight.response import of_scene
from ..maps.rests import rests
from ..orbits.orbit import OrbitError
from ..orbits.releases import rows_of
from .equations import problem
from .orbit_on_branch import OrbitPoint
from .touches import scales


def point_of(orbit, value):
    """The `OrbitPoint` of an orbit, about, as one at a value of a parameter. Raises OrbitError where it never moves."""
    frequency = float(orbit.scene.frequency)
    times, speeds, sides = _rows(orbit)
    late = np.mod(times + orbit.state.phase / frequency, orbit.periods * 2.0 * np.pi / frequency)
    order = np.argsort(late)
    plain = late[order], speeds[order], sides[order].astype(float)
    begun = (0.0, 0.0) if len(times) else _at_phase_0(orbit)
    return OrbitPoint(value, *plain, orbit.periods, *begun, 0.0)


def _rows(orbit):
    """(times, speeds, sides) of an orbit's impacts since its section, and of its releases."""
    impacts = orbit.impacts
    if not orbit.rests:
        return impacts.time, impacts.speed, impacts.side
    state = orbit.state
    spans = rests(orbit.scene, state, orbit.periods).spans
    if not spans or not all(np.isfinite(end) for *_, end in spans):
        raise OrbitError("the wall never lets the mass go", orbit.residual, "give an orbit that moves")
    return rows_of(orbit.scene, state.phase, impacts.time, impacts.speed, impacts.side, spans, orbit.periods)


def _at_phase_0(orbit):
    """(x, v) of an orbit without impacts when the drive is at phase 0; of any under spring and damper, as it is the
    only one."""
    state, frequency = orbit.state, float(orbit.scene.frequency)
    if orbit.scene.force is None or state.phase == 0:
        return float(state.x), float(state.v)
    late = np.mod(-state.phase, 2.0 * np.pi) / frequency
    numbers = (jnp.asarray(each, orbit.scene.dtype) for each in (state.x, state.v, state.phase, late))
    x, v = of_scene(orbit.scene, *numbers)[0]
    return float(x), float(v)


def bring_to(along, z, value):
    """The `Point` near z at a value of the parameter, to rounding: `met` says whether there is one."""
    numbers = (np.float64(each) for each in (0.0, 1.0, 1.0, -np.inf, np.inf))
    return pinned(problem(along), z, -1, value, Control(scales(along, 1.0), *numbers), along)

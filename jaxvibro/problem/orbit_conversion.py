"""Convert an `Orbit` to a point of a branch, and correct it to a parameter value."""

import jax.numpy as jnp
import numpy as np

from continuation.arclength import StepControl
from continuation.event_search import solve_with_fixed_entry

from ..flight.flow_matrix import fly_with_matrix
from ..maps.sticking_phases import find_sticking_phases
from ..orbits.chatter_and_release import sticking_orbit_rows
from ..orbits.orbit import OrbitError
from .equations import continuation_problem
from .grazing_contact import arclength_weights
from .orbit_point import OrbitPoint


def orbit_row_of(orbit, value):
    """Convert an orbit to plain numbers at a value of a parameter.

    Parameters
    ----------
    orbit : Orbit
        Orbit.
    value : float
        Value of the parameter.

    Returns
    -------
    OrbitPoint
        The orbit, not corrected.

    Raises
    ------
    OrbitError
        If the mass never leaves its wall.
    """
    frequency = float(orbit.scene.frequency)
    times, speeds, sides = _impact_columns(orbit)
    section_times = np.mod(times + orbit.state.phase / frequency, orbit.periods * 2.0 * np.pi / frequency)
    order = np.argsort(section_times)
    sorted_columns = section_times[order], speeds[order], sides[order].astype(float)
    state = (0.0, 0.0) if len(times) else _at_phase_0(orbit)
    return OrbitPoint(value, *sorted_columns, orbit.periods, *state, 0.0)


def _impact_columns(orbit):
    """Return times, speeds and sides of an orbit's impacts and releases since its section."""
    impacts = orbit.impacts
    if not orbit.rests:
        return impacts.time, impacts.speed, impacts.side
    state = orbit.state
    sticking_intervals = find_sticking_phases(orbit.scene, state, orbit.periods).intervals
    if not sticking_intervals or not all(np.isfinite(end) for *_, end in sticking_intervals):
        raise OrbitError("the mass never leaves the wall", orbit.residual, "use an orbit that moves")
    return sticking_orbit_rows(
        orbit.scene, state.phase, impacts.time, impacts.speed, impacts.side, sticking_intervals, orbit.periods
    )


def _at_phase_0(orbit):
    """Return (x, v) at phase 0 of an orbit without impacts.

    Under spring and damper the state at any phase serves, because that orbit is unique.
    """
    state, frequency = orbit.state, float(orbit.scene.frequency)
    if orbit.scene.force is None or state.phase == 0:
        return float(state.x), float(state.v)
    time_to_phase_0 = np.mod(-state.phase, 2.0 * np.pi) / frequency
    arguments = (jnp.asarray(value, orbit.scene.dtype) for value in (state.x, state.v, state.phase, time_to_phase_0))
    x, v = fly_with_matrix(orbit.scene, *arguments)[0]
    return float(x), float(v)


def correct_to_value(problem, z, value):
    """Correct an orbit to a value of the parameter by Newton's method, to rounding.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Guess.
    value : float
        Value of the parameter.

    Returns
    -------
    Point
        Solution; ``converged`` states whether there is one.
    """
    control_values = (np.float64(number) for number in (0.0, 1.0, 1.0, -np.inf, np.inf))
    return solve_with_fixed_entry(
        continuation_problem(problem),
        z,
        -1,
        value,
        StepControl(arclength_weights(problem, 1.0), *control_values),
        problem,
    )

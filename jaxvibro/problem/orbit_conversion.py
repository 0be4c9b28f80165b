"""Convert an `Orbit` to an `OrbitPoint`, and correct an orbit to a parameter value."""

import jax.numpy as jnp
import numpy as np

from continuation.arclength import StepControl
from continuation.event_search import solve_with_fixed_entry

from ..flight.flow_matrix import fly_with_matrix
from ..maps.sticking_phase_intervals import find_sticking_phases
from ..orbits.chatter_and_release import sticking_orbit_rows
from ..orbits.orbit import OrbitError
from .grazing_contact import arclength_weights
from .orbit_equations import continuation_problem
from .orbit_point import OrbitPoint


def orbit_point_of(orbit, parameter_value):
    """Convert an `Orbit` to an `OrbitPoint` at a parameter value.

    Parameters
    ----------
    orbit : Orbit
        Orbit.
    parameter_value : float
        Value of the parameter.

    Returns
    -------
    OrbitPoint
        The orbit, without a correction by Newton's method.

    Raises
    ------
    OrbitError
        If the mass never leaves its wall.
    """
    frequency = float(orbit.scene.frequency)
    times, speeds, sides = _impact_columns(orbit)
    times_since_phase_0 = np.mod(times + orbit.state.phase / frequency, orbit.periods * 2.0 * np.pi / frequency)
    time_order = np.argsort(times_since_phase_0)
    sorted_impacts = times_since_phase_0[time_order], speeds[time_order], sides[time_order].astype(float)
    state_at_phase_0 = (0.0, 0.0) if len(times) else _state_at_phase_0(orbit)
    return OrbitPoint(parameter_value, *sorted_impacts, orbit.periods, *state_at_phase_0, 0.0)


def _impact_columns(orbit):
    """Return times, speeds and sides of an orbit's impacts and releases since its section."""
    impacts = orbit.impacts
    if not orbit.rests:
        return impacts.time, impacts.speed, impacts.side
    state = orbit.state
    sticking_intervals = find_sticking_phases(orbit.scene, state, orbit.periods).intervals
    if not sticking_intervals or not all(np.isfinite(release_time) for *_, release_time in sticking_intervals):
        raise OrbitError("the mass never leaves the wall", orbit.residual, "use an orbit that moves")
    return sticking_orbit_rows(
        orbit.scene, state.phase, impacts.time, impacts.speed, impacts.side, sticking_intervals, orbit.periods
    )


def _state_at_phase_0(orbit):
    """Return (x, v) at phase 0 of an orbit without impacts.

    With a spring and a damper the state at the phase of `orbit` is returned without a flight to phase 0, because
    `solve_impact_free_orbit` computes the unique orbit without a guess.
    """
    state, frequency = orbit.state, float(orbit.scene.frequency)
    if orbit.scene.force is None or state.phase == 0:
        return float(state.x), float(state.v)
    time_to_phase_0 = np.mod(-state.phase, 2.0 * np.pi) / frequency
    flight_arguments = (
        jnp.asarray(value, orbit.scene.dtype) for value in (state.x, state.v, state.phase, time_to_phase_0)
    )
    x, v = fly_with_matrix(orbit.scene, *flight_arguments)[0]
    return float(x), float(v)


def correct_to_parameter(problem, z, parameter_value):
    """Correct an orbit to a value of the parameter by Newton's method, up to rounding.

    Parameters
    ----------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Guess.
    parameter_value : float
        Value of the parameter.

    Returns
    -------
    Point
        Solution; valid if ``converged`` is true.
    """
    step_control_values = (np.float64(step_control_value) for step_control_value in (0.0, 1.0, 1.0, -np.inf, np.inf))
    return solve_with_fixed_entry(
        continuation_problem(problem),
        z,
        -1,
        parameter_value,
        StepControl(arclength_weights(problem, 1.0), *step_control_values),
        problem,
    )

"""Convert an `Orbit`, as users receive it, to an `OrbitProblem` with unknowns, and an `OrbitPoint` to an `Orbit`."""

import jax.numpy as jnp
import numpy as np

from ..contact.kinds import flow_of_scene, fly_with_matrix
from ..flight.wall_positions import wall_states
from ..maps import itinerary as words
from ..maps.sticking_phase_intervals import find_sticking_phases
from ..orbits.chatter_and_release import sticking_orbit_rows
from ..orbits.orbit import OrbitError, eigenvalue_pair, make_orbit, rotate_to_canonical_start
from ..orbits.orbit_from_impacts import orbit_of_exact_impacts
from ..scene.codes import Contact, Status
from ..scene.state import Impacts, State
from .orbit_diagnostics import diagnose
from .orbit_equations import are_releases
from .orbit_point import impact_times_and_sides, sticking_record_of
from .orbit_problem import make_orbit_problem


def problem_of_orbit(orbit, name):
    """Set up the problem of an orbit with one free parameter.

    Parameters
    ----------
    orbit : Orbit
        Orbit.
    name : str
        Free parameter.

    Returns
    -------
    problem : OrbitProblem
        Problem of the orbit.
    z : ndarray
        Unknowns, without a correction by Newton's method.

    Raises
    ------
    OrbitError
        If the mass never leaves its wall.
    """
    impacts, state = impacts_since_phase_0(orbit)
    problem = make_orbit_problem(orbit.scene, name, periods=orbit.periods)
    return problem.with_impacts(np.array([*state, float(orbit.scene.parameter(name))]), impacts)


def impacts_since_phase_0(orbit):
    """List the impacts of an orbit since phase 0.

    Parameters
    ----------
    orbit : Orbit
        Orbit.

    Returns
    -------
    impacts : list of tuple
        Time, speed and side of each impact and release, as `OrbitProblem.with_impacts` takes them.
    state : tuple of float
        (x, v) at phase 0 if there are no impacts, else zeros.

    Raises
    ------
    OrbitError
        If the mass never leaves its wall.
    """
    frequency = float(orbit.scene.frequency)
    times, speeds, sides = _impact_columns(orbit)
    times_since_phase_0 = np.mod(times + orbit.state.phase / frequency, orbit.periods * 2.0 * np.pi / frequency)
    time_order = np.argsort(times_since_phase_0)
    sorted_columns = times_since_phase_0[time_order], speeds[time_order], sides[time_order].astype(float)
    return list(zip(*sorted_columns, strict=True)), (0.0, 0.0) if len(times) else _state_at_phase_0(orbit)


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
    `OrbitProblem.with_impacts` computes the unique orbit without a guess.
    """
    state, frequency = orbit.state, float(orbit.scene.frequency)
    if flow_of_scene(orbit.scene).has_unique_free_response() or state.phase == 0:
        return float(state.x), float(state.v)
    time_to_phase_0 = np.mod(-state.phase, 2.0 * np.pi) / frequency
    flight_arguments = (
        jnp.asarray(value, orbit.scene.dtype) for value in (state.x, state.v, state.phase, time_to_phase_0)
    )
    x, v = fly_with_matrix(orbit.scene, *flight_arguments)[0]
    return float(x), float(v)


def orbit_from_point(scene, orbit_point):
    """Make an `Orbit` from an `OrbitPoint`.

    Parameters
    ----------
    scene : Scene
        Scene of the orbit.
    orbit_point : OrbitPoint
        Orbit.

    Returns
    -------
    Orbit
        The orbit.
    """
    if are_releases(orbit_point.sides).any():
        return _sticking_orbit(scene, orbit_point)
    if len(orbit_point.times):
        return orbit_of_exact_impacts(
            scene, orbit_point.times, orbit_point.speeds, orbit_point.sides, orbit_point.periods, orbit_point.residual
        )
    empty_array, diagnostics = np.zeros(0), diagnose(orbit_point.problem, orbit_point.z[None])
    clearance = float(diagnostics.clearance.min(initial=np.inf))
    impacts = Impacts(empty_array, empty_array.astype(np.int8), empty_array, 0, np.inf, clearance, Status.OK)
    floquet_multipliers = eigenvalue_pair(float(diagnostics.trace[0]), float(diagnostics.determinant[0]))
    itinerary_words = ("",) * orbit_point.periods
    return make_orbit(
        scene,
        State(orbit_point.x, orbit_point.v),
        impacts,
        itinerary_words,
        floquet_multipliers,
        orbit_point.residual,
        "state",
    )


def _sticking_orbit(scene, orbit_point):
    """Make an `Orbit` that sticks from an `OrbitPoint`, without the bounces just before sticking."""
    diagnostics = diagnose(orbit_point.problem, orbit_point.z[None])
    drive_period = 2.0 * np.pi / float(scene.frequency)
    times, speeds, sides = orbit_point.problem.impacts(orbit_point.z)
    is_impact, section_points = abs(sides) == 1, np.stack([diagnostics.x[0], diagnostics.v[0]], 1)
    impact_times, wall_sides = impact_times_and_sides(orbit_point)
    impact_times = np.mod(impact_times, orbit_point.periods * drive_period)
    time_order = np.argsort(impact_times, kind="stable")
    itinerary_words = words.itinerary_of_impacts(
        impact_times[time_order], wall_sides[time_order], orbit_point.periods, drive_period
    )
    impact_columns = times[is_impact], speeds[is_impact], sides[is_impact]
    min_clearance = float(diagnostics.clearance.min(initial=np.inf))
    itinerary_words, (x, v), impacts = rotate_to_canonical_start(
        itinerary_words, section_points, *impact_columns, min_clearance, drive_period
    )
    wall_states_at_phase_0 = zip((-1.0, 1.0), wall_states(scene, 0.0), strict=True)
    sticking_sides = [
        wall_sign
        for wall_sign, (position, velocity) in wall_states_at_phase_0
        if (x, v) == (float(position), float(velocity))
    ]
    state = State(x, v, 0.0, sticking_sides[0] * Contact.STUCK if sticking_sides else 0.0)
    orbit_fields = itinerary_words, np.zeros(2, complex), orbit_point.residual, "state"
    return make_orbit(scene, state, impacts, *orbit_fields, sticking_record_of(scene, orbit_point))

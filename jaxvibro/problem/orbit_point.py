"""Represent a periodic orbit as a solution of an `OrbitProblem`; convert it, and compare it with others."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..contact.kinds import flow_of_scene, fly_with_matrix
from ..flight.wall_positions import wall_states
from ..maps import itinerary as words
from ..maps.sticking_phase_intervals import NO_STICKING, find_sticking_phases
from ..orbits.chatter_and_release import sticking_orbit_rows
from ..orbits.orbit import (
    OrbitError,
    eigenvalue_pair,
    impacts_as_points,
    is_same_orbit,
    make_orbit,
    mirror_points,
    repetition_count,
    rotate_to_canonical_start,
)
from ..orbits.orbit_from_impacts import orbit_of_exact_impacts
from ..scene.scene import SIDES
from ..scene.state import Contact, Impacts, State, Status
from .orbit_equations import are_releases, diagnose
from .orbit_problem import OrbitProblem, make_orbit_problem

REPEAT_TOLERANCE = 1e-6  # largest difference of identical times and speeds


def equivalent_unknowns(problem, given_problem, given_z, near_z):
    """Yield unknowns near a point that describe a given orbit, for each possible first impact.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbits.
    given_problem : OrbitProblem
        Problem of the given orbit.
    given_z : ndarray
        Unknowns of the given orbit.
    near_z : ndarray
        Unknowns of the point.

    Yields
    ------
    ndarray
        Unknowns of the given orbit.
    """
    n_rows, n_impacts, sequence = problem.n_rows, problem.n_used_rows, given_problem.sequence
    if len(sequence.sides) != n_rows or sequence.periods != problem.sequence.periods or not n_rows:
        return
    if given_problem.n_used_rows != n_impacts:
        return
    sides, problem_sides = np.asarray(sequence.sides[:n_impacts]), np.asarray(problem.sequence.sides)
    orbit_duration = given_problem.duration(given_z)
    drive_period = 2.0 * np.pi / given_problem.parameter_value(given_z, "frequency")
    times, speeds, _ = given_problem.impacts(given_z)
    for first_impact_index in range(n_impacts):
        if not np.array_equal(np.roll(sides, -first_impact_index), problem_sides[:n_impacts]):
            continue
        shifted_times = np.concatenate([times[first_impact_index:], times[:first_impact_index] + orbit_duration])
        shifted_times = shifted_times - drive_period * np.round((shifted_times[0] - near_z[0]) / drive_period)
        for period_shift in (-drive_period, 0.0, drive_period):
            z = np.zeros(2 * n_rows + 1)
            z[:n_impacts], z[n_rows : n_rows + n_impacts], z[-1] = (
                shifted_times + period_shift,
                np.roll(speeds, -first_impact_index),
                given_z[-1],
            )
            yield z


def is_repeated(problem, z):
    """Test whether an orbit consists of several traversals of a shorter orbit.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    bool
        True if the orbit is repeated. Impacts with zero speed are ignored.
    """
    return repetition_count(comparison_points(problem, z), int(problem.sequence.periods), REPEAT_TOLERANCE) > 1


def match_repeated_contacts(problem, z, contact_times, contact_sides):
    """Match the grazing contacts of a repeated orbit after each traversal of the shorter orbit.

    Returns the index of the contact that corresponds to each contact after 0, 1, ... traversals, an array of shape
    (traversals, contacts). Impacts with zero speed are ignored in the search for a shorter orbit.
    """
    n_periods = int(problem.sequence.periods)
    n_traversals = repetition_count(comparison_points(problem, z), n_periods, REPEAT_TOLERANCE)
    orbit_duration = problem.duration(z)
    time_differences = (
        contact_times - contact_times[:, None] - orbit_duration / n_traversals * np.arange(n_traversals)[:, None, None]
    )
    mismatches = abs(
        time_differences - orbit_duration * np.round(time_differences / orbit_duration)
    ) + orbit_duration * (contact_sides != contact_sides[:, None])
    return mismatches.argmin(axis=2)


def comparison_points(problem, z, speed_scale=None):
    """Return the impacts of an orbit in order as points for `orbit`.

    Parameters
    ----------
    problem : OrbitProblem
        Equations of the orbit.
    z : ndarray
        Unknowns.
    speed_scale : float, optional
        Unit of the speeds. None means the largest speed.

    Returns
    -------
    ndarray
        Points.
    """
    times, speeds, _ = problem.impacts(z)
    sides = np.asarray(problem.sequence.sides[: len(times)])
    speed_scale = speed_scale or speeds.max(initial=0.0) or 1.0
    return impacts_as_points(problem.parameter_value(z, "frequency"), times, sides, speeds, speed_scale)


IMPACT_TOLERANCE = 1e-6  # relative to the largest speed; closer impacts are identical


class OrbitPoint(NamedTuple):
    """Periodic orbit as a point of a branch or a locus.

    Attributes
    ----------
    problem : OrbitProblem
        Problem of the orbit. The scene has the values of the parameters at this orbit.
    z : ndarray
        Unknowns.
    x, v : float
        State at phase 0.
    residual : float
        Largest residual of the equations.
    tangent : ndarray or None
        Unit tangent of the branch. The components of x and v are 0 where the branch has been read from a file.
    """

    problem: OrbitProblem
    z: Float[np.ndarray, " unknowns"]
    x: float
    v: float
    residual: float
    tangent: Float[np.ndarray, " unknowns"] | None = None

    @property
    def value(self) -> float:
        """Value of the parameter of the branch; on a locus, of the first parameter."""
        return float(self.z[self.problem.n_orbit_unknowns])

    @property
    def times(self) -> Float[np.ndarray, " impacts"]:
        """Times of the impacts and releases since phase 0."""
        return np.asarray(self.problem.impacts(self.z)[0])

    @property
    def speeds(self) -> Float[np.ndarray, " impacts"]:
        """Speeds of the impacts; 0 for releases."""
        return np.asarray(self.problem.impacts(self.z)[1])

    @property
    def sides(self) -> Float[np.ndarray, " impacts"]:
        """Sides of the impacts. Releases have side +-2, or +-3 if the mass lifts before the sticking phase."""
        return self.problem.impacts(self.z)[2]

    @property
    def periods(self) -> int:
        """Number of drive periods."""
        return int(self.problem.sequence.periods)

    @property
    def frequency(self) -> float:
        """Drive frequency."""
        return self.problem.parameter_value(self.z, "frequency")

    @property
    def itinerary(self) -> tuple[str, ...]:
        """Walls hit, one word for each drive period, without the infinitely many bounces before sticking."""
        times, sides = impact_times_and_sides(self)
        return words.itinerary_of_orbit(times, sides, self.periods, 2.0 * np.pi / self.frequency)

    def mirror(self) -> "OrbitPoint":
        """Return the mirror image, whose state at phase 0 is unknown; an orbit without impacts is returned as it is."""
        if not self.problem.n_rows:
            return self
        times, speeds, sides = self.problem.impacts(self.z)
        mirrored_impacts = list(zip(times + np.pi / self.frequency, speeds, -sides, strict=True))
        problem, z = self.problem.with_impacts(self.z, mirrored_impacts)
        return OrbitPoint(problem, z, np.nan, np.nan, self.residual)

    def with_section_state(self) -> "OrbitPoint":
        """Return the orbit with its state at phase 0."""
        diagnostics = diagnose(self.problem, self.z[None])
        return self._replace(x=float(diagnostics.x[0, 0]), v=float(diagnostics.v[0, 0]))


def make_orbit_point(problem, value, impacts, periods, state=(np.nan, np.nan), residual=0.0, tangent=None):
    """Make an `OrbitPoint` of numbers, without a correction by Newton's method.

    Parameters
    ----------
    problem : OrbitProblem
        Problem of an orbit without impacts of the same branch, as `make_orbit_problem` returns it.
    value : float
        Value of the parameter.
    impacts : sequence of tuple
        Time, speed and side of each impact and release, as `OrbitProblem.with_impacts` takes them.
    periods : int
        Number of drive periods.
    state : tuple of float, optional
        State at phase 0.
    residual : float, optional
        Largest residual of the equations.
    tangent : ndarray, optional
        Tangent of the branch: entries of the times, of the speeds and of the parameter, without empty rows.

    Returns
    -------
    OrbitPoint
        The orbit.
    """
    z = np.array([*state, value])
    if impacts:
        problem, z = problem.with_impacts(z, impacts, periods=float(periods))
    else:
        problem = problem._replace(sequence=problem.sequence._replace(periods=np.asarray(float(periods))))
    padded_tangent = None
    if tangent is not None:
        padded_tangent, n_impacts = np.zeros(len(z)), len(impacts)
        padded_tangent[:n_impacts], padded_tangent[-1] = tangent[:n_impacts], tangent[-1]
        padded_tangent[problem.n_rows : problem.n_rows + n_impacts] = tangent[n_impacts:-1]
    return point_of_solution(problem, z, state, residual, padded_tangent)


def point_of_solution(problem, z, state, residual, tangent=None):
    """Make the `OrbitPoint` of a solution, with the values of its parameters in the scene.

    Parameters
    ----------
    problem : OrbitProblem
        Problem of the orbit.
    z : ndarray
        Unknowns.
    state : tuple of float
        State at phase 0.
    residual : float
        Largest residual.
    tangent : ndarray, optional
        Tangent of the curve.

    Returns
    -------
    OrbitPoint
        The orbit.
    """
    return OrbitPoint(problem.with_scene_at(z), z, *map(float, state), float(residual), tangent)


def impact_times_and_sides(orbit_point):
    """Return (times, sides) of the impacts; a mass that lifts off before it sticks has an additional impact at once."""
    times, _, sides = orbit_point.problem.impacts(orbit_point.z)
    is_impact = ~are_releases(sides)
    lifts_before_sticking = np.roll(abs(sides) > Contact.STUCK, -1)
    time_order = np.argsort(np.concatenate([times[is_impact], times[lifts_before_sticking]]), kind="stable")
    return tuple(
        np.concatenate([impact_column[is_impact], impact_column[lifts_before_sticking]])[time_order]
        for impact_column in (times, sides)
    )


def sticking_record_of(scene, orbit_point):
    """Return the `StickingPhaseIntervals` of an orbit, without the growth rate and the intervals."""
    release_codes = orbit_point.sides[are_releases(orbit_point.sides)]
    chatter_walls = {
        words.LETTERS[int(np.sign(side))] for side in release_codes if float(scene.bounce(SIDES[int(side > 0)])) > 0
    }
    return NO_STICKING._replace(
        has_sticking=bool(len(release_codes)), count=len(release_codes), chatter_walls="".join(sorted(chatter_walls))
    )


def label_of_point(scene, orbit_point, itinerary_words):
    """Return the label of an orbit.

    Parameters
    ----------
    scene : Scene
        Scene of the orbit.
    orbit_point : OrbitPoint
        Orbit.
    itinerary_words : tuple of str
        Itinerary of the orbit.

    Returns
    -------
    str
        Label P n p q, with inf for a wall on which the mass sticks after complete chatter.
    """
    return words.format_label(itinerary_words, sticking_record_of(scene, orbit_point).chatter_walls)


def is_own_mirror_image(problem, z):
    """Test whether an orbit of a symmetric scene is its own mirror image.

    Parameters
    ----------
    problem : OrbitProblem
        Problem of the orbit.
    z : ndarray
        Unknowns.

    Returns
    -------
    bool
        True if the orbit equals its mirror image.
    """
    if not problem.n_rows and not flow_of_scene(problem.scene).has_unique_free_response():
        return _is_antiperiodic(problem, z)
    impact_points_array = comparison_points(problem, z)
    return is_same_orbit(impact_points_array, mirror_points(impact_points_array), IMPACT_TOLERANCE)


def _is_antiperiodic(problem, z):
    """Test whether an orbit without impacts has the state (-x, -v) after half of its periods.

    An orbit with an even number of periods is never its own mirror image.
    """
    if int(problem.sequence.periods) % 2 == 0:
        return False
    half_sequence, initial_state = problem.sequence._replace(periods=0.5 * problem.sequence.periods), z[:2]
    residual, _ = problem._replace(sequence=half_sequence).evaluate(z)
    return bool(abs(residual + 2.0 * initial_state).max() <= IMPACT_TOLERANCE * (1.0 + abs(initial_state).max()))


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

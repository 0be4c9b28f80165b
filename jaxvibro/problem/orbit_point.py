"""Orbits as plain numbers, and conversions that need no Newton iteration and so apply at singular points as well."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from continuation import augmented_systems

from ..flight.wall_positions import wall_states
from ..maps import itinerary as words
from ..maps.sticking_phase_intervals import NO_STICKING
from ..orbits.impact_equations import ImpactSequence
from ..orbits.orbit import eigenvalue_pair, make_orbit
from ..orbits.orbit_comparison import impacts_as_points, is_same_orbit, mirror_points
from ..orbits.orbit_from_impacts import orbit_of_exact_impacts
from ..scene.codes import Contact, Status
from ..scene.scene import SIDES
from ..scene.scene_parameters import mark_parameters
from ..scene.state import Impacts, State
from .branches_from_grazing import make_padded_sequence, solve_impact_free_orbit
from .orbit_diagnostics import diagnose
from .orbit_equations import OrbitEquations, are_releases, continuation_problem

IMPACT_TOLERANCE = 1e-6  # relative to the largest speed; closer impacts are identical


class OrbitPoint(NamedTuple):
    """Orbit as plain numbers.

    Attributes
    ----------
    value : float
        Value of the branch's parameter.
    times, speeds, sides : ndarray
        Times since phase 0, speeds and sides of the impacts, arrays of shape (impacts,). Releases at the end of a
        sticking phase have side +-2, or +-3 if the mass lifts before that phase.
    periods : int
        Number of drive periods.
    x, v : float
        State at phase 0.
    residual : float
        Largest residual of the equations of the orbit.
    """

    value: float
    times: Float[np.ndarray, " impacts"]
    speeds: Float[np.ndarray, " impacts"]
    sides: Float[np.ndarray, " impacts"]
    periods: int
    x: float
    v: float
    residual: float


def itinerary_of_point(orbit_point, frequency):
    """Return the itinerary of an orbit, without the infinitely many bounces before sticking.

    Parameters
    ----------
    orbit_point : OrbitPoint
        Orbit.
    frequency : float
        Drive frequency.

    Returns
    -------
    tuple of str
        Walls hit, one word for each drive period.
    """
    times, sides = impact_times_and_sides(orbit_point)
    return words.itinerary_of_orbit(times, sides, orbit_point.periods, 2.0 * np.pi / frequency)


def impact_times_and_sides(orbit_point):
    """Return (times, sides) of the impacts; a mass that lifts off before it sticks has an additional impact at once."""
    is_impact = ~are_releases(orbit_point.sides)
    lifts_before_sticking = np.roll(abs(orbit_point.sides) > Contact.STUCK, -1)
    time_order = np.argsort(
        np.concatenate([orbit_point.times[is_impact], orbit_point.times[lifts_before_sticking]]), kind="stable"
    )
    return tuple(
        np.concatenate([impact_column[is_impact], impact_column[lifts_before_sticking]])[time_order]
        for impact_column in (orbit_point.times, orbit_point.sides)
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


def comparison_points(orbit_point, frequency, speed_scale=None):
    """Return the impacts of an orbit in order as points for `orbit_comparison`.

    Parameters
    ----------
    orbit_point : OrbitPoint
        Orbit.
    frequency : float
        Drive frequency.
    speed_scale : float, optional
        Unit of the speeds. None means the largest speed.

    Returns
    -------
    ndarray
        Points.
    """
    return impacts_as_points(
        frequency,
        orbit_point.times,
        orbit_point.sides,
        orbit_point.speeds,
        speed_scale or orbit_point.speeds.max(initial=0.0) or 1.0,
    )


def is_own_mirror_image(scene, orbit_point):
    """Test whether an orbit of a symmetric scene is its own mirror image.

    Parameters
    ----------
    scene : Scene
        Symmetric scene at the orbit.
    orbit_point : OrbitPoint
        Orbit.

    Returns
    -------
    bool
        True if the orbit equals its mirror image.
    """
    if not len(orbit_point.times) and scene.force is not None:
        return _is_antiperiodic(scene, orbit_point)
    impact_points_array = comparison_points(orbit_point, float(scene.frequency))
    return is_same_orbit(impact_points_array, mirror_points(impact_points_array), IMPACT_TOLERANCE)


def _is_antiperiodic(scene, orbit_point):
    """Test whether an orbit without impacts has the state (-x, -v) after half of its periods.

    An orbit with an even number of periods is never its own mirror image.
    """
    if orbit_point.periods % 2 == 0:
        return False
    empty_array, amplitude = np.zeros(0), float(scene.amplitude)
    sequence = ImpactSequence(empty_array, empty_array, empty_array, *_scalar_arrays(0.0, 0.5 * orbit_point.periods))
    half_duration_problem, initial_state = (
        OrbitEquations(*mark_parameters(scene, "amplitude"), sequence),
        np.array([orbit_point.x, orbit_point.v]),
    )
    residual, _ = augmented_systems.evaluate_problem(
        continuation_problem(half_duration_problem), np.append(initial_state, amplitude), half_duration_problem
    )
    return bool(
        abs(np.asarray(residual) + 2.0 * initial_state).max() <= IMPACT_TOLERANCE * (1.0 + abs(initial_state).max())
    )


def orbit_from_point(scene, orbit_point):
    """Make an `Orbit` from an `OrbitPoint`.

    Parameters
    ----------
    scene : Scene
        Scene of the orbit.
    orbit_point : OrbitPoint
        Orbit as plain numbers.

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
    empty_array = np.zeros(0)
    problem = OrbitEquations(
        scene,
        jax.tree.map(lambda leaf: np.int32(0), scene),
        ImpactSequence(*[empty_array] * 3, *_scalar_arrays(0.0, orbit_point.periods)),
    )
    diagnostics = diagnose(problem, np.array([[orbit_point.x, orbit_point.v, orbit_point.value]]))
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
    problem, z = set_up_equations(scene, "amplitude", orbit_point._replace(value=float(scene.amplitude)))
    diagnostics, drive_period = diagnose(problem, z[None]), 2.0 * np.pi / float(scene.frequency)
    is_impact, orbit_duration, section_points = (
        abs(orbit_point.sides) == 1,
        orbit_point.periods * drive_period,
        np.stack([diagnostics.x[0], diagnostics.v[0]], 1),
    )
    impact_times, wall_sides = impact_times_and_sides(orbit_point)
    impact_times = np.mod(impact_times, orbit_duration)
    time_order = np.argsort(impact_times, kind="stable")
    itinerary_words = words.itinerary_of_impacts(
        impact_times[time_order], wall_sides[time_order], orbit_point.periods, drive_period
    )
    first_period_index = words.canonical_start_period(itinerary_words, section_points)
    times_from_start = np.mod(orbit_point.times[is_impact] - first_period_index * drive_period, orbit_duration)
    time_order = np.argsort(times_from_start)
    impact_columns = (
        times_from_start[time_order],
        orbit_point.sides[is_impact][time_order].astype(np.int8),
        orbit_point.speeds[is_impact][time_order],
    )
    clearance = float(diagnostics.clearance.min(initial=np.inf))
    impacts = Impacts(*impact_columns, len(times_from_start), float(impact_columns[2].min()), clearance, Status.OK)
    x, v = section_points[first_period_index].tolist()
    wall_states_at_phase_0 = zip((-1.0, 1.0), wall_states(scene, 0.0), strict=True)
    sticking_sides = [
        wall_sign
        for wall_sign, (position, velocity) in wall_states_at_phase_0
        if (x, v) == (float(position), float(velocity))
    ]
    state = State(x, v, 0.0, sticking_sides[0] * Contact.STUCK if sticking_sides else 0.0)
    orbit_fields = (
        words.rotate_periods(itinerary_words, first_period_index),
        np.zeros(2, complex),
        orbit_point.residual,
        "state",
    )
    return make_orbit(scene, state, impacts, *orbit_fields, sticking_record_of(scene, orbit_point))


def _scalar_arrays(*values):
    return (np.asarray(value, float) for value in values)


def set_up_equations(scene, parameter_name, orbit_point):
    """Set up the equations and the unknowns z of an orbit.

    Parameters
    ----------
    scene : Scene
        Scene.
    parameter_name : str
        Free parameter.
    orbit_point : OrbitPoint
        Orbit as plain numbers.

    Returns
    -------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns.
    """
    empty_array = np.zeros(0)
    sequence = ImpactSequence(
        empty_array, empty_array, empty_array, np.asarray(0.0), np.asarray(float(orbit_point.periods))
    )
    problem = OrbitEquations(*mark_parameters(scene, parameter_name), sequence)
    if not len(orbit_point.times):
        return problem, solve_impact_free_orbit(problem, orbit_point.value, (orbit_point.x, orbit_point.v))
    problem = problem._replace(
        sequence=make_padded_sequence(
            problem, list(zip(orbit_point.times, orbit_point.speeds, orbit_point.sides, strict=True))
        )
    )
    return problem, np.concatenate([problem.sequence.times, problem.sequence.speeds, [orbit_point.value]])

"""Describe orbits that are known to exist, without Newton's method, so that singular points are included."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from continuation import augmented_systems

from ..flight.wall_positions import wall_states
from ..maps import itinerary as words
from ..maps.sticking_phases import NO_STICKING
from ..orbits.impact_equations import ImpactSequence
from ..orbits.orbit import eigenvalue_pair, make_orbit
from ..orbits.orbit_comparison import impacts_as_points, is_same_orbit, mirror_points
from ..orbits.orbit_from_impacts import orbit_of_exact_impacts
from ..scene.codes import Contact, Status
from ..scene.parameters import mark_parameters
from ..scene.scene import SIDES
from ..scene.state import Impacts, State
from .diagnostics import diagnose
from .equations import OrbitEquations, are_releases, continuation_problem
from .grazing import padded_sequence, solve_free_orbit

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
        Largest residual of its equations.
    """

    value: float
    times: Float[np.ndarray, " impacts"]
    speeds: Float[np.ndarray, " impacts"]
    sides: Float[np.ndarray, " impacts"]
    periods: int
    x: float
    v: float
    residual: float


def itinerary(orbit_row, frequency):
    """Return the itinerary of an orbit, without the infinitely many bounces before sticking.

    Parameters
    ----------
    orbit_row : OrbitPoint
        Orbit.
    frequency : float
        Drive frequency.

    Returns
    -------
    tuple of str
        Walls hit, one word for each drive period.
    """
    times, sides = impact_times_and_sides(orbit_row)
    return words.itinerary_of_orbit(times, sides, orbit_row.periods, 2.0 * np.pi / frequency)


def impact_times_and_sides(orbit_row):
    """Return times and sides of an orbit's impacts; a mass that lifts before sticking returns at once."""
    is_impact = ~are_releases(orbit_row.sides)
    returns_at_once = np.roll(abs(orbit_row.sides) > Contact.STUCK, -1)
    order = np.argsort(np.concatenate([orbit_row.times[is_impact], orbit_row.times[returns_at_once]]), kind="stable")
    return tuple(
        np.concatenate([column[is_impact], column[returns_at_once]])[order]
        for column in (orbit_row.times, orbit_row.sides)
    )


def sticking_phases_of(scene, orbit_row):
    """Return the `StickingPhases` of an orbit, without growth rate and intervals."""
    release_codes = orbit_row.sides[are_releases(orbit_row.sides)]
    chatter_walls = {
        words.LETTERS[int(np.sign(side))] for side in release_codes if float(scene.bounce(SIDES[int(side > 0)])) > 0
    }
    return NO_STICKING._replace(
        has_sticking=bool(len(release_codes)), count=len(release_codes), chatter_walls="".join(sorted(chatter_walls))
    )


def label_of(scene, orbit_row, itinerary_words):
    """Return the label of an orbit.

    Parameters
    ----------
    scene : Scene
        Scene of the orbit.
    orbit_row : OrbitPoint
        Orbit.
    itinerary_words : tuple of str
        Its itinerary.

    Returns
    -------
    str
        Label P n p q, with inf for a wall on which the mass sticks after complete chatter.
    """
    return words.label(itinerary_words, sticking_phases_of(scene, orbit_row).chatter_walls)


def impact_points(orbit_row, frequency, speed_scale=None):
    """Return the impacts of an orbit in order as points for `orbit_comparison`.

    Parameters
    ----------
    orbit_row : OrbitPoint
        Orbit.
    frequency : float
        Drive frequency.
    speed_scale : float, optional
        Unit of the speeds. None is the largest speed.

    Returns
    -------
    ndarray
        Points.
    """
    return impacts_as_points(
        frequency,
        orbit_row.times,
        orbit_row.sides,
        orbit_row.speeds,
        speed_scale or orbit_row.speeds.max(initial=0.0) or 1.0,
    )


def is_own_mirror_image(scene, orbit_row):
    """Test whether an orbit of a symmetric scene is its own mirror image.

    Parameters
    ----------
    scene : Scene
        Symmetric scene at the orbit.
    orbit_row : OrbitPoint
        Orbit.

    Returns
    -------
    bool
        True if the orbit equals its mirror image.
    """
    if not len(orbit_row.times) and scene.force is not None:
        return _is_antiperiodic(scene, orbit_row)
    points = impact_points(orbit_row, float(scene.frequency))
    return is_same_orbit(points, mirror_points(points), IMPACT_TOLERANCE)


def _is_antiperiodic(scene, orbit_row):
    """Test whether an orbit without impacts is at (-x, -v) after half of its periods.

    With an even number of periods no orbit is its own image.
    """
    if orbit_row.periods % 2 == 0:
        return False
    no_impacts, amplitude = np.zeros(0), float(scene.amplitude)
    sequence = ImpactSequence(no_impacts, no_impacts, no_impacts, *_scalar_arrays(0.0, 0.5 * orbit_row.periods))
    half_problem, initial_state = (
        OrbitEquations(*mark_parameters(scene, "amplitude"), sequence),
        np.array([orbit_row.x, orbit_row.v]),
    )
    residual, _ = augmented_systems.evaluate(
        continuation_problem(half_problem), np.append(initial_state, amplitude), half_problem
    )
    return bool(
        abs(np.asarray(residual) + 2.0 * initial_state).max() <= IMPACT_TOLERANCE * (1.0 + abs(initial_state).max())
    )


def orbit_from_row(scene, orbit_row):
    """Make the `Orbit` of plain numbers.

    Parameters
    ----------
    scene : Scene
        Scene of the orbit.
    orbit_row : OrbitPoint
        Orbit as plain numbers.

    Returns
    -------
    Orbit
        The orbit.
    """
    if are_releases(orbit_row.sides).any():
        return _sticking_orbit(scene, orbit_row)
    if len(orbit_row.times):
        return orbit_of_exact_impacts(
            scene, orbit_row.times, orbit_row.speeds, orbit_row.sides, orbit_row.periods, orbit_row.residual
        )
    no_impacts = np.zeros(0)
    problem = OrbitEquations(
        scene,
        jax.tree.map(lambda leaf: np.int32(0), scene),
        ImpactSequence(*[no_impacts] * 3, *_scalar_arrays(0.0, orbit_row.periods)),
    )
    diagnostics = diagnose(problem, np.array([[orbit_row.x, orbit_row.v, orbit_row.value]]))
    clearance = float(diagnostics.clearance.min(initial=np.inf))
    impacts = Impacts(no_impacts, no_impacts.astype(np.int8), no_impacts, 0, np.inf, clearance, Status.OK)
    floquet_multipliers = eigenvalue_pair(float(diagnostics.trace[0]), float(diagnostics.determinant[0]))
    itinerary_words = ("",) * orbit_row.periods
    return make_orbit(
        scene,
        State(orbit_row.x, orbit_row.v),
        impacts,
        itinerary_words,
        floquet_multipliers,
        orbit_row.residual,
        "state",
    )


def _sticking_orbit(scene, orbit_row):
    """Make the `Orbit` of plain numbers that sticks, without its last bounces."""
    problem, z = set_up_problem(scene, "amplitude", orbit_row._replace(value=float(scene.amplitude)))
    diagnostics, drive_period = diagnose(problem, z[None]), 2.0 * np.pi / float(scene.frequency)
    is_impact, orbit_duration, section_points = (
        abs(orbit_row.sides) == 1,
        orbit_row.periods * drive_period,
        np.stack([diagnostics.x[0], diagnostics.v[0]], 1),
    )
    impact_times, sides = impact_times_and_sides(orbit_row)
    impact_times = np.mod(impact_times, orbit_duration)
    order = np.argsort(impact_times, kind="stable")
    itinerary_words = words.words_of_impacts(impact_times[order], sides[order], orbit_row.periods, drive_period)
    first_period = words.canonical_start(itinerary_words, section_points)
    shifted_times = np.mod(orbit_row.times[is_impact] - first_period * drive_period, orbit_duration)
    order = np.argsort(shifted_times)
    impact_columns = (
        shifted_times[order],
        orbit_row.sides[is_impact][order].astype(np.int8),
        orbit_row.speeds[is_impact][order],
    )
    clearance = float(diagnostics.clearance.min(initial=np.inf))
    impacts = Impacts(*impact_columns, len(shifted_times), float(impact_columns[2].min()), clearance, Status.OK)
    x, v = section_points[first_period].tolist()
    wall_motions = zip((-1.0, 1.0), wall_states(scene, 0.0), strict=True)
    sticking_sides = [
        sign for sign, (position, velocity) in wall_motions if (x, v) == (float(position), float(velocity))
    ]
    state = State(x, v, 0.0, sticking_sides[0] * Contact.STUCK if sticking_sides else 0.0)
    orbit_fields = words.rotate(itinerary_words, first_period), np.zeros(2, complex), orbit_row.residual, "state"
    return make_orbit(scene, state, impacts, *orbit_fields, sticking_phases_of(scene, orbit_row))


def _scalar_arrays(*values):
    return (np.asarray(value, float) for value in values)


def set_up_problem(scene, name, orbit_row):
    """Set up the equations and the unknowns of an orbit.

    Parameters
    ----------
    scene : Scene
        Scene.
    name : str
        Free parameter.
    orbit_row : OrbitPoint
        Orbit as plain numbers.

    Returns
    -------
    problem : OrbitEquations
        Equations of the orbit.
    z : ndarray
        Unknowns.
    """
    no_impacts = np.zeros(0)
    sequence = ImpactSequence(no_impacts, no_impacts, no_impacts, np.asarray(0.0), np.asarray(float(orbit_row.periods)))
    problem = OrbitEquations(*mark_parameters(scene, name), sequence)
    if not len(orbit_row.times):
        return problem, solve_free_orbit(problem, orbit_row.value, (orbit_row.x, orbit_row.v))
    problem = problem._replace(
        sequence=padded_sequence(problem, list(zip(orbit_row.times, orbit_row.speeds, orbit_row.sides, strict=True)))
    )
    return problem, np.concatenate([problem.sequence.times, problem.sequence.speeds, [orbit_row.value]])

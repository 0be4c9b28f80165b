"""Represent a periodic orbit as a solution of an `OrbitProblem`; name it and compare it with its mirror image."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..contact.kinds import flow_of_scene
from ..maps import itinerary as words
from ..maps.sticking_phase_intervals import NO_STICKING
from ..orbits.orbit_comparison import is_same_orbit, mirror_points
from ..scene.codes import Contact
from ..scene.scene import SIDES
from .orbit_diagnostics import diagnose
from .orbit_equations import are_releases
from .orbit_equivalence import comparison_points
from .orbit_problem import OrbitProblem

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

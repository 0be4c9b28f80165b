"""An orbit that is known to be one, described without Newton's method: a point of a branch, be it singular."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..maps import itinerary as words
from ..orbits.by_impacts import by_section
from ..orbits.impact_equations import Cycle
from ..orbits.orbit import described, multipliers
from ..orbits.orbit_comparison import is_same_orbit, meetings, mirrored
from ..scene.codes import Status
from ..scene.parameters import marked
from ..scene.state import Impacts, State
from .diagnostics import diagnose
from .equations import OrbitEquations
from .grazing import free_start, padded

SAME = 1e-6  # of the largest speed: two impacts as near are one


class OrbitPoint(NamedTuple):
    """An orbit in plain numbers. value: of the branch's parameter; times, since phase 0, speeds, sides: of the impacts;
    periods; x, v: at phase 0; residual: the largest error left in its equations."""

    value: float
    times: Float[np.ndarray, " impacts"]
    speeds: Float[np.ndarray, " impacts"]
    sides: Float[np.ndarray, " impacts"]
    periods: int
    x: float
    v: float
    residual: float


def itinerary(spot, frequency):
    """The walls that a `OrbitPoint`'s orbit hits, a word a period."""
    return words.around(spot.times, spot.sides, spot.periods, 2.0 * np.pi / frequency)


def impacts(spot, frequency, length=None):
    """The impacts of a `OrbitPoint`'s orbit in order as points (`orbit_comparison`), speeds over a length per t or the
    largest."""
    return meetings(frequency, spot.times, spot.sides, spot.speeds, length or spot.speeds.max(initial=0.0) or 1.0)


def is_own_image(spot, frequency):
    """Whether an orbit is its own mirror image."""
    points = impacts(spot, frequency)
    return is_same_orbit(points, mirrored(points), SAME)


def described_orbit(scene, spot):
    """The `Orbit` of a `OrbitPoint` of a scene."""
    if len(spot.times):
        return by_section(scene, spot.times, spot.speeds, spot.sides, spot.periods, spot.residual)
    blank = np.zeros(0)
    along = OrbitEquations(
        scene, jax.tree.map(lambda leaf: np.int32(0), scene), Cycle(*[blank] * 3, *_numbers(0.0, spot.periods))
    )
    look = diagnose(along, np.array([[spot.x, spot.v, spot.value]]))
    clear = float(look.clear.min(initial=np.inf))
    impacts = Impacts(blank, blank.astype(np.int8), blank, 0, np.inf, clear, Status.OK)
    roots = multipliers(float(look.trace[0]), float(look.determinant[0]))
    walls = ("",) * spot.periods
    return described(scene, State(spot.x, spot.v), impacts, walls, roots, spot.residual, "state")


def _numbers(*values):
    return (np.asarray(value, float) for value in values)


def place_orbit(scene, name, spot):
    """(`OrbitEquations`, z) of a `orbit_on_branch.OrbitPoint` of a scene."""
    blank = np.zeros(0)
    cycle = Cycle(blank, blank, blank, np.asarray(0.0), np.asarray(float(spot.periods)))
    along = OrbitEquations(*marked(scene, name), cycle)
    if not len(spot.times):
        return along, free_start(along, spot.value, (spot.x, spot.v))
    along = along._replace(cycle=padded(along, list(zip(spot.times, spot.speeds, spot.sides, strict=True))))
    return along, np.concatenate([along.cycle.times, along.cycle.speeds, [spot.value]])

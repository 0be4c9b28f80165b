"""An orbit that is known to be one, described without Newton's method: a point of a branch, be it singular."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from continuation import locate

from ..flight.wall_positions import places
from ..maps import itinerary as words
from ..maps.rests import NO_RESTS
from ..orbits.by_impacts import by_section
from ..orbits.impact_equations import Cycle
from ..orbits.orbit import described, multipliers
from ..orbits.orbit_comparison import is_same_orbit, meetings, mirrored
from ..scene.codes import Contact, Status
from ..scene.parameters import marked
from ..scene.scene import SIDES
from ..scene.state import Impacts, State
from .diagnostics import diagnose
from .equations import OrbitEquations, are_releases, problem
from .grazing import free_start, padded

SAME = 1e-6  # of the largest speed: two impacts as near are one


class OrbitPoint(NamedTuple):
    """An orbit in plain numbers. value: of the branch's parameter; times, since phase 0, speeds, sides: of the impacts,
    and of releases at the end of a rest, whose side is +-2, or +-3 where the mass lifts before that; periods; x, v: at
    phase 0; residual: the largest error left in its equations."""

    value: float
    times: Float[np.ndarray, " impacts"]
    speeds: Float[np.ndarray, " impacts"]
    sides: Float[np.ndarray, " impacts"]
    periods: int
    x: float
    v: float
    residual: float


def itinerary(spot, frequency):
    """The walls that a `OrbitPoint`'s orbit hits, a word a period, but for the endless hops before a rest."""
    times, sides = hits(spot)
    return words.around(times, sides, spot.periods, 2.0 * np.pi / frequency)


def hits(spot):
    """(times, sides) of a `OrbitPoint`'s impacts; where the mass lifts before a rest it comes back at once."""
    hit = ~are_releases(spot.sides)
    again = np.roll(abs(spot.sides) > Contact.STUCK, -1)
    order = np.argsort(np.concatenate([spot.times[hit], spot.times[again]]), kind="stable")
    return tuple(np.concatenate([each[hit], each[again]])[order] for each in (spot.times, spot.sides))


def rests_of(scene, spot):
    """The `Rests` of a `OrbitPoint`'s orbit, without what is between them."""
    ends = spot.sides[are_releases(spot.sides)]
    letters = {words.LETTERS[int(np.sign(side))] for side in ends if float(scene.bounce(SIDES[int(side > 0)])) > 0}
    return NO_RESTS._replace(rests=bool(len(ends)), count=len(ends), endless="".join(sorted(letters)))


def label_of(scene, spot, walls):
    """P n p q of a `OrbitPoint`'s orbit with this itinerary, inf on a wall where it rests after endless hops."""
    return words.label(walls, rests_of(scene, spot).endless)


def impacts(spot, frequency, length=None):
    """The impacts of a `OrbitPoint`'s orbit in order as points (`orbit_comparison`), speeds over a length per t or the
    largest."""
    return meetings(frequency, spot.times, spot.sides, spot.speeds, length or spot.speeds.max(initial=0.0) or 1.0)


def is_own_image(scene, spot):
    """Whether an orbit of a symmetric scene, at the point, is its own mirror image."""
    if not len(spot.times) and scene.force is not None:
        return _turns_back(scene, spot)
    points = impacts(spot, float(scene.frequency))
    return is_same_orbit(points, mirrored(points), SAME)


def _turns_back(scene, spot):
    """Whether an orbit without impacts is at -x, -v after half of its periods; of an even number of them none is its
    own image."""
    if spot.periods % 2 == 0:
        return False
    blank, value = np.zeros(0), float(scene.amplitude)
    cycle = Cycle(blank, blank, blank, *_numbers(0.0, 0.5 * spot.periods))
    half, start = OrbitEquations(*marked(scene, "amplitude"), cycle), np.array([spot.x, spot.v])
    moved, _ = locate.evaluated(problem(half), np.append(start, value), half)
    return bool(abs(np.asarray(moved) + 2.0 * start).max() <= SAME * (1.0 + abs(start).max()))


def described_orbit(scene, spot):
    """The `Orbit` of a `OrbitPoint` of a scene."""
    if are_releases(spot.sides).any():
        return _resting_orbit(scene, spot)
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


def _resting_orbit(scene, spot):
    """The `Orbit` of a `OrbitPoint` that rests, without its last hops."""
    along, z = place_orbit(scene, "amplitude", spot._replace(value=float(scene.amplitude)))
    look, length = diagnose(along, z[None]), 2.0 * np.pi / float(scene.frequency)
    hit, whole, points = abs(spot.sides) == 1, spot.periods * length, np.stack([look.x[0], look.v[0]], 1)
    every, sides = hits(spot)
    every = np.mod(every, whole)
    order = np.argsort(every, kind="stable")
    walls = words.split(every[order], sides[order], spot.periods, length)
    turn = words.first(walls, points)
    late = np.mod(spot.times[hit] - turn * length, whole)
    order = np.argsort(late)
    rows = late[order], spot.sides[hit][order].astype(np.int8), spot.speeds[hit][order]
    clear = float(look.clear.min(initial=np.inf))
    impacts = Impacts(*rows, len(late), float(rows[2].min()), clear, Status.OK)
    x, v = points[turn].tolist()
    ends = zip((-1.0, 1.0), places(scene, 0.0), strict=True)
    held = [sign for sign, (place, pace) in ends if (x, v) == (float(place), float(pace))]
    state = State(x, v, 0.0, held[0] * Contact.STUCK if held else 0.0)
    own = words.turned(walls, turn), np.zeros(2, complex), spot.residual, "state"
    return described(scene, state, impacts, *own, rests_of(scene, spot))


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

"""Orbits from states: `find_orbit` from one, settled or not; `find_orbits` from many."""

import numpy as np

from ..flight.wall_positions import places
from ..maps import itinerary as words
from ..maps.initial_conditions import box
from ..maps.iterate import KEEP, iterate
from ..maps.rests import may_rest
from ..scene import check
from ..scene.codes import Status
from ..scene.scale import is_driven
from ..scene.scene import Scene
from ..scene.state import State, check_start, real_state
from .by_impacts import by_impacts, guessed
from .by_shooting import by_state
from .orbit import Orbit, OrbitError

SETTLED = 1e-3  # of the largest x and v: a return as near as this
FREE = (
    "a free motion repeats, if at all, after a period of its own, and does so from every phase, so that no single "
    "orbit has the drive's period; give the scene a drive, or let damping and walls bring the mass to rest"
)


@check.host("use solve_orbits; located has derivatives of an orbit")
def find_orbit(
    scene: Scene,
    state: State,
    periods: int | None = None,
    itinerary: tuple[str, ...] | list[str] | None = None,
    settle: int = 200,
) -> Orbit:
    """The periodic orbit that a state settles on, or, with settle=0, an orbit near it, stable or not: an `Orbit`.

    scene: a single one; state: a `State` of numbers, the section lies at its phase. periods: drive periods n of the
    orbit, at most 64; None takes the least number, up to 32, after which the state comes back; what is found may have
    a divisor of it. itinerary: the walls to be hit, a word of "L" and "R" a period, ("LR",) or ("LRL", "R"), compared
    cyclically; None takes those that are hit from the state on. Where the state hits others, the orbit may be far from
    it: of those that random guesses lead to the nearest is taken. settle: drive periods before Newton's method.

    Raises OrbitError, with status, residual and advice, where there is no such orbit: no return, no convergence, a
    singular Jacobian (a bifurcation), a flight through a wall; ArgumentError for arguments that cannot be.
    """
    check.require_single(scene)
    state, settle = _lane(real_state(scene, state)), check.whole("settle", settle, 0)
    check_start(scene, state)
    if itinerary is not None:
        itinerary = words.checked(itinerary, periods)
        periods = len(itinerary)
    if periods is not None and check.whole("periods", periods, 1) > KEEP:
        raise check.ArgumentError("periods", f"must be at most {KEEP}", periods)
    size = max(float(abs(np.asarray(each)).max()) for each in (state.x, state.v))
    try:
        if settle:
            state = _followed(iterate(scene, state, settle)).state
        periods = periods or _returns(scene, state, settle, size)
        return _near(scene, state, periods, itinerary)
    except OrbitError as error:
        if np.isnan(error.residual) or is_driven(scene):
            raise
        raise OrbitError(f"{error.status}, and the scene has no drive", error.residual, FREE) from None


def _lane(state):
    if np.shape(state.x + state.v + state.phase + state.contact):
        raise check.ArgumentError("state", "must be a single state, not a batch", f"shape {np.shape(state.x)}")
    return State(*(np.reshape(np.asarray(each), 1) for each in (state.x, state.v, state.phase, state.contact)))


def _followed(found):
    if found.status[0] >= Status.CAP:
        what = f"the state cannot be followed ({Status(found.status[0]).word})"
        raise OrbitError(what, np.nan, "start between the walls of the scene, at the state's phase")
    return found


def _returns(scene, state, settle, size):
    """The least number of periods after which the state comes back: to within SETTLED where it has settled.

    size: of x and v at the start; a motion that has decayed to rounding beside that is at rest.
    """
    points = _followed(iterate(scene, state, check.MOST_PERIODS)).points[:, 0]
    first = np.array([state.x[0], state.v[0]])
    apart, scale = abs(points - first).max(axis=1), abs(points).max()
    decayed = scale <= float(np.finfo(scene.dtype).eps) * size
    if settle and apart.min() > SETTLED * scale and not decayed:
        advice = "settle longer; or give periods and settle=0 for an unstable orbit, or ask find_orbits"
        raise OrbitError(
            f"the state does not come back within {check.MOST_PERIODS} periods", float(apart.min()), advice
        )
    return 1 if decayed else int(np.argmax(apart <= max(2.0 * apart.min(), 1e-6 * scale))) + 1


def _near(scene, state, periods, itinerary):
    """The orbit near a state: by its impacts, or by the state where it rests on a wall or meets none."""
    kept = _followed(iterate(scene, state, periods))
    found = words.words(kept.side[:, 0])
    plain = State(*(float(each[0]) for each in (state.x, state.v, state.phase, state.contact)))
    length = 2.0 * np.pi / float(scene.frequency)
    hit = kept.side[:, 0] != 0
    times = (kept.time[:, 0] + length * np.arange(periods)[:, None])[hit]
    speeds, sides = kept.speed[:, 0][hit], kept.side[:, 0][hit]
    late = _late(scene, plain, float(kept.x[-1, 0]), float(kept.v[-1, 0]), SETTLED * length)
    if late is not None:
        wait, speed, side = late
        times, speeds = np.append(times, length * periods + wait), np.append(speeds, speed)
        sides = np.append(sides, side)
        found = (*found[:-1], found[-1] + words.LETTERS[side])
    if itinerary is not None and not words.same(found, itinerary):
        return guessed(scene, itinerary, plain, box(scene)[2])
    if not any(found) or may_rest(scene, kept.status, kept.contact):
        return by_state(scene, plain, periods)
    return by_impacts(scene, times, speeds, sides, plain.phase, periods)


def _late(scene, begin, x, v, longest):
    """(time after the end, speed, side) of the impact with which a round that begins on a rigid wall ends, where a
    rounding, or a guess's error, has put it after the end; None where there is none so soon."""
    for side, wall, (place, pace) in zip((-1, 1), (scene.left, scene.right), places(scene, begin.phase), strict=True):
        if wall is None or wall.soft:
            continue
        on = abs(begin.x - place) <= 8.0 * np.finfo(scene.dtype).eps * abs(float(place))
        gap, speed = side * (float(place) - x), side * (v - float(pace))
        if on and side * (begin.v - pace) < 0 and gap >= 0 and speed * longest > gap:
            return gap / speed, speed, side
    return None

"""Orbits from states: `find_orbit` from one, settled or not; `find_orbits` from many."""

import numpy as np

from ..flight.wall_positions import wall_states
from ..maps import itinerary as words
from ..maps.initial_conditions import initial_box
from ..maps.iterate import MAX_RECORDED_PERIODS, iterate
from ..maps.sticking_phases import may_stick
from ..scene import check
from ..scene.codes import Status
from ..scene.scene import Scene
from ..scene.state import State, check_start, state_arrays
from ..scene.typical_scales import is_driven
from .orbit import Orbit, OrbitError
from .orbit_from_impacts import orbit_from_impacts, orbit_from_random_guesses
from .shooting import orbit_from_state

RETURN_TOLERANCE = 1e-3  # of the largest x and v: a return as near as this
ADVICE_UNDRIVEN = (
    "a free motion repeats, if at all, after a period of its own, and does so from every phase, so that no single "
    "orbit has the drive's period; give the scene a drive, or let damping and walls bring the mass to rest"
)


@check.host_only("use solve_orbits; located has derivatives of an orbit")
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
    state, settle = _single_lane(state_arrays(scene, state)), check.whole_number("settle", settle, 0)
    check_start(scene, state)
    if itinerary is not None:
        itinerary = words.validate_itinerary(itinerary, periods)
        periods = len(itinerary)
    if periods is not None and check.whole_number("periods", periods, 1) > MAX_RECORDED_PERIODS:
        raise check.ArgumentError("periods", f"must be at most {MAX_RECORDED_PERIODS}", periods)
    initial_size = max(float(abs(np.asarray(component)).max()) for component in (state.x, state.v))
    try:
        if settle:
            state = _require_valid(iterate(scene, state, settle)).state
        periods = periods or _return_period(scene, state, settle, initial_size)
        return _orbit_near(scene, state, periods, itinerary)
    except OrbitError as error:
        if np.isnan(error.residual) or is_driven(scene):
            raise
        raise OrbitError(f"{error.status}, and the scene has no drive", error.residual, ADVICE_UNDRIVEN) from None


def _single_lane(state):
    if np.shape(state.x + state.v + state.phase + state.contact):
        raise check.ArgumentError("state", "must be a single state, not a batch", f"shape {np.shape(state.x)}")
    return State(
        *(np.reshape(np.asarray(component), 1) for component in (state.x, state.v, state.phase, state.contact))
    )


def _require_valid(iterates):
    if iterates.status[0] >= Status.CAP:
        reason = f"the state cannot be followed ({Status(iterates.status[0]).word})"
        raise OrbitError(reason, np.nan, "start between the walls of the scene, at the state's phase")
    return iterates


def _return_period(scene, state, settle, initial_size):
    """The least number of periods after which the state comes back: to within SETTLED where it has settled.

    initial_size: of x and v at the start; a motion that has decayed to rounding beside that is at rest.
    """
    points = _require_valid(iterate(scene, state, check.MAX_ORBIT_PERIODS)).points[:, 0]
    start_point = np.array([state.x[0], state.v[0]])
    distances, scale = abs(points - start_point).max(axis=1), abs(points).max()
    has_decayed = scale <= float(np.finfo(scene.dtype).eps) * initial_size
    if settle and distances.min() > RETURN_TOLERANCE * scale and not has_decayed:
        advice = "settle longer; or give periods and settle=0 for an unstable orbit, or ask find_orbits"
        raise OrbitError(
            f"the state does not come back within {check.MAX_ORBIT_PERIODS} periods", float(distances.min()), advice
        )
    return 1 if has_decayed else int(np.argmax(distances <= max(2.0 * distances.min(), 1e-6 * scale))) + 1


def _orbit_near(scene, state, periods, itinerary):
    """The orbit near a state: by its impacts, or by the state where it rests on a wall or meets none."""
    iterates = _require_valid(iterate(scene, state, periods))
    observed_itinerary = words.words_of_rows(iterates.side[:, 0])
    start = State(*(float(component[0]) for component in (state.x, state.v, state.phase, state.contact)))
    drive_period = 2.0 * np.pi / float(scene.frequency)
    is_impact = iterates.side[:, 0] != 0
    times = (iterates.time[:, 0] + drive_period * np.arange(periods)[:, None])[is_impact]
    speeds, sides = iterates.speed[:, 0][is_impact], iterates.side[:, 0][is_impact]
    missed_impact = _missed_impact(
        scene, start, float(iterates.x[-1, 0]), float(iterates.v[-1, 0]), RETURN_TOLERANCE * drive_period
    )
    if missed_impact is not None:
        delay, speed, side = missed_impact
        times, speeds = np.append(times, drive_period * periods + delay), np.append(speeds, speed)
        sides = np.append(sides, side)
        observed_itinerary = (*observed_itinerary[:-1], observed_itinerary[-1] + words.LETTERS[side])
    if itinerary is not None and not words.is_same_itinerary(observed_itinerary, itinerary):
        return orbit_from_random_guesses(scene, itinerary, start, initial_box(scene)[2])
    if not any(observed_itinerary) or may_stick(scene, iterates.status, iterates.contact):
        return orbit_from_state(scene, start, periods)
    return orbit_from_impacts(scene, times, speeds, sides, start.phase, periods)


def _missed_impact(scene, start, x, v, max_delay):
    """(time after the end, speed, side) of the impact with which a round that begins on a rigid wall ends, where a
    rounding, or a guess's error, has put it after the end; None where there is none so soon."""
    for side, wall, (wall_position, wall_velocity) in zip(
        (-1, 1), (scene.left, scene.right), wall_states(scene, start.phase), strict=True
    ):
        if wall is None or wall.soft:
            continue
        starts_on_wall = abs(start.x - wall_position) <= 8.0 * np.finfo(scene.dtype).eps * abs(float(wall_position))
        gap, speed = side * (float(wall_position) - x), side * (v - float(wall_velocity))
        if starts_on_wall and side * (start.v - wall_velocity) < 0 and gap >= 0 and speed * max_delay > gap:
            return gap / speed, speed, side
    return None

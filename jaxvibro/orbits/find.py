"""Find a periodic orbit from one state."""

import numpy as np

from ..flight.wall_positions import wall_states
from ..maps import itinerary as words
from ..maps.initial_conditions import initial_box
from ..maps.iterate import MAX_RECORDED_PERIODS, iterate
from ..maps.sticking_phase_intervals import may_stick
from ..scene import check
from ..scene.codes import Status
from ..scene.scene import Scene
from ..scene.state import State, check_start_within_walls, make_state_arrays
from ..scene.typical_scales import is_driven
from .orbit import Orbit, OrbitError
from .orbit_from_impacts import orbit_from_impacts, orbit_from_random_guesses
from .shooting import orbit_from_state

RETURN_TOLERANCE = 1e-3  # relative to the largest x and v: the state has returned
ADVICE_UNDRIVEN = (
    "a free motion repeats, if at all, with a period of its own and from every phase, so that no isolated orbit has "
    "the drive's period; give the scene a drive, or damping or restitution that let the motion decay"
)


@check.host_only("use solve_orbits; located has derivatives of an orbit")
def find_orbit(
    scene: Scene,
    state: State,
    periods: int | None = None,
    itinerary: tuple[str, ...] | list[str] | None = None,
    settle: int = 200,
) -> Orbit:
    """Find the periodic orbit that a state settles on, or one near the state.

    With ``settle=0`` the orbit near the state is found, stable or unstable.

    Parameters
    ----------
    scene : Scene
        Oscillator, drive and walls. A single scene.
    state : State
        Initial state. The section lies at its phase.
    periods : int, optional
        Number n of drive periods of the orbit, at most 64. By default it is the smallest number up to 32 after which
        the state returns. The minimal period of the orbit may be a divisor of n.
    itinerary : sequence of str, optional
        Walls to be hit: a word of "L" and "R" for each period, as ``("LR",)`` or ``("LRL", "R")``, compared cyclically.
        By default it is the itinerary of the motion from the state. If this motion hits other walls, Newton's method
        starts from random guesses. The result is then the orbit nearest to the state, which may be far from the state.
    settle : int, optional
        Number of drive periods before Newton's method, at least 0.

    Returns
    -------
    Orbit
        The periodic orbit.

    Raises
    ------
    OrbitError
        If there is no such orbit: the state does not return, Newton's method does not converge, the Jacobian is
        singular (a bifurcation), or a flight passes through a wall. The error has a status, a residual and advice.
    ArgumentError
        If an argument is invalid.

    See Also
    --------
    find_orbits : Orbits near many trajectories.
    solve_orbits : Orbits of many scenes, with derivatives.
    follow : Continue an orbit in a parameter.

    Examples
    --------
    >>> orbit = jv.find_orbit(scene, state)
    >>> orbit.label, orbit.stable
    ('P111', True)
    """
    check.require_single_scene(scene)
    state, settle = _single_lane_state(make_state_arrays(scene, state)), check.check_whole_number("settle", settle, 0)
    check_start_within_walls(scene, state)
    if itinerary is not None:
        itinerary = words.validate_itinerary(itinerary, periods)
        periods = len(itinerary)
    if periods is not None and check.check_whole_number("periods", periods, 1) > MAX_RECORDED_PERIODS:
        raise check.ArgumentError("periods", f"must be at most {MAX_RECORDED_PERIODS}", periods)
    initial_amplitude = max(float(abs(np.asarray(component)).max()) for component in (state.x, state.v))
    try:
        if settle:
            state = _require_valid_motion(iterate(scene, state, settle)).state
        periods = periods or _return_period(scene, state, settle, initial_amplitude)
        return _solve_near_state(scene, state, periods, itinerary)
    except OrbitError as error:
        if np.isnan(error.residual) or is_driven(scene):
            raise
        raise OrbitError(f"{error.status}, and the scene has no drive", error.residual, ADVICE_UNDRIVEN) from None


def _single_lane_state(state):
    if np.shape(state.x + state.v + state.phase + state.contact):
        raise check.ArgumentError("state", "must be a single state, not a batch", f"shape {np.shape(state.x)}")
    return State(
        *(np.reshape(np.asarray(component), 1) for component in (state.x, state.v, state.phase, state.contact))
    )


def _require_valid_motion(iterates):
    if iterates.status[0] >= Status.CAP:
        reason = f"the motion from the state cannot be computed ({Status(iterates.status[0]).word})"
        raise OrbitError(reason, np.nan, "start between the walls of the scene, at the state's phase")
    return iterates


def _return_period(scene, state, settle, initial_amplitude):
    """Find the smallest number of drive periods after which the state returns.

    If `settle` is positive, the state must return within `RETURN_TOLERANCE`. `initial_amplitude` is the largest of
    ``|x|`` and ``|v|`` at the start; a motion that has decayed to the rounding error of this size is at equilibrium.
    """
    section_points = _require_valid_motion(iterate(scene, state, check.MAX_ORBIT_PERIODS)).points[:, 0]
    start_point = np.array([state.x[0], state.v[0]])
    return_distances, motion_scale = abs(section_points - start_point).max(axis=1), abs(section_points).max()
    is_at_equilibrium = motion_scale <= float(np.finfo(scene.dtype).eps) * initial_amplitude
    if settle and return_distances.min() > RETURN_TOLERANCE * motion_scale and not is_at_equilibrium:
        advice = "settle longer; for an unstable orbit give periods and settle=0, or use find_orbits"
        raise OrbitError(
            f"the state does not return within {check.MAX_ORBIT_PERIODS} periods", float(return_distances.min()), advice
        )
    return (
        1
        if is_at_equilibrium
        else int(np.argmax(return_distances <= max(2.0 * return_distances.min(), 1e-6 * motion_scale))) + 1
    )


def _solve_near_state(scene, state, periods, itinerary):
    """Solve for the impacts of the orbit near a state, or for its state if the mass sticks or hits no wall."""
    iterates = _require_valid_motion(iterate(scene, state, periods))
    observed_itinerary = words.itinerary_of_rows(iterates.side[:, 0])
    start_state = State(*(float(component[0]) for component in (state.x, state.v, state.phase, state.contact)))
    drive_period = 2.0 * np.pi / float(scene.frequency)
    is_impact = iterates.side[:, 0] != 0
    impact_times = (iterates.time[:, 0] + drive_period * np.arange(periods)[:, None])[is_impact]
    speeds, sides = iterates.speed[:, 0][is_impact], iterates.side[:, 0][is_impact]
    missed_impact = _missed_closing_impact(
        scene, start_state, float(iterates.x[-1, 0]), float(iterates.v[-1, 0]), RETURN_TOLERANCE * drive_period
    )
    if missed_impact is not None:
        delay, speed, side = missed_impact
        impact_times, speeds = np.append(impact_times, drive_period * periods + delay), np.append(speeds, speed)
        sides = np.append(sides, side)
        observed_itinerary = (*observed_itinerary[:-1], observed_itinerary[-1] + words.LETTERS[side])
    if itinerary is not None and not words.is_same_itinerary(observed_itinerary, itinerary):
        return orbit_from_random_guesses(scene, itinerary, start_state, initial_box(scene)[2])
    if not any(observed_itinerary) or may_stick(scene, iterates.status, iterates.contact):
        return orbit_from_state(scene, start_state, periods)
    return orbit_from_impacts(scene, impact_times, speeds, sides, start_state.phase, periods)


def _missed_closing_impact(scene, start_state, end_x, end_v, max_delay):
    """Return (delay, speed, side) of the impact that closes an orbit which starts on a rigid wall, or None.

    Because of rounding, or of the error of a guess, this impact may lie after the end of the last period.
    """
    for side, wall, (wall_position, wall_velocity) in zip(
        (-1, 1), (scene.left, scene.right), wall_states(scene, start_state.phase), strict=True
    ):
        if wall is None or wall.soft:
            continue
        starts_on_wall = abs(start_state.x - wall_position) <= 8.0 * np.finfo(scene.dtype).eps * abs(
            float(wall_position)
        )
        gap, speed = side * (float(wall_position) - end_x), side * (end_v - float(wall_velocity))
        if starts_on_wall and side * (start_state.v - wall_velocity) < 0 and gap >= 0 and speed * max_delay > gap:
            return gap / speed, speed, side
    return None

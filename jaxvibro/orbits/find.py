"""Find a periodic orbit from one state, and the periodic orbits near many trajectories.

Find the periodic orbits near many trajectories, stable and unstable, by Newton's method. A trajectory that passes near
an unstable periodic orbit follows this orbit for some time and nearly repeats itself. Each stretch of n periods is a
guess of the impacts of an orbit. Newton's method starts from the stretches whose two ends are nearest to each other,
and from some random stretches.
"""

from dataclasses import replace

import jax
import numpy as np

from continuation import newton

from ..flight.wall_positions import wall_states
from ..maps import itinerary as words
from ..maps.initial_conditions import draw_initial_states, initial_box
from ..maps.iterate import MAX_RECORDED_PERIODS, iterate
from ..maps.sticking_phase_intervals import may_stick
from ..scene import check
from ..scene.scene import Scene
from ..scene.scene_properties import is_driven, is_symmetric
from ..scene.state import State, Status, check_start_within_walls, make_state_arrays
from .orbit import Orbit, OrbitError, impacts_as_points, is_same_orbit, mirror_points
from .orbit_from_impacts import orbit_from_impacts, orbit_from_random_guesses, padded_sequence, solve_guesses
from .shooting import free_response, orbit_from_state

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


SETTLE_PERIODS = 300  # drive periods before the second record of the trajectories
MAX_NEAREST, N_RANDOM = 2048, 1024  # stretches of each length that serve as guesses
CELL_SIZE = 1e-4  # relative to the largest x and v: one stretch is kept of those that begin in a cell
LANES_PER_CALL = 256  # guesses per call of Newton's method
MAX_IMPACTS = 32  # largest number of impacts of an orbit
ORBIT_TOLERANCE = 1e-7  # relative to the largest speed: closer orbits are the same


@check.host_only("use solve_orbits, which takes guesses")
def find_orbits(scene: Scene, max_period: int = 4, starts: int = 200, seed: int = 0) -> tuple[Orbit, ...]:
    """Find the periodic orbits of a scene up to a given period, stable and unstable.

    Trajectories from random initial states provide the guesses for Newton's method.

    Parameters
    ----------
    scene : Scene
        Oscillator, drive and walls. A single scene.
    max_period : int, optional
        Largest number of drive periods, from 1 to 32.
    starts : int, optional
        Number of trajectories, at least 1. They start at phase 0, at random in the box of initial states.
    seed : int, optional
        Seed of the random numbers.

    Returns
    -------
    tuple of Orbit
        The distinct orbits, in order of their period. `Orbit.mirror_of` links orbits that are mirror images.

    Raises
    ------
    ArgumentError
        If `scene` is a batch, or if a count is out of range.

    See Also
    --------
    find_orbit : Orbit near one state.
    find_attractors : Attractors, periodic or not.

    Notes
    -----
    `find` may miss orbits that the sampled trajectories do not approach. The samples contain the first drive
    periods of each trajectory and, later, the motion on its attractor. More starts find more orbits.

    Examples
    --------
    >>> orbits = jv.find_orbits(scene, max_period=1, starts=20)
    >>> [(orbit.label, orbit.stable) for orbit in orbits]
    [('P100', True), ('P111', False), ('P111', True)]
    """
    check.require_single_scene(scene)
    max_periods = check.check_whole_number("max_period", max_period, 1)
    if max_periods > MAX_RECORDED_PERIODS // 2:
        raise check.ArgumentError("max_period", f"must be at most {MAX_RECORDED_PERIODS // 2}", max_period)
    starts, seed = check.check_whole_number("starts", starts, 1), check.check_whole_number("seed", seed, 0)
    first_run = iterate(scene, draw_initial_states(scene, starts, seed), MAX_RECORDED_PERIODS)
    runs = [first_run, iterate(scene, first_run.state, SETTLE_PERIODS)]
    speed_scale = initial_box(scene)[2]
    collection = _OrbitCollection(scene, speed_scale)
    collection.add(lambda: orbit_from_state(scene, free_response(scene), 1))
    rng = np.random.default_rng(seed)
    for periods in range(1, max_periods + 1):
        for impact_solution in _distinct_solutions(scene, _candidate_guesses(scene, runs, periods, rng)):
            collection.add(lambda guess=impact_solution: orbit_from_impacts(scene, *guess))
        for state in _returning_states(runs[1], periods):
            collection.add(lambda state=state, periods=periods: orbit_from_state(scene, state, periods))
    return collection.with_mirror_images()


class _OrbitCollection:
    """Distinct orbits found in a scene."""

    def __init__(self, scene, speed_scale):
        self.scene, self.max_speed, self.orbits, self.point_sets = scene, speed_scale, [], []

    def add(self, solve_orbit):
        """Add the orbit that `solve_orbit` returns, unless the orbit is known or `solve_orbit` raises OrbitError."""
        try:
            orbit = solve_orbit()
        except OrbitError:
            return
        points = self.impact_points_of(orbit)
        if self.find_index(orbit.periods, points) is None:
            self.orbits.append(orbit)
            self.point_sets.append(points)

    def impact_points_of(self, orbit):
        """Return the impacts of an orbit as points."""
        time = orbit.impacts.time + orbit.state.phase / float(self.scene.frequency)
        return impacts_as_points(
            float(self.scene.frequency), time, orbit.impacts.side, orbit.impacts.speed, self.max_speed
        )

    def find_index(self, periods, points):
        """Return the index of the orbit with these impacts, or None."""
        for index, (known_orbit, known_points) in enumerate(zip(self.orbits, self.point_sets, strict=True)):
            if known_orbit.periods == periods and is_same_orbit(points, known_points, ORBIT_TOLERANCE):
                return index
        return None

    def with_mirror_images(self):
        """Return the orbits in order, each with the index of its mirror image.

        In a symmetric scene, mirror images that were not found are added.
        """
        is_symmetric_scene = is_symmetric(self.scene)
        if is_symmetric_scene:
            for orbit, points in zip(list(self.orbits), list(self.point_sets), strict=True):
                if self.find_index(orbit.periods, mirror_points(points)) is None:
                    self.add(lambda orbit=orbit: _mirror_orbit(orbit))
        order = sorted(range(len(self.orbits)), key=lambda k: _orbit_sort_key(self.orbits[k]))
        new_indices = {old_index: new_index for new_index, old_index in enumerate(order)}
        mirror_indices = [self.find_index(self.orbits[k].periods, mirror_points(self.point_sets[k])) for k in order]
        return tuple(
            replace(self.orbits[k], mirror_of=new_indices.get(mirror_index) if is_symmetric_scene else None)
            for k, mirror_index in zip(order, mirror_indices, strict=True)
        )


def _orbit_sort_key(orbit):
    return orbit.periods, len(orbit.label), orbit.label, orbit.itinerary, orbit.state.x


def _mirror_orbit(orbit):
    """Solve for the mirror image of an orbit: impacts on the other walls, half a drive period later."""
    drive_period = 2.0 * np.pi / float(orbit.scene.frequency)
    impacts, orbit_duration = orbit.impacts, orbit.periods * drive_period
    if orbit.unknowns == "state":
        state = orbit.state
        return orbit_from_state(
            orbit.scene, State(-state.x, -state.v, state.phase + np.pi, -state.contact), orbit.periods
        )
    times = np.mod(impacts.time + 0.5 * drive_period, orbit_duration)
    order = np.argsort(times)
    return orbit_from_impacts(
        orbit.scene, times[order], impacts.speed[order], -impacts.side[order], orbit.state.phase, orbit.periods
    )


def _candidate_guesses(scene, runs, periods, rng):
    """Collect stretches of trajectories as guesses: {number of impacts: (list of (times, speeds, sides), periods)}."""
    drive_period = 2.0 * np.pi / float(scene.frequency)
    guesses_by_count = {}
    for run in runs:
        section_points = run.points
        return_distances = abs(section_points[periods:] - section_points[:-periods]).max(axis=-1)
        flat_return_distances = np.where((run.status < Status.CAP)[None, :], return_distances, np.inf).ravel()
        order = np.argsort(flat_return_distances, kind="stable")
        cell_indices = np.round(
            section_points[:-periods].reshape(-1, 2)[order] / (CELL_SIZE * abs(section_points).max())
        ).astype(int)
        nearest_indices = order[
            np.sort(np.unique(cell_indices, axis=0, return_index=True)[1])[:MAX_NEAREST]
        ]  # one in each cell
        stretch_indices = np.unique(
            np.concatenate([nearest_indices, rng.integers(0, flat_return_distances.size, N_RANDOM)])
        )
        for start_period, lane in zip(
            *np.unravel_index(
                stretch_indices[np.isfinite(flat_return_distances[stretch_indices])], return_distances.shape
            ),
            strict=True,
        ):
            period_rows = slice(start_period + 1, start_period + 1 + periods)
            is_impact = run.side[period_rows, lane] != 0
            n_impacts = int(is_impact.sum())
            if 0 < n_impacts <= MAX_IMPACTS:
                times = run.time[period_rows, lane] + drive_period * np.arange(periods)[:, None]
                guesses_by_count.setdefault(n_impacts, []).append(
                    (times[is_impact], run.speed[period_rows, lane][is_impact], run.side[period_rows, lane][is_impact])
                )
    return {n_impacts: (guesses, periods) for n_impacts, guesses in guesses_by_count.items()}


def _distinct_solutions(scene, guesses_by_count):
    """Yield the arguments of `orbit_from_impacts` for each distinct solution that Newton's method reaches."""
    drive_period = 2.0 * np.pi / float(scene.frequency)
    for n_impacts, (guesses, periods) in sorted(guesses_by_count.items()):
        known_keys = set()
        for batch_start in range(0, len(guesses), LANES_PER_CALL):
            guess_batch = guesses[batch_start : batch_start + LANES_PER_CALL]
            guess_batch += [guess_batch[-1]] * (LANES_PER_CALL - len(guess_batch))
            sequences = [padded_sequence(scene, *guess, 0.0, periods) for guess in guess_batch]
            batch_solutions, newton_results = solve_guesses(
                scene, jax.tree.map(lambda *arrays: np.stack(arrays), *sequences)
            )
            is_valid = (newton_results.status == newton.OK) & (batch_solutions.speeds[:, :n_impacts] > 0).all(axis=1)
            for k in np.flatnonzero(is_valid):
                times, speeds, sides = (solution_array[k, :n_impacts] for solution_array in batch_solutions[:3])
                sequence_key = _sequence_key(times, speeds, sides, periods, drive_period)
                if sequence_key not in known_keys:
                    known_keys.add(sequence_key)
                    yield times, speeds, sides, 0.0, periods


def _sequence_key(times, speeds, sides, periods, drive_period):
    """Return a key that is equal for impact sequences that differ by a shift of periods, except for rounding."""
    shifted_keys = []
    for period_shift in range(periods):
        shifted_times = np.mod(times - period_shift * drive_period, periods * drive_period)
        order = np.argsort(shifted_times)
        shifted_keys.append(
            tuple(np.round(shifted_times[order], 6)) + tuple(np.round(speeds[order], 6)) + tuple(sides[order])
        )
    return min(shifted_keys)


def _returning_states(run, periods):
    """Yield the final states that return after a number of periods, as guesses for shooting.

    Orbits that stick are found from these guesses only.
    """
    section_points = run.points
    tolerance = 1e-6 * abs(section_points[-1]).max(initial=1.0)
    has_returned = abs(section_points[-1] - section_points[-1 - periods]).max(axis=-1) <= tolerance
    known_keys = set()
    for lane in np.flatnonzero(has_returned & (run.status < Status.CAP)):
        state_key = tuple(np.round(section_points[-1, lane], 5))
        if state_key not in known_keys:
            known_keys.add(state_key)
            yield State(
                *(float(component[lane]) for component in (run.x[-1], run.v[-1])), 0.0, float(run.contact[-1, lane])
            )

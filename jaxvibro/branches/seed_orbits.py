"""Find seed orbits, on which random starts settle, and test whether an orbit lies on a branch."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..attractors.transients import compute_return_distances
from ..flight.wall_positions import WALL_SIGNS
from ..maps.initial_conditions import draw_initial_states
from ..maps.iterate import iterate
from ..orbits.orbit import is_same_orbit
from ..orbits.shooting import free_orbit
from ..problem.orbit_equations import diagnose
from ..problem.orbit_point import OrbitPoint, comparison_points, make_orbit_point
from ..problem.orbit_problem import make_orbit_problem
from ..scene.scene import SIDES
from ..scene.scene_parameters import parameter_domain
from ..scene.state import Contact, Status
from .branch import branch_point

PREFILTER_TOLERANCE = 0.15  # relative to the largest x and v of the branch; closer states are tested by Newton's method
ORBIT_TOLERANCE = 1e-5  # relative to the largest speed; largest difference of impacts of one orbit
CHATTER_TOLERANCE = 1e-4  # relative to the largest x and v; largest difference of states of one orbit that sticks


def is_on_branch(seed_orbit, branch):
    """Test whether a seed orbit lies on a branch."""
    if branch.data.sizes["period"] != seed_orbit.point.periods:
        return False
    value_offsets, branch_states = (
        branch.values - seed_orbit.point.value,
        np.stack([branch.data[key].values for key in "xv"], axis=2),
    )
    max_distance = PREFILTER_TOLERANCE * abs(branch_states).max()
    for row_before in np.flatnonzero(value_offsets[:-1] * value_offsets[1:] <= 0):
        if _are_states_near(
            seed_orbit, branch_states[row_before : row_before + 2], max_distance
        ) and _converges_to_seed_orbit(seed_orbit, branch, row_before):
            return True
    return False


def _are_states_near(seed_orbit, branch_states, max_distance):
    """Test whether the states of a seed orbit are near those of a point of a branch, up to a shift of periods."""
    shifted_branch_states = [
        np.roll(point_states, period_shift, axis=0)
        for point_states in branch_states
        for period_shift in range(len(point_states))
    ]
    return any(
        abs(shifted_states - seed_orbit.section_states).max() < max_distance for shifted_states in shifted_branch_states
    )


def _converges_to_seed_orbit(seed_orbit, branch, row_before):
    """Test whether Newton's method leads from one of two adjacent points of a branch to the seed orbit."""
    points = (branch_point(branch, row) for row in (row_before, row_before + 1))
    return any(correct_to_seed_orbit(seed_orbit, point.problem, point.z) is not None for point in points)


def correct_to_seed_orbit(seed_orbit, problem, z):
    """Correct z to the parameter value of a seed orbit by Newton's method.

    Returns the equations and z at this value, or None if the method does not converge to the seed orbit.
    """
    point = problem.solve_at(z, -1, seed_orbit.point.value, 1.0)
    return (problem, point.z) if point.converged and _is_seed_orbit(seed_orbit, problem, point.z) else None


def _is_seed_orbit(seed_orbit, problem, z):
    if seed_orbit.may_stick:
        diagnostics, state_scale = diagnose(problem, z[None]), abs(seed_orbit.section_states).max()
        seed_states = np.roll(seed_orbit.section_states, 1, axis=0)  # the last state is at phase 0
        return abs(np.stack([diagnostics.x[0], diagnostics.v[0]], 1) - seed_states).max() < CHATTER_TOLERANCE * max(
            1.0, state_scale
        )
    if not len(problem.sequence.sides):
        return not seed_orbit.point.problem.n_rows and abs(
            z[:2] - seed_orbit.section_states[0]
        ).max() < ORBIT_TOLERANCE * max(1.0, abs(seed_orbit.section_states).max())
    speed_scale = seed_orbit.point.speeds.max(initial=0.0)
    seed_impacts = comparison_points(seed_orbit.point.problem, seed_orbit.point.z, speed_scale)
    return is_same_orbit(comparison_points(problem, z, speed_scale), seed_impacts, ORBIT_TOLERANCE)


N_STARTS = 256  # each at its own value of the parameter
N_FREE_VALUES = 15  # values at which the motion without impacts is computed
SETTLING_PERIODS = 600  # drive periods
RETURN_TOLERANCE = 1e-7  # relative to the largest x and v; largest distance of a return


class SeedOrbit(NamedTuple):
    """Periodic orbit on which a start settled.

    Attributes
    ----------
    point : OrbitPoint
        Approximate orbit. It has no impacts if it sticks after complete chatter.
    section_states : ndarray
        x and v at the end of each period, array of shape (periods, 2).
    may_stick : bool
        True if the orbit may stick, or has too many bounces to be recorded.
    """

    point: OrbitPoint
    section_states: Float[np.ndarray, "periods 2"]
    may_stick: bool = False


def find_seed_orbits(scenes, name, bounds, max_period, seed):
    """Return the `SeedOrbit` list of each scene, with at most `max_period` periods, sorted by period.

    The scenes differ only in their numbers. The starts of all scenes are simulated together.
    """
    values_and_states = [_draw_values_and_states(scene, name, bounds, seed) for scene in scenes]
    values, state = jax.tree.map(lambda *leaves: np.concatenate(leaves), *values_and_states)
    iterates = iterate(_merge_scenes(scenes).replace(**{name: values}), state, SETTLING_PERIODS)
    lane_slices = [slice(first_lane, first_lane + N_STARTS) for first_lane in range(0, len(values), N_STARTS)]
    return [
        _seed_orbits_of_scene(scene, name, values[lanes], iterates.select_lanes(lanes), max_period)
        for scene, lanes in zip(scenes, lane_slices, strict=True)
    ]


def free_seed_orbits(scene, name, bounds):
    """Yield the `SeedOrbit` of the motion without impacts at several values of a parameter, where it exists.

    The values cover both sides of a resonance, near which this motion may not exist.
    """
    template = make_orbit_problem(scene, name, periods=1)
    lower, upper = np.clip(parameter_domain(scene, name), *bounds)
    for value in np.linspace(lower, upper, N_FREE_VALUES + 2)[1:-1].tolist():
        orbit = free_orbit(scene.replace(**{name: value}))
        if orbit is not None:
            state = float(orbit.state.x), float(orbit.state.v)
            yield SeedOrbit(make_orbit_point(template, value, [], 1, state), np.array([state]))


def _draw_values_and_states(scene, name, bounds, seed):
    """Return values of the parameter and the random initial `State` at each."""
    lower, upper = np.clip(parameter_domain(scene, name), *bounds)
    rng = np.random.default_rng(seed)
    values = lower + (upper - lower) * (np.arange(N_STARTS) + rng.random(N_STARTS)) / N_STARTS
    return values, draw_initial_states(scene.replace(**{name: values}), N_STARTS, (seed, 1))


def _merge_scenes(scenes):
    """Merge scenes into one with one lane per start; parameters that differ become arrays."""

    def merge_leaves(*leaves):
        values = np.stack(leaves)
        return leaves[0] if (values == values[0]).all() else np.repeat(values, N_STARTS)

    return jax.tree.map(merge_leaves, *scenes)


def _seed_orbits_of_scene(scene, name, values, iterates, max_period):
    """Return the seed orbits of one scene, sorted by period and value."""
    scene_at_values, seed_orbits = scene.replace(**{name: values}), []
    template = make_orbit_problem(scene, name, periods=1)
    drive_periods = 2.0 * np.pi / np.broadcast_to(scene_at_values.frequency, len(values))
    is_inelastic = {
        wall_sign: np.broadcast_to(np.equal(scene_at_values.bounce(side), 0.0), len(values))
        for side, wall_sign in zip(SIDES, WALL_SIGNS, strict=True)
        if side in scene.walls
    }
    for lane, periods, impacts in settled_orbits(iterates, drive_periods, max_period, True):
        section_states = iterates.points[-periods:, lane]
        impact_list = [] if impacts is None else list(zip(*impacts, strict=True))
        point = make_orbit_point(template, float(values[lane]), impact_list, periods, section_states[-1].tolist())
        may_stick = impacts is None or any(is_inelastic[side][lane] for side in point.sides)
        seed_orbits.append(SeedOrbit(point, section_states, may_stick))
    return sorted(seed_orbits, key=lambda seed_orbit: (seed_orbit.point.periods, seed_orbit.point.value))


def settled_orbits(iterates, drive_periods, max_period, include_chatter=False):
    """Yield the lanes that have settled on periodic orbits.

    Parameters
    ----------
    iterates : IteratedStates
        States and impacts of many lanes over many drive periods.
    drive_periods : ndarray
        Duration of a drive period of each lane.
    max_period : int
        Largest number of drive periods of an orbit.
    include_chatter : bool, optional
        True to include lanes that stick, or that have too many bounces to be recorded.

    Yields
    ------
    lane : int
        Lane.
    periods : int
        Number of drive periods.
    impacts : tuple of ndarray or None
        Times, speeds and sides of the impacts; None for lanes with chatter.
    """
    section_states = iterates.points
    return_distances, max_distances = (
        compute_return_distances(section_states)[:max_period],
        RETURN_TOLERANCE * abs(section_states).max(axis=(0, 2)),
    )
    for lane in np.flatnonzero((return_distances < max_distances).any(axis=0) & (iterates.status < Status.CAP)):
        periods = int(np.argmax(return_distances[:, lane] < max_distances[lane])) + 1
        if iterates.status[lane] == Status.FULL or (abs(iterates.contact[-periods:, lane]) == Contact.STUCK).any():
            if include_chatter:
                yield int(lane), periods, None
            continue
        is_impact = iterates.side[-periods:, lane] != 0
        impact_times = iterates.time[-periods:, lane] + drive_periods[lane] * np.arange(periods)[:, None]
        sides = iterates.side[-periods:, lane].astype(float)
        yield (
            int(lane),
            periods,
            tuple(column[is_impact] for column in (impact_times, iterates.speed[-periods:, lane], sides)),
        )

"""Find seed orbits: periodic orbits on which random starts settle, at values over the whole range of a parameter."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..attractors.recurrence import compute_return_distances
from ..flight.wall_positions import WALL_SIGNS
from ..maps.initial_conditions import draw_initial_states
from ..maps.iterate import iterate
from ..orbits.free_response import free_orbit
from ..problem.orbit_point import OrbitPoint, make_orbit_point
from ..problem.orbit_problem import make_orbit_problem
from ..scene.codes import Contact, Status
from ..scene.scene import SIDES
from ..scene.scene_parameters import parameter_domain

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

"""Simulate initial states until they recur or reach a limit, and cluster the states on the same periodic orbit."""

from dataclasses import dataclass, field

import jax
import numpy as np
from jaxtyping import ArrayLike, Float

from continuation.computation_limits import UNLIMITED

from ..maps import itinerary
from ..maps.initial_conditions import initial_box
from ..maps.iterate import MAX_RECORDED_PERIODS, IteratedStates, iterate
from ..maps.long_iteration import take_lanes
from ..scene.codes import Status
from .recurrence import compute_return_distances, find_recurrence_periods

MAX_SETTLE_FACTOR = 16  # times `settle` periods: time limit of the transient
EXTENSION_FACTOR = 4  # times that while other lanes still settle: the rest may be transient as well


@dataclass
class OrbitCluster:
    """Lanes on one periodic orbit.

    Parameters
    ----------
    points : ndarray
        Points on the section. Array of shape (periods, 2).
    itinerary_words : tuple of str
        Itinerary.
    lanes : list of int, optional
        Lanes on the orbit.
    """

    points: Float[np.ndarray, "periods 2"]
    itinerary_words: tuple[str, ...]
    lanes: list[int] = field(default_factory=list)

    def contains(
        self, points: Float[np.ndarray, "states 2"], itinerary_words: tuple[str, ...], tolerance: Float[ArrayLike, ""]
    ) -> bool:
        """Return True if `points` and `itinerary_words` are those of the orbit, up to a shift of the start."""
        if len(points) != len(self.points) or not itinerary.is_same_itinerary(itinerary_words, self.itinerary_words):
            return False
        return is_rotated_orbit(points, self.points, tolerance)


def is_rotated_orbit(points, other_points, tolerance):
    """Return True if the points of two orbits agree up to a cyclic shift.

    Parameters
    ----------
    points : ndarray
        Points of one orbit. Array of shape (periods, 2).
    other_points : ndarray
        Points of another orbit with the same number of periods.
    tolerance : float
        Largest distance of points that agree.

    Returns
    -------
    bool
        True if a cyclic shift of one sequence agrees with the other.
    """
    return any(abs(np.roll(other_points, shift, axis=0) - points).max() <= tolerance for shift in range(len(points)))


def settle_lanes(scene, state, settle, computation_limits=UNLIMITED):
    """Simulate lanes until they settle on a periodic orbit, or reach the largest number of periods.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    state : State
        Initial states. Leaves of shape (lanes,).
    settle : int
        Drive periods before recurrence is tested, at least `MAX_RECORDED_PERIODS`. Further rounds of increasing length
        follow, up to `MAX_SETTLE_FACTOR` times as many periods. The limit is `EXTENSION_FACTOR` times larger after a
        round in which a lane has settled, because the chaos of the other lanes may be transient.
    computation_limits : Limits, optional
        Time limit, after which no further round is started.

    Returns
    -------
    iterates : IteratedStates
        Last iterates of the lanes.
    periods : ndarray
        Number of periods of the orbit on which each lane has settled; 0 for none. Array of shape (lanes,).
    scale : float
        Largest magnitude of x and v, and of the positions in the box of initial states.
    """
    elapsed_periods, round_periods = max(settle, MAX_RECORDED_PERIODS), MAX_RECORDED_PERIODS
    max_periods, has_any_settled = MAX_SETTLE_FACTOR * elapsed_periods, False
    iterates = iterate(scene, state, elapsed_periods, max_single_lanes=0)
    is_valid = iterates.status < Status.CAP
    start_box_x_min, start_box_x_max, _ = initial_box(scene)
    max_state_magnitude = max([abs(start_box_x_min), abs(start_box_x_max), *abs(iterates.v[:, is_valid]).ravel()])
    recurrence_periods = np.zeros(len(is_valid), int)
    previous_distances = compute_return_distances(iterates.points)
    while (
        active_lanes := np.flatnonzero(is_valid & (recurrence_periods == 0))
    ).size and elapsed_periods < max_periods * (EXTENSION_FACTOR if has_any_settled else 1):
        if computation_limits.expired:
            break
        later_iterates = iterate(
            scene,
            take_lanes(iterates.state, active_lanes),
            round_periods,
            max_single_lanes=0,
        )
        return_distances = compute_return_distances(later_iterates.points)
        recurrence_periods[active_lanes] = find_recurrence_periods(
            return_distances, previous_distances[:, active_lanes], round_periods, max_state_magnitude, scene.dtype
        )
        previous_distances[:, active_lanes], has_any_settled = (
            return_distances,
            bool(recurrence_periods[active_lanes].any()),
        )
        iterates = _replace_lanes(iterates, active_lanes, later_iterates)
        is_valid = iterates.status < Status.CAP
        elapsed_periods, round_periods = elapsed_periods + round_periods, 2 * round_periods
    return iterates, np.where(is_valid, recurrence_periods, 0), max_state_magnitude


def _replace_lanes(iterates, lanes, later_iterates):
    """Return iterates in which later iterates replace those of some lanes."""
    state = jax.tree.map(
        lambda array, values: _copy_with_lanes(array, lanes, values), iterates.state, later_iterates.state
    )
    status = _copy_with_lanes(iterates.status, lanes, later_iterates.status)
    records = (
        _copy_with_lanes(array, (slice(None), lanes), values)
        for array, values in zip(iterates[2:], later_iterates[2:], strict=True)
    )
    return IteratedStates(state, status, *records)


def _copy_with_lanes(array, lanes, values):
    """Return a copy of an array with new values at some lanes."""
    new_array = np.array(array)
    new_array[lanes] = values
    return new_array


def extract_orbit(iterates, lane, n_periods):
    """Return section points and itinerary of the last periods of a lane.

    Parameters
    ----------
    iterates : IteratedStates
        Iterates of the lanes.
    lane : int
        Index of the lane.
    n_periods : int
        Number of periods.

    Returns
    -------
    points : ndarray
        Points on the section. Array of shape (periods, 2).
    words : tuple of str
        Itinerary.
    """
    return iterates.points[-n_periods:, lane], itinerary.itinerary_of_rows(iterates.side[-n_periods:, lane])


def cluster_orbits(iterates, recurrence_periods, tolerance):
    """Return the `OrbitCluster`s of the lanes that have settled, in order of their first lanes.

    tolerance: largest distance of points of the same orbit.
    """
    orbit_clusters = []
    for lane in np.flatnonzero(recurrence_periods):
        points, itinerary_words = extract_orbit(iterates, lane, recurrence_periods[lane])
        cluster = next(
            (cluster for cluster in orbit_clusters if cluster.contains(points, itinerary_words, tolerance)), None
        )
        if cluster is None:
            cluster = OrbitCluster(points, itinerary_words)
            orbit_clusters.append(cluster)
        cluster.lanes.append(int(lane))
    return orbit_clusters

"""Simulate initial states until they recur or reach the time limit, and cluster those on the same periodic orbit."""

from dataclasses import dataclass, field

import jax
import numpy as np
from jaxtyping import ArrayLike, Float

from continuation.limits import UNLIMITED

from ..maps import itinerary
from ..maps.iterate import MAX_RECORDED_PERIODS, Iterates, iterate
from ..scene.codes import Status
from .recurrence import recurrence_distances, recurrence_periods

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
        """Return True if these points, up to rotation, are those of the orbit."""
        if len(points) != len(self.points) or not itinerary.is_same_itinerary(itinerary_words, self.itinerary_words):
            return False
        return is_rotation(points, self.points, tolerance)


def is_rotation(points, other_points, tolerance):
    """Return True if two sets of points of an orbit agree up to rotation.

    Parameters
    ----------
    points : ndarray
        Points of an orbit. Array of shape (periods, 2).
    other_points : ndarray
        Points of an orbit with as many periods.
    tolerance : float
        Largest distance of points that agree.

    Returns
    -------
    bool
        True if a rotation of one agrees with the other.
    """
    return any(abs(np.roll(other_points, shift, axis=0) - points).max() <= tolerance for shift in range(len(points)))


def settle_lanes(scene, state, settle, max_position, limits=UNLIMITED):
    """Simulate lanes until they settle on a periodic orbit, or reach the time limit of the transient.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    state : State
        Initial states. Leaves of shape (lanes,).
    settle : int
        Drive periods before recurrence is tested. Further rounds of increasing length follow, up to `MAX_SETTLE_FACTOR`
        times as many periods, and `EXTENSION_FACTOR` times that while lanes settle in each round: chaos may be
        transient.
    max_position : float
        Largest possible magnitude of x.
    limits : Limits, optional
        Time limit, after which no further round is started.

    Returns
    -------
    iterates : Iterates
        Last iterates of the lanes.
    periods : ndarray
        Period on which each lane has settled; 0 for none. Array of shape (lanes,).
    scale : float
        Largest magnitude of x and v.
    """
    elapsed_periods, round_periods = max(settle, MAX_RECORDED_PERIODS), MAX_RECORDED_PERIODS
    max_periods, any_settled = MAX_SETTLE_FACTOR * elapsed_periods, False
    iterates = iterate(scene, state, elapsed_periods, max_single_lanes=0)
    is_valid = iterates.status < Status.CAP
    scale = max([max_position, *abs(iterates.v[:, is_valid]).ravel()])
    periods = np.zeros(len(is_valid), int)
    previous_distances = recurrence_distances(iterates.points)
    while (active_lanes := np.flatnonzero(is_valid & (periods == 0))).size and elapsed_periods < max_periods * (
        EXTENSION_FACTOR if any_settled else 1
    ):
        if limits.expired:
            break
        next_iterates = iterate(
            scene,
            jax.tree.map(lambda leaf, active_lanes=active_lanes: leaf[active_lanes], iterates.state),
            round_periods,
            max_single_lanes=0,
        )
        distances = recurrence_distances(next_iterates.points)
        periods[active_lanes] = recurrence_periods(
            distances, previous_distances[:, active_lanes], round_periods, scale, scene.dtype
        )
        previous_distances[:, active_lanes], any_settled = distances, bool(periods[active_lanes].any())
        iterates = _replace_lanes(iterates, active_lanes, next_iterates)
        is_valid = iterates.status < Status.CAP
        elapsed_periods, round_periods = elapsed_periods + round_periods, 2 * round_periods
    return iterates, np.where(is_valid, periods, 0), scale


def _replace_lanes(iterates, lanes, next_iterates):
    """Return the iterates with later ones in place of some lanes."""
    state = jax.tree.map(lambda array, values: _with_lanes(array, lanes, values), iterates.state, next_iterates.state)
    status = _with_lanes(iterates.status, lanes, next_iterates.status)
    records = (
        _with_lanes(array, (slice(None), lanes), values)
        for array, values in zip(iterates[2:], next_iterates[2:], strict=True)
    )
    return Iterates(state, status, *records)


def _with_lanes(array, lanes, values):
    """Return a copy of the array with new values at some lanes."""
    result = np.array(array)
    result[lanes] = values
    return result


def extract_orbit(iterates, lane, periods):
    """Return the last periods of a lane.

    Parameters
    ----------
    iterates : Iterates
        Iterates of the lanes.
    lane : int
        Index of the lane.
    periods : int
        Number of periods.

    Returns
    -------
    points : ndarray
        Points on the section. Array of shape (periods, 2).
    words : tuple of str
        Itinerary.
    """
    return iterates.points[-periods:, lane], itinerary.words_of_rows(iterates.side[-periods:, lane])


def cluster_orbits(iterates, periods, tolerance):
    """Return the periodic orbits on which lanes have settled, in order of the first lane.

    tolerance: largest distance of points of the same orbit.
    """
    orbit_clusters = []
    for lane in np.flatnonzero(periods):
        points, itinerary_words = extract_orbit(iterates, lane, periods[lane])
        cluster = next(
            (cluster for cluster in orbit_clusters if cluster.contains(points, itinerary_words, tolerance)), None
        )
        if cluster is None:
            cluster = OrbitCluster(points, itinerary_words)
            orbit_clusters.append(cluster)
        cluster.lanes.append(int(lane))
    return orbit_clusters

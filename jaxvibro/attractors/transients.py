"""Starts are run on until they recur, or until patience ends; those on one periodic orbit are put together."""

from dataclasses import dataclass, field

import jax
import numpy as np
from jaxtyping import ArrayLike, Float

from continuation.limits import UNLIMITED

from ..maps import itinerary
from ..maps.iterate import MAX_RECORDED_PERIODS, Iterates, iterate
from ..scene.codes import Status
from .recurrence import recurrence_distances, recurrence_periods

MAX_SETTLE_FACTOR = 16  # times `settle` periods after which a start that has not recurred is given up
EXTENSION_FACTOR = 4  # times that, as long as others still settle: what is left may be on the way as well


@dataclass
class OrbitCluster:
    """Lanes on one periodic orbit: its points on Sigma, shape (periods, 2), and its itinerary."""

    points: Float[np.ndarray, "periods 2"]
    itinerary_words: tuple[str, ...]
    lanes: list[int] = field(default_factory=list)

    def contains(
        self, points: Float[np.ndarray, "states 2"], itinerary_words: tuple[str, ...], tolerance: Float[ArrayLike, ""]
    ) -> bool:
        """Whether these points are the orbit's, begun anywhere along it."""
        if len(points) != len(self.points) or not itinerary.is_same_itinerary(itinerary_words, self.itinerary_words):
            return False
        return is_rotation(points, self.points, tolerance)


def is_rotation(points, other_points, tolerance):
    """Whether points of an orbit (periods, 2) are others, begun anywhere along it."""
    return any(abs(np.roll(other_points, shift, axis=0) - points).max() <= tolerance for shift in range(len(points)))


def settle_lanes(scene, state, settle, max_position, limits=UNLIMITED):
    """(trail, periods, scale): the lanes' ends, the period each has settled on (0: none), the largest of x and v.

    A lane is run for `settle` periods, then on in ever longer rounds until it has settled, at most PATIENCE times as
    long altogether, and MORE times that while lanes settle in each round: chaos may be a transient. max_position: the
    largest x there may be. limits: no further round is begun once their time is over."""
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
    """The trail with a later one in place of some lanes'."""
    state = jax.tree.map(lambda array, values: _with_lanes(array, lanes, values), iterates.state, next_iterates.state)
    status = _with_lanes(iterates.status, lanes, next_iterates.status)
    records = (
        _with_lanes(array, (slice(None), lanes), values)
        for array, values in zip(iterates[2:], next_iterates[2:], strict=True)
    )
    return Iterates(state, status, *records)


def _with_lanes(array, lanes, values):
    result = np.array(array)
    result[lanes] = values
    return result


def extract_orbit(iterates, lane, periods):
    """(points, words) of the last periods of a lane."""
    return iterates.points[-periods:, lane], itinerary.words_of_rows(iterates.side[-periods:, lane])


def cluster_orbits(iterates, periods, tolerance):
    """The periodic orbits that lanes have settled on, in order of the first lane; tolerance: the distance that tells
    two."""
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

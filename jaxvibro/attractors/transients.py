"""Simulate initial states until they recur or reach a limit, and cluster the states on the same periodic orbit."""

from dataclasses import dataclass, field

import jax
import numpy as np
from jaxtyping import ArrayLike, Float

from continuation.branch_segment import UNLIMITED

from ..maps import itinerary
from ..maps.initial_conditions import initial_box
from ..maps.iterate import MAX_RECORDED_PERIODS, IteratedStates, iterate, take_lanes
from ..scene.check import MAX_ORBIT_PERIODS
from ..scene.state import Status


def compute_return_distances(section_points):
    """Return the largest distance of states that are n periods apart, for n from 1 to `MAX_ORBIT_PERIODS`.

    The largest distance is taken over the last `MAX_ORBIT_PERIODS` periods.

    Parameters
    ----------
    section_points : ndarray
        x and v on the section, over at least twice `MAX_ORBIT_PERIODS` periods. Array of shape (periods, lanes, 2).

    Returns
    -------
    ndarray
        Distances. Array of shape (MAX_ORBIT_PERIODS, lanes).
    """
    last_section_points = section_points[-MAX_ORBIT_PERIODS:]
    return np.stack(
        [
            abs(last_section_points - section_points[-MAX_ORBIT_PERIODS - n_periods : -n_periods]).max(axis=(0, 2))
            for n_periods in range(1, MAX_ORBIT_PERIODS + 1)
        ]
    )


def bound_limit_distance(return_distances, earlier_distances, periods_between):
    """Return a bound on the distance of lanes from their limit, from return distances at two times.

    Return distances that shrink by a factor q per period sum up to ``return_distances / (1 - q^n)``. If they do not
    shrink, the bound is infinite, except for a return distance of exactly 0. return_distances, earlier_distances:
    (MAX_ORBIT_PERIODS, lanes); periods_between: periods between the two measurements."""
    period_numbers = np.arange(1, MAX_ORBIT_PERIODS + 1)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        shrink_factors = np.where(return_distances < earlier_distances, return_distances / earlier_distances, 1.0) ** (
            period_numbers / periods_between
        )
        limit_distances = return_distances / (1.0 - shrink_factors)
    return np.where(return_distances == 0, 0.0, np.where(np.isnan(limit_distances), np.inf, limit_distances))


def find_recurrence_periods(return_distances, earlier_distances, periods_between, max_state_magnitude, dtype):
    """Return the number of periods after which each lane recurs, 0 if it has not settled.

    Parameters
    ----------
    return_distances : ndarray
        Present return distances. Array of shape (MAX_ORBIT_PERIODS, lanes).
    earlier_distances : ndarray
        Earlier return distances, of the same shape.
    periods_between : int
        Periods between the two measurements.
    max_state_magnitude : float or ndarray
        Largest magnitude of x and v, for all lanes or of shape (lanes,).
    dtype : dtype
        Floating-point type of the states.

    Returns
    -------
    ndarray
        Periods. Array of shape (lanes,).

    Notes
    -----
    A lane has settled on period n if its distance from the limit is at most ``tol = eps^(1/2) scale``, where
    scale is `max_state_magnitude`. Rounding errors end the decrease of the return distances. A lane has therefore also
    settled if its return distance is at most ``64 eps scale``, or is at most tol and no longer decreases. The result is
    the smallest divisor of the smallest such n whose return distance is at most 10 tol. Smaller return distances cannot
    be required, because the limit is known only to about tol.
    """
    machine_eps = np.finfo(dtype).eps
    tolerance = machine_eps**0.5 * max_state_magnitude
    has_stopped_shrinking = (return_distances <= 64.0 * machine_eps * max_state_magnitude) | (
        (return_distances <= tolerance) & (return_distances >= earlier_distances)
    )
    is_settled = has_stopped_shrinking | (
        bound_limit_distance(return_distances, earlier_distances, periods_between) <= tolerance
    )
    recurrence_periods = np.where(is_settled.any(axis=0), is_settled.argmax(axis=0) + 1, 0)
    returns_nearby = return_distances <= 10.0 * tolerance
    for lane in np.flatnonzero(recurrence_periods):
        recurrence_periods[lane] = _recurrent_divisor(recurrence_periods[lane], returns_nearby[:, lane])
    return recurrence_periods


def _recurrent_divisor(n_periods, returns_nearby):
    """Return the smallest divisor of `n_periods` after which the lane returns nearby; 0 for `n_periods` = 0."""
    return next(
        (
            divisor
            for divisor in range(1, n_periods + 1)
            if n_periods % divisor == 0 and (returns_nearby[divisor - 1] or divisor == n_periods)
        ),
        0,
    )


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

"""Search for the smallest shock that leads to another attractor, in shrinking discs.

The set of shocks that leave the basin of attraction may have a fractal boundary, and no gradient leads to the nearest
point of this boundary. A disc about the points of the attractor is therefore sampled evenly. The disc shrinks to the
smallest shock that leaves the basin. If no shock leaves the basin, the disc is sampled more densely.

Motions that start near a boundary have long transients, so the neighbourhoods of the shocks with the longest transients
are sampled too. Windows of decreasing size, down to rounding, are sampled about the smallest shock. Finally the ray
through the smallest shock is sampled.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
import scipy
from jaxtyping import Float

from continuation.branch_segment import UNLIMITED, Limits

from ..attractors.basin_labels import (
    OUTSIDE,
    UNRESOLVED,
    AttractorNeighbourhood,
    PointCloud,
    TrappingEllipses,
    label_starts_in_parallel,
)
from ..flight.wall_positions import wall_states
from ..scene.scene import SIDES, Scene

SEQUENCE_STEPS = (
    0.6180339887498949,
    (0.7548776662466927, 0.5698402909980532),
)  # steps of low-discrepancy sequences in one and two dimensions
FIRST_SHOCKS, SHOCK_FACTOR = 1 << 12, 4  # shocks of the first disc; factor for a disc that is sampled again
MIN_REDUCTION = 1e-5  # relative reduction below which a disc has not shrunk
N_SLOW_STARTS, SHOCKS_PER_START, N_WINDOW_WIDTHS = (
    64,
    128,
    5,
)  # slowest motions, shocks about each, windows of decreasing width
WINDOW_SHOCKS, MAX_REPEATS = (
    1024,
    3,
)  # shocks of a window about the smallest one; most windows of one width
RAY_SHOCKS = 256  # shocks along a ray
RAY_EXTENT = 2.0  # times the smallest shock: extent of its ray


class ShockProblem(NamedTuple):
    """Scene, phase and attractor of a search for the smallest shock.

    Attributes
    ----------
    scene : Scene
        Scene without lanes.
    phase : float
        Phase of the drive at the shock, in rad.
    neighbourhoods : list of AttractorNeighbourhood
        Neighbourhood of each attractor.
    attractor_index : int
        Index of the attractor on which the motion is before the shock.
    changes_position : bool
        True if the shocks change the position as well as the velocity.
    max_periods : int
        Largest number of drive periods of a motion.
    """

    scene: Scene
    phase: float
    neighbourhoods: list[AttractorNeighbourhood]
    attractor_index: int
    changes_position: bool
    max_periods: int


class ShockResult(NamedTuple):
    """Result of the search at one phase.

    Attributes
    ----------
    size : float
        Size of the smallest shock that leaves the basin of attraction; inf if no shock does.
    shock : ndarray
        Components dx and dv of this shock.
    point_before : ndarray
        x and v just before the shock.
    destination_index : int
        Index of the attractor that the motion approaches after the shock.
    bracket : tuple of float
        Size of a shock in the same direction after which the motion stays in the basin, and `size`.
    max_leaving_size : float
        Size up to which all tested shocks in the same direction, from `size` on, leave the basin.
    safe_size : float
        Size below which no shock leaves the basin, because a trapping region contains the states after all such shocks.
    n_smaller_tested : int
        Number of tested shocks that are smaller than `size`.
    n_undecided : int
        Number of the shocks counted in `n_smaller_tested` after which the motion approaches no attractor with
        certainty.
    least_undecided : float
        Size of the smallest undecided shock of all tests; inf if no shock is undecided.
    is_complete : bool
        True if the search was completed.
    """

    size: float
    shock: Float[np.ndarray, "2"]
    point_before: Float[np.ndarray, "2"]
    destination_index: int
    bracket: tuple[float, float]
    max_leaving_size: float
    safe_size: float
    n_smaller_tested: int
    n_undecided: int
    least_undecided: float
    is_complete: bool


def search_least_shock(
    problem: ShockProblem,
    max_size: float,
    max_disc_shocks: int,
    seed: int,
    report_n_shocks_done: Callable[[int], object],
    computation_limits: Limits = UNLIMITED,
) -> ShockResult:
    """Search for the smallest shock at one phase, of size up to `max_size`, with up to `max_disc_shocks` shocks per
    disc.

    report_n_shocks_done: called with the number of shocks after each batch of tests; computation_limits: limits, after
    which the smallest of the tested shocks is returned."""
    shock_search = _SmallestShockSearch(
        problem, max_size, np.random.default_rng(seed), report_n_shocks_done, computation_limits
    )
    n_disc_shocks = min(FIRST_SHOCKS, max_disc_shocks)
    while True:
        previous_size = shock_search.size
        shock_search.test_disc(n_disc_shocks)
        if shock_search.is_out_of_time():
            break
        if shock_search.size > (1.0 - MIN_REDUCTION) * previous_size:
            shock_search.test_near_slowest(n_disc_shocks)
        if shock_search.size < previous_size:
            shock_search.test_near_smallest()
        if shock_search.size <= shock_search.rounding_size:
            break
        if shock_search.size > (1.0 - MIN_REDUCTION) * previous_size:
            if n_disc_shocks == max_disc_shocks:
                break
            n_disc_shocks = min(SHOCK_FACTOR * n_disc_shocks, max_disc_shocks)
    return shock_search.result(shock_search.search_ray())


def empty_result(problem: ShockProblem) -> ShockResult:
    """Return the result of a phase at which no shock has been tested."""
    undefined_pair, trapping_region = np.full(2, np.nan), problem.neighbourhoods[problem.attractor_index].region
    safe_radius = 0.0 if trapping_region is None else largest_safe_shock_size(trapping_region, problem.changes_position)
    return ShockResult(
        np.nan, undefined_pair, undefined_pair, -1, (np.nan, np.nan), np.nan, safe_radius, 0, 0, np.inf, False
    )


class _SmallestShockSearch:
    """State of a search: the smallest tested shock that leaves the basin, and the record of all tests."""

    def __init__(self, problem, max_size, rng, report_n_shocks_done, computation_limits):
        self.problem, self.rng, self.count_shocks, self.limits, self.complete = (
            problem,
            rng,
            report_n_shocks_done,
            computation_limits,
            True,
        )
        self.points = clip_to_walls(
            problem.scene, problem.phase, points_before_shock(problem.neighbourhoods[problem.attractor_index])
        )
        self.tree = scipy.spatial.cKDTree(self.points)
        self.rounding_size = (
            np.finfo(problem.scene.dtype).eps * abs(self.points).max()
        )  # smaller shocks vanish in rounding
        self.size, self.point_index, self.shock, self.destination_index = max_size, -1, np.full(2, np.nan), -1
        self.sizes, self.undecided_sizes = [], []
        self.last_staying_shocks, self.n_sequence_points = None, 0

    def is_out_of_time(self):
        """Return True if the time limit is reached, and mark the search as incomplete."""
        self.complete = self.complete and not self.limits.expired
        return not self.complete

    def test_shocks(self, point_indices, shocks):
        """Test shocks (lanes, 2) that are smaller than the smallest known one; return (labels, sizes) of these.

        point_indices: indices of the points of the attractor to which the shocks are applied. The smallest shock that
        leaves the basin is stored.
        """
        shocked_states = self.points[point_indices] + shocks
        if self.problem.changes_position and len(self.points) > 1:
            point_indices = self.tree.query(shocked_states)[1]
            shocks = shocked_states - self.points[point_indices]
        shock_sizes = np.hypot(*shocks.T)
        is_smaller = shock_sizes < self.size
        if not is_smaller.any():
            return np.empty(0, np.int32), np.empty(0)
        point_indices, shocks, shock_sizes, shocked_states = (
            point_indices[is_smaller],
            shocks[is_smaller],
            shock_sizes[is_smaller],
            shocked_states[is_smaller],
        )
        scene, phase, neighbourhoods, attractor_index, _, max_periods = self.problem
        labels, periods = label_starts_in_parallel(scene, *shocked_states.T, phase, neighbourhoods, max_periods)
        self.count_shocks(len(shocked_states))
        self.sizes.append(shock_sizes[labels != OUTSIDE])
        self.undecided_sizes.append(shock_sizes[labels == UNRESOLVED])
        is_leaving = (labels >= 0) & (labels != attractor_index)
        if is_leaving.any():
            smallest_index = np.where(is_leaving, shock_sizes, np.inf).argmin()
            self.size, self.point_index, self.destination_index = (
                float(shock_sizes[smallest_index]),
                int(point_indices[smallest_index]),
                int(labels[smallest_index]),
            )
            self.shock = shocks[smallest_index]
        is_staying = (labels == attractor_index) & (shock_sizes < self.size)
        self.last_staying_shocks = point_indices[is_staying], shocks[is_staying], periods[is_staying]
        return labels, shock_sizes

    def test_disc(self, n_shocks):
        """Test `n_shocks` shocks, distributed evenly over the disc whose radius is the smallest known size."""
        point_indices = self.rng.integers(len(self.points), size=n_shocks)
        sequence_indices = self.n_sequence_points + np.arange(1, n_shocks + 1)
        self.n_sequence_points += n_shocks
        self.test_shocks(point_indices, self.size * self._evenly_spread_shocks(sequence_indices))

    def _evenly_spread_shocks(self, sequence_indices):
        """Return evenly distributed shocks (lanes, 2) of sizes below 1."""
        if not self.problem.changes_position:
            return np.stack(
                [np.zeros(len(sequence_indices)), 2.0 * (SEQUENCE_STEPS[0] * sequence_indices % 1.0) - 1.0], -1
            )
        shock_radii, shock_angles = (
            np.sqrt(SEQUENCE_STEPS[1][0] * sequence_indices % 1.0),
            2.0 * np.pi * (SEQUENCE_STEPS[1][1] * sequence_indices % 1.0),
        )
        return shock_radii[:, None] * np.stack([np.cos(shock_angles), np.sin(shock_angles)], -1)

    def test_near_slowest(self, n_shocks):
        """Test windows of decreasing width about shocks of the last test after which the motion returns latest."""
        window_width = self.size * (np.sqrt(np.pi / n_shocks) if self.problem.changes_position else 2.0 / n_shocks)
        for _ in range(N_WINDOW_WIDTHS):
            point_indices, shocks, periods = self.last_staying_shocks
            random_order = self.rng.permutation(len(periods))
            slowest_indices = random_order[np.argsort(-periods[random_order], kind="stable")[:N_SLOW_STARTS]]
            if not slowest_indices.size or self.is_out_of_time():
                return
            slowest_indices = np.repeat(slowest_indices, SHOCKS_PER_START)
            self._test_window(point_indices[slowest_indices], shocks[slowest_indices], window_width)
            window_width /= 4.0

    def test_near_smallest(self):
        """Test windows of decreasing width about the smallest known shock."""
        relative_width, n_same_width_windows = 0.5, 0
        while relative_width > np.finfo(self.problem.scene.dtype).eps ** 0.5 and not self.is_out_of_time():
            previous_size = self.size
            self._test_window(
                np.full(WINDOW_SHOCKS, self.point_index),
                np.tile(self.shock, (WINDOW_SHOCKS, 1)),
                relative_width * previous_size,
            )
            n_same_width_windows = n_same_width_windows + 1 if self.size < previous_size else MAX_REPEATS
            if n_same_width_windows >= MAX_REPEATS:
                relative_width, n_same_width_windows = relative_width / 4.0, 0

    def _test_window(self, point_indices, shocks, window_width):
        """Test a random shock within `window_width` of each shock (lanes, 2), at the same or a nearby point."""
        if len(self.points) > 1:
            jittered_points, point_indices = (
                self.points[point_indices] + window_width * self._random_unit_shocks(len(point_indices), True),
                point_indices,
            )
            distances, nearest_indices = self.tree.query(jittered_points)
            point_indices = np.where(distances <= window_width, nearest_indices, point_indices)
        self.test_shocks(
            point_indices,
            shocks + window_width * self._random_unit_shocks(len(point_indices), self.problem.changes_position),
        )

    def _random_unit_shocks(self, n_shocks, changes_position):
        """Return random shocks (lanes, 2) of sizes below 1."""
        shock_angles, shock_radii = 2.0 * np.pi * self.rng.random(n_shocks), np.sqrt(self.rng.random(n_shocks))
        if not changes_position:
            return np.stack([np.zeros(n_shocks), 2.0 * self.rng.random(n_shocks) - 1.0], -1)
        return shock_radii[:, None] * np.stack([np.cos(shock_angles), np.sin(shock_angles)], -1)

    def search_ray(self):
        """Return `bracket` and `max_leaving_size` of the `ShockResult`, from shocks along the smallest shock."""
        if self.destination_index < 0:
            return (self.size, np.inf), np.inf
        if self.size <= self.rounding_size:
            return (0.0, self.size), self.size
        staying_size, eps = 0.0, np.finfo(self.problem.scene.dtype).eps
        ray_fractions = np.arange(1, RAY_SHOCKS) / RAY_SHOCKS
        while self.size - staying_size > eps**0.5 * self.size and not self.is_out_of_time():
            leaving_size, point_index, shock_direction = self.size, self.point_index, self.shock / self.size
            trial_sizes = staying_size + ray_fractions * (leaving_size - staying_size)
            self.test_shocks(np.full(len(trial_sizes), point_index), trial_sizes[:, None] * shock_direction)
            staying_size = max(staying_size, *trial_sizes[trial_sizes < self.size].tolist())
        return (staying_size, self.size), self._largest_leaving_size()

    def _largest_leaving_size(self):
        """Return the size up to which all tested shocks on the ray leave the basin of attraction."""
        scene, phase, neighbourhoods, attractor_index, _, max_periods = self.problem
        trial_sizes = self.size * (1.0 + (RAY_EXTENT - 1.0) * np.geomspace(1e-6, 1.0, RAY_SHOCKS))
        shocked_states = self.points[self.point_index] + trial_sizes[:, None] * (self.shock / self.size)
        labels, _ = label_starts_in_parallel(scene, *shocked_states.T, phase, neighbourhoods, max_periods)
        nonleaving_indices = np.flatnonzero((labels < 0) | (labels == attractor_index))
        return float(np.append(self.size, trial_sizes)[nonleaving_indices[0] if nonleaving_indices.size else -1])

    def result(self, ray_result):
        """Return the `ShockResult` of the smallest shock."""
        (bracket, all_leave_up_to_size), has_shock = ray_result, self.destination_index >= 0
        tested_sizes, undecided_sizes = np.concatenate(self.sizes), np.concatenate(self.undecided_sizes)
        neighbourhood = self.problem.neighbourhoods[self.problem.attractor_index]
        return ShockResult(
            size=self.size if has_shock else np.inf,
            shock=self.shock,
            point_before=self.points[self.point_index] if has_shock else np.full(2, np.nan),
            destination_index=self.destination_index,
            bracket=bracket,
            max_leaving_size=all_leave_up_to_size,
            safe_size=largest_safe_shock_size(neighbourhood.region, self.problem.changes_position),
            n_smaller_tested=int((tested_sizes < self.size).sum()),
            n_undecided=int((undecided_sizes < self.size).sum()),
            least_undecided=float(undecided_sizes.min(initial=np.inf)),
            is_complete=self.complete,
        )


def points_before_shock(neighbourhood: AttractorNeighbourhood) -> Float[np.ndarray, "points 2"]:
    """Return the points of a periodic attractor, or a sample of a chaotic one, to which shocks are applied."""
    return np.asarray(
        neighbourhood.region.tree.data if isinstance(neighbourhood.region, PointCloud) else neighbourhood.points
    )


def clip_to_walls(scene, phase, points):
    """Return points (lanes, 2), with points that are beyond a rigid wall by rounding moved onto the wall."""
    for wall_sign, side, (wall_position, _) in zip(
        (1.0, -1.0), SIDES, jax.device_get(wall_states(scene, phase)), strict=True
    ):
        wall = getattr(scene, side)
        if wall is not None and not wall.soft:
            clipped_x = wall_sign * np.maximum(wall_sign * points[:, 0], wall_sign * wall_position)
            points = np.stack([clipped_x, points[:, 1]], -1)
    return points


def largest_safe_shock_size(trapping_region: TrappingEllipses | PointCloud, changes_position: bool) -> float:
    """Return the size below which shocks in all directions stay in the trapping region; 0 for a point cloud."""
    if isinstance(trapping_region, PointCloud):
        return 0.0
    inverse_radii = [
        np.linalg.norm(ellipse_matrix, 2) if changes_position else np.hypot(*ellipse_matrix[:, 1])
        for ellipse_matrix in trapping_region.ellipse_matrices
    ]
    return float(1.0 / max(inverse_radii))

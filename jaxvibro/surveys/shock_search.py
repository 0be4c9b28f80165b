"""Search for the smallest shock that leads to another attractor, in shrinking discs.

The set of shocks that leave may have a fractal boundary, and no gradient leads to its nearest point. So a disc about
the attractor's points is sampled evenly and shrinks to the smallest shock that leaves. If none does, the disc is
sampled more densely. Motions take longer the nearer they start to a boundary, so the surroundings of the slowest ones
are sampled too. About each smallest shock windows of decreasing size are sampled, down to rounding, and finally its own
ray.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
import scipy
from jaxtyping import Float

from continuation.limits import UNLIMITED, Limits

from ..attractors.basin_labels import OUTSIDE, UNRESOLVED, AttractorNeighbourhood, assign_labels
from ..attractors.trapping_region import PointCloud, TrappingRegion
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
    """Scene, phase and attractor of a search.

    Attributes
    ----------
    scene : Scene
        Scene without lanes.
    phase : float
        Phase of the drive at the shock, in rad.
    neighbourhoods : list of AttractorNeighbourhood
        Neighbourhood of each attractor.
    attractor_index : int
        Index of the attractor to be left.
    is_planar : bool
        True if positions change too.
    max_periods : int
        Largest number of drive periods of a motion.
    """

    scene: Scene
    phase: float
    neighbourhoods: list[AttractorNeighbourhood]
    attractor_index: int
    is_planar: bool
    max_periods: int


class ShockResult(NamedTuple):
    """Result of the search at one phase.

    Attributes
    ----------
    size : float
        Smallest shock that leaves; inf if none does.
    shock : ndarray
        dx and dv.
    point_before : ndarray
        x and v just before the shock.
    to : int
        Index of the attractor that the motion approaches.
    bracket : tuple of float
        A size on its ray that stays, and the smallest size that leaves.
    until : float
        Size up to which all tested shocks on the ray leave.
    safe : float
        Size below which no shock leaves, since a trapping region contains all of them.
    below : int
        Number of smaller shocks tested.
    undecided : int
        Number of these that do not certainly approach any attractor.
    least_undecided : float
        Smallest of all such; inf without.
    complete : bool
        True if the search was completed.
    """

    size: float
    shock: Float[np.ndarray, "2"]
    point_before: Float[np.ndarray, "2"]
    to: int
    bracket: tuple[float, float]
    until: float
    safe: float
    below: int
    undecided: int
    least_undecided: float
    complete: bool


def search_least_shock(
    problem: ShockProblem,
    max_size: float,
    max_shocks: int,
    seed: int,
    count_shocks: Callable[[int], object],
    limits: Limits = UNLIMITED,
) -> ShockResult:
    """Return the smallest shock at one phase, at most `max_size`, for discs of up to `max_shocks` shocks.

    count_shocks: called with the number of shocks of each call; limits: time limit, after which the smallest shock up
    to then is returned.
    """
    shock_search = _ShockSearch(problem, max_size, np.random.default_rng(seed), count_shocks, limits)
    n_shocks = min(FIRST_SHOCKS, max_shocks)
    while True:
        previous_size = shock_search.size
        shock_search.try_disc(n_shocks)
        if shock_search.is_out_of_time():
            break
        if shock_search.size > (1.0 - MIN_REDUCTION) * previous_size:
            shock_search.try_slow_windows(n_shocks)
        if shock_search.size < previous_size:
            shock_search.try_near_least()
        if shock_search.size <= shock_search.rounding_size:
            break
        if shock_search.size > (1.0 - MIN_REDUCTION) * previous_size:
            if n_shocks == max_shocks:
                break
            n_shocks = min(SHOCK_FACTOR * n_shocks, max_shocks)
    return shock_search.result(shock_search.search_ray())


def empty_result(problem: ShockProblem) -> ShockResult:
    """Return the result of a phase at which no shock has been tested."""
    undefined, region = np.full(2, np.nan), problem.neighbourhoods[problem.attractor_index].region
    safe_radius = 0.0 if region is None else safe_size(region, problem.is_planar)
    return ShockResult(np.nan, undefined, undefined, -1, (np.nan, np.nan), np.nan, safe_radius, 0, 0, np.inf, False)


class _ShockSearch:
    """Smallest shock up to now, of sizes below `size`, and the record of all tests."""

    def __init__(self, problem, max_size, rng, count_shocks, limits):
        self.problem, self.rng, self.count_shocks, self.limits, self.complete = problem, rng, count_shocks, limits, True
        self.points = clip_to_walls(
            problem.scene, problem.phase, base_points(problem.neighbourhoods[problem.attractor_index])
        )
        self.tree = scipy.spatial.cKDTree(self.points)
        self.rounding_size = (
            np.finfo(problem.scene.dtype).eps * abs(self.points).max()
        )  # smaller shocks vanish in rounding
        self.size, self.base_index, self.shock, self.destination = max_size, -1, np.full(2, np.nan), -1
        self.sizes, self.undecided_sizes = [], []
        self.last_stays, self.n_drawn = None, 0

    def is_out_of_time(self):
        """Return True if the time is used up; the result is then not complete."""
        self.complete = self.complete and not self.limits.expired
        return not self.complete

    def try_shocks(self, base_indices, shocks):
        """Test shocks (lanes, 2) of these points, keep the smallest that leaves, and return (labels, sizes)."""
        z = self.points[base_indices] + shocks
        if self.problem.is_planar and len(self.points) > 1:
            base_indices = self.tree.query(z)[1]
            shocks = z - self.points[base_indices]
        size = np.hypot(*shocks.T)
        is_smaller = size < self.size
        if not is_smaller.any():
            return np.empty(0, np.int32), np.empty(0)
        base_indices, shocks, size, z = base_indices[is_smaller], shocks[is_smaller], size[is_smaller], z[is_smaller]
        scene, phase, neighbourhoods, index, _, max_periods = self.problem
        labels, periods = assign_labels(scene, *z.T, phase, neighbourhoods, max_periods)
        self.count_shocks(len(z))
        self.sizes.append(size[labels != OUTSIDE])
        self.undecided_sizes.append(size[labels == UNRESOLVED])
        is_escaping = (labels >= 0) & (labels != index)
        if is_escaping.any():
            best = np.where(is_escaping, size, np.inf).argmin()
            self.size, self.base_index, self.destination = float(size[best]), int(base_indices[best]), int(labels[best])
            self.shock = shocks[best]
        is_staying = (labels == index) & (size < self.size)
        self.last_stays = base_indices[is_staying], shocks[is_staying], periods[is_staying]
        return labels, size

    def try_disc(self, n_shocks):
        """Test `n_shocks` shocks, distributed evenly over the sizes below the smallest one."""
        base_indices = self.rng.integers(len(self.points), size=n_shocks)
        sequence_indices = self.n_drawn + np.arange(1, n_shocks + 1)
        self.n_drawn += n_shocks
        self.try_shocks(base_indices, self.size * self._even_shocks(sequence_indices))

    def _even_shocks(self, sequence_indices):
        """Return evenly distributed shocks (lanes, 2) of sizes below 1."""
        if not self.problem.is_planar:
            return np.stack(
                [np.zeros(len(sequence_indices)), 2.0 * (SEQUENCE_STEPS[0] * sequence_indices % 1.0) - 1.0], -1
            )
        radius, angle = (
            np.sqrt(SEQUENCE_STEPS[1][0] * sequence_indices % 1.0),
            2.0 * np.pi * (SEQUENCE_STEPS[1][1] * sequence_indices % 1.0),
        )
        return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)

    def try_slow_windows(self, n_shocks):
        """Test windows of decreasing width about the slowest shocks of the last disc."""
        width = self.size * (np.sqrt(np.pi / n_shocks) if self.problem.is_planar else 2.0 / n_shocks)
        for _ in range(N_WINDOW_WIDTHS):
            base_indices, shocks, periods = self.last_stays
            order = self.rng.permutation(len(periods))
            slowest = order[np.argsort(-periods[order], kind="stable")[:N_SLOW_STARTS]]
            if not slowest.size or self.is_out_of_time():
                return
            slowest = np.repeat(slowest, SHOCKS_PER_START)
            self._try_window(base_indices[slowest], shocks[slowest], width)
            width /= 4.0

    def try_near_least(self):
        """Test windows of decreasing width about the smallest shock, moving with it."""
        width, n_repeats = 0.5, 0
        while width > np.finfo(self.problem.scene.dtype).eps ** 0.5 and not self.is_out_of_time():
            previous_size = self.size
            self._try_window(
                np.full(WINDOW_SHOCKS, self.base_index), np.tile(self.shock, (WINDOW_SHOCKS, 1)), width * previous_size
            )
            n_repeats = n_repeats + 1 if self.size < previous_size else MAX_REPEATS
            if n_repeats >= MAX_REPEATS:
                width, n_repeats = width / 4.0, 0

    def _try_window(self, base_indices, shocks, width):
        """Test one shock within `width` of each of these (lanes, 2), also from nearby points of a sample."""
        if len(self.points) > 1:
            trial_points, base_indices = (
                self.points[base_indices] + width * self._random_shocks(len(base_indices), True),
                base_indices,
            )
            distances, nearest = self.tree.query(trial_points)
            base_indices = np.where(distances <= width, nearest, base_indices)
        self.try_shocks(base_indices, shocks + width * self._random_shocks(len(base_indices), self.problem.is_planar))

    def _random_shocks(self, n_shocks, is_planar):
        """Return random shocks (lanes, 2) of sizes below 1."""
        angle, radius = 2.0 * np.pi * self.rng.random(n_shocks), np.sqrt(self.rng.random(n_shocks))
        if not is_planar:
            return np.stack([np.zeros(n_shocks), 2.0 * self.rng.random(n_shocks) - 1.0], -1)
        return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)

    def search_ray(self):
        """Return (bracket, until) of the smallest shock in its direction."""
        if self.destination < 0:
            return (self.size, np.inf), np.inf
        if self.size <= self.rounding_size:
            return (0.0, self.size), self.size
        lower, eps = 0.0, np.finfo(self.problem.scene.dtype).eps
        fractions = np.arange(1, RAY_SHOCKS) / RAY_SHOCKS
        while self.size - lower > eps**0.5 * self.size and not self.is_out_of_time():
            upper, base_index, direction = self.size, self.base_index, self.shock / self.size
            sizes = lower + fractions * (upper - lower)
            self.try_shocks(np.full(len(sizes), base_index), sizes[:, None] * direction)
            lower = max(lower, *sizes[sizes < self.size].tolist())
        return (lower, self.size), self._ray_limit()

    def _ray_limit(self):
        """Return the size up to which all tested shocks on the ray leave."""
        scene, phase, neighbourhoods, index, _, max_periods = self.problem
        sizes = self.size * (1.0 + (RAY_EXTENT - 1.0) * np.geomspace(1e-6, 1.0, RAY_SHOCKS))
        z = self.points[self.base_index] + sizes[:, None] * (self.shock / self.size)
        labels, _ = assign_labels(scene, *z.T, phase, neighbourhoods, max_periods)
        stay_indices = np.flatnonzero((labels < 0) | (labels == index))
        return float(np.append(self.size, sizes)[stay_indices[0] if stay_indices.size else -1])

    def result(self, ray_result):
        """Return the `ShockResult` of the smallest shock."""
        (bracket, until), has_shock = ray_result, self.destination >= 0
        sizes, undecided_sizes = np.concatenate(self.sizes), np.concatenate(self.undecided_sizes)
        neighbourhood = self.problem.neighbourhoods[self.problem.attractor_index]
        return ShockResult(
            size=self.size if has_shock else np.inf,
            shock=self.shock,
            point_before=self.points[self.base_index] if has_shock else np.full(2, np.nan),
            to=self.destination,
            bracket=bracket,
            until=until,
            safe=safe_size(neighbourhood.region, self.problem.is_planar),
            below=int((sizes < self.size).sum()),
            undecided=int((undecided_sizes < self.size).sum()),
            least_undecided=float(undecided_sizes.min(initial=np.inf)),
            complete=self.complete,
        )


def base_points(neighbourhood: AttractorNeighbourhood) -> Float[np.ndarray, "points 2"]:
    """Return the points of an attractor to which shocks are applied; for a chaotic one all of its sample."""
    return np.asarray(
        neighbourhood.region.tree.data if isinstance(neighbourhood.region, PointCloud) else neighbourhood.points
    )


def clip_to_walls(scene, phase, points):
    """Return points (lanes, 2); points that rounding puts beyond a rigid wall are moved onto it."""
    for sign, side, (position, _) in zip((1.0, -1.0), SIDES, jax.device_get(wall_states(scene, phase)), strict=True):
        wall = getattr(scene, side)
        if wall is not None and not wall.soft:
            x = sign * np.maximum(sign * points[:, 0], sign * position)
            points = np.stack([x, points[:, 1]], -1)
    return points


def safe_size(region: TrappingRegion | PointCloud, is_planar: bool) -> float:
    """Return the size below which no shock in any direction leaves the trapping region; 0 for a point cloud."""
    if isinstance(region, PointCloud):
        return 0.0
    norms = [
        np.linalg.norm(ellipse_matrix, 2) if is_planar else np.hypot(*ellipse_matrix[:, 1])
        for ellipse_matrix in region.ellipse_matrices
    ]
    return float(1.0 / max(norms))

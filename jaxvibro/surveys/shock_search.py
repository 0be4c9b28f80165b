"""The least of very many shocks that leads to another attractor: discs that shrink to the least one found.

Which starts leave is a set whose edge may be fractal, and no slope leads to its nearest point. So a disc about the
attractor's points is tried evenly, and shrinks to the least shock that leaves; where none does, it is tried more
densely, and, as starts take the longer the nearer to an edge they are, closely about those that took longest. About
each least one windows of all sizes are tried, down to rounding, and at the end its own ray.
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
)  # steps of even sequences in one and two numbers
FIRST_SHOCKS, SHOCK_FACTOR = 1 << 12, 4  # shocks of the first disc; times as many in one that is tried again
MIN_REDUCTION = 1e-5  # of the size: by less a disc has not shrunk
N_SLOW_STARTS, SHOCKS_PER_START, N_WINDOW_WIDTHS = (
    64,
    128,
    5,
)  # starts that took longest, shocks tried about each, windows a quarter as wide
WINDOW_SHOCKS, MAX_REPEATS = 1024, 3  # shocks of a window about the least one; windows of one size at most
RAY_SHOCKS = 256  # shocks tried along a ray
RAY_EXTENT = 2.0  # times the least shock: so far its direction is tried


class ShockProblem(NamedTuple):
    """Where shocks are tried: a single scene at a phase of the drive (rad), the `AttractorNeighbourhood` of each of its
    attractors, the place of the one that is to be left; is_planar: whether positions change too; max_periods: drive
    periods of a start."""

    scene: Scene
    phase: float
    neighbourhoods: list[AttractorNeighbourhood]
    attractor_index: int
    is_planar: bool
    max_periods: int


class ShockResult(NamedTuple):
    """What came of one phase. size: of the least shock that leaves, inf where none does; shock: (dx, dv); point_before:
    (x, v); to: the attractor's place; bracket: (one that stays, the least that leaves) on its ray; until: up to here
    all tried on the ray leave; safe: none smaller leaves, as a trap holds them all; below: smaller ones that were
    tried; undecided: how many of them are certain to be on no attractor; least_undecided: the least of all such, else
    inf; complete: whether the search came to its end."""

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
    """The least shock at one phase: no longer than `max_size`, looked for until so many in a disc find none smaller.

    count_shocks: called with the number of shocks of each call. limits: once the time is over the least shock so far is
    given."""
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
    """What is known of a phase at which no shock has been tried."""
    undefined, region = np.full(2, np.nan), problem.neighbourhoods[problem.attractor_index].region
    safe_radius = 0.0 if region is None else safe_size(region, problem.is_planar)
    return ShockResult(np.nan, undefined, undefined, -1, (np.nan, np.nan), np.nan, safe_radius, 0, 0, np.inf, False)


class _ShockSearch:
    """The least shock so far, of sizes below `size`, and all that was tried."""

    def __init__(self, problem, max_size, rng, count_shocks, limits):
        self.problem, self.rng, self.count_shocks, self.limits, self.complete = problem, rng, count_shocks, limits, True
        self.points = clip_to_walls(
            problem.scene, problem.phase, base_points(problem.neighbourhoods[problem.attractor_index])
        )
        self.tree = scipy.spatial.cKDTree(self.points)
        self.rounding_size = (
            np.finfo(problem.scene.dtype).eps * abs(self.points).max()
        )  # smaller ones are lost in rounding
        self.size, self.base_index, self.shock, self.destination = max_size, -1, np.full(2, np.nan), -1
        self.sizes, self.undecided_sizes = [], []
        self.last_stays, self.n_drawn = None, 0

    def is_out_of_time(self):
        """Return True if the time is over; what is found is then not complete."""
        self.complete = self.complete and not self.limits.expired
        return not self.complete

    def try_shocks(self, base_indices, shocks):
        """Tries shocks (lanes, 2) of the points at these places and keeps the least that leaves: (labels, sizes)."""
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
        """Tries so many shocks, evenly over the sizes below the least one."""
        base_indices = self.rng.integers(len(self.points), size=n_shocks)
        sequence_indices = self.n_drawn + np.arange(1, n_shocks + 1)
        self.n_drawn += n_shocks
        self.try_shocks(base_indices, self.size * self._even_shocks(sequence_indices))

    def _even_shocks(self, sequence_indices):
        """Even shocks (lanes, 2) of sizes below 1."""
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
        """Tries windows about those shocks of the last disc that took longest, ever smaller ones."""
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
        """Tries windows about the least shock, ever smaller ones, and goes along with it."""
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
        """Tries shocks no further than a width from these (lanes, 2), one each; of a sample's near points too."""
        if len(self.points) > 1:
            trial_points, base_indices = (
                self.points[base_indices] + width * self._random_shocks(len(base_indices), True),
                base_indices,
            )
            distances, nearest = self.tree.query(trial_points)
            base_indices = np.where(distances <= width, nearest, base_indices)
        self.try_shocks(base_indices, shocks + width * self._random_shocks(len(base_indices), self.problem.is_planar))

    def _random_shocks(self, n_shocks, is_planar):
        angle, radius = 2.0 * np.pi * self.rng.random(n_shocks), np.sqrt(self.rng.random(n_shocks))
        if not is_planar:
            return np.stack([np.zeros(n_shocks), 2.0 * self.rng.random(n_shocks) - 1.0], -1)
        return radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)

    def search_ray(self):
        """(bracket, until) of the least shock in its direction."""
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
        scene, phase, neighbourhoods, index, _, max_periods = self.problem
        sizes = self.size * (1.0 + (RAY_EXTENT - 1.0) * np.geomspace(1e-6, 1.0, RAY_SHOCKS))
        z = self.points[self.base_index] + sizes[:, None] * (self.shock / self.size)
        labels, _ = assign_labels(scene, *z.T, phase, neighbourhoods, max_periods)
        stay_indices = np.flatnonzero((labels < 0) | (labels == index))
        return float(np.append(self.size, sizes)[stay_indices[0] if stay_indices.size else -1])

    def result(self, ray_result):
        """The `ShockResult` of the least shock."""
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
    """The points of an attractor that shocks are tried from: of a chaotic one all of its sample."""
    return np.asarray(
        neighbourhood.region.tree.data if isinstance(neighbourhood.region, PointCloud) else neighbourhood.points
    )


def clip_to_walls(scene, phase, points):
    """Points (lanes, 2), those that rounding puts beyond a rigid wall on it."""
    for sign, side, (position, _) in zip((1.0, -1.0), SIDES, jax.device_get(wall_states(scene, phase)), strict=True):
        wall = getattr(scene, side)
        if wall is not None and not wall.soft:
            x = sign * np.maximum(sign * points[:, 0], sign * position)
            points = np.stack([x, points[:, 1]], -1)
    return points


def safe_size(region: TrappingRegion | PointCloud, is_planar: bool) -> float:
    """How large a shock can be that is sure to leave an attractor's trap of ellipses in no direction; 0 of a cloud."""
    if isinstance(region, PointCloud):
        return 0.0
    norms = [
        np.linalg.norm(ellipse_matrix, 2) if is_planar else np.hypot(*ellipse_matrix[:, 1])
        for ellipse_matrix in region.ellipse_matrices
    ]
    return float(1.0 / max(norms))

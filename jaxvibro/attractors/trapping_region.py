"""Traps: neighbourhoods of an attractor on Sigma from which no state leaves again.

Near a point of a periodic attractor of n periods the map F^n draws in. In the norm of z' P z, with P from Lyapunov's
equation of its derivative M, it does so at every return: an ellipse abs(L (z - point)) <= r, L' L = P, is mapped into
itself. How large r may be is tried on a fan of states. A chaotic attractor has no such ellipse: a sample of it takes
its place.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float

from ..maps.iterate import MAX_RECORDED_PERIODS, final_states, iterate
from ..maps.monodromy import monodromy
from ..maps.phase_shift import shift_phase
from ..scene.codes import Status
from ..scene.state import State

N_DIRECTIONS, RADII_PER_OCTAVE = 32, 8  # of a fan: directions, radii from one to its double
SAFETY_FACTOR = 0.5  # of the largest ellipse whose fan comes back nearer
SAMPLE_ROUNDS = 8  # times KEEP periods of each of the sampled states of a chaotic attractor
DISTANCE_FACTOR = 3.0  # times the distance within which 99 % of one half of a sample find the other: on the same set


class TrappingRegion(NamedTuple):
    """Of a periodic attractor: its points (n, 2), and L (n, 2, 2); a state with abs(L (z - point)) <= 1 is in it."""

    points: Float[np.ndarray, "points 2"]
    ellipse_matrices: Float[np.ndarray, "points 2 2"]

    def contains(self, z: Float[np.ndarray, "lanes 2"]) -> Bool[np.ndarray, " lanes"]:
        """Whether states (lanes, 2) are in it."""
        is_inside = np.zeros(len(z), bool)
        for point, ellipse_matrix in zip(self.points, self.ellipse_matrices, strict=True):
            is_inside |= np.square((z - point) @ ellipse_matrix.T).sum(axis=1) <= 1.0
        return is_inside


class PointCloud(NamedTuple):
    """Of a chaotic attractor: a tree of sampled points, and how near to one of them a state counts as on it."""

    tree: "scipy.spatial.cKDTree"
    max_distance: float

    def contains(self, z: Float[np.ndarray, "lanes 2"]) -> Bool[np.ndarray, " lanes"]:
        """Whether states (lanes, 2) are near it."""
        return np.isfinite(self.tree.query(z, distance_upper_bound=self.max_distance)[0])


def find_trapping_region(scene, points, phase, scale):
    """The `TrappingRegion` of a periodic attractor with these points (n, 2) on Sigma, in order; None where there is
    none.

    There is none where the derivative does not exist or does not draw in, and where an impact falls on the section's
    phase, as neighbours jump there. phase: rad, of the section; scale: of x and v, the largest.
    """
    jacobians = np.asarray(monodromy(scene, free_states(scene, points, phase), len(points)), float)
    ellipse_matrices = []
    for index, jacobian in enumerate(jacobians):
        if not np.isfinite(jacobian).all() or (spectral_radius := max(abs(np.linalg.eigvals(jacobian)))) >= 1.0:
            return None
        contraction = 0.5 * (1.0 + spectral_radius)
        ellipse_matrix = scipy.linalg.cholesky(
            scipy.linalg.solve_discrete_lyapunov(jacobian.T / contraction, np.eye(2))
        )
        radius = _trapping_radius(
            scene, np.roll(points, -index, axis=0), phase, ellipse_matrix, 0.5 * (1.0 + contraction), scale
        )
        if not radius:
            return None
        ellipse_matrices.append(ellipse_matrix / radius)
    return TrappingRegion(points, np.array(ellipse_matrices))


def _trapping_radius(scene, points, phase, ellipse_matrix, contraction, scale):
    """A radius below which all states of a fan come nearer to the first point, by the rate at least; 0: none."""
    angles = 2.0 * np.pi * np.arange(N_DIRECTIONS) / N_DIRECTIONS
    directions = np.linalg.solve(ellipse_matrix, np.stack([np.cos(angles), np.sin(angles)])).T
    n_halvings = int(-0.5 * np.log2(np.finfo(scene.dtype).eps))  # down to where rounding is not yet felt
    radii = scale * 2.0 ** (-np.arange(n_halvings * RADII_PER_OCTAVE) / RADII_PER_OCTAVE)
    fan_points = points[0] + radii[:, None, None] * directions
    end_state, status = final_states(scene, free_states(scene, fan_points.reshape(-1, 2), phase), len(points))
    offsets = np.stack([end_state.x, end_state.v], -1) - points[0]
    distances = np.sqrt(np.square(offsets @ ellipse_matrix.T).sum(axis=1)).reshape(fan_points.shape[:2])
    invalid = (status >= Status.CAP).reshape(fan_points.shape[:2])  # beyond a wall there are no states
    bad_radii = np.flatnonzero(((distances > contraction * radii[:, None]) & ~invalid).any(axis=1))
    first_good = bad_radii[-1] + 1 if bad_radii.size else 0
    return SAFETY_FACTOR * radii[first_good] if first_good < len(radii) else 0.0


def sample_attractor(scene, points, phase):
    """The `PointCloud` of a chaotic attractor with these points (lanes, 2) on Sigma at phase 0."""
    state, _ = shift_phase(scene, free_states(scene, points, 0.0), phase)
    samples = []
    for _ in range(1 + SAMPLE_ROUNDS):
        iterates = iterate(scene, state, MAX_RECORDED_PERIODS)
        state = iterates.state
        samples.append(iterates.points)
    samples = np.concatenate(samples[1:])  # in the first round the lanes part from each other
    n_half = samples.shape[1] // 2
    first_half, second_half = (half_sample.reshape(-1, 2) for half_sample in (samples[:, :n_half], samples[:, n_half:]))
    max_distance = np.quantile(scipy.spatial.cKDTree(first_half).query(second_half)[0], 0.99)
    return PointCloud(scipy.spatial.cKDTree(samples.reshape(-1, 2)), DISTANCE_FACTOR * max_distance)


def free_states(scene, points, phase):
    """Free states at these points (lanes, 2) and a phase."""
    x, v = np.asarray(points, scene.dtype).T
    return State(x, v, np.full(len(x), phase, scene.dtype), np.zeros(len(x), scene.dtype))

"""Construct trapping regions: neighbourhoods of an attractor on the section that no state leaves.

Near a point of a periodic attractor of n periods the map F^n contracts. With P from Lyapunov's equation for its
derivative M, it contracts in the norm of ``z' P z`` at every return: an ellipse ``abs(L (z - point)) <= r``, with
``L' L = P``, is mapped into itself. The admissible r is tested on a fan of states. A chaotic attractor has no such
ellipse; a sample of its points is used instead.
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

N_DIRECTIONS, RADII_PER_OCTAVE = 32, 8  # directions of a fan, and radii per factor of two
SAFETY_FACTOR = 0.5  # times the largest ellipse whose fan returns nearer
SAMPLE_ROUNDS = 8  # times `MAX_RECORDED_PERIODS` from each state of a chaotic attractor
DISTANCE_FACTOR = 3.0  # times the distance within which 99 % of one half of a sample have a neighbour in the other


class TrappingRegion(NamedTuple):
    """Trapping ellipses of a periodic attractor.

    Parameters
    ----------
    points : ndarray
        Points of the attractor. Array of shape (n, 2).
    ellipse_matrices : ndarray
        Matrices L. Array of shape (n, 2, 2). A state is inside if ``abs(L (z - point)) <= 1``.
    """

    points: Float[np.ndarray, "points 2"]
    ellipse_matrices: Float[np.ndarray, "points 2 2"]

    def contains(self, z: Float[np.ndarray, "lanes 2"]) -> Bool[np.ndarray, " lanes"]:
        """Return True for states (lanes, 2) inside the region."""
        is_inside = np.zeros(len(z), bool)
        for point, ellipse_matrix in zip(self.points, self.ellipse_matrices, strict=True):
            is_inside |= np.square((z - point) @ ellipse_matrix.T).sum(axis=1) <= 1.0
        return is_inside


class PointCloud(NamedTuple):
    """Sample of a chaotic attractor.

    Parameters
    ----------
    tree : scipy.spatial.cKDTree
        Sampled points.
    max_distance : float
        Distance from a sampled point up to which a state counts as on the attractor.
    """

    tree: "scipy.spatial.cKDTree"
    max_distance: float

    def contains(self, z: Float[np.ndarray, "lanes 2"]) -> Bool[np.ndarray, " lanes"]:
        """Return True for states (lanes, 2) near a sampled point."""
        return np.isfinite(self.tree.query(z, distance_upper_bound=self.max_distance)[0])


def find_trapping_region(scene, points, phase, scale):
    """Return the `TrappingRegion` of a periodic attractor with these points (n, 2), in order; None if there is none.

    There is none if the derivative does not exist or does not contract, or if an impact falls on the phase of the
    section, since neighbouring states are then discontinuous. phase: of the section, in rad; scale: largest magnitude
    of x and v.
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
    """Return a radius below which all states of a fan approach the first point at this rate at least; 0 for none."""
    angles = 2.0 * np.pi * np.arange(N_DIRECTIONS) / N_DIRECTIONS
    directions = np.linalg.solve(ellipse_matrix, np.stack([np.cos(angles), np.sin(angles)])).T
    n_halvings = int(-0.5 * np.log2(np.finfo(scene.dtype).eps))  # down to radii at which rounding is still negligible
    radii = scale * 2.0 ** (-np.arange(n_halvings * RADII_PER_OCTAVE) / RADII_PER_OCTAVE)
    fan_points = points[0] + radii[:, None, None] * directions
    end_state, status = final_states(scene, free_states(scene, fan_points.reshape(-1, 2), phase), len(points))
    offsets = np.stack([end_state.x, end_state.v], -1) - points[0]
    distances = np.sqrt(np.square(offsets @ ellipse_matrix.T).sum(axis=1)).reshape(fan_points.shape[:2])
    invalid = (status >= Status.CAP).reshape(fan_points.shape[:2])  # states beyond a wall are invalid
    bad_radii = np.flatnonzero(((distances > contraction * radii[:, None]) & ~invalid).any(axis=1))
    first_good = bad_radii[-1] + 1 if bad_radii.size else 0
    return SAFETY_FACTOR * radii[first_good] if first_good < len(radii) else 0.0


def sample_attractor(scene, points, phase):
    """Return the `PointCloud` of a chaotic attractor with these points (lanes, 2) on the section at phase 0."""
    state, _ = shift_phase(scene, free_states(scene, points, 0.0), phase)
    samples = []
    for _ in range(1 + SAMPLE_ROUNDS):
        iterates = iterate(scene, state, MAX_RECORDED_PERIODS)
        state = iterates.state
        samples.append(iterates.points)
    samples = np.concatenate(samples[1:])  # in the first round the lanes separate
    n_half = samples.shape[1] // 2
    first_half, second_half = (half_sample.reshape(-1, 2) for half_sample in (samples[:, :n_half], samples[:, n_half:]))
    max_distance = np.quantile(scipy.spatial.cKDTree(first_half).query(second_half)[0], 0.99)
    return PointCloud(scipy.spatial.cKDTree(samples.reshape(-1, 2)), DISTANCE_FACTOR * max_distance)


def free_states(scene, points, phase):
    """Return free states at these points (lanes, 2) and a phase."""
    x, v = np.asarray(points, scene.dtype).T
    return State(x, v, np.full(len(x), phase, scene.dtype), np.zeros(len(x), scene.dtype))

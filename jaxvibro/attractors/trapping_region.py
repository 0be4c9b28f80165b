"""Construct trapping regions: neighbourhoods of an attractor that an iterate of the stroboscopic map takes into itself.

Near a point of a periodic attractor of n periods, the n-th iterate F^n of the stroboscopic map contracts. Let M be the
derivative of F^n at the point, and P the solution of Lyapunov's equation for M. Then F^n contracts distances from the
point in the norm ``(w' P w)^(1/2)`` of a vector w with transpose w'. F^n therefore maps the ellipse ``abs(L (z -
point)) <= r``, with ``L' L = P``, into itself if r is small. The
largest r is determined with test states in many directions. For a chaotic attractor, a sample of its points is used in
place of ellipses.
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


class TrappingEllipses(NamedTuple):
    """Trapping ellipses about the points of a periodic attractor; motions from inside approach the attractor.

    Parameters
    ----------
    points : ndarray
        Points of the attractor. Array of shape (n, 2).
    ellipse_matrices : ndarray
        Matrices L of the ellipses. Array of shape (n, 2, 2). A state z is inside an ellipse if
        ``abs(L (z - point)) <= 1``.
    """

    points: Float[np.ndarray, "points 2"]
    ellipse_matrices: Float[np.ndarray, "points 2 2"]

    def contains(self, states: Float[np.ndarray, "lanes 2"]) -> Bool[np.ndarray, " lanes"]:
        """Return True for states (lanes, 2) inside one of the ellipses."""
        is_inside = np.zeros(len(states), bool)
        for point, ellipse_matrix in zip(self.points, self.ellipse_matrices, strict=True):
            is_inside |= np.square((states - point) @ ellipse_matrix.T).sum(axis=1) <= 1.0
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

    def contains(self, states: Float[np.ndarray, "lanes 2"]) -> Bool[np.ndarray, " lanes"]:
        """Return True for states (lanes, 2) near a sampled point."""
        return np.isfinite(self.tree.query(states, distance_upper_bound=self.max_distance)[0])


def find_trapping_ellipses(scene, attractor_points, phase, max_state_magnitude):
    """Return the `TrappingEllipses` of a periodic attractor, or None if no trapping ellipse is found.

    No ellipse is found if the derivative of the map does not exist or does not contract, or if an impact falls on the
    phase of the section, where the map is discontinuous. attractor_points: points of the orbit in order, (n, 2); phase:
    phase of the section, in rad; max_state_magnitude: largest magnitude of x and v."""
    return_jacobians = np.asarray(
        monodromy(scene, make_free_states(scene, attractor_points, phase), len(attractor_points)), float
    )
    ellipse_matrices = []
    for point_index, return_jacobian in enumerate(return_jacobians):
        if (
            not np.isfinite(return_jacobian).all()
            or (spectral_radius := max(abs(np.linalg.eigvals(return_jacobian)))) >= 1.0
        ):
            return None
        contraction_factor = 0.5 * (1.0 + spectral_radius)
        ellipse_matrix = scipy.linalg.cholesky(
            scipy.linalg.solve_discrete_lyapunov(return_jacobian.T / contraction_factor, np.eye(2))
        )
        radius = _trapping_radius(
            scene,
            np.roll(attractor_points, -point_index, axis=0),
            phase,
            ellipse_matrix,
            0.5 * (1.0 + contraction_factor),
            max_state_magnitude,
        )
        if not radius:
            return None
        ellipse_matrices.append(ellipse_matrix / radius)
    return TrappingEllipses(attractor_points, np.array(ellipse_matrices))


def _trapping_radius(scene, attractor_points, phase, ellipse_matrix, contraction_factor, max_state_magnitude):
    """Return a radius at which the return map contracts an ellipse by `contraction_factor`; 0 if there is none."""
    angles = 2.0 * np.pi * np.arange(N_DIRECTIONS) / N_DIRECTIONS
    fan_directions = np.linalg.solve(ellipse_matrix, np.stack([np.cos(angles), np.sin(angles)])).T
    n_halvings = int(-0.5 * np.log2(np.finfo(scene.dtype).eps))  # down to radii at which rounding is still negligible
    radii = max_state_magnitude * 2.0 ** (-np.arange(n_halvings * RADII_PER_OCTAVE) / RADII_PER_OCTAVE)
    fan_points = attractor_points[0] + radii[:, None, None] * fan_directions
    end_state, status = final_states(
        scene, make_free_states(scene, fan_points.reshape(-1, 2), phase), len(attractor_points)
    )
    end_offsets = np.stack([end_state.x, end_state.v], -1) - attractor_points[0]
    end_radii = np.sqrt(np.square(end_offsets @ ellipse_matrix.T).sum(axis=1)).reshape(fan_points.shape[:2])
    has_bad_status = (status >= Status.CAP).reshape(fan_points.shape[:2])  # states beyond a wall are invalid
    failing_radius_indices = np.flatnonzero(
        ((end_radii > contraction_factor * radii[:, None]) & ~has_bad_status).any(axis=1)
    )
    first_valid_index = failing_radius_indices[-1] + 1 if failing_radius_indices.size else 0
    return SAFETY_FACTOR * radii[first_valid_index] if first_valid_index < len(radii) else 0.0


def sample_chaotic_attractor(scene, attractor_points, phase):
    """Return the `PointCloud` of a chaotic attractor at a phase; attractor_points: its points (lanes, 2) at phase 0."""
    state, _ = shift_phase(scene, make_free_states(scene, attractor_points, 0.0), phase)
    section_points = []
    for _ in range(1 + SAMPLE_ROUNDS):
        iterates = iterate(scene, state, MAX_RECORDED_PERIODS)
        state = iterates.state
        section_points.append(iterates.points)
    section_points = np.concatenate(section_points[1:])  # in the first round the lanes separate
    n_half_lanes = section_points.shape[1] // 2
    first_half, second_half = (
        half_sample.reshape(-1, 2)
        for half_sample in (section_points[:, :n_half_lanes], section_points[:, n_half_lanes:])
    )
    max_distance = np.quantile(scipy.spatial.cKDTree(first_half).query(second_half)[0], 0.99)
    return PointCloud(scipy.spatial.cKDTree(section_points.reshape(-1, 2)), DISTANCE_FACTOR * max_distance)


def make_free_states(scene, points, phase):
    """Return the states without contact at points (lanes, 2) and a phase."""
    x, v = np.asarray(points, scene.dtype).T
    return State(x, v, np.full(len(x), phase, scene.dtype), np.zeros(len(x), scene.dtype))

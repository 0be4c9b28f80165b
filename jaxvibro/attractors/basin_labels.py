"""Label many initial states with the attractors that they approach, by trapping regions.

Construct trapping regions: neighbourhoods of an attractor that an iterate of the stroboscopic map takes into itself.
Near a point of a periodic attractor of n periods, the n-th iterate F^n of the stroboscopic map contracts. Let M be the
derivative of F^n at the point, and P the solution of Lyapunov's equation for M. Then F^n contracts distances from the
point in the norm ``(w' P w)^(1/2)`` of a vector w with transpose w'. F^n therefore maps the ellipse ``abs(L (z -
point)) <= r``, with ``L' L = P``, into itself if r is small. The largest r is determined with test states in many
directions. For a chaotic attractor, a sample of its points is used in place of ellipses.

The states are simulated together. The simulation of a state ends once its attractor is identified.
"""

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax import lax
from jaxtyping import Bool, Float

from continuation.hostcall import persistent_jit

from ..compiled.kernel_calls import BLOCK_WIDTH
from ..compiled.lane_arithmetic import COMPILER_OPTIONS
from ..maps import two_tier_strobe
from ..maps.initial_conditions import initial_box
from ..maps.iterate import MAX_RECORDED_PERIODS, final_states, iterate
from ..maps.monodromy import monodromy
from ..maps.sections import shift_phase
from ..scene.state import State, Status
from ..stores.engines import n_usable_cores

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


PERIODS_PER_CHECK = 8  # drive periods between two checks
LANES_PER_CALL = 1 << 14  # lanes of one compiled call
MIN_CONSECUTIVE_CHECKS = 8  # consecutive checks near a chaotic attractor that identify it
UNRESOLVED, OUTSIDE = -1, -2
FAR_COORDINATE = 1e18  # position of lanes without a final state, on no attractor


class AttractorNeighbourhood(NamedTuple):
    """Attractor at a phase of the drive, with the region that identifies motions on it.

    Attributes
    ----------
    points : ndarray
        Points on the section: those of a periodic attractor, or a sample of a chaotic one. Array of shape (n, 2).
    region : TrappingEllipses, PointCloud or None
        Trapping region of a periodic attractor, or point cloud of a chaotic one. None if the attractor is unresolved or
        no trapping region exists.
    """

    points: Float[np.ndarray, "points 2"]
    region: TrappingEllipses | PointCloud | None


def build_neighbourhoods(scene, attractors, phase):
    """Build the neighbourhoods of some attractors at a phase of the drive.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    attractors : sequence of Attractor
        Attractors.
    phase : float
        Phase of the drive, in rad.

    Returns
    -------
    list of AttractorNeighbourhood
        Neighbourhood of each attractor.
    """
    max_state_magnitude = max(abs(float(box_bound)) for box_bound in initial_box(scene))
    return [_build_neighbourhood(scene, attractor, phase, max_state_magnitude) for attractor in attractors]


def _build_neighbourhood(scene, attractor, phase, max_state_magnitude):
    """Build the neighbourhood of one attractor."""
    if attractor.kind == "unresolved":
        return AttractorNeighbourhood(attractor.points, None)
    if attractor.kind == "chaotic":
        point_cloud = sample_chaotic_attractor(scene, attractor.points, phase)
        return AttractorNeighbourhood(np.asarray(point_cloud.tree.data[:: len(attractor.points)]), point_cloud)
    attractor_state_fields = (attractor.state.x, attractor.state.v, 0.0, attractor.state.contact)
    section_state, _ = shift_phase(
        scene, State(*(np.full(1, field_value, scene.dtype) for field_value in attractor_state_fields)), phase
    )
    points = iterate(scene, section_state, attractor.periods).points[:, 0]
    return AttractorNeighbourhood(points, find_trapping_ellipses(scene, points, phase, max_state_magnitude))


def label_starts_in_parallel(scene, x, v, phase, neighbourhoods, max_periods):
    """Label initial states with the attractors they approach, using all processor cores.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    x : ndarray
        Positions. Array of shape (lanes,).
    v : ndarray
        Velocities. Array of shape (lanes,).
    phase : float
        Phase of the drive, in rad.
    neighbourhoods : sequence of AttractorNeighbourhood
        Neighbourhoods of the attractors.
    max_periods : int
        Largest number of drive periods.

    Returns
    -------
    tuple of ndarray
        Labels and periods, as returned by `label_starts`.
    """
    with ThreadPoolExecutor(n_usable_cores()) as executor:
        return label_starts(executor, scene, x, v, phase, neighbourhoods, max_periods)


def label_starts(executor, scene, x, v, phase, neighbourhoods, max_periods):
    """Label initial states with the attractors that they approach.

    Parameters
    ----------
    executor : concurrent.futures.Executor
        Pool of threads.
    scene : Scene
        Scene without lanes.
    x : ndarray
        Positions. Array of shape (lanes,).
    v : ndarray
        Velocities. Array of shape (lanes,).
    phase : float
        Phase of the drive, in rad.
    neighbourhoods : sequence of AttractorNeighbourhood
        Neighbourhoods of the attractors.
    max_periods : int
        Largest number of drive periods, rounded up to a multiple of `PERIODS_PER_CHECK`.

    Returns
    -------
    labels : ndarray
        Index in `neighbourhoods`. UNRESOLVED if no attractor is identified within `max_periods`, or the state cannot be
        iterated. OUTSIDE for an initial state beyond a rigid wall.
    periods : ndarray
        Drive periods after which the label was known; 0 for a state that is unresolved after `max_periods`.

    Notes
    -----
    A periodic attractor is identified if its trapping region contains the state. A chaotic attractor is identified if
    its point cloud contains the state at `MIN_CONSECUTIVE_CHECKS` consecutive checks.
    """
    labels, periods_to_label = np.full(len(x), UNRESOLVED, np.int32), np.zeros(len(x), np.int32)
    active_lanes = np.arange(len(x))
    lane_states = np.stack([x, v, np.zeros(len(x))]).astype(scene.dtype)
    n_checks_near_attractor = np.zeros((len(neighbourhoods), len(x)), np.int8)
    for elapsed_periods in range(PERIODS_PER_CHECK, max_periods + PERIODS_PER_CHECK, PERIODS_PER_CHECK):
        block_slices = [
            slice(block_start, block_start + LANES_PER_CALL)
            for block_start in range(0, len(active_lanes), LANES_PER_CALL)
        ]
        block_inputs = [
            [array[..., block_slice] for block_slice in block_slices]
            for array in (lane_states, n_checks_near_attractor)
        ]
        block_results = executor.map(partial(_label_block_at_check, scene, phase, neighbourhoods), *block_inputs)
        lane_states, n_checks_near_attractor, new_labels, status = (
            np.concatenate(array, axis=-1) for array in zip(*block_results, strict=True)
        )
        new_labels = np.where(status == Status.INVALID, OUTSIDE, new_labels)
        is_finished = (new_labels != UNRESOLVED) | (status >= Status.CAP)
        labels[active_lanes[is_finished]], periods_to_label[active_lanes[is_finished]] = (
            new_labels[is_finished],
            elapsed_periods,
        )
        active_lanes, lane_states, n_checks_near_attractor = (
            active_lanes[~is_finished],
            lane_states[:, ~is_finished],
            n_checks_near_attractor[:, ~is_finished],
        )
        if not len(active_lanes):
            break
    return labels, periods_to_label


def _label_block_at_check(scene, phase, neighbourhoods, lane_states, n_checks_near_attractor):
    """Advance lanes by `PERIODS_PER_CHECK` periods and label them.

    Returns ((x, v, contact), number of consecutive checks near each attractor, labels, statuses).
    """
    n_lanes = lane_states.shape[1]
    padded_states = [np.pad(array, (0, LANES_PER_CALL - n_lanes)) for array in lane_states]
    *end_states, status = (
        array[:n_lanes]
        for array in jax.device_get(
            _advance_blocks_to_check(scene, *padded_states, scene.dtype.type(phase), -(-n_lanes // BLOCK_WIDTH))
        )
    )
    end_points, labels = np.stack(end_states[:2], -1), np.full(n_lanes, UNRESOLVED, np.int32)
    end_points[status >= Status.CAP] = scene.dtype.type(FAR_COORDINATE)
    n_checks_near_attractor = n_checks_near_attractor.copy()
    for attractor_index, neighbourhood in enumerate(neighbourhoods):
        if neighbourhood.region is None:
            continue
        is_inside = neighbourhood.region.contains(end_points)
        if isinstance(neighbourhood.region, PointCloud):
            n_checks_near_attractor[attractor_index] = np.where(
                is_inside, n_checks_near_attractor[attractor_index] + 1, 0
            )
            is_inside = n_checks_near_attractor[attractor_index] >= MIN_CONSECUTIVE_CHECKS
        labels[is_inside] = attractor_index
    return np.stack(end_states), n_checks_near_attractor, labels, status


@persistent_jit(compiler_options=COMPILER_OPTIONS)
def _advance_blocks_to_check(scene, x, v, contact, phase, n_blocks):
    """Advance the first `n_blocks` blocks of lanes by `PERIODS_PER_CHECK` periods.

    Returns (x, v, contact, status). The other blocks are unchanged and have status 0.
    """

    def advance_block(block_index, carry):
        """Advance one block of lanes."""
        first_lane = block_index * BLOCK_WIDTH
        block_states = [lax.dynamic_slice_in_dim(array, first_lane, BLOCK_WIDTH) for array in carry[:3]]
        end_state, impacts = two_tier_strobe.two_tier_strobe(
            scene, State(block_states[0], block_states[1], phase, block_states[2]), PERIODS_PER_CHECK, 0, BLOCK_WIDTH
        )
        block_results = (end_state.x, end_state.v, end_state.contact, impacts.status)
        return [
            lax.dynamic_update_slice_in_dim(array, block_result, first_lane, 0)
            for array, block_result in zip(carry, block_results, strict=True)
        ]

    return lax.fori_loop(0, n_blocks, advance_block, [x, v, contact, jnp.zeros(x.shape, jnp.int32)])

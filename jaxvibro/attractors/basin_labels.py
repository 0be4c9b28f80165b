"""Label many initial states with the attractors that they approach.

The states are simulated together. The simulation of a state ends once its attractor is identified.
"""

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation.hostcall import persistent_jit

from ..compiled.kernel_calls import BLOCK_WIDTH
from ..compiled.lane_arithmetic import COMPILER_OPTIONS
from ..maps import two_tier_strobe
from ..maps.iterate import iterate
from ..maps.phase_shift import shift_phase
from ..scene.codes import Status
from ..scene.state import State
from ..stores.engines import n_usable_cores
from .trapping_region import PointCloud, TrappingEllipses, find_trapping_ellipses, sample_chaotic_attractor

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


def build_neighbourhoods(scene, attractors, phase, max_state_magnitude):
    """Build the neighbourhoods of some attractors at a phase of the drive.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    attractors : sequence of Attractor
        Attractors.
    phase : float
        Phase of the drive, in rad.
    max_state_magnitude : float
        Largest magnitude of x and v.

    Returns
    -------
    list of AttractorNeighbourhood
        Neighbourhood of each attractor.
    """
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

"""Label many initial states with the attractor they approach.

The states are simulated together, and a state is dropped once a trapping region contains it.
"""

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import COMPILER_OPTIONS
from ..compiled.kernels import BLOCK_WIDTH
from ..maps import two_tiers
from ..maps.iterate import iterate
from ..maps.phase_shift import shift_phase
from ..scene.codes import Status
from ..scene.state import State
from ..stores.engines import n_usable_cores
from .trapping_region import PointCloud, TrappingRegion, find_trapping_region, sample_attractor

PERIODS_PER_CHECK = 8  # drive periods between two checks
LANES_PER_CALL = 1 << 14  # lanes of one compiled call
MIN_CONSECUTIVE_CHECKS = 8  # consecutive checks near a chaotic attractor that identify it
UNRESOLVED, OUTSIDE = -1, -2
FAR_COORDINATE = 1e18  # position of lanes without a final state, on no attractor


class AttractorNeighbourhood(NamedTuple):
    """Attractor at a phase of the drive, with the region that identifies it.

    Attributes
    ----------
    points : ndarray
        Points on the section, a sample of a chaotic attractor. Array of shape (n, 2).
    region : TrappingRegion, PointCloud or None
        Trapping region of a periodic attractor, point cloud of a chaotic one; None if there is no such region.
    """

    points: Float[np.ndarray, "points 2"]
    region: TrappingRegion | PointCloud | None


def build_neighbourhoods(scene, attractors, phase, scale):
    """Build the neighbourhoods of some attractors at a phase of the drive.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    attractors : sequence of Attractor
        Attractors.
    phase : float
        Phase of the drive, in rad.
    scale : float
        Largest magnitude of x and v.

    Returns
    -------
    list of AttractorNeighbourhood
        Neighbourhood of each attractor.
    """
    return [_build_neighbourhood(scene, attractor, phase, scale) for attractor in attractors]


def _build_neighbourhood(scene, attractor, phase, scale):
    """Build the neighbourhood of one attractor."""
    if attractor.kind == "unresolved":
        return AttractorNeighbourhood(attractor.points, None)
    if attractor.kind == "chaotic":
        cloud = sample_attractor(scene, attractor.points, phase)
        return AttractorNeighbourhood(np.asarray(cloud.tree.data[:: len(attractor.points)]), cloud)
    start = (attractor.state.x, attractor.state.v, 0.0, attractor.state.contact)
    state, _ = shift_phase(scene, State(*(np.full(1, value, scene.dtype) for value in start)), phase)
    points = iterate(scene, state, attractor.periods).points[:, 0]
    return AttractorNeighbourhood(points, find_trapping_region(scene, points, phase, scale))


def assign_labels(scene, x, v, phase, neighbourhoods, max_periods):
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
    with ThreadPoolExecutor(n_usable_cores()) as pool:
        return label_starts(pool, scene, x, v, phase, neighbourhoods, max_periods)


def label_starts(pool, scene, x, v, phase, neighbourhoods, max_periods):
    """Return (label, periods) of each initial state (lanes,).

    label: index in `neighbourhoods`; UNRESOLVED if no region contained the state within `max_periods`, and OUTSIDE
    beyond a wall. periods: drive periods after which the region contained the state. pool: of threads.
    """
    labels, periods = np.full(len(x), UNRESOLVED, np.int32), np.zeros(len(x), np.int32)
    lanes = np.arange(len(x))
    lane_states = np.stack([x, v, np.zeros(len(x))]).astype(scene.dtype)
    near_counts = np.zeros((len(neighbourhoods), len(x)), np.int8)
    for elapsed_periods in range(PERIODS_PER_CHECK, max_periods + PERIODS_PER_CHECK, PERIODS_PER_CHECK):
        blocks = [slice(start, start + LANES_PER_CALL) for start in range(0, len(lanes), LANES_PER_CALL)]
        block_inputs = [[array[..., block] for block in blocks] for array in (lane_states, near_counts)]
        block_results = pool.map(partial(_check_block, scene, phase, neighbourhoods), *block_inputs)
        lane_states, near_counts, new_labels, status = (
            np.concatenate(array, axis=-1) for array in zip(*block_results, strict=True)
        )
        new_labels = np.where(status == Status.INVALID, OUTSIDE, new_labels)
        is_finished = (new_labels != UNRESOLVED) | (status >= Status.CAP)
        labels[lanes[is_finished]], periods[lanes[is_finished]] = new_labels[is_finished], elapsed_periods
        lanes, lane_states, near_counts = (
            lanes[~is_finished],
            lane_states[:, ~is_finished],
            near_counts[:, ~is_finished],
        )
        if not len(lanes):
            break
    return labels, periods


def _check_block(scene, phase, neighbourhoods, lane_states, near_counts):
    """Advance lanes by one round; return ((x, v, contact), consecutive checks near each attractor, label, status)."""
    n_lanes = lane_states.shape[1]
    padded_states = [np.pad(array, (0, LANES_PER_CALL - n_lanes)) for array in lane_states]
    *end_states, status = (
        array[:n_lanes]
        for array in jax.device_get(
            _advance_lanes(scene, *padded_states, scene.dtype.type(phase), -(-n_lanes // BLOCK_WIDTH))
        )
    )
    z, labels = np.stack(end_states[:2], -1), np.full(n_lanes, UNRESOLVED, np.int32)
    z[status >= Status.CAP] = scene.dtype.type(FAR_COORDINATE)
    near_counts = near_counts.copy()
    for index, neighbourhood in enumerate(neighbourhoods):
        if neighbourhood.region is None:
            continue
        is_inside = neighbourhood.region.contains(z)
        if isinstance(neighbourhood.region, PointCloud):
            near_counts[index] = np.where(is_inside, near_counts[index] + 1, 0)
            is_inside = near_counts[index] >= MIN_CONSECUTIVE_CHECKS
        labels[is_inside] = index
    return np.stack(end_states), near_counts, labels, status


@persistent_jit(compiler_options=COMPILER_OPTIONS)
def _advance_lanes(scene, x, v, contact, phase, n_blocks):
    """Return (x, v, contact, status) after one round of the first `n_blocks` blocks; the rest is unchanged."""

    def advance_block(block_index, carry):
        """Advance one block of lanes."""
        start = block_index * BLOCK_WIDTH
        block_states = [lax.dynamic_slice_in_dim(array, start, BLOCK_WIDTH) for array in carry[:3]]
        end_state, impacts = two_tiers.strobe(
            scene, State(block_states[0], block_states[1], phase, block_states[2]), PERIODS_PER_CHECK, 0, BLOCK_WIDTH
        )
        block_results = (end_state.x, end_state.v, end_state.contact, impacts.status)
        return [
            lax.dynamic_update_slice_in_dim(array, update, start, 0)
            for array, update in zip(carry, block_results, strict=True)
        ]

    return lax.fori_loop(0, n_blocks, advance_block, [x, v, contact, jnp.zeros(x.shape, jnp.int32)])

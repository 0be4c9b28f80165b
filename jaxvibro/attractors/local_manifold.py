"""Compute the local manifold of a saddle as a graph over the line of its eigenvector.

F is the stroboscopic map over the period of the saddle for the unstable manifold, and its inverse for the stable one.
Near the saddle the curve is ``saddle + a e + g(a) n``, with the eigenvector e and the normal n. With the multiplier r,
F maps the points of the curve near a / r to the points near a, and contracts across the curve. The polynomial g is the
fixed point of this graph transform (Hadamard). The images also give the polynomial p: F maps the point of the curve at
p(a) to the point at a. Rounding errors along the curve do not affect g.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import ArrayLike, Float
from numpy.polynomial import chebyshev

from continuation.hostcall import persistent_jit

from ..compiled.kernel_calls import BLOCK_WIDTH
from ..compiled.lane_arithmetic import COMPILER_OPTIONS
from ..maps import two_tier_strobe
from ..maps.strobe_inverse import strobe_backward
from ..scene.codes import Status
from ..scene.state import State

LANES_PER_CALL = 1 << 12  # lanes of one compiled call
MIN_RADIUS = 1e-6  # times the scene's size: at this distance the line deviates from the curve by the square of it
MAX_RADIUS = 0.1  # times the scene's size: the longest local manifold that is tried
N_NODES, DEGREE = 32, 14  # nodes and degree of the polynomial
MAX_ITERATIONS = 30  # largest number of iterations of the graph transform
CHANGE_ROUNDINGS, ERROR_ROUNDINGS = (
    5,
    500,
)  # roundings of the scene's size: changes of g that count as converged; errors of g that are accepted


class LocalManifold(NamedTuple):
    """Local manifold of a saddle.

    Attributes
    ----------
    saddle_point : ndarray
        Saddle. Array of shape (2,).
    direction : ndarray
        Eigenvector of length 1. Array of shape (2,).
    radius : float
        Distance from the saddle along the eigenvector, in both directions, up to which the series hold.
    offset_series : ndarray
        Coefficients of the Chebyshev series in ``a / radius`` of g, the distance of the curve from the eigenvector.
    preimage_series : ndarray
        Coefficients of the Chebyshev series in ``a / radius`` of p, the coordinate of the point that F maps to a.
    """

    saddle_point: Float[np.ndarray, "2"]
    direction: Float[np.ndarray, "2"]
    radius: float
    offset_series: Float[np.ndarray, " across"]
    preimage_series: Float[np.ndarray, " before"]

    def points_at(self, coordinate: Float[np.ndarray, " lanes"]) -> Float[np.ndarray, "lanes 2"]:
        """Return the points (lanes, 2) of the curve at positive or negative coordinates along the eigenvector."""
        normal_direction = np.array([-self.direction[1], self.direction[0]])
        normal_offset = chebyshev.chebval(coordinate / self.radius, self.offset_series)
        return self.saddle_point + coordinate[:, None] * self.direction + normal_offset[:, None] * normal_direction

    def preimage_coordinate(self, coordinate: Float[ArrayLike, "*lanes"]) -> Float[ArrayLike, "*lanes"]:
        """Return the coordinates of the points that the map takes to the points at the given coordinates."""
        return chebyshev.chebval(coordinate / self.radius, self.preimage_series)


def iterate_map(scene, states, phase, n_iterations, is_backward):
    """Apply the stroboscopic map, or its inverse, `n_iterations` times to states (lanes, 2) at a phase.

    Returns (final states (lanes, 2), numbers of impacts, True for lanes with a final state).
    """
    chunk_results = []
    for first_lane in range(0, len(states), LANES_PER_CALL):
        state_chunk = states[first_lane : first_lane + LANES_PER_CALL]
        padded_chunk = np.pad(state_chunk, ((0, LANES_PER_CALL - len(state_chunk)), (0, 0)))
        padded_results = _iterate_blocks(
            scene,
            *padded_chunk.T,
            scene.dtype.type(phase),
            n_iterations,
            -(-len(state_chunk) // BLOCK_WIDTH),
            is_backward,
        )
        chunk_results.append([array[: len(state_chunk)] for array in jax.device_get(padded_results)])
    x, v, n_impacts, status = (np.concatenate(array) for array in zip(*chunk_results, strict=True))
    return np.stack([x, v], -1), n_impacts, status < Status.CAP


@persistent_jit(static_argnames="inverse", compiler_options=COMPILER_OPTIONS)
def _iterate_blocks(scene, x, v, phase, n_iterations, n_blocks, inverse):
    """Return (x, v, impacts, status) after `n_iterations`; lanes beyond the first `n_blocks` blocks are unchanged."""

    def iterate_once(_, carry):
        x, v, contact, n_impacts, status = carry
        state = State(x, v, phase, contact)
        end_state, impacts = (
            strobe_backward(scene, state, BLOCK_WIDTH)
            if inverse
            else two_tier_strobe.two_tier_strobe(scene, state, 1, 0, BLOCK_WIDTH)
        )
        return (
            end_state.x,
            end_state.v,
            end_state.contact,
            n_impacts + impacts.count,
            jnp.maximum(status, impacts.status),
        )

    def iterate_block(block_index, carry):
        first_lane = block_index * BLOCK_WIDTH
        x, v = (lax.dynamic_slice_in_dim(array, first_lane, BLOCK_WIDTH) for array in carry[:2])
        zeros = jnp.zeros(BLOCK_WIDTH, jnp.int32)
        x, v, _, n_impacts, status = lax.fori_loop(0, n_iterations, iterate_once, (x, v, 0.0 * x, zeros, zeros))
        block_arrays = (x, v, n_impacts, status)
        return [
            lax.dynamic_update_slice_in_dim(array, block_array, first_lane, 0)
            for array, block_array in zip(carry, block_arrays, strict=True)
        ]

    zeros = jnp.zeros(x.shape, jnp.int32)
    return lax.fori_loop(0, n_blocks, iterate_block, [x, v, zeros, zeros])


def compute_local_manifold(
    scene, saddle_point, eigenvector, stretch_factor, periods, phase, is_backward, scene_length_scale
):
    """Compute the longest `LocalManifold` that is accurate to rounding, or else a short piece of the eigenvector.

    saddle_point: of shape (2,); eigenvector: of length 1; stretch_factor: multiplier of the map over `periods` drive
    periods (of its inverse if `is_backward`), of magnitude above 1; scene_length_scale: typical length of the scene."""
    rounding_error, local_axes = (
        scene_length_scale * np.finfo(scene.dtype).eps,
        np.array([eigenvector, [-eigenvector[1], eigenvector[0]]]),
    )

    def map_curve_points(local_manifold, coordinate):
        """Return the coordinates of the images of points of the curve along the eigenvector and its normal.

        Returns None if an image does not exist, if the numbers of impacts differ, or if the image is folded.
        """
        image_states, n_impacts, has_image = iterate_map(
            scene, local_manifold.points_at(coordinate), phase, periods, is_backward
        )
        image_coords = local_axes @ (image_states - saddle_point).T
        is_folded = not (np.diff(image_coords[0]) > 0).all()
        return None if is_folded or not has_image.all() or (n_impacts != n_impacts[0]).any() else image_coords

    radius = MAX_RADIUS * scene_length_scale
    while radius > MIN_RADIUS * scene_length_scale:
        local_manifold = _converge_series(
            LocalManifold(saddle_point, eigenvector, radius, np.zeros(1), np.array([0.0, radius / stretch_factor])),
            map_curve_points,
            rounding_error,
        )
        if local_manifold is not None:
            return local_manifold
        radius *= 0.5
    return LocalManifold(
        saddle_point,
        eigenvector,
        MIN_RADIUS * scene_length_scale,
        np.zeros(1),
        np.array([0.0, MIN_RADIUS * scene_length_scale / stretch_factor]),
    )


def _converge_series(local_manifold, map_curve_points, rounding_error):
    """Return the local manifold with converged series, or None if polynomials of degree `DEGREE` do not fit."""
    chebyshev_nodes = local_manifold.radius * chebyshev.chebpts2(N_NODES)
    for _ in range(MAX_ITERATIONS):
        preimage_coordinates = local_manifold.preimage_coordinate(chebyshev_nodes)
        image_coords = map_curve_points(local_manifold, preimage_coordinates)
        if image_coords is None:
            return None
        offset_series, preimage_series = chebyshev.chebfit(
            image_coords[0] / local_manifold.radius, np.stack([image_coords[1], preimage_coordinates], -1), DEGREE
        ).T
        offset_change = abs(
            chebyshev.chebval(chebyshev_nodes / local_manifold.radius, offset_series)
            - chebyshev.chebval(chebyshev_nodes / local_manifold.radius, local_manifold.offset_series)
        )
        local_manifold = local_manifold._replace(offset_series=offset_series, preimage_series=preimage_series)
        if offset_change.max() <= CHANGE_ROUNDINGS * rounding_error:
            break
    image_coords = map_curve_points(
        local_manifold, local_manifold.preimage_coordinate(0.5 * (chebyshev_nodes[1:] + chebyshev_nodes[:-1]))
    )
    if image_coords is None:
        return None
    offset_mismatch = image_coords[1] - chebyshev.chebval(
        image_coords[0] / local_manifold.radius, local_manifold.offset_series
    )
    return local_manifold if abs(offset_mismatch).max() <= ERROR_ROUNDINGS * rounding_error else None

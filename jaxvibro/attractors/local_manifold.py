"""The germ of a manifold: the curve near its saddle, as a graph over the eigenvector's line.

Near saddle + a e the curve is saddle + a e + g(a) n, n across e. g, a polynomial, is the fixed point of the graph
transform (Hadamard): F leads the points of the curve near a / r to those near a, r being the multiplier, and draws in
across the curve. They tell the way back along it too: F leads its point at p(a) to that at a. g belongs to the curve
alone, so that no rounding along the curve enters it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import ArrayLike, Float
from numpy.polynomial import chebyshev

from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import COMPILER_OPTIONS
from ..compiled.kernels import BLOCK_WIDTH
from ..maps import two_tiers
from ..maps.inverse import strobe_backward
from ..scene.codes import Status
from ..scene.state import State

LANES_PER_CALL = 1 << 12  # of one compiled call
MIN_RADIUS = 1e-6  # of the scene's size: so far from the saddle the line is the curve, to the square of it
MAX_RADIUS = 0.1  # of the scene's size: the longest germ that is tried
N_NODES, DEGREE = 32, 14  # of the polynomial
MAX_ITERATIONS = 30  # of the graph transform, at most
CHANGE_ROUNDINGS, ERROR_ROUNDINGS = (
    5,
    500,
)  # roundings of the scene's size: g changes no more; g is the curve, and a germ may be as long


class LocalManifold(NamedTuple):
    """radius: as far along the line, to both sides, g (across) and p (before) hold: Chebyshev series in a / reach."""

    saddle: Float[np.ndarray, "2"]
    direction: Float[np.ndarray, "2"]
    radius: float
    offset_series: Float[np.ndarray, " across"]
    preimage_series: Float[np.ndarray, " before"]

    def points_at(self, coordinate: Float[np.ndarray, " lanes"]) -> Float[np.ndarray, "lanes 2"]:
        """The curve's points (lanes, 2) so far along the line, of either sign."""
        normal = np.array([-self.direction[1], self.direction[0]])
        offset = chebyshev.chebval(coordinate / self.radius, self.offset_series)
        return self.saddle + coordinate[:, None] * self.direction + offset[:, None] * normal

    def preimage(self, coordinate: Float[ArrayLike, "*lanes"]) -> Float[ArrayLike, "*lanes"]:
        """How far along are the points that the map leads to those so far along."""
        return chebyshev.chebval(coordinate / self.radius, self.preimage_series)


def iterate_map(scene, z, phase, n_steps, inverse):
    """(z, impacts, good): F^steps of states (lanes, 2) at a phase, or of the inverse where `inverse`."""
    chunk_results = []
    for start in range(0, len(z), LANES_PER_CALL):
        chunk = z[start : start + LANES_PER_CALL]
        padded_chunk = np.pad(chunk, ((0, LANES_PER_CALL - len(chunk)), (0, 0)))
        results = _iterate_blocks(
            scene, *padded_chunk.T, scene.dtype.type(phase), n_steps, -(-len(chunk) // BLOCK_WIDTH), inverse
        )
        chunk_results.append([array[: len(chunk)] for array in jax.device_get(results)])
    x, v, n_impacts, status = (np.concatenate(array) for array in zip(*chunk_results, strict=True))
    return np.stack([x, v], -1), n_impacts, status < Status.CAP


@persistent_jit(static_argnames="inverse", compiler_options=COMPILER_OPTIONS)
def _iterate_blocks(scene, x, v, phase, n_steps, n_blocks, inverse):
    def iterate_once(_, carry):
        x, v, contact, n_impacts, status = carry
        state = State(x, v, phase, contact)
        end_state, impacts = (
            strobe_backward(scene, state, BLOCK_WIDTH) if inverse else two_tiers.strobe(scene, state, 1, 0, BLOCK_WIDTH)
        )
        return (
            end_state.x,
            end_state.v,
            end_state.contact,
            n_impacts + impacts.count,
            jnp.maximum(status, impacts.status),
        )

    def iterate_block(block_index, carry):
        start = block_index * BLOCK_WIDTH
        x, v = (lax.dynamic_slice_in_dim(array, start, BLOCK_WIDTH) for array in carry[:2])
        zeros = jnp.zeros(BLOCK_WIDTH, jnp.int32)
        x, v, _, n_impacts, status = lax.fori_loop(0, n_steps, iterate_once, (x, v, 0.0 * x, zeros, zeros))
        block_results = (x, v, n_impacts, status)
        return [
            lax.dynamic_update_slice_in_dim(array, update, start, 0)
            for array, update in zip(carry, block_results, strict=True)
        ]

    zeros = jnp.zeros(x.shape, jnp.int32)
    return lax.fori_loop(0, n_blocks, iterate_block, [x, v, zeros, zeros])


def compute_local_manifold(scene, saddle, direction, stretch, periods, phase, inverse, scene_size):
    """The longest `LocalManifold` that is the curve to rounding; where none is, the line itself.

    saddle (2,); direction: the eigenvector, of length 1; stretch: how much `periods` drive periods (those of the
    inverse where `inverse`) stretch it, beyond 1 or -1; scene_size: a length of the scene."""
    rounding, axes = scene_size * np.finfo(scene.dtype).eps, np.array([direction, [-direction[1], direction[0]]])

    def image_of(local_manifold, coordinate):
        """(along, across) of the images of a germ's points, or None: between them is a corner, a wall or a fold."""
        z, n_impacts, valid = iterate_map(scene, local_manifold.points_at(coordinate), phase, periods, inverse)
        image_coords = axes @ (z - saddle).T
        is_folded = not (np.diff(image_coords[0]) > 0).all()
        return None if is_folded or not valid.all() or (n_impacts != n_impacts[0]).any() else image_coords

    radius = MAX_RADIUS * scene_size
    while radius > MIN_RADIUS * scene_size:
        local_manifold = _converge_series(
            LocalManifold(saddle, direction, radius, np.zeros(1), np.array([0.0, radius / stretch])), image_of, rounding
        )
        if local_manifold is not None:
            return local_manifold
        radius *= 0.5
    return LocalManifold(
        saddle, direction, MIN_RADIUS * scene_size, np.zeros(1), np.array([0.0, MIN_RADIUS * scene_size / stretch])
    )


def _converge_series(local_manifold, image_of, rounding):
    """The germ with its series found, or None: the curve is no polynomial of this degree as far as that."""
    nodes = local_manifold.radius * chebyshev.chebpts2(N_NODES)
    for _ in range(MAX_ITERATIONS):
        preimages = local_manifold.preimage(nodes)
        image_coords = image_of(local_manifold, preimages)
        if image_coords is None:
            return None
        offset_series, preimage_series = chebyshev.chebfit(
            image_coords[0] / local_manifold.radius, np.stack([image_coords[1], preimages], -1), DEGREE
        ).T
        change = abs(
            chebyshev.chebval(nodes / local_manifold.radius, offset_series)
            - chebyshev.chebval(nodes / local_manifold.radius, local_manifold.offset_series)
        )
        local_manifold = local_manifold._replace(offset_series=offset_series, preimage_series=preimage_series)
        if change.max() <= CHANGE_ROUNDINGS * rounding:
            break
    image_coords = image_of(local_manifold, local_manifold.preimage(0.5 * (nodes[1:] + nodes[:-1])))
    if image_coords is None:
        return None
    mismatch = image_coords[1] - chebyshev.chebval(
        image_coords[0] / local_manifold.radius, local_manifold.offset_series
    )
    return local_manifold if abs(mismatch).max() <= ERROR_ROUNDINGS * rounding else None

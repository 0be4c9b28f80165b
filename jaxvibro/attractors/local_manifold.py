"""Compute the local manifold of a saddle as a graph over the line of its eigenvector.

Near the saddle the curve is ``saddle + a e + g(a) n``, with n perpendicular to e. The polynomial g is the fixed point
of the graph transform (Hadamard): with the multiplier r, F maps the points of the curve near a / r to those near a, and
contracts across the curve. The images also give the inverse along the curve: F maps its point at p(a) to that at a. g
depends on the curve only, so rounding along the curve does not enter.
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
    saddle : ndarray
        Saddle. Array of shape (2,).
    direction : ndarray
        Eigenvector of length 1.
    radius : float
        Distance along the line, in both directions, up to which the series hold.
    offset_series : ndarray
        Chebyshev series of g (across) in a / radius.
    preimage_series : ndarray
        Chebyshev series of p (before) in a / radius.
    """

    saddle: Float[np.ndarray, "2"]
    direction: Float[np.ndarray, "2"]
    radius: float
    offset_series: Float[np.ndarray, " across"]
    preimage_series: Float[np.ndarray, " before"]

    def points_at(self, coordinate: Float[np.ndarray, " lanes"]) -> Float[np.ndarray, "lanes 2"]:
        """Return the points (lanes, 2) of the curve at these coordinates along the line, of either sign."""
        normal = np.array([-self.direction[1], self.direction[0]])
        offset = chebyshev.chebval(coordinate / self.radius, self.offset_series)
        return self.saddle + coordinate[:, None] * self.direction + offset[:, None] * normal

    def preimage(self, coordinate: Float[ArrayLike, "*lanes"]) -> Float[ArrayLike, "*lanes"]:
        """Return the coordinates that the map takes to these coordinates."""
        return chebyshev.chebval(coordinate / self.radius, self.preimage_series)


def iterate_map(scene, z, phase, n_steps, inverse):
    """Return (z, impacts, valid) after F^n_steps of states (lanes, 2) at a phase, or of its inverse if `inverse`."""
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
    """Return (x, v, impacts, status) of blocks of lanes after `n_steps`."""

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
    """Return the longest `LocalManifold` that is accurate to rounding, or else the line itself.

    saddle (2,); direction: eigenvector of length 1; stretch: its multiplier over `periods` drive periods (of the
    inverse if `inverse`), beyond 1 or -1; scene_size: a length of the scene.
    """
    rounding, axes = scene_size * np.finfo(scene.dtype).eps, np.array([direction, [-direction[1], direction[0]]])

    def image_of(local_manifold, coordinate):
        """Return (along, across) of the images of points of the curve, or None for a corner, a wall or a fold."""
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
    """Return the local manifold with converged series, or None if no polynomial of this degree fits."""
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

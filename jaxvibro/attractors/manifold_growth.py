"""Compute the local manifold of a saddle, and grow one side of the manifold from it.

Compute the local manifold of a saddle as a graph over the line of its eigenvector. F is the stroboscopic map over the
period of the saddle for the unstable manifold, and its inverse for the stable one. Near the saddle the curve is
``saddle + a e + g(a) n``, with the eigenvector e and the normal n. With the multiplier r, F maps the points of the
curve near a / r to the points near a, and contracts across the curve. The polynomial g is the fixed point of this graph
transform (Hadamard). The images also give the polynomial p: F maps the point of the curve at p(a) to the point at a.
Rounding errors along the curve do not affect g.

F is the stroboscopic map over the period of the saddle, or its inverse. W(s) is the point of the local manifold at the
coordinate s, b is the end of the local manifold, and F maps W(a) to W(b). Level k consists of the points
``F^k(W(a^(1-u) b^u))`` with 0 <= u < 1. F contracts across the curve. A negative multiplier exchanges the sides of the
saddle, so the segment changes sides from level to level. Two applications of F per level would instead stretch the
segment by the square of the multiplier.

If neighbours are too far apart, or the curve turns too much between them, points between them are added in u. An added
point is mapped from the local manifold, not interpolated. This is Hobson's scheme (J. Comput. Phys. 104, 14, 1993) with
the step control of Krauskopf and Osinga (J. Comput. Phys. 146, 404, 1998).

F stretches the curve, so higher levels need more accurate points of the segment. The rounding of x and v, relative to
the distance from the saddle, limits the length of the curve. A long local manifold therefore allows a longer curve.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import ArrayLike, Bool, Float, Int
from numpy.polynomial import chebyshev

from continuation.branch_segment import UNLIMITED
from continuation.hostcall import persistent_jit

from ..compiled.kernel_calls import BLOCK_WIDTH
from ..compiled.lane_arithmetic import COMPILER_OPTIONS
from ..maps import two_tier_strobe
from ..maps.strobe_inverse import strobe_backward
from ..scene.state import State, Status

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


N_START_POINTS = 33  # points of the local manifold and of its first image
MIN_PARAMETER_STEP = 1e-14  # in u: nearer points are indistinguishable
HALF_FRACTION, QUARTER_FRACTIONS = np.array([0.5]), np.array([0.25, 0.5, 0.75])
MAX_QUARTERED_GAPS = 16  # up to this many gaps are split in four at once: a call costs the same for a hundred lanes
ATTRACTOR_LENGTH = 1e-4  # times the spacing: a shorter, shrinking level has reached an attractor
MAX_LEVELS = 1000
CORNER_DISTANCE = 1e-7  # times the scene's size: nearer neighbours with different itineraries mark a corner


class ManifoldPointRules(NamedTuple):
    """Rules for the points of a manifold.

    Attributes
    ----------
    spacing : float
        Largest distance of neighbours.
    angle : float
        Largest turn between neighbours, in rad.
    min_distance : float
        Distance below which turns do not matter.
    max_unscaled_speed : float
        Speed beyond which the spacing grows with the speed.
    fastest : float
        Speed beyond which the curve is left out.
    length : float
        Length of a side.
    max_points : int
        Largest number of points of a side.
    scene_length_scale : float
        Typical length of the scene.
    """

    spacing: float
    angle: float
    min_distance: float
    max_unscaled_speed: float
    fastest: float
    length: float
    max_points: int
    scene_length_scale: float


class ManifoldLevel(NamedTuple):
    """Points of level k: images under F^k of points of the fundamental segment.

    Attributes
    ----------
    u : ndarray
        Parameters u of the preimages on the segment. Array of shape (points,).
    z : ndarray
        States. Array of shape (points, 2).
    n_impacts : ndarray
        Numbers of impacts during the applications of F.
    is_valid : ndarray
        True for points with a final state that are not too fast.
    """

    u: Float[np.ndarray, " points"]
    z: Float[np.ndarray, "points 2"]
    n_impacts: Int[np.ndarray, " points"]
    is_valid: Bool[np.ndarray, " points"]


def grow_manifold_levels(
    scene,
    local_manifold,
    side,
    multiplier_sign,
    periods,
    phase,
    is_backward,
    point_rules,
    computation_limits=UNLIMITED,
):
    """Compute the `ManifoldLevel`s of one side of the manifold, and the reason for its end.

    Parameters
    ----------
    scene : Scene
        Scene without lanes.
    local_manifold : LocalManifold
        Local manifold of the saddle.
    side : int
        Side of the saddle, -1 or 1.
    multiplier_sign : float
        Sign of the multiplier.
    periods : int
        Drive periods of F.
    phase : float
        Phase of the section, in rad.
    is_backward : bool
        True if F is the map in reversed time.
    point_rules : ManifoldPointRules
        Rules for the points.
    computation_limits : Limits, optional
        Time limit, after which no further level is started.

    Returns
    -------
    levels : list of ManifoldLevel
        Levels in order.
    end_reason : str
        Reason for the end, as in `manifold.manifold`.
    """
    levels, remaining_length, previous_level_length, n_points = [], point_rules.length, 0.0, 0
    for level_index in range(MAX_LEVELS):
        outer_coordinate = side * multiplier_sign**level_index * local_manifold.radius
        inner_coordinate = (
            local_manifold.preimage_coordinate(multiplier_sign * outer_coordinate)
            if level_index
            else side * MIN_RADIUS * point_rules.scene_length_scale
        )

        def evaluate_level(
            parameters, level_index=level_index, inner_coordinate=inner_coordinate, outer_coordinate=outer_coordinate
        ):
            """Return the `ManifoldLevel` of the points with the given parameters u."""
            states = local_manifold.points_at(
                outer_coordinate * (inner_coordinate / outer_coordinate) ** (1.0 - parameters)
            )
            states, n_impacts, is_valid = iterate_map(scene, states, phase, level_index * periods, is_backward)
            return ManifoldLevel(parameters, states, n_impacts, is_valid & (abs(states[:, 1]) <= point_rules.fastest))

        parameters = levels[-1].u if level_index > 1 else np.linspace(0.0, 1.0, N_START_POINTS)
        manifold_level = _refine_level(
            evaluate_level(parameters),
            evaluate_level,
            point_rules._replace(length=remaining_length),
        )
        _, is_connected, distances = measure_neighbour_gaps(manifold_level, point_rules)
        arc_lengths = np.cumsum(np.where(is_connected, distances, 0.0))
        levels.append(manifold_level)
        if arc_lengths[-1] >= remaining_length:
            levels[-1] = ManifoldLevel(
                *(array[: np.searchsorted(arc_lengths, remaining_length) + 2] for array in manifold_level)
            )
            return levels, "length"
        n_points += len(manifold_level.u)
        if not manifold_level.is_valid.any():
            return levels, "fast"
        if arc_lengths[-1] < min(previous_level_length, ATTRACTOR_LENGTH * point_rules.spacing):
            return levels, "attractor"
        if n_points > point_rules.max_points:
            return levels, "points"
        if computation_limits.expired:
            return levels, "max_seconds"
        remaining_length, previous_level_length = remaining_length - arc_lengths[-1], arc_lengths[-1]
    return levels, "points"


def measure_neighbour_gaps(manifold_level, point_rules):
    """Return (distance / allowed distance, True if connected, distance) of each pair of neighbours."""
    is_valid_pair = manifold_level.is_valid[:-1] & manifold_level.is_valid[1:]
    with np.errstate(invalid="ignore"):
        distances = np.where(is_valid_pair, np.hypot(*np.diff(manifold_level.z, axis=0).T), np.inf)
        pair_speeds = np.maximum(abs(manifold_level.z[:-1, 1]), abs(manifold_level.z[1:, 1]))
        spacing_ratios = distances / (
            point_rules.spacing
            * np.where(pair_speeds > point_rules.max_unscaled_speed, pair_speeds / point_rules.max_unscaled_speed, 1.0)
        )
    return spacing_ratios, is_valid_pair & (spacing_ratios <= 1.0) & (np.diff(manifold_level.n_impacts) == 0), distances


def _refine_level(manifold_level, evaluate_level, point_rules):
    """Add points to a level until it obeys `point_rules` up to the required length, or has `max_points` points."""
    while len(manifold_level.u) < point_rules.max_points:
        needs_split = _needs_refinement(manifold_level, point_rules)
        if not needs_split.any():
            break
        split_fractions = HALF_FRACTION if needs_split.sum() > MAX_QUARTERED_GAPS else QUARTER_FRACTIONS
        inserted_points = evaluate_level(
            (
                manifold_level.u[:-1][needs_split, None]
                + split_fractions * np.diff(manifold_level.u)[needs_split, None]
            ).ravel()
        )
        insertion_indices = np.repeat(np.flatnonzero(needs_split) + 1, len(split_fractions))
        manifold_level = ManifoldLevel(
            *(
                np.insert(array, insertion_indices, values, axis=0)
                for array, values in zip(manifold_level, inserted_points, strict=True)
            )
        )
    return manifold_level


def _needs_refinement(manifold_level, point_rules):
    """Return True for pairs of neighbours between which `point_rules` require further points."""
    spacing_ratios, is_connected, distances = measure_neighbour_gaps(manifold_level, point_rules)
    impact_count_changes = np.diff(manifold_level.n_impacts) != 0
    is_any_end_valid = manifold_level.is_valid[:-1] | manifold_level.is_valid[1:]
    is_too_far = is_any_end_valid & np.where(
        impact_count_changes, distances > CORNER_DISTANCE * point_rules.scene_length_scale, spacing_ratios > 1.0
    )
    chord_vectors = np.diff(manifold_level.z, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        chord_angles = np.unwrap(np.arctan2(chord_vectors[:, 1], chord_vectors[:, 0]))
        turns_sharply = abs(np.diff(chord_angles)) > point_rules.angle
    turns_sharply &= is_connected[:-1] & is_connected[1:]
    is_at_sharp_turn = np.append(turns_sharply, False) | np.append(False, turns_sharply)
    is_at_sharp_turn &= (distances > point_rules.min_distance) & is_connected
    arc_lengths = np.cumsum(np.where(is_connected, distances, 0.0))
    is_within_length = np.append(0.0, arc_lengths[:-1]) < point_rules.length
    return (is_too_far | is_at_sharp_turn) & is_within_length & (np.diff(manifold_level.u) > MIN_PARAMETER_STEP)

"""Grow one side of an invariant manifold from images of a fundamental segment of the local manifold.

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

import numpy as np
from jaxtyping import Bool, Float, Int

from continuation.computation_limits import UNLIMITED

from .local_manifold import MIN_RADIUS, iterate_map

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

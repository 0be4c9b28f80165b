"""Grow one side of an invariant manifold from images of a fundamental segment of the local manifold.

Point k + u of a side, 0 <= u < 1, is ``F^k(W(a^(1-u) b^u))``. W is the local manifold, b its end, and F maps a to b.
F contracts across the curve. A negative multiplier swaps the sides, so the segment changes sides with each level;
iterating F twice instead would stretch it by the square of the multiplier. Where neighbours are too far apart, or the
curve turns too much between them, the midpoint in u is added and computed from the start: nothing is interpolated. k
grows level by level. This is Hobson's scheme (J. Comput. Phys. 104, 14, 1993) with the step control of Krauskopf and
Osinga (J. Comput. Phys. 146, 404, 1998).

Levels are stretched, so the points of the segment need an increasing accuracy. The rounding of x and v, relative to the
distance from the saddle, limits the length of the curve. A long local manifold is therefore better.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from continuation.limits import UNLIMITED

from .local_manifold import MIN_RADIUS, iterate_map

N_START_POINTS = 33  # points of the local manifold and of its first image
MIN_PARAMETER_STEP = 1e-14  # in u: nearer points are indistinguishable
HALF_FRACTION, QUARTER_FRACTIONS = np.array([0.5]), np.array([0.25, 0.5, 0.75])
MAX_QUARTERED_GAPS = 16  # up to this many gaps are split in four at once: a call costs the same for a hundred lanes
ATTRACTOR_LENGTH = 1e-4  # times the spacing: a shorter, shrinking level has reached an attractor
MAX_LEVELS = 1000
CORNER_DISTANCE = 1e-7  # times the scene's size: nearer neighbours with different itineraries mark a corner


class ManifoldRules(NamedTuple):
    """Rules for the points of a manifold.

    Attributes
    ----------
    spacing : float
        Largest distance of neighbours.
    angle : float
        Largest turn between neighbours, in rad.
    min_distance : float
        Distance below which turns do not matter.
    usual_speed : float
        Speed beyond which the spacing grows with the speed.
    fastest : float
        Speed beyond which the curve is left out.
    length : float
        Length of a side.
    max_points : int
        Largest number of points of a side.
    """

    spacing: float
    angle: float
    min_distance: float
    usual_speed: float
    fastest: float
    length: float
    max_points: int


class ManifoldLevel(NamedTuple):
    """Points of one level, images under F^k of points of the segment.

    Attributes
    ----------
    u : ndarray
        Parameters. Array of shape (points,).
    z : ndarray
        States. Array of shape (points, 2).
    n_impacts : ndarray
        Numbers of impacts on the way.
    valid : ndarray
        True for points with a final state.
    """

    u: Float[np.ndarray, " points"]
    z: Float[np.ndarray, "points 2"]
    n_impacts: Int[np.ndarray, " points"]
    valid: Bool[np.ndarray, " points"]


def grow_levels(
    scene, local_manifold, side, multiplier_sign, periods, phase, inverse, scene_size, rules, limits=UNLIMITED
):
    """Return the `ManifoldLevel`s of a side, and the reason for its end.

    local_manifold: a `LocalManifold`; side: -1 or 1; multiplier_sign: sign of the multiplier; periods: drive periods of
    F, or of its inverse if `inverse`; scene_size: a length of the scene; limits: time limit, after which no further
    level is started.
    """
    levels, remaining_length, previous_length, n_points = [], rules.length, 0.0, 0
    for level_index in range(MAX_LEVELS):
        outer_end = side * multiplier_sign**level_index * local_manifold.radius
        inner_end = (
            local_manifold.preimage(multiplier_sign * outer_end) if level_index else side * MIN_RADIUS * scene_size
        )

        def evaluate_level(u, level_index=level_index, inner_end=inner_end, outer_end=outer_end):
            """Return the level at these parameters."""
            z = local_manifold.points_at(outer_end * (inner_end / outer_end) ** (1.0 - u))
            z, n_impacts, valid = iterate_map(scene, z, phase, level_index * periods, inverse)
            return ManifoldLevel(u, z, n_impacts, valid & (abs(z[:, 1]) <= rules.fastest))

        u = levels[-1].u if level_index > 1 else np.linspace(0.0, 1.0, N_START_POINTS)
        level = _refine_level(evaluate_level(u), evaluate_level, scene_size, rules._replace(length=remaining_length))
        _, connected, distances = neighbour_gaps(level, scene_size, rules)
        arc_length = np.cumsum(np.where(connected, distances, 0.0))
        levels.append(level)
        if arc_length[-1] >= remaining_length:
            levels[-1] = ManifoldLevel(*(array[: np.searchsorted(arc_length, remaining_length) + 2] for array in level))
            return levels, "length"
        n_points += len(level.u)
        if not level.valid.any():
            return levels, "fast"
        if arc_length[-1] < min(previous_length, ATTRACTOR_LENGTH * rules.spacing):
            return levels, "attractor"
        if n_points > rules.max_points:
            return levels, "points"
        if limits.expired:
            return levels, "max_seconds"
        remaining_length, previous_length = remaining_length - arc_length[-1], arc_length[-1]
    return levels, "points"


def neighbour_gaps(level, scene_size, rules):
    """Return (distance over largest distance, True if joined, distance) of neighbours, each (points - 1,)."""
    valid = level.valid[:-1] & level.valid[1:]
    with np.errstate(invalid="ignore"):
        distances = np.where(valid, np.hypot(*np.diff(level.z, axis=0).T), np.inf)
        speed = np.maximum(abs(level.z[:-1, 1]), abs(level.z[1:, 1]))
        spacing_ratio = distances / (
            rules.spacing * np.where(speed > rules.usual_speed, speed / rules.usual_speed, 1.0)
        )
    return spacing_ratio, valid & (spacing_ratio <= 1.0) & (np.diff(level.n_impacts) == 0), distances


def _refine_level(level, evaluate_level, scene_size, rules):
    """Return the level with points added until its rules hold, up to the required length."""
    while len(level.u) < rules.max_points:
        needs_split = _needs_refinement(level, scene_size, rules)
        if not needs_split.any():
            break
        fractions = HALF_FRACTION if needs_split.sum() > MAX_QUARTERED_GAPS else QUARTER_FRACTIONS
        new_level = evaluate_level(
            (level.u[:-1][needs_split, None] + fractions * np.diff(level.u)[needs_split, None]).ravel()
        )
        insert_indices = np.repeat(np.flatnonzero(needs_split) + 1, len(fractions))
        level = ManifoldLevel(
            *(np.insert(array, insert_indices, values, axis=0) for array, values in zip(level, new_level, strict=True))
        )
    return level


def _needs_refinement(level, scene_size, rules):
    """Return True for pairs of neighbours that need a point between them."""
    spacing_ratio, connected, distances = neighbour_gaps(level, scene_size, rules)
    count_changes = np.diff(level.n_impacts) != 0
    any_valid = level.valid[:-1] | level.valid[1:]
    too_far = any_valid & np.where(count_changes, distances > CORNER_DISTANCE * scene_size, spacing_ratio > 1.0)
    chords = np.diff(level.z, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        directions = np.unwrap(np.arctan2(chords[:, 1], chords[:, 0]))
        is_sharp = abs(np.diff(directions)) > rules.angle
    is_sharp &= connected[:-1] & connected[1:]
    near_sharp = np.append(is_sharp, False) | np.append(False, is_sharp)
    near_sharp &= (distances > rules.min_distance) & connected
    arc_length = np.cumsum(np.where(connected, distances, 0.0))
    within_length = np.append(0.0, arc_length[:-1]) < rules.length
    return (too_far | near_sharp) & within_length & (np.diff(level.u) > MIN_PARAMETER_STEP)

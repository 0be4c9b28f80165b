"""A strand: one side of an invariant manifold, as images of a fundamental piece of its germ.

Point k + u of a strand, 0 <= u < 1, is F^k(W(a^(1-u) b^u)), W the germ, b its end, a what F leads there: F draws in
across the strand. A negative multiplier changes the sides, and so does the piece with each level; with F twice in place
of F it would be stretched by the multiplier's square. Where neighbours lie too far apart, or the strand turns too much
between them, the point half way in u is added, computed from the start: nothing is interpolated. Level by level k
grows. This is Hobson's scheme (J. Comput. Phys. 104, 14, 1993) with the control of Krauskopf and Osinga (J. Comput.
Phys. 146, 404, 1998). As levels are stretched, the piece's points have to be known better and better: the rounding of x
and v, over the distance from the saddle, ends what can be told. So the germ is to be long.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from continuation.limits import UNLIMITED

from .local_manifold import MIN_RADIUS, iterate_map

N_START_POINTS = 33  # points of the germ, and of its first image
MIN_PARAMETER_STEP = 1e-14  # in u: nearer ones are no longer told apart
HALF_FRACTION, QUARTER_FRACTIONS = np.array([0.5]), np.array([0.25, 0.5, 0.75])
MAX_QUARTERED_GAPS = (
    16  # gaps that are split in four at once, on the way to corners: a call costs the same for a hundred lanes
)
ATTRACTOR_LENGTH = 1e-4  # of the spacing: a level as short, and shorter than the one before, has come to an attractor
MAX_LEVELS = 1000  # levels
CORNER_DISTANCE = (
    1e-7  # of the scene's size: where itineraries change and neighbours are nearer, the strand has a corner
)


class ManifoldRules(NamedTuple):
    """spacing: the largest distance of neighbours; angle: the largest turn (rad); min_distance: the distance below
    which turns do not matter; usual_speed: the speed beyond which spacing grows with it; fastest: that at which a
    strand is left; length, max_points: of the strand, of its points."""

    spacing: float
    angle: float
    min_distance: float
    usual_speed: float
    fastest: float
    length: float
    max_points: int


class ManifoldLevel(NamedTuple):
    """Points of a strand, F^k of some: u, z (points, 2), the impacts on their ways, whether they have an end."""

    u: Float[np.ndarray, " points"]
    z: Float[np.ndarray, "points 2"]
    n_impacts: Int[np.ndarray, " points"]
    valid: Bool[np.ndarray, " points"]


def grow_levels(
    scene, local_manifold, side, multiplier_sign, periods, phase, inverse, scene_size, rules, limits=UNLIMITED
):
    """The `ManifoldLevel`s of a strand, and why it ends.

    local_manifold: its `Germ`; side: -1 or 1; multiplier_sign: that of the multiplier; periods: of the drive that F
    takes, or its inverse where `inverse`; scene_size: a length of the scene; limits: no further level is begun once
    their time is over."""
    levels, remaining_length, previous_length, n_points = [], rules.length, 0.0, 0
    for level_index in range(MAX_LEVELS):
        outer_end = side * multiplier_sign**level_index * local_manifold.radius
        inner_end = (
            local_manifold.preimage(multiplier_sign * outer_end) if level_index else side * MIN_RADIUS * scene_size
        )

        def evaluate_level(u, level_index=level_index, inner_end=inner_end, outer_end=outer_end):
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
    """(distance of neighbours over that allowed, whether they are joined, distance), each (points - 1,)."""
    valid = level.valid[:-1] & level.valid[1:]
    with np.errstate(invalid="ignore"):
        distances = np.where(valid, np.hypot(*np.diff(level.z, axis=0).T), np.inf)
        speed = np.maximum(abs(level.z[:-1, 1]), abs(level.z[1:, 1]))
        spacing_ratio = distances / (
            rules.spacing * np.where(speed > rules.usual_speed, speed / rules.usual_speed, 1.0)
        )
    return spacing_ratio, valid & (spacing_ratio <= 1.0) & (np.diff(level.n_impacts) == 0), distances


def _refine_level(level, evaluate_level, scene_size, rules):
    """The level with points added until its rules are kept, as far along as the length asks for."""
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
    """Which pairs of neighbours need a point between them."""
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

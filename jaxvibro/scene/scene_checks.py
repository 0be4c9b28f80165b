"""Check each number of a scene against the rule for its name, and check that the walls do not touch."""

from collections.abc import Callable
from math import gcd
from typing import Any, NamedTuple

import jax
import numpy as np

from . import check

MAX_BATCH_POINTS = 1 << 20  # bounds the memory of one search: 8 MB per array


def minimum_gap(left_wall, right_wall):
    """Return the smallest distance of two walls over the drive cycle, for each scene of the batch.

    The result is float64, in the unit of the positions. The sign is certain: the walls never touch if the result is
    positive. If both walls have the same harmonic, the result is the exact minimum. Otherwise it is a positive lower
    bound, or the smallest value in a search.
    """
    (left_cos, left_sin, left_harmonic), (right_cos, right_sin, right_harmonic) = (
        _motion_components(left_wall),
        _motion_components(right_wall),
    )
    mean_gap = np.float64(right_wall.position) - np.float64(left_wall.position)
    if left_harmonic == right_harmonic:
        return mean_gap - np.hypot(right_cos - left_cos, right_sin - left_sin)
    gap_bound = mean_gap - np.hypot(left_cos, left_sin) - np.hypot(right_cos, right_sin)
    gap_coefficients = np.stack(
        [np.ravel(array) for array in np.broadcast_arrays(mean_gap, left_cos, left_sin, right_cos, right_sin)]
    )
    harmonic_gcd = gcd(left_harmonic, right_harmonic)
    return _search_doubtful_lanes(
        gap_bound, gap_coefficients, left_harmonic // harmonic_gcd, right_harmonic // harmonic_gcd
    )


def _motion_components(wall):
    """Return B cos p, B sin p and m of a wall's motion ``B cos(m theta + p)``, theta being the phase of the drive."""
    if wall.motion is None:
        return np.float64(0.0), np.float64(0.0), 1
    amplitude, phase = np.float64(wall.motion.amplitude), np.float64(wall.motion.phase)
    return amplitude * np.cos(phase), amplitude * np.sin(phase), wall.motion.harmonic


def _search_doubtful_lanes(gap_bound, gap_coefficients, left_harmonic, right_harmonic):
    """Replace the bounds that are not above 0 by the results of a search."""
    flat_gaps = np.array(gap_bound).ravel()
    doubtful_lanes = np.flatnonzero(flat_gaps <= 0)
    block_size = max(1, MAX_BATCH_POINTS // (8 * max(left_harmonic, right_harmonic)))
    for first_index in range(0, doubtful_lanes.size, block_size):
        block_lanes = doubtful_lanes[first_index : first_index + block_size]
        flat_gaps[block_lanes] = _minimise_gap(gap_coefficients[:, block_lanes], left_harmonic, right_harmonic)
    return flat_gaps.reshape(np.shape(gap_bound))


def _minimise_gap(gap_coefficients, left_harmonic, right_harmonic):
    """Return the smallest gap in each lane, at most 0 if the walls touch.

    The method is branch and bound. In the interval of half-width h about c, the gap f is at least
    ``f(c) - h |f'(c)| - h^2 max |f''| / 2``. An interval is finished if this bound is above 0, and is halved otherwise.
    An interval counts as a contact if its bound is not above 0 and differs from f(c) by no more than rounding.
    """
    wall_amplitudes = (
        np.hypot(gap_coefficients[1], gap_coefficients[2]),
        np.hypot(gap_coefficients[3], gap_coefficients[4]),
    )
    max_gap_curvature = wall_amplitudes[0] * left_harmonic**2 + wall_amplitudes[1] * right_harmonic**2
    rounding_error = 4 * np.finfo(np.float64).eps * (abs(gap_coefficients[0]) + wall_amplitudes[0] + wall_amplitudes[1])
    n_first_intervals = 8 * max(left_harmonic, right_harmonic)
    half_width = np.pi / n_first_intervals
    min_gap = np.full(gap_coefficients.shape[1], np.inf)
    interval_lane = np.repeat(np.arange(min_gap.size), n_first_intervals)
    interval_centre = np.tile((2 * np.arange(n_first_intervals) + 1) * half_width, min_gap.size)
    while interval_lane.size:
        centre_gap, gap_slope = _gap_and_slope(
            gap_coefficients[:, interval_lane], interval_centre, left_harmonic, right_harmonic
        )
        max_gap_decrease = half_width * abs(gap_slope) + half_width**2 * max_gap_curvature[interval_lane] / 2
        is_certainly_open = centre_gap > max_gap_decrease
        is_touching = ~is_certainly_open & (max_gap_decrease < rounding_error[interval_lane])
        np.minimum.at(min_gap, interval_lane, np.where(is_touching, np.minimum(centre_gap, 0.0), centre_gap))
        half_width /= 2
        is_unresolved = ~is_certainly_open & (min_gap[interval_lane] > 0)
        interval_lane = np.repeat(interval_lane[is_unresolved], 2)
        interval_centre = (interval_centre[is_unresolved, None] + np.array([-half_width, half_width])).ravel()
    return min_gap


def _gap_and_slope(gap_coefficients, drive_phase, left_harmonic, right_harmonic):
    """Return the gap and its derivative with respect to the phase of the drive."""
    mean_gap, left_cos, left_sin, right_cos, right_sin = gap_coefficients
    left_angle, right_angle = left_harmonic * drive_phase, right_harmonic * drive_phase
    gap = (
        mean_gap
        + right_cos * np.cos(right_angle)
        - right_sin * np.sin(right_angle)
        - left_cos * np.cos(left_angle)
        + left_sin * np.sin(left_angle)
    )
    gap_slope = left_harmonic * (left_cos * np.sin(left_angle) + left_sin * np.cos(left_angle))
    gap_slope = gap_slope - right_harmonic * (right_cos * np.sin(right_angle) + right_sin * np.cos(right_angle))
    return gap, gap_slope


class Rule(NamedTuple):
    """Rule for the values of a quantity.

    Attributes
    ----------
    text : str
        Rule, for an error message.
    is_satisfied_by : callable
        Function of the value, True for a valid one.
    domain : tuple of float
        Smallest and largest valid value.
    """

    text: str
    is_satisfied_by: Callable[[Any], Any]
    domain: tuple[float, float]


FRACTION = Rule("must lie between 0 and 1", lambda value: (value >= 0) & (value <= 1), (0.0, 1.0))
POSITIVE = Rule("must be greater than 0", lambda value: value > 0, (np.finfo(float).tiny, np.inf))
NOT_NEGATIVE = Rule("must not be negative", lambda value: value >= 0, (0.0, np.inf))
RULES = {  # by the last part of the key
    "frequency": POSITIVE,
    "damping": NOT_NEGATIVE,
    "restitution": FRACTION,
    "stiffness": POSITIVE,
    "mass": POSITIVE,
    "length": POSITIVE,
}
PATH_KEYS = ("name", "key", "idx")  # attributes of the path entries of a dataclass, a dict, a tuple


def check_scene(scene):
    """Check numbers, walls and force of a scene and return the scene; traced values are not checked."""
    named_leaves = [
        (dotted_leaf_name(leaf_path), leaf) for leaf_path, leaf in jax.tree_util.tree_leaves_with_path(scene)
    ]
    check.require_broadcast(named_leaves)
    for key, leaf in named_leaves:
        check_value(key, leaf)
    if scene.left is not None and scene.right is not None:
        require_walls_apart(scene.left, scene.right)
    scene.flow_kind.check_values(scene)
    return scene


def check_value(key, value):
    """Check a value against the rule of its key; the parameters of a force or a contact law have no rule."""
    quantity = key.rpartition(".")[2]
    if quantity in RULES and ".numbers." not in key:
        check_rule(key, value, RULES[quantity])


def check_rule(key, value, rule):
    """Check that a value satisfies a rule; a traced value is not checked."""
    if not check.is_traced(value):
        check.require(key, rule.text, value, rule.is_satisfied_by(value))


def dotted_leaf_name(leaf_path):
    """Return the dotted name of a leaf from its path in the tree."""
    return ".".join(
        str(next(getattr(path_entry, key) for key in PATH_KEYS if hasattr(path_entry, key))) for path_entry in leaf_path
    )


def require_walls_apart(left_wall, right_wall):
    """Check that the walls are in order, and that they neither touch nor cross while they move."""
    if check.is_traced(left_wall.position, right_wall.position):
        return
    rule = "must lie to the right of left.position"
    check.require("right.position", rule, right_wall.position, left_wall.position < right_wall.position)
    if check.is_traced(*jax.tree.leaves((left_wall.motion, right_wall.motion))):
        return
    if left_wall.motion is not None or right_wall.motion is not None:
        min_gap = minimum_gap(left_wall, right_wall)
        moving_side = "left" if right_wall.motion is None else "right"
        check.require(
            f"{moving_side}.motion",
            "walls must not touch or cross in their motion: the smallest gap must exceed 0",
            min_gap,
            min_gap > 0,
        )

"""Describe the stability of orbits in words, from Floquet multipliers."""

import numpy as np

CIRCLE_TOLERANCE = 1e-6  # rounding of a multiplier that is on the unit circle at a special point
STABILITY_WORDS = ("stable", "neutral", "saddle", "flip saddle", "repelling")


def stability_words(multipliers):
    """Describe the stability of orbits in words.

    Parameters
    ----------
    multipliers : array_like
        Pairs of multipliers, array of shape (points, 2). Infinite multipliers, which occur at impacts with zero speed,
        count as outside the unit circle.

    Returns
    -------
    ndarray
        Array of shape (points,): ``"stable"``, ``"saddle"`` (only one multiplier outside the unit circle, above 1),
        ``"flip saddle"`` (only one outside, below -1), ``"repelling"`` (both outside) or ``"neutral"`` (no multiplier
        outside, at least one on the unit circle).
    """
    multiplier_pairs = np.asarray(multipliers)
    with np.errstate(invalid="ignore"):
        moduli = abs(multiplier_pairs)
    is_outside, is_on_circle = moduli > 1.0 + CIRCLE_TOLERANCE, abs(moduli - 1.0) <= CIRCLE_TOLERANCE
    has_flip_multiplier = (is_outside & (multiplier_pairs.real < 0)).any(axis=1)
    word_conditions = [
        is_outside.all(axis=1),
        is_outside.any(axis=1) & has_flip_multiplier,
        is_outside.any(axis=1),
        is_on_circle.any(axis=1),
    ]
    return np.select(word_conditions, ["repelling", "flip saddle", "saddle", "neutral"], "stable")


def stability_around(multipliers, point_index):
    """Describe the stability before and after a point of a branch, such as ``"saddle to stable"``.

    At the first and at the last point of the branch, the description is the stability of the orbit itself. If a
    multiplier of a neighbour is on the unit circle, the mean trace and determinant of the two points decide.

    Parameters
    ----------
    multipliers : array_like
        Pairs of multipliers along the branch, array of shape (points, 2).
    point_index : int
        Index of the point.

    Returns
    -------
    str
        Description of the stability.
    """
    multiplier_pairs = np.asarray(multipliers)
    if point_index in (0, len(multiplier_pairs) - 1):
        return str(stability_words(multiplier_pairs[point_index : point_index + 1])[0])
    return " to ".join(
        dict.fromkeys(
            _stability_between(multiplier_pairs, point_index, neighbour_index)
            for neighbour_index in (point_index - 1, point_index + 1)
        )
    )


def _stability_between(multiplier_pairs, point_index, neighbour_index):
    """Describe the stability between a point and its neighbour."""
    stability_word = str(stability_words(multiplier_pairs[neighbour_index : neighbour_index + 1])[0])
    if stability_word != "neutral" or not np.isfinite(multiplier_pairs[point_index]).all():
        return stability_word
    both_pairs = multiplier_pairs[[point_index, neighbour_index]]
    trace, determinant = both_pairs.sum(axis=1).real.mean(), both_pairs.prod(axis=1).real.mean()
    return str(stability_words(np.roots([1.0, -trace, determinant])[None])[0])

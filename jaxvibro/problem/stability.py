"""Describe multipliers in words."""

import numpy as np

CIRCLE_TOLERANCE = 1e-6  # rounding of a multiplier that is on the unit circle at a special point
STABILITY_WORDS = ("stable", "neutral", "saddle", "flip saddle", "repelling")


def stability_words(multipliers):
    """Describe the stability of orbits in words.

    Parameters
    ----------
    multipliers : array_like
        Pairs of multipliers, array of shape (points, 2). Infinite ones, at an impact with zero speed, count as outside
        the unit circle.

    Returns
    -------
    ndarray
        Array of shape (points,): ``"stable"``, ``"saddle"`` (a multiplier above 1), ``"flip saddle"`` (one below -1),
        ``"repelling"`` (both outside the unit circle) or ``"neutral"`` (on the unit circle).
    """
    multiplier_pairs = np.asarray(multipliers)
    with np.errstate(invalid="ignore"):
        moduli = abs(multiplier_pairs)
    is_outside, is_on_circle = moduli > 1.0 + CIRCLE_TOLERANCE, abs(moduli - 1.0) <= CIRCLE_TOLERANCE
    is_flip = (is_outside & (multiplier_pairs.real < 0)).any(axis=1)
    conditions = [
        is_outside.all(axis=1),
        is_outside.any(axis=1) & is_flip,
        is_outside.any(axis=1),
        is_on_circle.any(axis=1),
    ]
    return np.select(conditions, ["repelling", "flip saddle", "saddle", "neutral"], "stable")


def stability_around(multipliers, index):
    """Describe the stability before and after a point of a branch, such as ``"saddle to stable"``.

    At the first and at the last point of the branch, the description is the stability of the orbit itself. If a
    multiplier of a neighbour is on the unit circle, the mean trace and determinant of the two points decide.

    Parameters
    ----------
    multipliers : array_like
        Pairs of multipliers along the branch, array of shape (points, 2).
    index : int
        Index of the point.

    Returns
    -------
    str
        Description.
    """
    multiplier_pairs = np.asarray(multipliers)
    if index in (0, len(multiplier_pairs) - 1):
        return str(stability_words(multiplier_pairs[index : index + 1])[0])
    return " to ".join(dict.fromkeys(_stability_between(multiplier_pairs, index, k) for k in (index - 1, index + 1)))


def _stability_between(multiplier_pairs, index, neighbour):
    """Describe the stability between a point and its neighbour."""
    word = str(stability_words(multiplier_pairs[neighbour : neighbour + 1])[0])
    if word != "neutral" or not np.isfinite(multiplier_pairs[index]).all():
        return word
    two_pairs = multiplier_pairs[[index, neighbour]]
    trace, determinant = two_pairs.sum(axis=1).real.mean(), two_pairs.prod(axis=1).real.mean()
    return str(stability_words(np.roots([1.0, -trace, determinant])[None])[0])

"""What multipliers say of an orbit, in words."""

import numpy as np

CIRCLE_TOLERANCE = 1e-6  # of a multiplier's size from 1: at a special point it is on the unit circle but for a rounding
STABILITY_WORDS = ("stable", "neutral", "saddle", "flip saddle", "repelling")


def stability_words(multipliers):
    """ "stable", "saddle" (a multiplier above 1), "flip saddle" (one below -1), "repelling" (both are beyond), or
    "neutral" (on the unit circle) of pairs of multipliers, (points, 2): (points,) of texts. Infinite ones, at an impact
    without speed, are beyond."""
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
    """Describe the stability before and after a point of a branch, as "saddle to stable".

    An end has the word of its own orbit, as in a table of all points. Where a neighbour is itself a special point, on
    the unit circle, the word is that of the stretch between the two: of the mean trace and determinant.
    """
    multiplier_pairs = np.asarray(multipliers)
    if index in (0, len(multiplier_pairs) - 1):
        return str(stability_words(multiplier_pairs[index : index + 1])[0])
    return " to ".join(dict.fromkeys(_stability_between(multiplier_pairs, index, k) for k in (index - 1, index + 1)))


def _stability_between(multiplier_pairs, index, neighbour):
    """The word between a point and its neighbour."""
    word = str(stability_words(multiplier_pairs[neighbour : neighbour + 1])[0])
    if word != "neutral" or not np.isfinite(multiplier_pairs[index]).all():
        return word
    two_pairs = multiplier_pairs[[index, neighbour]]
    trace, determinant = two_pairs.sum(axis=1).real.mean(), two_pairs.prod(axis=1).real.mean()
    return str(stability_words(np.roots([1.0, -trace, determinant])[None])[0])

"""What multipliers say of an orbit, in words."""

import numpy as np

NEAR = 1e-6  # of a multiplier's size from 1: at a special point it is on the unit circle but for a rounding
WORDS = ("stable", "neutral", "saddle", "flip saddle", "repelling")


def words(multipliers):
    """ "stable", "saddle" (a multiplier above 1), "flip saddle" (one below -1), "repelling" (both are beyond), or
    "neutral" (on the unit circle) of pairs of multipliers, (points, 2): (points,) of texts. Infinite ones, at an impact
    without speed, are beyond."""
    pairs = np.asarray(multipliers)
    with np.errstate(invalid="ignore"):
        size = abs(pairs)
    beyond, on = size > 1.0 + NEAR, abs(size - 1.0) <= NEAR
    flips = (beyond & (pairs.real < 0)).any(axis=1)
    choice = [beyond.all(axis=1), beyond.any(axis=1) & flips, beyond.any(axis=1), on.any(axis=1)]
    return np.select(choice, ["repelling", "flip saddle", "saddle", "neutral"], "stable")


def words_around(multipliers, place):
    """Describe the stability before and after a point of a branch, as "saddle to stable".

    An end has the word of its own orbit, as in a table of all points. Where a neighbour is itself a special point, on
    the unit circle, the word is that of the stretch between the two: of the mean trace and determinant.
    """
    pairs = np.asarray(multipliers)
    if place in (0, len(pairs) - 1):
        return str(words(pairs[place : place + 1])[0])
    return " to ".join(dict.fromkeys(_beside(pairs, place, k) for k in (place - 1, place + 1)))


def _beside(pairs, place, neighbour):
    """The word between a point and its neighbour."""
    found = str(words(pairs[neighbour : neighbour + 1])[0])
    if found != "neutral" or not np.isfinite(pairs[place]).all():
        return found
    both = pairs[[place, neighbour]]
    trace, determinant = both.sum(axis=1).real.mean(), both.prod(axis=1).real.mean()
    return str(words(np.roots([1.0, -trace, determinant])[None])[0])

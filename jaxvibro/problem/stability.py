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


def words_around(found, place):
    """The word before and after a point of a branch, as "saddle to stable"; one where both are alike, or at an end."""
    near = [found[k] for k in (place - 1, place + 1) if 0 <= k < len(found)] or [found[place]]
    return " to ".join(dict.fromkeys(near))

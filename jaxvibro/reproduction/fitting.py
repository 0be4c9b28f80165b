"""Numbers of a scene fitted to values of special points: by gradient to come close, by Gauss and Newton to finish."""

from typing import NamedTuple

import numpy as np
import optax
from jaxtyping import Float

from ..loci.held_point import HeldPoint, move, slopes

RATE, CLOSE, LONG = 0.02, 0.03, 80  # of Adam's steps; a misfit so small ends them; so many at most
ROUNDS, LEAST = 20, 1e-13  # of Newton's steps; one as short is the last
WITHIN = 0.5  # of the way to where a point ends: nearer, its Newton's method may find another


class Fit(NamedTuple):
    """values: the numbers fitted; misfits: value less target of each point; by: d value / d number, (points, numbers);
    met: whether the last step was rounding; points: the `held_point.HeldPoint` there."""

    values: Float[np.ndarray, " numbers"]
    misfits: Float[np.ndarray, " points"]
    by: Float[np.ndarray, "points numbers"]
    met: bool
    points: tuple[HeldPoint, ...]

    @property
    def condition(self) -> float:
        """Of the derivative: how much more one direction of the numbers is felt than another."""
        return float(np.linalg.cond(self.by))


def fitted(points, targets, start, low, high):
    """The `Fit` of the least squares, from a start, within (low, high) of each number.

    points: `held_point.HeldPoint`, with the same numbers kept; targets: their values as they should be. Where a point
    does not exist with the start's numbers, it starts on the way there, from the points' own.
    """
    points, values = there(points, start)
    rule = optax.adam(RATE)
    state = rule.init(values)
    for _ in range(LONG):
        misfits, by = _felt(points, targets)
        if abs(misfits).max() < CLOSE:
            break
        step, state = rule.update(np.asarray(2.0 * by.T @ misfits), state)
        points, values = there(points, np.clip(values + np.asarray(step), low, high))
    return _finished(points, targets, low, high)


def there(points, values):
    """(points, numbers): the points where their numbers are these, or as near on the way as all of them exist."""
    start, values = np.array(points[0].kept), np.asarray(values, float)
    found = [move(one, values) for one in points]
    share = min(each for _, each in found)
    if share < 1.0:
        values = start + WITHIN * share * (values - start)
        found = [move(one, values) for one in points]
    return tuple(one for one, _ in found), values


def _felt(points, targets):
    """(misfits, their derivatives)."""
    values = np.array([one.value for one in points])
    return values - np.asarray(targets), np.stack([slopes(one) for one in points])


def _finished(points, targets, low, high):
    met = False
    for _ in range(ROUNDS):
        misfits, by = _felt(points, targets)
        values = np.array(points[0].kept)
        step = -np.linalg.lstsq(by, misfits, rcond=None)[0]
        if met:
            break
        points, _ = there(points, np.clip(values + step, low, high))
        met = abs(step).max() < LEAST * (1.0 + abs(values).max())
    return Fit(values, misfits, by, bool(met), points)

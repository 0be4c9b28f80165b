"""Numbers of scenes fitted to values of special points, by Gauss and Newton, through `located`."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..scene import check
from ..scene.codes import SolutionStatus
from ..scene.scene import changed
from .located import located
from .located_point import Located

ROUNDS, LEAST = 60, 1e-12  # of Newton's steps; one as short, in scales, is the last
SMALL = 1e-8  # scales: of steps that are shorter, one that is no shorter than the one before is the last: rounding
FAR = 2.0  # scales: the longest step
NEARER = 0.25  # of the way to a bound is kept
SHORTEST = 1.0 / 64.0  # of a step
ROUNDING = 1e-12  # of the squares' sum
TINY = 1e-300
WEAKEST = 1e-9  # of the strongest combination: a weaker one is not felt by the points, and held


class Points(NamedTuple):
    """Values of special points as functions of numbers: the functions, what was published, its errors, the names of
    each number, of several that are one, and their scales."""

    functions: tuple[Located, ...]
    values: Float[np.ndarray, " points"]
    sigma: Float[np.ndarray, " points"]
    names: tuple[tuple[str, ...], ...]
    scales: Float[np.ndarray, " numbers"]
    low: Float[np.ndarray, " numbers"]
    high: Float[np.ndarray, " numbers"]


class Met(NamedTuple):
    """numbers; residuals: values less published ones, in errors; by: their derivatives by numbers in scales; met:
    whether the last step was a short one."""

    numbers: Float[np.ndarray, " numbers"]
    residuals: Float[np.ndarray, " points"]
    by: Float[np.ndarray, "points numbers"]
    met: bool


def points_of(record, names, scales, low, high):
    """The `Points` of a `PointRecord`."""
    functions = tuple(located(one, None, wall) for one, wall in zip(record.points, record.walls, strict=True))
    for one in functions:
        for name in (each for group in names for each in group):
            check.require_known(name, one.special.scene.names, name)
            if name == one.name:
                raise check.ArgumentError(f"free.{name}", "must not be what a point's value is of", name)
    return Points(functions, record.values, np.full(len(functions), record.sigma), names, scales, low, high)


def met(points, numbers):
    """The least squares from numbers on: `Met`; None where a point exists at none of the numbers on the way there."""
    own = np.array(
        [[float(one.special.scene.parameter(group[0])) for group in points.names] for one in points.functions]
    )
    now = _there(points, np.mean(own, 0), numbers)
    if now is None:
        return None
    before = SMALL
    for _ in range(ROUNDS):
        step = -np.linalg.lstsq(now.by, now.residuals, rcond=WEAKEST)[0]
        size = float(abs(step).max())
        short, before = size <= LEAST or before <= size < SMALL, size
        new = _stepped(points, now, _longest(points, now.numbers, step) * step)
        if new is None:
            return now
        now = new
        if short:
            return now._replace(met=True)
    return now


def _there(points, own, numbers):
    """The `Met` at numbers, or as near on the way from the points' own as all of them exist."""
    share = 1.0
    while share >= SHORTEST:
        found = _felt(points, own + share * (numbers - own))
        if found is not None:
            return found
        share *= 0.5
    return _felt(points, own)


def _stepped(points, now, step):
    """The `Met` after as much of a step as makes it no worse; None where none does."""
    share, most = 1.0, (1.0 + ROUNDING) * (now.residuals @ now.residuals)
    while share >= SHORTEST:
        found = _felt(points, now.numbers + share * step * points.scales)
        if found is not None and (found.residuals @ found.residuals <= most or abs(step).max() <= SMALL):
            return found
        share *= 0.5
    return None


def _longest(points, numbers, step):
    """How much of a step is taken at most."""
    shares = [1.0, FAR / max(float(abs(step).max()), TINY)]
    for number, move, low, high in zip(numbers, step * points.scales, points.low, points.high, strict=True):
        room = (high - number) if move > 0 else (number - low)
        if move and np.isfinite(room):
            shares.append((1.0 - NEARER) * room / abs(move))
    return min(shares)


def _felt(points, numbers):
    """The `Met` at numbers, None where a point is not reached."""
    residuals, by = [], []
    for one, value, sigma in zip(points.functions, points.values, points.sigma, strict=True):
        scene = one.special.scene
        moved = changed(scene, {name: number for g, number in zip(points.names, numbers, strict=True) for name in g})
        found = one.solve(moved)
        if int(found.status) != SolutionStatus.OK:
            return None
        slopes = jax.grad(one)(moved)
        residuals.append((float(found.value) - value) / sigma)
        by.append([sum(float(slopes.parameter(name)) for name in group) for group in points.names])
    by = np.array(by) * points.scales / points.sigma[:, None]
    return Met(np.array(numbers), np.array(residuals), by, False)

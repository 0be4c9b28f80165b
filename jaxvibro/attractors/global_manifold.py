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

from .local_manifold import LEAST, mapped

START = 33  # points of the germ, and of its first image
FINEST = 1e-14  # in u: nearer ones are no longer told apart
HALF, QUARTERS = np.array([0.5]), np.array([0.25, 0.5, 0.75])
FEW = 16  # gaps that are split in four at once, on the way to corners: a call costs the same for a hundred lanes
SHORT = 1e-4  # of the spacing: a level as short, and shorter than the one before, has come to an attractor
MOST = 1000  # levels
TOUCH = 1e-7  # of the scene's size: where itineraries change and neighbours are nearer, the strand has a corner


class Rules(NamedTuple):
    """spacing: the largest distance of neighbours; angle: the largest turn (rad); least: the distance below which turns
    do not matter; usual: the speed beyond which spacing grows with it; fastest: that at which a strand is left; length,
    most: of the strand, of its points."""

    spacing: float
    angle: float
    least: float
    usual: float
    fastest: float
    length: float
    most: int


class Level(NamedTuple):
    """Points of a strand, F^k of some: u, z (points, 2), the impacts on their ways, whether they have an end."""

    u: Float[np.ndarray, " points"]
    z: Float[np.ndarray, "points 2"]
    count: Int[np.ndarray, " points"]  # type: ignore[assignment]  # hides tuple's method
    good: Bool[np.ndarray, " points"]


def levels(scene, start, side, sign, periods, phase, back, size, rules, limits=UNLIMITED):
    """The `Level`s of a strand, and why it ends.

    start: its `Germ`; side: -1 or 1; sign: that of the multiplier; periods: of the drive that F takes, or its inverse
    where `back`; size: a length of the scene; limits: no further level is begun once their time is over.
    """
    found, left, before, points = [], rules.length, 0.0, 0
    for k in range(MOST):
        end = side * sign**k * start.reach
        begin = start.back(sign * end) if k else side * LEAST * size

        def at(u, k=k, begin=begin, end=end):
            z = start.at(end * (begin / end) ** (1.0 - u))
            z, count, good = mapped(scene, z, phase, k * periods, back)
            return Level(u, z, count, good & (abs(z[:, 1]) <= rules.fastest))

        u = found[-1].u if k > 1 else np.linspace(0.0, 1.0, START)
        level = _refined(at(u), at, size, rules._replace(length=left))
        _, joined, apart = gaps(level, size, rules)
        along = np.cumsum(np.where(joined, apart, 0.0))
        found.append(level)
        if along[-1] >= left:
            found[-1] = Level(*(each[: np.searchsorted(along, left) + 2] for each in level))
            return found, "length"
        points += len(level.u)
        if not level.good.any():
            return found, "fast"
        if along[-1] < min(before, SHORT * rules.spacing):
            return found, "attractor"
        if points > rules.most:
            return found, "points"
        if limits.expired:
            return found, "max_seconds"
        left, before = left - along[-1], along[-1]
    return found, "points"


def gaps(level, size, rules):
    """(distance of neighbours over that allowed, whether they are joined, distance), each (points - 1,)."""
    good = level.good[:-1] & level.good[1:]
    with np.errstate(invalid="ignore"):
        apart = np.where(good, np.hypot(*np.diff(level.z, axis=0).T), np.inf)
        speed = np.maximum(abs(level.z[:-1, 1]), abs(level.z[1:, 1]))
        over = apart / (rules.spacing * np.where(speed > rules.usual, speed / rules.usual, 1.0))
    return over, good & (over <= 1.0) & (np.diff(level.count) == 0), apart


def _refined(level, at, size, rules):
    """The level with points added until its rules are kept, as far along as the length asks for."""
    while len(level.u) < rules.most:
        split = _coarse(level, size, rules)
        if not split.any():
            break
        share = HALF if split.sum() > FEW else QUARTERS
        new = at((level.u[:-1][split, None] + share * np.diff(level.u)[split, None]).ravel())
        places = np.repeat(np.flatnonzero(split) + 1, len(share))
        level = Level(*(np.insert(old, places, part, axis=0) for old, part in zip(level, new, strict=True)))
    return level


def _coarse(level, size, rules):
    """Which pairs of neighbours need a point between them."""
    over, joined, apart = gaps(level, size, rules)
    changed = np.diff(level.count) != 0
    either = level.good[:-1] | level.good[1:]
    far = either & np.where(changed, apart > TOUCH * size, over > 1.0)
    chord = np.diff(level.z, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        way = np.unwrap(np.arctan2(chord[:, 1], chord[:, 0]))
        bend = abs(np.diff(way)) > rules.angle
    bend &= joined[:-1] & joined[1:]
    turns = np.append(bend, False) | np.append(False, bend)
    turns &= (apart > rules.least) & joined
    along = np.cumsum(np.where(joined, apart, 0.0))
    begun = np.append(0.0, along[:-1]) < rules.length
    return (far | turns) & begun & (np.diff(level.u) > FINEST)

"""A strand: one side of an invariant manifold, as images of a fundamental piece of the eigenvector's line.

Point k + u of a strand, 0 <= u < 1, is F^k(saddle + s r^(u-1) e), r the multiplier, e its eigenvector: F draws in
across the strand. Where neighbours lie too far apart, or the strand turns too much between them, the point half way in
u is added, computed from the start: nothing is interpolated. Level by level k grows. This is Hobson's scheme (J.
Comput. Phys. 104, 14, 1993) with the control of Krauskopf and Osinga (J. Comput. Phys. 146, 404, 1998). As levels are
stretched, u has to be known better and better: its rounding ends what can be told.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from continuation.kept import kept

from . import period
from .backward import backward
from .entry import CAP
from .lanes import OPTIONS, WIDTH
from .state import State

LANES = 1 << 12  # of one compiled call
FIRST = 1e-6  # of the scene's size: so far from the saddle the line is the curve, to the square of it
FINEST = 1e-14  # in u: nearer ones are no longer told apart
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

    u: np.ndarray
    z: np.ndarray
    count: np.ndarray
    good: np.ndarray


def mapped(scene, z, phase, steps, back):
    """(z, impacts, good): F^steps of states (lanes, 2) at a phase, or of the inverse where `back`."""
    parts = []
    for first in range(0, len(z), LANES):
        some = z[first : first + LANES]
        padded = np.pad(some, ((0, LANES - len(some)), (0, 0)))
        found = _run(scene, *padded.T, scene.dtype.type(phase), steps, -(-len(some) // WIDTH), back)
        parts.append([each[: len(some)] for each in jax.device_get(found)])
    x, v, count, status = (np.concatenate(each) for each in zip(*parts, strict=True))
    return np.stack([x, v], -1), count, status < CAP


@kept(static_argnames="back", compiler_options=OPTIONS)
def _run(scene, x, v, phase, steps, blocks, back):
    def one(_, carry):
        x, v, contact, count, status = carry
        state = State(x, v, phase, contact)
        end, impacts = backward(scene, state, WIDTH) if back else period.strobe(scene, state, 1, 0, WIDTH)
        return end.x, end.v, end.contact, count + impacts.count, jnp.maximum(status, impacts.status)

    def block(k, whole):
        start = k * WIDTH
        x, v = (lax.dynamic_slice_in_dim(each, start, WIDTH) for each in whole[:2])
        none = jnp.zeros(WIDTH, jnp.int32)
        x, v, _, count, status = lax.fori_loop(0, steps, one, (x, v, 0.0 * x, none, none))
        new = (x, v, count, status)
        return [lax.dynamic_update_slice_in_dim(old, part, start, 0) for old, part in zip(whole, new, strict=True)]

    none = jnp.zeros(x.shape, jnp.int32)
    return lax.fori_loop(0, blocks, block, [x, v, none, none])


def levels(scene, saddle, heading, rate, periods, phase, back, size, rules):
    """The `Level`s of a strand, and why it ends.

    saddle (2,); heading: the eigenvector, of length 1, its sign tells the side; rate: how much `periods` drive periods
    (those of the inverse where `back`) stretch it, above 1; size: a length of the scene.
    """
    found, left, before, points = [], rules.length, 0.0, 0
    u = np.linspace(0.0, 1.0, 9)
    for k in range(MOST):

        def at(u, k=k):
            z = saddle + FIRST * size * rate ** (u[:, None] - 1.0) * heading
            z, count, good = mapped(scene, z, phase, k * periods, back)
            return Level(u, z, count, good & (abs(z[:, 1]) <= rules.fastest))

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
        left, before, u = left - along[-1], along[-1], level.u
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
        new = at(0.5 * (level.u[:-1] + level.u[1:])[split])
        places = np.flatnonzero(split) + 1
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

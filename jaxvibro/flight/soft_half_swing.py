"""The first step within a stiff wall: most of a half-swing, the same time after every entry that is fast enough.

From y = 0 at the speed u, under a push p on y, y(t) = u G(t) + int G(t - s) p(s) ds, where G is what a unit of speed
does to y: exp(-gamma2 t) sin(d t) / d, d^2 = 1 + k2 - gamma2^2. While p >= -P, y >= u G - P int G; and as G' / G falls,
int G / G rises up to pi / d. So u > P int G / G at the step's end certifies that the mass is still within.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from ..compiled.compiler_hints import choose
from . import drive, flow
from .wall import tail

SHARE = 0.9  # of the half-swing: the way out is then nearer than the longest step
SLIGHT = 0.5  # times the stiffness: damping^2 below which there is such a step
DOUBLINGS = 3  # of a step of the flow, in which time / d and 2 gamma2 count: SHARE pi sqrt(2) sqrt(2) < 8 of them
MARGIN = 1.01


class Plunge(NamedTuple):
    """A step of a given time: ratio, int G / G at its end, inf where there is no such step; change: of the push within
    it, a bound; free, forced, angle: `flow.doubled`'s; waves: as forced, under the wall's own motion, None where it
    stands still; terms: as forced, under the drive's further terms."""

    time: Float[jax.Array, "..."]
    ratio: Float[jax.Array, "..."]
    change: Float[jax.Array, "..."]
    free: flow.FreeFlow
    forced: flow.ForcedFlow
    angle: tuple[Float[jax.Array, "..."], Float[jax.Array, "..."]]
    waves: flow.ForcedFlow | None
    terms: tuple[flow.ForcedFlow, ...] = ()


def plunge(wall, force, frequency, series, waves, stiffness, terms=()):
    """The `Plunge` into a soft wall's `Lane`; series, waves: of the flow within it, stiffness: 1 + k2; terms: (the
    drive's further `Term`, the series under it)."""
    damping, own = wall.damping, frequency * float(wall.harmonic)
    given = [term for term, _ in terms]
    fast = jnp.maximum(frequency, own)
    fast = jnp.maximum(fast, frequency * float(drive.fastest(given))) if given else fast
    slight = (damping * damping < SLIGHT * stiffness) & (fast < jnp.sqrt(stiffness))
    time = SHARE * math.pi / jnp.sqrt(choose(slight, stiffness - damping * damping, stiffness))
    free, forced, angle = flow.redoubled(series, frequency, damping, time, stiffness, DOUBLINGS)
    moved = None if waves is None else flow.redoubled(waves, own, damping, time, stiffness, DOUBLINGS)[1]
    ratio = MARGIN * (1.0 - free[0]) / (stiffness * free[1])
    ratio = choose(slight, ratio, jnp.full_like(ratio, jnp.inf))
    change = tail(wall, force, frequency, damping, 1, given)[0] * time
    more = [
        flow.redoubled(own, drive.rate_of(term, frequency), damping, time, stiffness, DOUBLINGS)[1]
        for term, own in terms
    ]
    return Plunge(time, ratio, change, free, forced, angle, moved, tuple(more))


def is_sure(plunge, speed, push):
    """Whether the step is certain after an entry at this speed and this push into the wall."""
    weak = plunge.change - push
    return speed > plunge.ratio * choose(weak > 0, weak, 0.0)

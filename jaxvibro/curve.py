"""The equations of a special point along two parameters of the scene, as `continuation` takes them.

z = (times, speeds, first parameter, second). To the orbit's equations comes one more: an impact has no speed (GR), or
the equations, or those of a change that is the opposite each time round, are singular in times and speeds (SN; PD). A
symmetric orbit is followed by half of it, whose change then closes as itself at SN, as its opposite at SB: both are
regular there, while for the whole orbit a pitchfork is not.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from continuation.problem import Problem

from . import cycle, ring
from .along import Along, cycle_at, impacts, problem, there, varied
from .cycle import Cycle
from .frame import frame
from .lanes import one_kernel
from .scene import Scene


class Grazing(NamedTuple):
    """What a locus of GR is of. scene, which, cycle: as of `Along`, the touch being an impact; pick: (rows,), 1 at the
    impact without speed; slack: how deep behind a wall a flight may be, as the touch has a rounding."""

    scene: Scene
    which: Scene
    cycle: Cycle
    pick: np.ndarray
    slack: np.ndarray

    @property
    def hits(self):
        """The rows of impacts whose speeds are to be positive."""
        return np.flatnonzero((self.cycle.sides != 0) & (self.pick == 0))


class Singular(NamedTuple):
    """What a locus of SN, PD or SB is of. scene, which, cycle: as of `Along`; closing: 1 where a change of the orbit
    comes back as itself, -1 where as its opposite."""

    scene: Scene
    which: Scene
    cycle: Cycle
    closing: np.ndarray

    hits = Along.hits
    slack = Along.slack


def _grazing(z, curve):
    value, slopes = impacts(z, curve)
    rows = len(curve.pick)
    more = jnp.concatenate([jnp.zeros(rows), curve.pick, jnp.zeros(len(z) - 2 * rows)])
    return _with(value, jnp.sum(more * z)), (slopes, more)


def _singular(z, curve):
    """w J v, w and v being J's null vectors where it is singular, over the length of its gradient w J' v: it is then
    about the distance from its zero. As second derivatives commute, that by times and speeds is w times the derivative
    of the equations' slopes along v (Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria, 4.1.2)."""
    value, slopes, changes = varied(z, curve)
    left, right = ring.nulls(slopes, curve.closing)
    built, free = frame(there(curve, z)), len(left)

    def along(unknowns):
        there = cycle_at(curve, unknowns)._replace(closing=curve.closing)
        return ring.of(cycle.equations(built, there)[1])

    own, bent = jax.jvp(along, (z[:free],), (right,))
    bent = own._replace(own=bent.own, following=bent.following)
    by = jnp.stack([ring.product(left, each, right, curve.closing) for each in changes])
    more = jnp.concatenate([ring.across(left, bent), by])
    size = jnp.sqrt(jnp.sum(more * more))
    return _with(value, ring.product(left, slopes, right, curve.closing) / size), (slopes, more / size)


def _with(value, last):
    return jnp.concatenate([value, last[None]])


def _bordered(slopes, row, right):
    closed, more = slopes
    return ring.bordered(closed, jnp.stack([more, row]), right)


def _plain(function):
    def plain(z, curve):
        """(F, dF/dz); an empty row's unknowns are to be zero."""
        value, (slopes, more) = function(z, curve)
        empty = jnp.tile(curve.cycle.sides == 0, 2)
        orbit = jnp.where(empty, z[: len(empty)], value[:-1])
        return _with(orbit, value[-1]), jnp.concatenate([ring.dense(slopes), more[None]])

    return plain


GRAZING = Problem(_grazing, _bordered, _plain(_grazing), (), one_kernel)
SINGULAR = Problem(_singular, _bordered, _plain(_singular), (), one_kernel)
problem.register(Grazing, lambda curve: GRAZING)
problem.register(Singular, lambda curve: SINGULAR)

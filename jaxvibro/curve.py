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
from jax import lax

from continuation.problem import Problem

from . import cycle, ring
from .along import Along, cycle_at, impacts, problem, there
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
    """The determinant is taken over the length of its gradient: it is then about the distance from its zero."""
    value, slopes = impacts(z, curve)

    def measure(z):
        built = frame(there(curve, z))
        return ring.determinant(ring.of(cycle.equations(built, cycle_at(curve, z))[1]), curve.closing)

    def add(k, found):
        unit = jnp.where(jnp.arange(len(z)) == k, 1.0, 0.0)
        size, slope = jax.jvp(measure, (z,), (unit,))
        return size, lax.dynamic_update_index_in_dim(found[1], slope, k, 0)

    last, more = lax.fori_loop(0, len(z), add, (jnp.zeros_like(z[0]), jnp.zeros_like(z)))
    size = jnp.sqrt(jnp.sum(more * more))
    return _with(value, last / size), (slopes, more / size)


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

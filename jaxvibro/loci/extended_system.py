"""The equations of a special point along two parameters of the scene, as `continuation` takes them.

z = (times, speeds, first parameter, second). To the orbit's equations comes one more: an impact has no speed (GR), or
the equations, or those of a change that is the opposite each time round, are singular in times and speeds (SN; PD). A
symmetric orbit is followed by half of it, whose change then closes as itself at SN, as its opposite at SB: both are
regular there, while for the whole orbit a pitchfork is not.

Between soft walls the derivatives by the parameters, and of the slopes, are differences (`beside`): the equations are
compiled once in place of many times. They only point the way: where a locus lies is decided by the equations and their
first derivatives by times and speeds, which are exact. A touch of a soft wall that is smooth (`soft_grazing.is_smooth`)
is an impact that does nothing, as at speed zero the equations with a stay are singular.

An orbit that rests has no ring: before a release nothing hangs on what was before, and beside a grazing a row alone has
no pivot. Its equations are solved as one matrix.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from continuation.arclength import bordered
from continuation.arrays import Array
from continuation.problem import Problem

from ..compiled.kernels import one_kernel
from ..flight.coefficients import framed
from ..orbits import cyclic_system, impact_equations
from ..orbits.impact_equations import Cycle
from ..problem import grazing, touches
from ..problem.equations import OrbitEquations, are_impacts, cycle_at, impacts, problem, there, varied
from ..scene.scene import Scene

APART = 1e-5  # of 1 + abs z: the points of a difference


class Grazing(NamedTuple):
    """What a locus of GR is of. scene, which, cycle: as of `OrbitEquations`, the touch being an impact; pick: (rows,),
    1 at the impact without speed; slack: how deep behind a wall a flight may be, as the touch has a rounding."""

    scene: Scene
    which: Scene
    cycle: Cycle
    pick: Float[Array, " rows"]
    slack: Float[Array, ""]

    @property
    def hits(self) -> Int[np.ndarray, " impacts"]:
        """The rows of impacts whose speeds are to be positive."""
        return np.flatnonzero(are_impacts(self.cycle) & (self.pick == 0))


@touches.rests.register
def _(curve: Grazing, look):
    return look.rest, np.where(curve.pick > 0, np.inf, look.hold)  # at the touch the wall may begin to press: a DG


class Singular(NamedTuple):
    """What a locus of SN, PD or SB is of. scene, which, cycle: as of `OrbitEquations`; closing: 1 where a change of the
    orbit comes back as itself, -1 where as its opposite."""

    scene: Scene
    which: Scene
    cycle: Cycle
    closing: Float[Array, ""]

    hits = OrbitEquations.hits  # type: ignore[misc]  # properties that both have
    slack = OrbitEquations.slack  # type: ignore[misc]  # so too


def _grazing(z, curve):
    value, slopes = impacts(z, curve)
    more = _picked(z, curve)
    return _with(value, jnp.sum(more * z)), (slopes, more)


def _picked(z, curve):
    rows = len(curve.pick)
    return jnp.concatenate([jnp.zeros(rows), curve.pick, jnp.zeros(len(z) - 2 * rows)])


def _singular(z, curve):
    """w J v, w and v being J's null vectors where it is singular, over the length of its gradient w J' v: it is then
    about the distance from its zero. As second derivatives commute, that by times and speeds is w times the derivative
    of the equations' slopes along v (Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria, 4.1.2)."""
    value, slopes, changes = varied(z, curve)
    left, right = cyclic_system.nulls(slopes, curve.closing)
    built, free = framed(there(curve, z)), len(left)

    def along(unknowns):
        there = cycle_at(curve, unknowns)._replace(closing=curve.closing)
        return cyclic_system.of(impact_equations.equations(built, there)[1])

    own, bent = jax.jvp(along, (z[:free],), (right,))
    bent = own._replace(own=bent.own, following=bent.following)
    return _closed(curve, value, slopes, changes, bent, left, right)


def _closed(curve, value, slopes, changes, bent, left, right):
    """(F with w J v, over the length of its gradient, at its end; their slopes)."""
    by = jnp.stack([cyclic_system.product(left, each, right, curve.closing) for each in changes])
    more = jnp.concatenate([cyclic_system.across(left, bent), by])
    size = jnp.sqrt(jnp.sum(more * more))
    return _with(value, cyclic_system.product(left, slopes, right, curve.closing) / size), (slopes, more / size)


def _soft_grazing(z, curve):
    value, slopes, _ = beside(z, curve)
    return _with(value, jnp.sum(_picked(z, curve) * z)), (slopes, _picked(z, curve))


def _soft_singular(z, curve):
    value, slopes, (*changes, bent) = beside(z, curve, curve.closing)
    return _closed(curve, value, slopes, changes, bent, *cyclic_system.nulls(slopes, curve.closing))


def beside(z, curve, closing=None):
    """(F, its `cyclic_system.Ring`, how the ring's own and following change with each parameter and, where a closing is
    given, along its right null vector), by central differences."""
    rows, free = len(curve.cycle.sides), 2 * len(curve.cycle.sides)
    more, last = int(closing is not None), jnp.sum(curve.cycle.sides != 0) - 1
    apart = APART * (1.0 + jnp.append(abs(z[free:]), jnp.full(more, jnp.max(abs(z[:free])))))
    ways = np.concatenate([[[0.0] * len(apart)], np.eye(len(apart)), -np.eye(len(apart))])

    def look(k, found):
        step = lax.dynamic_index_in_dim(jnp.asarray(ways, z.dtype), k, keepdims=False) * apart
        moved = jnp.concatenate([z[:free], z[free:] + step[: len(z) - free]])
        built, given = framed(there(curve, moved)), cycle_at(curve, z)
        if more:  # none at the first turn, at z itself, before the null vector is known
            right = _unit(cyclic_system.nulls(_ring(found, 0, last), closing)[1])
            change = jnp.where(step[-1] == 0, 0.0, step[-1] * right)
            given = impact_equations.unwound(given, built.period, ((change, closing),))
        value, slopes = impact_equations.equations(built, given)
        one, count = cyclic_system.of(slopes), len(given.sides)
        new = one._replace(by=cyclic_system.pairs(value[:, None], count))[:3]
        return [lax.dynamic_update_index_in_dim(all_, new[:rows], k, 0) for all_, new in zip(found, new, strict=True)]

    blank = [jnp.zeros((len(ways), rows, 2, wide), z.dtype) for wide in (2, 2, 1)]
    found = lax.fori_loop(0, len(ways), look, blank)
    here = _ring(found, 0, last)
    value = jnp.where(jnp.arange(rows) <= last, here.by[:, :, 0].T, 0.0).reshape(-1)
    changes = [_change(found, k, apart, last) for k in range(len(apart))]
    by = jnp.concatenate([one.by for one in changes[: len(z) - free]], 2)
    if more:
        length = jnp.max(abs(cyclic_system.nulls(here, closing)[1]))
        changes[-1] = jax.tree.map(lambda each: each * length, changes[-1]._replace(last=1.0))._replace(last=last)
    return value, here._replace(by=by), [one._replace(by=by) for one in changes]


def _unit(vector):
    return vector / jnp.max(abs(vector))


def _ring(found, k, last):
    """The `Ring` of a turn of `beside`, by: F."""
    return cyclic_system.Ring(*(each[k] for each in found), last)


def _change(found, k, apart, last):
    """How the same change along a way."""
    count = len(apart)
    return cyclic_system.Ring(*((each[1 + k] - each[1 + count + k]) / (2.0 * apart[k]) for each in found), last)


def _with(value, last):
    return jnp.concatenate([value, last[None]])


def _bordered(slopes, row, right):
    closed, more = slopes
    return cyclic_system.bordered(closed, jnp.stack([more, row]), right)


def _plain(function, z, curve):
    """(F, dF/dz) of one of these systems; an empty row's unknowns are to be zero."""
    value, (slopes, more) = function(z, curve)
    empty = jnp.tile(curve.cycle.sides == 0, 2)
    orbit = jnp.where(empty, z[: len(empty)], value[:-1])
    return _with(orbit, value[-1]), jnp.concatenate([cyclic_system.dense(slopes), more[None]])


def _problem(function):
    return Problem(function, _bordered, partial(_plain, function), (), one_kernel)


GRAZING, SINGULAR = _problem(_grazing), _problem(_singular)
SOFT_GRAZING, SOFT_SINGULAR = _problem(_soft_grazing), _problem(_soft_singular)
RESTING = {
    soft: Problem(partial(_plain, one), bordered, partial(_plain, one), (), one_kernel)
    for soft, one in ((False, _grazing), (True, _soft_grazing))
}


@grazing.recut.register
def _(curve: Grazing, cycle, rows):
    pick = np.zeros(len(cycle.sides))
    pick[: len(rows)] = curve.pick[list(rows)]
    still = curve.cycle.still is not None
    return curve._replace(cycle=cycle._replace(still=pick if still else None), pick=pick)


@problem.register
def _(curve: Grazing):
    soft = bool(curve.scene.soft_sides)
    if curve.cycle.releases is not None:
        return RESTING[soft]
    return SOFT_GRAZING if soft else GRAZING


problem.register(Singular, lambda curve: SOFT_SINGULAR if curve.scene.soft_sides else SINGULAR)

"""The equations of an orbit whose rest just is one, along two parameters: of a CH, or of a release within a rest (RL).

To the orbit's equations comes how far the hops before a release are from those that just end in rest, or how hard the
wall presses where it does least. Both are known by numbers alone, the one by halving: their slopes are differences, by
the times of the row and of its release, its speed and the parameters, as nothing else matters to them.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from continuation.arclength import bordered
from continuation.arrays import Array
from continuation.problem import Problem

from ..compiled.kernels import one_kernel
from ..flight.coefficients import framed
from ..orbits import cyclic_system, impact_equations, releases
from ..orbits.impact_equations import Cycle
from ..problem import touches
from ..problem.equations import are_impacts, cycle_at, impacts, problem, there
from ..scene.scene import Scene
from .extended_system import beside

APART = 1e-5  # of 1 + abs z: the points of a difference


class Completing(NamedTuple):
    """What a locus of CH or RL is of. scene, which, cycle: as of `OrbitEquations`; pick: (rows,), 1 at the row whose
    rest just is one; held: 1 where its wall just holds, 0 where its hops just end; slack: as of `Grazing`."""

    scene: Scene
    which: Scene
    cycle: Cycle
    pick: Float[Array, " rows"]
    held: Float[Array, ""]
    slack: Float[Array, ""]

    @property
    def hits(self) -> Int[np.ndarray, " impacts"]:
        """The rows of impacts, whose speeds are to be positive."""
        return np.flatnonzero(are_impacts(self.cycle))


def _measure(measure, curve, z):
    """What is zero there."""
    built, given = framed(there(curve, z)), cycle_at(curve, z)
    found = impact_equations.flights(built, given)
    every, _ = releases.tails_of(built, given, found)
    row = jnp.argmax(curve.pick)
    return measure(built, jax.tree.map(lambda each: each[row], every))


def _matter(curve, z):
    """The directions of z that change it: (directions, unknowns)."""
    rows = len(curve.pick)
    last = jnp.sum(curve.cycle.sides != 0) - 1
    row = jnp.argmax(curve.pick)
    following = jnp.where(row == last, 0, row + 1)
    places = jnp.stack([row, following, rows + row, *range(2 * rows, len(z))])
    return jnp.eye(len(z), dtype=z.dtype)[places]


def _completing(measure, soft, z, curve):
    """(F, dF/dz); an empty row's unknowns are to be zero."""
    value, slopes = beside(z, curve)[:2] if soft else impacts(z, curve)
    empty = jnp.tile(curve.cycle.sides == 0, 2)
    orbit = jnp.where(empty, z[: len(empty)], value)
    ways = _matter(curve, z)
    steps = APART * (1.0 + abs(ways @ z))
    moves = steps[:, None] * ways
    found = jax.vmap(partial(_measure, measure, curve))(jnp.concatenate([z[None], z + moves, z - moves]))
    ahead, back = jnp.split(found[1:], 2)
    more = ((ahead - back) / (2.0 * steps)) @ ways
    return jnp.append(orbit, found[0]), jnp.concatenate([cyclic_system.dense(slopes), more[None]])


def _problem(measure, soft):
    function = partial(_completing, measure, soft)
    return Problem(function, bordered, function, (), one_kernel, at_once=True)


PROBLEMS = {
    (held, soft): _problem(releases.least_press if held else releases.too_fast, soft)
    for held in (False, True)
    for soft in (False, True)
}


@problem.register
def _(curve: Completing):
    return PROBLEMS[bool(curve.held), bool(curve.scene.soft_sides)]


@touches.rests.register
def _(curve: Completing, look):
    rest, hold = (np.where(curve.pick > 0, np.inf, each) for each in (look.rest, look.hold))
    return (look.rest, hold) if bool(curve.held) else (rest, look.hold)

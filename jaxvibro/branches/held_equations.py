"""The equations of orbits along two parameters with one more number that is to stay what it is, as `continuation` takes
them: z = (times, speeds or x and v, first parameter, second).

How the number changes with z is told by central differences: they point the way alone, while whether it is what it is
to be is exact.
"""

from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation.arclength import bordered
from continuation.arrays import Array
from continuation.problem import Problem

from ..compiled.kernels import one_kernel
from ..flight.coefficients import framed
from ..orbits.impact_equations import Cycle
from ..problem.diagnostics import flight
from ..problem.equations import FREE, IMPACTS, RESTING, OrbitEquations, cycle_at, problem, there
from ..scene.scene import Scene
from .largest_position import of_cycle, of_flight

APART = 1e-5  # of 1 + abs z: the points of a difference


class HeldOrbits(NamedTuple):
    """Orbits of which a number is held. scene, which, cycle: as of `OrbitEquations`; pick: (2,), 1 at that of `HELD`
    which is held; value: what it is to be."""

    scene: Scene
    which: Scene
    cycle: Cycle
    pick: Float[Array, "2"]
    value: Float[Array, ""]

    hits = OrbitEquations.hits  # type: ignore[misc]  # properties that both have
    slack = OrbitEquations.slack  # type: ignore[misc]  # so too


def _peak(z, held):
    if len(held.cycle.sides):
        return of_cycle(framed(there(held, z)), cycle_at(held, z))
    return of_flight(*flight(held, z))


def _least_speed(z, held):
    rows = len(held.cycle.sides)
    return jnp.min(jnp.where(held.cycle.sides != 0, z[rows : 2 * rows], jnp.inf), initial=jnp.inf)


HELD = {"peak": _peak, "least_speed": _least_speed}


def number(z, held):
    """The number that is held, at z."""
    return sum(held.pick[k] * jnp.where(held.pick[k] > 0, one(z, held), 0.0) for k, one in enumerate(HELD.values()))


def _system(plain, z, held):
    """(F, dF/dz) with the number less its value at the end."""
    value, slopes = plain(z, held)
    apart = APART * (1.0 + abs(z))
    ways = np.concatenate([np.zeros((1, len(z))), np.eye(len(z)), -np.eye(len(z))])
    found = lax.map(lambda way: number(z + way * apart, held), jnp.asarray(ways, z.dtype))
    more = (found[1 : len(z) + 1] - found[len(z) + 1 :]) / (2.0 * apart)
    return jnp.append(value, found[0] - held.value), jnp.concatenate([slopes, more[None]])


def _problem(of):
    function = partial(_system, of.plain)
    return Problem(function, bordered, function, (), one_kernel, of.holds, at_once=True)


PROBLEMS = tuple(_problem(one) for one in (IMPACTS, RESTING, FREE))


@problem.register
def _(held: HeldOrbits):
    rests = held.cycle.releases is not None
    return PROBLEMS[(1 if rests else 0) if len(held.cycle.sides) else 2]

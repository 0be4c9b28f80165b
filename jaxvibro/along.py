"""The equations of a periodic orbit along one parameter of the scene, as `continuation` takes them.

An orbit with impacts: z = (times, speeds, parameter), see `cycle`. One without: z = (x, v at the section, parameter).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from continuation.arclength import bordered
from continuation.problem import Problem, Test

from . import cycle, flow, ring
from .cycle import Cycle
from .frame import frame
from .lanes import one_kernel
from .scene import Scene


class Along(NamedTuple):
    """What a branch is of. scene: its numbers but for the parameter; which: the scene's tree with True where the
    parameter stands; cycle: sides, phase and periods; its times and speeds are not used."""

    scene: Scene
    which: Scene
    cycle: Cycle


def there(along, value):
    """The scene at a value of the parameter."""
    return jax.tree.map(lambda leaf, mark: jnp.where(mark, value, leaf), along.scene, along.which)


def cycle_at(along, z):
    """The `Cycle` with these unknowns."""
    rows = len(along.cycle.sides)
    return along.cycle._replace(times=z[:rows], speeds=z[rows : 2 * rows])


@jax.jit
def _impacts(z, along):
    """(F, its `ring.Ring`)."""
    given = cycle_at(along, z)

    def at(value):
        return cycle.equations(frame(there(along, value)), given)

    (value, slopes), (by, _) = jax.jvp(at, (z[-1],), (jnp.ones_like(z[-1]),))
    return value, ring.of(slopes, by)


def _plain(z, along):
    """(F, dF/dz); an empty row's unknowns are to be zero."""
    value, slopes = _impacts(z, along)
    empty = jnp.tile(along.cycle.sides == 0, 2)
    return jnp.where(empty, z[:-1], value), ring.dense(slopes)


def _flip(z, along):
    built, given = frame(there(along, z[-1])), cycle_at(along, z)
    return ring.dense(ring.of(cycle.equations(built, given)[1]), -1.0)[:, :-1]


@jax.jit
def _free(z, along):
    """(F, dF/dz): what a flight over the periods leaves to be periodic."""

    def values(z):
        scene, turns = there(along, z[-1]), along.cycle
        span = turns.periods * 2.0 * jnp.pi / scene.frequency
        force = scene.amplitude * jnp.cos(turns.phase), scene.amplitude * jnp.sin(turns.phase)
        x, v = flow.flown(flow.responses(scene.frequency, scene.damping, span), *force, z[0], z[1])
        return jnp.stack([x - z[0], v - z[1]])

    return values(z), jax.jacfwd(values)(z)


IMPACTS = Problem(_impacts, ring.bordered, _plain, (Test("PD", _flip),), one_kernel)
FREE = Problem(_free, bordered, _free, (), one_kernel)


def problem(along):
    """The `Problem` of the orbits of an `Along`."""
    return IMPACTS if len(along.cycle.sides) else FREE

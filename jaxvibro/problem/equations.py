"""The equations of a periodic orbit along parameters of the scene, as `continuation` takes them.

An orbit with impacts: z = (times, speeds, parameters), see `impact_equations`. One without: z = (x, v at the section,
parameters). A branch has one parameter, a locus (see `crossing`) two.
"""

from functools import singledispatch
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from continuation.arclength import bordered
from continuation.problem import Problem, Test

from ..compiled.kernels import one_kernel
from ..flight import response
from ..flight.coefficients import framed
from ..orbits import cyclic_system, impact_equations
from ..orbits.impact_equations import Cycle
from ..scene.codes import Contact
from ..scene.scene import Scene

NONE = 1e-10  # of the drive's amplitudes, per t: as small a speed is none


class OrbitEquations(NamedTuple):
    """What a branch is of. scene: its numbers but for the parameters; which: the scene's tree with 1 where the first
    parameter stands, 2 the second, else 0; cycle: sides, phase and periods; its times and speeds are not used."""

    scene: Scene
    which: Scene
    cycle: Cycle

    @property
    def hits(self) -> Int[np.ndarray, " impacts"]:
        """The rows of impacts, whose speeds are to be positive."""
        return np.flatnonzero(are_impacts(self.cycle))

    @property
    def slack(self) -> float:
        """How deep behind a wall a flight may be, as a touch that is meant is found with a rounding."""
        return 0.0


def are_impacts(cycle):
    """Which rows of a cycle are impacts, and neither empty nor releases: (rows,)."""
    hit = np.asarray(cycle.sides != 0)
    return hit if cycle.releases is None else hit & (np.asarray(cycle.releases) == 0)


def codes(cycle):
    """The sides of a cycle's rows, +-2 or +-3 of releases, as `grazing.padded` takes them: (rows,)."""
    return cycle.sides if cycle.releases is None else cycle.sides * (1.0 + cycle.releases)


def are_releases(codes):
    """Which of some rows with these `codes` are releases."""
    return abs(np.asarray(codes)) >= Contact.STUCK


def there(along, z):
    """The scene at z."""
    values = z[2 * len(along.cycle.sides) or 2 :]

    def put(leaf, mark):
        for k in range(len(values)):
            leaf = jnp.where(mark == k + 1, values[k], leaf)
        return leaf

    return jax.tree.map(put, along.scene, along.which)


def number_there(along, z, name):
    """A number of the scene at z, of the scene itself, as the host asks for it: a float."""
    return _value(along, z, getattr(along.which, name), getattr(along.scene, name))


def _value(along, z, mark, own):
    """A number at z: its own, or the parameter that it is marked as."""
    place = int(mark)
    return float(z[(2 * len(along.cycle.sides) or 2) + place - 1] if place else own)


def cycle_at(along, z):
    """The `Cycle` with these unknowns."""
    rows = len(along.cycle.sides)
    return along.cycle._replace(times=z[:rows], speeds=z[rows : 2 * rows])


@jax.jit
def impacts(z, along):
    """(F, its `cyclic_system.Ring`)."""
    return varied(z, along)[:2]


def varied(z, along):
    """(F, its `cyclic_system.Ring`, how the ring's own and following change with each parameter)."""
    given, free = cycle_at(along, z), 2 * len(along.cycle.sides)

    def at(values):
        value, slopes = impact_equations.equations(framed(there(along, jnp.concatenate([z[:free], values]))), given)
        return value, cyclic_system.of(slopes)

    by, more = [], []
    for unit in np.eye(len(z) - free):
        (value, slopes), (change, bent) = jax.jvp(at, (z[free:],), (jnp.asarray(unit, z.dtype),))
        by.append(change)
        more.append(slopes._replace(own=bent.own, following=bent.following))
    return value, slopes._replace(by=cyclic_system.pairs(jnp.stack(by, 1), len(given.sides))), more


def _plain(z, along):
    """(F, dF/dz); an empty row's unknowns are to be zero."""
    value, slopes = impacts(z, along)
    empty = jnp.tile(along.cycle.sides == 0, 2)
    return jnp.where(empty, z[: len(value)], value), cyclic_system.dense(slopes)


def _flip(z, along):
    built, given = framed(there(along, z)), cycle_at(along, z)
    return cyclic_system.dense(cyclic_system.of(impact_equations.equations(built, given)[1]), -1.0)


def _hits(z, along):
    """Whether each impact has a speed: where one has none, the equations are singular, and every test is zero."""
    speeds, strength = z[len(along.cycle.sides) :][along.hits], abs(number_there(along, z, "amplitude"))
    for mark, term in zip(along.which.drive, along.scene.drive, strict=True):
        strength += abs(_value(along, z, mark.amplitude, term.amplitude))
    return bool((speeds > NONE * strength).all())


@jax.jit
def _free(z, along):
    """(F, dF/dz): what a flight over the periods leaves to be periodic."""

    def values(z):
        scene, turns = there(along, z), along.cycle
        span = turns.periods * 2.0 * jnp.pi / scene.frequency
        x, v = response.of_scene(scene, z[0], z[1], turns.phase, span)[0]
        left = jnp.stack([x - z[0], v - z[1]])
        return left, left

    slopes, left = jax.jacfwd(values, has_aux=True)(z)
    return left, slopes


def _free_flip(z, along):
    """M + I, singular where the period doubles."""
    return _free(z, along)[1][:, :2] + 2.0 * jnp.eye(2, dtype=z.dtype)


IMPACTS = Problem(impacts, cyclic_system.bordered, _plain, (Test("PD", _flip),), one_kernel, _hits)
RESTING = Problem(_plain, bordered, _plain, (), one_kernel, _hits)  # what forgets does not double
FREE = Problem(_free, bordered, _free, (Test("PD", _free_flip),), one_kernel)


@singledispatch
def problem(along):
    """The `Problem` of what is followed: of the orbits of an `OrbitEquations`."""
    if not len(along.cycle.sides):
        return FREE
    return IMPACTS if along.cycle.releases is None else RESTING

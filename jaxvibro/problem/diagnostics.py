"""What is to be known of each of many points of a branch: clearances, multipliers, the states at the section."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation.arrays import Array
from continuation.persistent_jit import persistent_jit

from ..compiled.compiler_hints import one_kernel
from ..flight import response
from ..flight.coefficients import framed
from ..flight.flows import flow_of
from ..orbits import cyclic_system, flight_clearance, impact_equations
from .equations import cycle_at, there

LANES = 144  # points of a compiled call


class Diagnostics(NamedTuple):
    """clear, late: (points, flights, walls), the least distance at a turning point towards the wall, and its time since
    the flight's start; trace, determinant: (points,), of the monodromy matrix; x, v: (points, periods), at the
    section's phase; fold, flip: (points,), determinants, zero where a branch folds and where the period doubles."""

    clear: Float[Array, "*points flights walls"]
    late: Float[Array, "*points flights walls"]
    trace: Float[Array, "*points"]
    determinant: Float[Array, "*points"]
    x: Float[Array, "*points periods"]
    v: Float[Array, "*points periods"]
    fold: Float[Array, "*points"]
    flip: Float[Array, "*points"]


def diagnose(along, zs):
    """The `Diagnostics` at points, shape (points, n + 1)."""
    periods = int(along.cycle.periods)
    wide = 1 << (periods - 1).bit_length()  # so that fewer sizes are compiled
    look = Diagnostics(*each_of(hitting if len(along.cycle.sides) else _free, along, zs, wide))
    return look._replace(x=look.x[:, :periods], v=look.v[:, :periods])


def each_of(one, along, zs, periods):
    """What a function of a module, (along, z, periods) -> a tuple of arrays, gives at points: a tuple of arrays."""
    parts = []
    for first in range(0, len(zs), LANES):
        some = zs[first : first + LANES]
        padded = np.concatenate([some, np.repeat(some[-1:], LANES - len(some), axis=0)])
        found = _seen(one, along, padded, np.int32(len(some)), periods)
        parts.append([each[: len(some)] for each in found])
    return tuple(np.concatenate(each) for each in zip(*parts, strict=True))


def _in_turn(one, along, zs, count, periods):
    return _each(along, zs, count, jax.jit(one, static_argnums=2), periods)


@persistent_jit(static_argnums=(0, 4), numpy_first=_in_turn)
def _seen(one, along, zs, count, periods):
    """Point by point in one kernel: as fast here as many lanes at once, and compiled in half the time."""
    return one_kernel(_each, along, zs, count, one=one, periods=periods)


def _each(along, zs, count, one, periods):
    def look(k, found):
        new = one(along, lax.dynamic_index_in_dim(zs, k, keepdims=False), periods)
        return jax.tree.map(lambda whole, part: lax.dynamic_update_index_in_dim(whole, part, k, 0), found, new)

    shapes = jax.eval_shape(lambda along, z: one(along, z, periods), along, zs[0])
    blank = jax.tree.map(lambda leaf: jnp.zeros((len(zs), *leaf.shape), leaf.dtype), shapes)
    return lax.fori_loop(0, count, look, blank)


def hitting(along, z, periods):
    """The `Diagnostics` at one point of orbits with impacts."""
    built, given = framed(there(along, z)), cycle_at(along, z)
    found = impact_equations.flights(built, given)
    x, v = impact_equations.at(built, given, found, built.period * jnp.arange(periods))
    clear = flight_clearance.clearances(built, found, flight_clearance.samples(built, found))
    measures = cyclic_system.determinants(cyclic_system.of(impact_equations.equations(built, given, found)[1]))
    return Diagnostics(*clear, *impact_equations.invariants(built, found, given.sides), x, v, *measures)


def _free(along, z, periods):
    built, found = flight(along, z)
    around = found.time / flight_clearance.OVERLAP
    _, matrix = flow_of(built).matrix(built, found.x, found.v, found.cosine, found.sine, around)
    p00, _, _, p11 = response.by_rows(matrix)
    x, v = jnp.full(periods, z[0]), jnp.full(periods, z[1])
    clear = flight_clearance.clearances(built, found, flight_clearance.samples(built, found))
    return Diagnostics(*clear, (p00 + p11)[0], response.determinant(matrix)[0], x, v, *[jnp.ones_like(z[0])] * 2)


def flight(along, z):
    """(`Frame`, the one flight) of an orbit without impacts: over a little more than its periods."""
    built, turns = framed(there(along, z)), along.cycle
    return built, flight_clearance.without_impacts(built, turns.phase, turns.periods, z[0], z[1])

"""What is to be known of each of many points of a branch: clearances, multipliers, the states at the section."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float

from continuation.arrays import Array
from continuation.persistent_jit import SOON, persistent_jit

from ..compiled.kernels import one_kernel
from ..flight import response
from ..flight.coefficients import framed
from ..flight.flows import flow_of
from ..orbits import cyclic_system, flight_clearance, impact_equations, releases
from ..orbits.meeting_wall import way
from .equations import cycle_at, there

LANES = 144  # points of a compiled call


class Diagnostics(NamedTuple):
    """clear, late: (points, flights, walls), the least distance at a turning point towards the wall, and its time since
    the flight's start; trace, determinant: (points,), of the monodromy matrix; x, v: (points, periods), at the
    section's phase; fold, flip: (points,), determinants, zero where a branch folds and where the period doubles. rest,
    hold, plain: (points, rows), as `releases.Tails` has them, inf where nothing rests; hold as `releases.draws` too."""

    clear: Float[Array, "*points flights walls"]
    late: Float[Array, "*points flights walls"]
    trace: Float[Array, "*points"]
    determinant: Float[Array, "*points"]
    x: Float[Array, "*points periods"]
    v: Float[Array, "*points periods"]
    fold: Float[Array, "*points"]
    flip: Float[Array, "*points"]
    rest: Float[Array, "*points rows"]
    hold: Float[Array, "*points rows"]
    plain: Float[Array, "*points rows"]


def diagnose(along, zs):
    """The `Diagnostics` at points, shape (points, n + 1)."""
    periods = int(along.cycle.periods)
    wide = 1 << (periods - 1).bit_length()  # so that fewer sizes are compiled
    look = Diagnostics(*each_of(_way_of(along), along, zs, wide))
    return look._replace(x=look.x[:, :periods], v=look.v[:, :periods])


def _way_of(along):
    if not len(along.cycle.sides):
        return _free
    return hitting if along.cycle.releases is None else resting


def each_of(one, along, zs, periods):
    """What a function of a module, (along, z, periods) -> a tuple of arrays, gives at points: a tuple of arrays."""
    parts = []
    for first in range(0, len(zs), LANES):
        some = zs[first : first + LANES]
        padded = np.concatenate([some, np.repeat(some[-1:], LANES - len(some), axis=0)])
        seen = _seen_resting if one is resting else _seen
        found = jax.device_get(seen(one, along, padded, np.int32(len(some)), periods))
        parts.append([each[: len(some)] for each in found])
    return tuple(np.concatenate(each) for each in zip(*parts, strict=True))


def _in_turn(one, along, zs, count, periods):
    return _each(along, zs, count, jax.jit(one, static_argnums=2), periods)


@persistent_jit(static_argnums=(0, 4), numpy_first=_in_turn)
def _seen(one, along, zs, count, periods):
    """Point by point in one kernel: as fast here as many lanes at once, and compiled in half the time."""
    return one_kernel(_each, along, zs, count, one=one, periods=periods)


@persistent_jit(static_argnums=(0, 4), compiler_options=SOON)
def _seen_resting(one, along, zs, count, periods):
    """The same compiled at once: a chatter has too many hops for Python."""
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
    own = impact_equations.invariants(built, found, given.sides)
    none = jnp.full_like(given.times, jnp.inf)
    return Diagnostics(*clear, *own, x, v, *measures, none, releases.draws(built, given, found), none)


def resting(along, z, periods):
    """The `Diagnostics` at one point of orbits that rest: their multipliers are zero. Where a mass is let go its wall
    is none that it comes to."""
    built, given = framed(there(along, z)), cycle_at(along, z)
    found = impact_equations.flights(built, given)
    times = built.period * jnp.arange(periods)
    look = releases.tails(built, given, found, times)
    count = flight_clearance.samples(built, found)
    clear, late = flight_clearance.clearances(built, found, count)
    own = jnp.array([wall.sign for wall in built.walls]) == given.sides[:, None]
    leaves = (given.releases[:, None] > 0) & own & (late <= 2.0 * (found.time / count)[:, None])
    clear = jnp.where(leaves, jnp.inf, clear)
    ring = cyclic_system.of(impact_equations.equations(built, given, found)[1])
    fold, none = cyclic_system.determinants(ring)[0], jnp.zeros_like(z[0])
    state = _stayed(built, given, found, look, times)
    hold = jnp.minimum(look.hold, releases.draws(built, given, found))
    return Diagnostics(clear, late, none, none, *state, fold, 1.0 + none, look.rest, hold, look.plain)


def _stayed(built, given, found, look, times):
    """(x, v) at times since the section's phase, in flight, within hops, or at rest."""
    x, v = impact_equations.at(built, given, found, times)
    span = given.periods * built.period
    since = times[:, None] - given.times
    since = jnp.where(given.sides != 0, since - span * jnp.floor(since / span), jnp.inf)
    row = jnp.argmin(since, axis=1)
    tail, ends = releases.tails_of(built, given, found)
    late = jnp.take_along_axis(since, row[:, None], 1)[:, 0]
    held, side = ends[row] & (late < -tail.tau[row]), given.sides[row]
    angle = given.phase + built.frequency * times
    where, pace, _ = way(built, side, jnp.cos(angle), jnp.sin(angle))
    height, rise = (each[row, jnp.arange(len(times))] for each in (look.height, look.pace))
    return jnp.where(held, where - side * height, x), jnp.where(held, pace - side * rise, v)


def _free(along, z, periods):
    built, found = flight(along, z)
    around = found.time / flight_clearance.OVERLAP
    _, matrix = flow_of(built).matrix(built, found.x, found.v, found.cosine, found.sine, around)
    p00, _, _, p11 = response.by_rows(matrix)
    x, v = jnp.full(periods, z[0]), jnp.full(periods, z[1])
    clear = flight_clearance.clearances(built, found, flight_clearance.samples(built, found))
    measures = [jnp.ones_like(z[0])] * 2
    none = jnp.zeros(0, z.dtype)
    return Diagnostics(*clear, (p00 + p11)[0], response.determinant(matrix)[0], x, v, *measures, none, none, none)


def flight(along, z):
    """(`Frame`, the one flight) of an orbit without impacts: over a little more than its periods."""
    built, turns = framed(there(along, z)), along.cycle
    return built, flight_clearance.without_impacts(built, turns.phase, turns.periods, z[0], z[1])

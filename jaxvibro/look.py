"""What is to be known of each of many points of a branch: clearances, multipliers, the states at the section."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from . import cycle, flow, passes, ring
from .along import cycle_at, there
from .frame import frame
from .lanes import OPTIONS, one_kernel

LANES = 80  # points of a compiled call
OVERLAP = 1.0625  # of its periods, that the flight of an orbit without impacts is looked at


class Look(NamedTuple):
    """clear, late: (points, flights, walls), the least distance at a turning point towards the wall, and its time since
    the flight's start; trace, determinant: (points,), of the monodromy matrix; x, v: (points, periods), at the
    section's phase; flip: (points,), zero where the period doubles."""

    clear: np.ndarray
    late: np.ndarray
    trace: np.ndarray
    determinant: np.ndarray
    x: np.ndarray
    v: np.ndarray
    flip: np.ndarray


def looked(along, zs):
    """The `Look` at points, shape (points, n + 1)."""
    rows, periods = len(along.cycle.sides), int(along.cycle.periods)
    parts = []
    for first in range(0, len(zs), LANES):
        some = zs[first : first + LANES]
        padded = np.concatenate([some, np.repeat(some[-1:], LANES - len(some), axis=0)])
        run = _flown if rows else _unmet
        parts.append([each[: len(some)] for each in jax.device_get(run(along, padded, periods))])
    return Look(*(np.concatenate(each) for each in zip(*parts, strict=True)))


@partial(jax.jit, static_argnums=2, compiler_options=OPTIONS)
def _flown(along, zs, periods):
    def times(z):
        built = frame(there(along, z[-1]))
        return passes.samples(built, cycle.flights(built, cycle_at(along, z)))

    samples = jnp.max(jax.vmap(times)(zs))
    return one_kernel(_seen, along, zs, samples, periods=periods)


def _seen(along, zs, samples, periods):
    return jax.vmap(lambda z: _one(along, z, samples, periods))(zs)


def _one(along, z, samples, periods):
    built, given = frame(there(along, z[-1])), cycle_at(along, z)
    found = cycle.flights(built, given)
    places = [cycle.at(built, given, found, k * built.period) for k in range(periods)]
    x, v = (jnp.stack(each) for each in zip(*places, strict=True))
    clear = passes.clearances(built, found, samples)
    flip = ring.determinant(ring.of(cycle.equations(built, given)[1]), -1.0)
    return Look(*clear, *cycle.invariants(built, found, given.sides), x, v, flip)


@partial(jax.jit, static_argnums=2, compiler_options=OPTIONS)
def _unmet(along, zs, periods):
    samples = jnp.max(jax.vmap(lambda z: passes.samples(*flight(along, z)))(zs))

    def one(z):
        built, found = flight(along, z)
        (p00, p01, p11), _, _ = flow.doubled(built.series, built.frequency, built.damping, found.time / OVERLAP)
        x, v = jnp.full(periods, z[0]), jnp.full(periods, z[1])
        clear = passes.clearances(built, found, samples)
        return Look(*clear, (p00 + p11)[0], (p00 * p11 + p01 * p01)[0], x, v, jnp.ones_like(z[0]))

    return jax.vmap(one)(zs)


def flight(along, z):
    """(`Frame`, the one flight) of an orbit without impacts: over a little more than its periods."""
    built, turns = frame(there(along, z[-1])), along.cycle
    span = jnp.reshape(OVERLAP * turns.periods * built.period, 1)
    start = (jnp.reshape(each, 1) for each in (z[0], z[1], jnp.cos(turns.phase), jnp.sin(turns.phase)))
    return built, passes.Flight(span, *start)

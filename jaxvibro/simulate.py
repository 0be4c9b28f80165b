"""A trajectory at even samples, with its impacts: for pictures."""

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import lax

from . import check, clearance, log
from .entry import enter
from .frame import frame
from .lanes import choose
from .strobe import CAP, STATUS, travel
from .strobe import close as finish

SLOTS = 1024


def simulate(scene, state, periods=1, samples=200):
    """The trajectory of one state over whole drive periods, as an xarray.Dataset.

    scene, state: scalars, no batch. samples: of a period, evenly spaced; the first is the given state, the last the one
    at the end. Dataset: x(time), v(time), phase(time) in radians from the start's on, and of each impact, in order,
    impact_x, impact_side, impact_speed over the coordinate impact_time; time in t since the start.

    Raises SceneError for a batch, a start beyond a wall or a number that is not finite, and where an impact cap ends it.
    """
    periods, samples = check.whole("periods", periods, 1), check.whole("samples", samples, 1)
    state = jax.tree.map(lambda value: jnp.asarray(value, scene.dtype), state)
    shape = jnp.broadcast_shapes(*map(jnp.shape, jax.tree.leaves((scene, state))))
    if shape:
        raise check.SceneError("state", "must be one state in one scene, no batch", f"shape {shape}")
    (x, v, angle), impacts, status = jax.device_get(_trace(scene, state, periods, samples))
    if status >= CAP:
        raise check.SceneError("state", f"cannot be simulated, status {STATUS[status]}", (float(state.x), float(state.v)))
    return _dataset(scene, (x, v, angle), impacts, periods)


def _sampled(scene, state, periods, samples):
    built = frame(scene, ())
    path, valid, finite = enter(built, state)
    book = log.empty(path.x, SLOTS, 1, clearance.nothing(built))
    angles = state.phase + 2.0 * jnp.pi * jnp.arange(periods * samples + 1) / samples

    def sample(carry, angle):
        path, book = carry
        start = path._replace(
            cosine=jnp.cos(angle), sine=jnp.sin(angle), rest=choose(valid & finite, built.period / samples, 0.0)
        )
        path, book = lax.while_loop(lambda c: c[0].rest > 0, lambda c: travel(built, *c), (start, book))
        return (path, book._replace(steps=jnp.zeros_like(book.steps))), ((start.x, start.v), book.count)

    (path, book), ((x, v), counts) = lax.scan(sample, (path, book), angles[:-1])
    x, v = jnp.append(x, path.x), jnp.append(v, path.v)
    cap = jnp.full_like(path.x, jnp.inf)
    _, impacts = finish(path, book, state, valid, finite, SLOTS, cap)
    part = jnp.searchsorted(counts, jnp.arange(SLOTS), side="right")
    return (x, v, angles), impacts, part, impacts.status


_trace = jax.jit(_sampled, static_argnums=(2, 3))

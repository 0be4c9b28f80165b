"""Our own strobe on the same work: a batch given to it, a user's own vmap of it, and one state."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro
from benchmarks.work import CAP, GAMMA, OMEGA, RESTITUTION, Strobes


def scene(amplitude, stiffness=None, damping=None):
    """The scene at an amplitude, or at an array of them; both walls of that stiffness and damping, or rigid."""
    walls = (jaxvibro.Wall(place, stiffness=stiffness, damping=damping) for place in (-1.0, 1.0))
    return jaxvibro.make_scene(amplitude, OMEGA, GAMMA, RESTITUTION, tuple(walls))


def prepare_batch(states, stiffness=None, damping=None):
    """A call without arguments that maps (n, 3) states x, x', A given to strobe as a batch."""
    x, v, amplitude = jnp.asarray(states.T)
    many, start = scene(amplitude, stiffness, damping), jaxvibro.State(x, v)
    return lambda: jax.block_until_ready(jaxvibro.strobe(many, start, slots=CAP))


def prepare_vmap(states):
    """A call without arguments that maps the same states by the user's own jit of a vmap of a single strobe."""
    x, v, amplitude = jnp.asarray(states.T)
    base = scene(1.0)

    def one(x, v, amplitude):
        return jaxvibro.strobe(base.replace(amplitude=amplitude), jaxvibro.State(x, v), slots=CAP)

    mapped = jax.jit(jax.vmap(one))
    return lambda: jax.block_until_ready(mapped(x, v, amplitude))


def prepare_single(state, call):
    """A call without arguments that maps one state x, x', A by strobe itself or the user's jit of it."""
    x, v, amplitude = map(jnp.asarray, state)
    single, start = scene(amplitude), jaxvibro.State(x, v)
    return lambda: jax.block_until_ready(call(single, start))


def read(answer):
    """What strobe returned, as Strobes."""
    state, impacts = answer
    ends = np.stack([np.asarray(state.x), np.asarray(state.v)], axis=1)
    sides = np.asarray(impacts.side)[:, :CAP].astype(np.int8)
    return Strobes(ends, sides, np.asarray(impacts.time)[:, :CAP])

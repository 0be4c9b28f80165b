"""Our own strobe on the same work: a batch given to it, and a user's own vmap of it."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro
from benchmarks.work import CAP, CUBIC, GAMMA, OMEGA, RESTITUTION


def scene(amplitude, stiffness=None, damping=None):
    """The scene at an amplitude, or at an array of them; both walls of that stiffness and damping, or rigid."""
    walls = (jaxvibro.Wall(place, stiffness=stiffness, damping=damping) for place in (-1.0, 1.0))
    return jaxvibro.make_scene(amplitude, OMEGA, GAMMA, RESTITUTION, tuple(walls))


def prepare_batch(states, stiffness=None, damping=None, slots=CAP):
    """A call without arguments that maps (n, 3) states x, x', A given to strobe in a batch; slots: to record."""
    x, v, amplitude = jnp.asarray(states.T)
    many, start = scene(amplitude, stiffness, damping), jaxvibro.State(x, v)
    return lambda: jax.block_until_ready(jaxvibro.strobe(many, start, slots=slots))


def prepare_duffing(states, tolerance, solver=None, slots=CAP):
    """The same of Duffing's oscillator, whose force is one of the user's own, at a tolerance; solver: of diffrax's."""
    x, v, amplitude = jnp.asarray(states.T)
    force = jaxvibro.Force("duffing", {"cubic": CUBIC, "damping": GAMMA}, tolerance, solver)
    many = jaxvibro.make_scene(amplitude, OMEGA, restitution=RESTITUTION, walls=(-1.0, 1.0), force=force)
    return lambda: jax.block_until_ready(jaxvibro.strobe(many, jaxvibro.State(x, v), slots=slots))


def prepare_vmap(states):
    """A call without arguments that maps the same states by the user's own jit of a vmap of a single strobe,
    nothing recorded."""
    x, v, amplitude = jnp.asarray(states.T)
    base = scene(1.0)

    def one(x, v, amplitude):
        return jaxvibro.strobe(base.replace(amplitude=amplitude), jaxvibro.State(x, v), slots=0)

    mapped = jax.jit(jax.vmap(one))
    return lambda: jax.block_until_ready(mapped(x, v, amplitude))


def read(answer):
    """What strobe returned: ends, and sides where it recorded as many impacts as the rivals may have, else None."""
    state, impacts = answer
    ends = np.stack([np.asarray(state.x), np.asarray(state.v)], axis=1)
    full = impacts.side.shape[1] >= CAP
    return ends, np.asarray(impacts.side)[:, :CAP].astype(np.int8) if full else None

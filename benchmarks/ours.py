"""Map the states with this package: as a batch, and with a user's own vmap."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro
from benchmarks.work import CAP, CUBIC, GAMMA, OMEGA, RESTITUTION


def scene(amplitude, stiffness=None, damping=None):
    """Make the scene at an amplitude, or at an array of them; both walls with the stiffness and damping, or rigid."""
    walls = (jaxvibro.Wall(place, stiffness=stiffness, damping=damping) for place in (-1.0, 1.0))
    return jaxvibro.make_scene(amplitude, OMEGA, GAMMA, RESTITUTION, tuple(walls))


def prepare_batch(states, stiffness=None, damping=None, slots=CAP):
    """Make a call that maps (n, 3) states x, x', A as a batch; `slots` is the number of recorded impacts."""
    x, v, amplitude = jnp.asarray(states.T)
    many, start = scene(amplitude, stiffness, damping), jaxvibro.State(x, v)
    return lambda: jax.block_until_ready(jaxvibro.strobe(many, start, slots=slots))


def prepare_duffing(states, tolerance, solver=None, slots=CAP):
    """Make such a call for Duffing's oscillator, a user-defined force, at a tolerance and with a solver of diffrax."""
    x, v, amplitude = jnp.asarray(states.T)
    force = jaxvibro.Force("duffing", {"cubic": CUBIC, "damping": GAMMA}, tolerance, solver)
    many = jaxvibro.make_scene(amplitude, OMEGA, restitution=RESTITUTION, walls=(-1.0, 1.0), force=force)
    return lambda: jax.block_until_ready(jaxvibro.strobe(many, jaxvibro.State(x, v), slots=slots))


def prepare_vmap(states):
    """Make a call that maps the states by the user's own jit of a vmap of a single map, without record."""
    x, v, amplitude = jnp.asarray(states.T)
    base = scene(1.0)

    def one(x, v, amplitude):
        return jaxvibro.strobe(base.replace(amplitude=amplitude), jaxvibro.State(x, v), slots=0)

    mapped = jax.jit(jax.vmap(one))
    return lambda: jax.block_until_ready(mapped(x, v, amplitude))


def read(answer):
    """Return the ends of a result, and the sides if it records as many impacts as the rivals, else None."""
    state, impacts = answer
    ends = np.stack([np.asarray(state.x), np.asarray(state.v)], axis=1)
    full = impacts.side.shape[1] >= CAP
    return ends, np.asarray(impacts.side)[:, :CAP].astype(np.int8) if full else None

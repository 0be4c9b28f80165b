"""Our own strobe between soft walls, a batch given to it."""

import jax
import jax.numpy as jnp

import jaxvibro
from benchmarks.work import GAMMA, OMEGA, RESTITUTION


def scene(amplitude, stiffness, damping):
    """The scene at an amplitude, or at an array of them, both walls of that stiffness and damping."""
    left, right = (jaxvibro.Wall(place, stiffness=stiffness, damping=damping) for place in (-1.0, 1.0))
    return jaxvibro.make_scene(amplitude, OMEGA, GAMMA, RESTITUTION, (left, right))


def prepare(states, stiffness, damping):
    """A call without arguments that maps (n, 3) states x, x', A given to strobe as a batch."""
    x, v, amplitude = jnp.asarray(states.T)
    many, start = scene(amplitude, stiffness, damping), jaxvibro.State(x, v)
    return lambda: jax.block_until_ready(jaxvibro.strobe(many, start))

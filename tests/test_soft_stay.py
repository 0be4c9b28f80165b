"""Stays within soft walls as the equations of the impacts find them, against certified flight and the replay's."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from continuation.in_numpy import Tried
from jaxvibro.compiled.compiler_hints import one_kernel
from jaxvibro.flight.coefficients import frame
from jaxvibro.flight.soft_return import first_return
from jaxvibro.maps import contact_duration
from jaxvibro.orbits import stay
from jaxvibro.scene.codes import Contact

WALLS = {
    "unlike": (jv.Wall(-1.0, stiffness=30.0, damping=0.2), jv.Wall(1.0, stiffness=5e4, damping=300.0)),
    "moving": (jv.Wall(-1.0, stiffness=900.0, damping=2.0, motion=jv.Motion(0.1, 0.3)), 1.0),
    "one": (None, jv.Wall(1.0, stiffness=4.0, damping=9.0)),
    "fast": (jv.Wall(-1.0, stiffness=4.0, damping=0.1), 1.0),
}
FAST = 40.0, 9.0  # the drive turns within a step: the mass may be out and in again at its end
LANES = 40


def entries(kind, seed=5):
    """(scene, sides, cosines, sines, speeds) of a mass that enters soft walls, some speeds very small."""
    rng = np.random.default_rng(seed)
    drive = FAST if kind == "fast" else (2.5, 1.7)
    scene = jv.make_scene(*drive, 0.05, 0.7, WALLS[kind])
    angles, speeds = rng.uniform(0.0, 2.0 * np.pi, LANES), 10.0 ** rng.uniform(-6.0, 0.7, LANES)
    sides = np.array([-1.0 if side == "left" else 1.0 for side in scene.soft_sides])
    return scene, rng.choice(sides, LANES), np.cos(angles), np.sin(angles), speeds


def returned(scene, side, cosine, sine, speed):
    built = frame(scene)
    longest = stay.LONGEST * built.period + 0.0 * speed
    return first_return(built, side * Contact.ENTERED, side * speed, cosine, sine, longest)


def certified(scene, side, cosine, sine, speed):
    built = frame(scene)
    longest = stay.LONGEST * built.period + 0.0 * speed
    return contact_duration.duration(built, side * Contact.ENTERED, 0.0 * speed, side * speed, cosine, sine, longest)


def moved(leave, scene, side, cosine, sine, speed, near):
    """Ends of stays, and how they change with amplitude, frequency and speed at once."""

    def ends(amplitude, frequency, speed):
        built = frame(replace(scene, amplitude=amplitude, frequency=frequency))
        return tuple(leave(built, side, cosine, sine, speed, near))

    given = scene.amplitude, scene.frequency, jnp.asarray(speed)
    return jax.jvp(ends, given, jax.tree.map(jnp.ones_like, given))


def in_numpy(function, *args):
    return Tried(function, (), {})(args)


@pytest.mark.parametrize("kind", WALLS)
def test_first_returns_are_those_of_certified_flight(kind):
    given = entries(kind)
    found, true = in_numpy(returned, *given), in_numpy(certified, *given)
    assert (true > 0).all() and np.allclose(found, true, rtol=1e-11, atol=0.0)
    compiled = jax.jit(partial(one_kernel, returned))(*given)
    assert np.allclose(found, compiled, rtol=1e-11, atol=0.0)


@pytest.mark.parametrize("kind", WALLS)
def test_ends_of_stays_and_their_changes_are_those_of_the_replay(kind):
    given = entries(kind)
    near = in_numpy(certified, *given)
    ours = in_numpy(partial(moved, stay.leave), *given, near)
    theirs = in_numpy(partial(moved, partial(contact_duration.leave, order=stay.ORDER)), *given, near)
    for one, other in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        assert np.allclose(one, other, rtol=1e-9, atol=1e-12 * abs(other).max())

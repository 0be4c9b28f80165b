"""Contacts with soft walls in the equations of orbits, against certified flight and its derivatives."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.contact.contact_duration import solve_contact_end
from jaxvibro.contact.kinds import make_flow_coefficients
from jaxvibro.orbits.contact_maps import evaluate_contact_map

from .cached_functions import in_numpy

WALLS = {
    "unlike": (jv.Wall(-1.0, stiffness=30.0, damping=0.2), jv.Wall(1.0, stiffness=5e4, damping=300.0)),
    "moving": (jv.Wall(-1.0, stiffness=900.0, damping=2.0, motion=jv.Motion(0.1, 0.3)), 1.0),
    "one": (None, jv.Wall(1.0, stiffness=4.0, damping=9.0)),
    "fast": (jv.Wall(-1.0, stiffness=4.0, damping=0.1), 1.0),
}
FAST = 40.0, 9.0  # the drive turns within a step: the mass may be out and in again at its end
LANES = 40
PERIODS, ENTERED = 8.0, 4.0  # the longest contact; the code of a mass that has just entered a wall


def entries(kind, seed=5):
    """Return (scene, sides, cosines, sines, speeds) of entries into soft walls, some of them very slow."""
    rng = np.random.default_rng(seed)
    drive = FAST if kind == "fast" else (2.5, 1.7)
    scene = jv.make_scene(*drive, 0.05, 0.7, WALLS[kind])
    angles, speeds = rng.uniform(0.0, 2.0 * np.pi, LANES), 10.0 ** rng.uniform(-6.0, 0.7, LANES)
    sides = np.array([-1.0 if side == "left" else 1.0 for side in scene.soft_sides])
    return scene, rng.choice(sides, LANES), np.cos(angles), np.sin(angles), speeds


def certified(scene, side, cosine, sine, speed):
    coefficients = make_flow_coefficients(scene)
    longest = PERIODS * coefficients.period + 0.0 * speed
    return coefficients.contact.contact_duration(
        coefficients, side * ENTERED, 0.0 * speed, side * speed, cosine, sine, longest
    )


def moved(function, scene, side, cosine, sine, speed, near):
    """Return the values of a function of contacts, and their change with amplitude, frequency and speed at once."""

    def ends(amplitude, frequency, speed):
        changed = replace(scene, amplitude=amplitude, frequency=frequency)
        return tuple(function(changed, side, cosine, sine, speed, near))

    given = scene.amplitude, scene.frequency, jnp.asarray(speed)
    return jax.jvp(ends, given, jax.tree.map(jnp.ones_like, given))


def computed(scene, side, cosine, sine, speed, near):
    contact = evaluate_contact_map(make_flow_coefficients(scene), side, cosine, sine, speed)
    return contact.contact_time, contact.exit_velocity, contact.state_by_time, contact.state_by_speed


def expected(scene, side, cosine, sine, speed, near):
    """Return the same from certified flight: the state after a contact, brought back to the time when it began."""
    coefficients, zero, one = make_flow_coefficients(scene), 0.0 * speed, 0.0 * speed + 1.0

    def end_of(late, faster):
        angle = scene.frequency * late
        phase = cosine * jnp.cos(angle) - sine * jnp.sin(angle), sine * jnp.cos(angle) + cosine * jnp.sin(angle)
        return solve_contact_end(coefficients, side, *phase, speed + faster, near, 2)

    first = end_of(zero, zero)

    def brought_back(late, faster):
        end = end_of(late, faster)
        position, velocity = wall_at(scene, side, end.cosine, end.sine)
        v = velocity + end.v
        acceleration = scene.amplitude * end.cosine - position - 2.0 * scene.damping * v
        time = first.time - late - end.time
        return position + time * v, v + time * acceleration

    slopes = [jax.jvp(brought_back, (zero, zero), way)[1] for way in ((one, zero), (zero, one))]
    return first.time, first.v, *slopes


def wall_at(scene, side, cosine, sine):
    """Return the position and the velocity of the wall on a side at a drive phase."""
    ends = []
    for wall in (scene.left, scene.right):
        position, swing, angle = 0.0, 0.0, 0.0
        if wall is not None:
            position = wall.position
            swing, angle = (wall.motion.amplitude, wall.motion.phase) if wall.motion else (0.0, 0.0)
        turned = cosine * jnp.cos(angle) - sine * jnp.sin(angle), sine * jnp.cos(angle) + cosine * jnp.sin(angle)
        ends.append((position + swing * turned[0], -swing * scene.frequency * turned[1]))
    return tuple(jnp.where(side < 0.0, *each) for each in zip(*ends, strict=True))


@pytest.mark.parametrize("kind", WALLS)
def test_contact_map(kind):
    """The duration, the exit, how both change, and the derivatives are those of certified flight."""
    given = entries(kind)
    near = in_numpy(certified, *given)
    (values, changes), (true_values, true_changes) = (
        in_numpy(partial(moved, function), *given, near) for function in (computed, expected)
    )
    assert (near > 0.0).all() and np.allclose(values[0], near, rtol=1e-11, atol=0.0)
    rows = zip(jax.tree.leaves((values, changes)), jax.tree.leaves((true_values, true_changes)), strict=True)
    for row, true in rows:
        assert np.allclose(row, true, rtol=1e-8, atol=1e-10 * abs(true).max())


def test_a_short_contact_has_digits_of_its_own():
    scene = jv.make_scene(0.0, 0.05, 0.0, 0.7, (None, jv.Wall(0.0, stiffness=1e10 - 1.0, damping=0.0)))
    one = jnp.ones(1)
    found = jax.jit(certified)(scene, one, one, 0.0 * one, one)
    assert float(found[0]) == pytest.approx(np.pi / 1e5, rel=1e-15, abs=0.0)

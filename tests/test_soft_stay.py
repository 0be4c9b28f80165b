"""Stays within soft walls as the equations of the impacts find them, against certified flight and the replay's."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from continuation.numpy_evaluation import NumpyEvaluator
from jaxvibro.compiled.kernel_calls import call_as_kernel
from jaxvibro.flight import flow
from jaxvibro.flight.flight_coefficients import make_flow_coefficients
from jaxvibro.flight.linear_flow import acceleration_and_jerk
from jaxvibro.flight.soft_wall_exit import first_exit_time
from jaxvibro.flight.wall_motion import select_lists_by_side, wall_jet
from jaxvibro.maps import contact_duration
from jaxvibro.orbits import contact_maps, contact_phase
from jaxvibro.scene.codes import Contact

WALLS = {
    "unlike": (jv.Wall(-1.0, stiffness=30.0, damping=0.2), jv.Wall(1.0, stiffness=5e4, damping=300.0)),
    "moving": (jv.Wall(-1.0, stiffness=900.0, damping=2.0, motion=jv.Motion(0.1, 0.3)), 1.0),
    "one": (None, jv.Wall(1.0, stiffness=4.0, damping=9.0)),
    "fast": (jv.Wall(-1.0, stiffness=4.0, damping=0.1), 1.0),
}
FAST = 40.0, 9.0  # the drive turns within a step: the mass may be out and in again at its end
LANES = 40
MARKS = {"fast": (), "moving": pytest.mark.slow}
SOME = [pytest.param(kind, marks=MARKS.get(kind, pytest.mark.long)) for kind in WALLS]
UNLIKE = ["unlike", *(pytest.param(kind, marks=pytest.mark.slow) for kind in WALLS if kind != "unlike")]


def entries(kind, seed=5):
    """(scene, sides, cosines, sines, speeds) of a mass that enters soft walls, some speeds very small."""
    rng = np.random.default_rng(seed)
    drive = FAST if kind == "fast" else (2.5, 1.7)
    scene = jv.make_scene(*drive, 0.05, 0.7, WALLS[kind])
    angles, speeds = rng.uniform(0.0, 2.0 * np.pi, LANES), 10.0 ** rng.uniform(-6.0, 0.7, LANES)
    sides = np.array([-1.0 if side == "left" else 1.0 for side in scene.soft_sides])
    return scene, rng.choice(sides, LANES), np.cos(angles), np.sin(angles), speeds


def returned(scene, side, cosine, sine, speed):
    built = make_flow_coefficients(scene)
    longest = contact_phase.MAX_PERIODS * built.period + 0.0 * speed
    return first_exit_time(built, side * Contact.ENTERED, side * speed, cosine, sine, longest)


def certified(scene, side, cosine, sine, speed):
    built = make_flow_coefficients(scene)
    longest = contact_phase.MAX_PERIODS * built.period + 0.0 * speed
    return contact_duration.contact_duration_of(
        built, side * Contact.ENTERED, 0.0 * speed, side * speed, cosine, sine, longest
    )


def moved(function, scene, side, cosine, sine, speed, near):
    """What a function of a stay gives, and how that changes with amplitude, frequency and speed at once."""

    def ends(amplitude, frequency, speed):
        built = make_flow_coefficients(replace(scene, amplitude=amplitude, frequency=frequency))
        return tuple(function(built, side, cosine, sine, speed, near))[:4]

    given = scene.amplitude, scene.frequency, jnp.asarray(speed)
    return jax.jvp(ends, given, jax.tree.map(jnp.ones_like, given))


def kept(built, side, cosine, sine, speed, near):
    """How the flight after a stay changes at the time when it began, with the time and speed of the entry: by the
    replay's stay, and back to that time."""

    def before(late, faster):
        end = contact_duration.solve_contact_end(
            built, side, *flow.rotate_phasor_by_angle(cosine, sine, built.frequency * late), speed + faster, near, 2
        )
        ways = [wall_jet(wall, built.frequency, end.cosine, end.sine, 1) for wall in built.walls]
        where, pace = (0.0 * speed if each is None else each for each in select_lists_by_side(side, built.walls, ways))
        return late + end.time, where, pace + end.v, end.cosine, end.sine

    none = 0.0 * speed
    begin = before(none, none)[0]

    def back(late, faster):
        time, x, v, cosine, sine = before(late, faster)
        return x + (begin - time) * v, v + (begin - time) * acceleration_and_jerk(built, x, v, cosine, sine)[0]

    one = none + 1.0
    return [jax.jvp(back, (none, none), way)[1] for way in ((one, none), (none, one))]


def met(built, side, cosine, sine, speed, near):
    found = contact_maps.evaluate_contact_map(built, side, cosine, sine, speed)
    return [found.state_by_time, found.state_by_speed]


def in_numpy(function, *args):
    return NumpyEvaluator(function, (), {})(args)


@pytest.mark.parametrize("kind", SOME)
def test_first_returns_are_those_of_certified_flight(kind):
    given = entries(kind)
    found, true = in_numpy(returned, *given), in_numpy(certified, *given)
    assert (true > 0).all() and np.allclose(found, true, rtol=1e-11, atol=0.0)
    compiled = jax.jit(partial(call_as_kernel, returned))(*given)
    assert np.allclose(found, compiled, rtol=1e-11, atol=0.0)


@pytest.mark.parametrize("kind", UNLIKE)
def test_ends_of_stays_and_their_changes_are_those_of_the_replay(kind):
    given = entries(kind)
    near = in_numpy(certified, *given)
    ours = in_numpy(partial(moved, contact_phase.solve_contact_phase), *given, near)
    theirs = in_numpy(partial(moved, partial(contact_duration.solve_contact_end, order=1)), *given, near)
    for one, other in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        assert np.allclose(one, other, rtol=1e-9, atol=1e-12 * abs(other).max())


@pytest.mark.parametrize("kind", UNLIKE)
def test_what_a_stay_makes_of_its_start_is_as_by_the_derivatives_of_the_replays(kind):
    given = entries(kind)
    near = in_numpy(certified, *given)
    ours, theirs = (in_numpy(partial(moved, function), *given, near) for function in (met, kept))
    for one, other in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        assert np.allclose(one, other, rtol=1e-8, atol=1e-10 * abs(other).max())


@pytest.mark.parametrize(
    "kind", [pytest.param("unlike", marks=pytest.mark.long), pytest.param("moving", marks=pytest.mark.long)]
)
def test_second_derivatives_of_a_stay_are_differences_of_the_first(kind):
    scene, side, cosine, sine, speed = entries(kind)
    keep = speed > 1e-3  # of slower ones a difference sees nothing
    side, cosine, sine, speed = (each[keep] for each in (side, cosine, sine, speed))

    def along(s, near):
        """All of a stay, where amplitude, frequency and speed are s times greater by one."""
        built = make_flow_coefficients(replace(scene, amplitude=scene.amplitude + s, frequency=scene.frequency + s))
        found = contact_phase.solve_contact_phase(built, side, cosine, sine, speed * (1.0 + s), near)
        return jnp.stack([each for each in jax.tree.leaves(found) if jnp.shape(each)])

    def first(s, near):
        return jax.jvp(lambda s: along(s, near), (s,), (1.0,))[1]

    def near_at(s):
        there = replace(scene, amplitude=scene.amplitude + s, frequency=scene.frequency + s)
        return jax.jit(certified)(there, side, cosine, sine, speed * (1.0 + s))

    slopes, step = jax.jit(first), 1e-4
    second = jax.jit(lambda s, near: jax.jvp(lambda s: first(s, near), (s,), (1.0,))[1])(0.0, near_at(0.0))
    ends = [slopes(k * step, near_at(k * step)) for k in (1, -1, 2, -2)]
    true = (8.0 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12.0 * step)
    size = abs(true) + abs(slopes(0.0, near_at(0.0))) + 1e-3 * abs(true).max(axis=1, keepdims=True)
    assert np.median(abs(second - true) / size) < 1e-9
    assert np.max(abs(second - true) / size) < 1e-5

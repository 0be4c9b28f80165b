"""Derivatives through rests: what came before the last release counts for nothing, however many impacts it was."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

import jaxvibro as jv
from jaxvibro.flight.flow import fly
from jaxvibro.maps.reference_strobe import REPLAY_SLOTS
from jaxvibro.scene.codes import Contact
from tests.reference import rest_slopes, slopes
from tests.reference.draws import Draw
from tests.reference.scene import Motion, Scene, Wall

MANY = Draw(Scene(0.1, 0.5, 3.0, Wall(-9.0, 0.5), Wall(1.0, 0.85)), 0.7, 0.3, -1.5)  # hops on the right wall
HELD = Draw(Scene(0.1, 0.5, 0.5, Wall(-9.0, 0.5), Wall(-1.2, 0.88)), -1.4, 0.3, 0.0)  # as many, and then a rest
BOTH = Draw(Scene(0.19, 0.3, 2.7, Wall(-0.8, 0.6), Wall(1.0, 0.82)), 0.0, 0.3, 2.8)  # a rest on each, four impacts
MOVING = Draw(Scene(0.1, 0.5, 1.5, None, Wall(-0.3, 0.6, Motion(0.1, 0.3))), -0.8, 0.3, 2.5)
BY = ("x", "amplitude", "right.position")


def strobed(draw, numbers, periods=1):
    """(x and v, times, speeds) of a `Draw` with other numbers `BY`, and the end and the impacts."""
    gamma, omega, _, *walls = draw.scene[:5]
    x, amplitude, place = numbers
    walls = [jv.Wall(*wall[:2]) for wall in (walls[0], walls[1]._replace(position=place))]
    scene = jv.make_scene(amplitude, omega, gamma, 0.5, walls)
    end, impacts = jv.strobe(scene, jv.State(x, draw.v, draw.phase), periods, slots=48)
    return (jnp.stack([end.x, end.v]), impacts.time, impacts.speed), (end, impacts)


def sloped(draw, periods=1, way=jax.jacfwd):
    numbers = jnp.array([draw.x, draw.scene.amplitude, draw.scene.right.position])
    return way(lambda numbers: strobed(draw, numbers, periods), has_aux=True)(numbers)


def free(draw):
    """The derivatives by `BY` of a mass that the right wall, which stands still, lets go, and that hits none."""

    def flown(numbers):
        _, amplitude, place = numbers
        gamma, omega = draw.scene[:2]
        scene, phase = jv.make_scene(amplitude, omega, gamma, 0.5, (None, 9.0)), jnp.arccos(place / amplitude)
        return jnp.stack(fly(scene, jv.State(place, 0.0, phase), (2.0 * jnp.pi + draw.phase - phase) / omega))

    return jax.jacfwd(flown)(jnp.array([draw.x, draw.scene.amplitude, draw.scene.right.position]))


def test_more_impacts_than_slots_before_a_release():
    (by, *_), (_, impacts) = sloped(MANY, way=jax.jacrev)
    hits = impacts.time[impacts.side != 0]
    assert len(hits) == impacts.count > REPLAY_SLOTS and hits[-1] < (np.arccos(1.0 / 3.0) - MANY.phase) / 0.5
    assert np.array_equal(by[:, 0], [0.0, 0.0])
    assert np.allclose(by, free(MANY), rtol=1e-12, atol=0)


def test_more_impacts_than_slots_before_a_rest_that_lasts():
    (by, times, _), (end, impacts) = sloped(HELD)
    assert impacts.count > REPLAY_SLOTS and end.contact == Contact.STUCK
    assert np.array_equal(by, [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    story = rest_slopes.story(*HELD)
    (true,) = rest_slopes.impacts(HELD, story, np.asarray(impacts.time[:1]), 1).values()
    assert np.allclose(times[0], true[0, [slopes.names(HELD.scene).index(name) for name in BY]], rtol=1e-12, atol=0)


def test_two_rests_of_a_period():
    (end, times, speeds), (_, impacts) = sloped(BOTH)
    columns = [slopes.names(BOTH.scene).index(name) for name in BY]
    story = rest_slopes.story(*BOTH)
    assert [stretch.since and stretch.since[0] for stretch in story.stretches] == [None, -1, 1]
    assert len(story.stretches[-1].hits) == 4
    assert np.allclose(end, rest_slopes.jacobian(BOTH, story)[:, columns], rtol=1e-12, atol=1e-12)
    for stretch in story.stretches[:2]:
        known = np.array([t - BOTH.phase / BOTH.scene.omega for t, _ in stretch.hits[:2]])
        for time, true in rest_slopes.impacts(BOTH, story, known, 2).items():
            k = int(np.argmin(abs(impacts.time - time)))
            assert abs(impacts.time[k] - time) < 1e-9 and (true[0, 0] == 0) == (stretch.since is not None)
            assert np.allclose([times[k], speeds[k]], true[:, columns], rtol=1e-10, atol=1e-14)


def test_two_periods_with_rests_are_two_strobes():
    first, (end, impacts) = sloped(BOTH)
    after = BOTH._replace(x=float(end.x), v=float(end.v))

    def onward(z):
        (end, *_), _ = strobed(after._replace(v=z[1]), jnp.array([z[0], *z[2:]]))
        return end

    second = jax.jacfwd(onward)(jnp.array([after.x, after.v, BOTH.scene.amplitude, BOTH.scene.right.position]))
    (whole, times, speeds), _ = sloped(BOTH, periods=2)
    assert np.allclose(whole, second[:, :2] @ first[0] + np.pad(second[:, 2:], ((0, 0), (1, 0))), rtol=1e-10)
    count = int(impacts.count)
    assert np.allclose(times[:count], first[1][:count], rtol=1e-10, atol=1e-13)
    assert np.allclose(speeds[:count], first[2][:count], rtol=1e-10, atol=1e-13)


def test_the_reference_by_half_a_step_and_by_the_wall(monkeypatch):
    story = rest_slopes.story(*MOVING)
    (before, after), names = story.stretches, slopes.names(MOVING.scene)
    assert before.since is None and len(before.hits) > 10 and after.since[0] == 1 and not story.held
    whole = rest_slopes.jacobian(MOVING, story)
    assert np.array_equal(whole[:, :2], np.zeros((2, 2)))
    monkeypatch.setattr(rest_slopes, "STEP", rest_slopes.STEP / 2)
    assert np.allclose(rest_slopes.jacobian(MOVING, story), whole, rtol=1e-14, atol=0)
    held = MOVING._replace(phase=1.0)
    by = dict(zip(names, rest_slopes.jacobian(held, rest_slopes.story(*held)).T, strict=True))
    assert np.allclose(by["right.position"], [1.0, 0.0], rtol=0, atol=1e-15)
    assert np.allclose(by["right.motion.amplitude"], [np.cos(1.3), -0.5 * np.sin(1.3)], rtol=0, atol=1e-15)


def test_a_rest_forgets_a_derivative_that_was_not_known():
    # hops of one period, more than there are slots for, end in the next
    scene = jv.make_scene(0.8, 1.0, 0.1, 0.98, (None, -1.0))
    start, _ = jv.strobe(scene, jv.State(-1.1, 0.0), 2)

    def end(periods, numbers):
        done, impacts = jv.strobe(scene, jv.State(*numbers), periods)
        return jnp.stack([done.x, done.v]), (impacts.count, done.contact)

    found = []
    for periods in (1, 2):
        run = jax.jit(jax.vmap(jax.jacfwd(partial(end, periods), has_aux=True)))
        found.append(run(jnp.array([[float(start.x), float(start.v)]])))
    (few, (count, contact)), (both, (_, held)) = found
    assert count > REPLAY_SLOTS and contact != 2 and np.isnan(few).all()
    assert held == 2 and np.array_equal(both, np.zeros((1, 2, 2)))


def test_samples_after_a_release_forget_as_many_impacts():
    _, (_, impacts) = strobed(MANY, jnp.array([MANY.x, 3.0, 1.0]))
    late = np.array([np.mean(impacts.time[34:36]), (np.arccos(1.0 / 3.0) - MANY.phase) / 0.5 - 0.1, 4.0 * np.pi])

    def states(numbers):
        scene = jv.make_scene(numbers[1], 0.5, 0.1, 0.85, (None, numbers[2]))
        found, _ = jv.sample(scene, jv.State(numbers[0], MANY.v, MANY.phase), late)
        return jnp.stack([found.x, found.v])

    found = jax.jacfwd(states)(jnp.array([MANY.x, 3.0, 1.0]))
    assert np.isnan(found[:, 0]).all()  # among its last hops, too many for the slots
    assert np.array_equal(found[:, 1], [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    assert np.allclose(found[:, 2], free(MANY), rtol=1e-11, atol=0)

"""Motions that stick: labels, the growth between sticking phases, and derivatives, which forget what was before."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import acos, hypot, log, mpf, workdps

import jaxvibro as jv
from jaxvibro.maps.itinerary import format_label
from jaxvibro.maps.reference_strobe import REPLAY_SLOTS
from jaxvibro.maps.sticking_phase_intervals import find_sticking_phases

from .reference import rest_slopes, rests, slopes
from .reference.draws import Draw
from .reference.scene import Scene, Wall
from .reference.special import exact
from .truths import plain

# amplitude, frequency, damping, restitution, wall, side: the mass sticks to it once a period
STICKING = [
    (1.5, 0.5, 0.1, 0.6, -1.0, 1),
    (1.5, 0.5, 0.1, 0.0, -1.0, 1),
    (1.3, 0.4, 0.05, 0.3, 1.0, -1),
    (2.0, 0.7, 0.2, 0.5, -0.8, 1),
    (2.2, 0.3, 0.3, 0.8, 0.5, -1),
]
NEAR = 0.03  # of the growth: bounces after those that are simulated count with the contact force as it is

# chatter on the right wall, released; as many bounces, and sticking to the end; sticking to each wall, four impacts
DRAWS = {
    "released": Draw(Scene(0.1, 0.5, 3.0, Wall(-9.0, 0.5), Wall(1.0, 0.85)), 0.7, 0.3, -1.5),
    "held": Draw(Scene(0.1, 0.5, 0.5, Wall(-9.0, 0.5), Wall(-1.2, 0.88)), -1.4, 0.3, 0.0),
    "both walls": Draw(Scene(0.19, 0.3, 2.7, Wall(-0.8, 0.6), Wall(1.0, 0.82)), 0.0, 0.3, 2.8),
}
BY = ("x", "amplitude", "right.position")


def scene(amplitude, frequency, damping, restitution, wall, side):
    return jv.make_scene(amplitude, frequency, damping, restitution, (None, wall) if side > 0 else (wall, None))


def settled(given, numbers):
    """Return a state of the motion on which a start near the wall settles."""
    state = jv.State(numbers[4] - 0.2 * numbers[5], 0.0)
    for _ in range(60):
        state, _ = jv.strobe(given, state)
    return state


def growth_to_sticking(amplitude, frequency, damping, restitution, wall, side):
    """Return the logarithm of the growth of a small change from the release to the next sticking, and the time between.

    The growth is the contact force when the mass sticks times the derivative of this time, by differences.
    """
    with workdps(30):
        given = exact(plain(scene(amplitude, frequency, damping, restitution, wall, side)))
        released = rests.release(given, side, side * acos(mpf(wall) / amplitude) / frequency)

        def begins(dx, dv):
            hit = rests.first(given, (released, wall + dx, dv), side)
            return rests.bounces(given, side, hit.time, restitution * hit.speed)[1]

        begin, shift = begins(0, mpf(0)), -side * mpf(10) ** -12
        gradient = [(begins(*change) - begin) / shift for change in ((shift, mpf(0)), (0, shift))]
        return float(log(rests.press_alone(given, side, begin) * hypot(*gradient))), float(begin - released)


@pytest.mark.parametrize("numbers", STICKING)
def test_growth_between_sticking_phases_is_that_of_the_closed_form(numbers):
    given = scene(*numbers)
    found = find_sticking_phases(given, settled(given, numbers), 1)
    growth, span = growth_to_sticking(*numbers)
    assert (found.has_sticking, found.count) == (True, 1)
    assert found.chatter_walls == ("" if numbers[3] == 0 else "R" if numbers[5] > 0 else "L")
    assert abs(found.growth_rate * span * numbers[1] / (2 * np.pi) - growth) < NEAR


@pytest.mark.parametrize("numbers", STICKING[2:4])
def test_growth_between_sticking_phases_under_a_force_is_that_under_the_spring(numbers):
    given = scene(*numbers)
    force = jv.Force("polynomial", {"c1": 1.0, "damping": numbers[2]})
    own = jv.make_scene(*numbers[:2], restitution=numbers[3], walls=(given.left, given.right), force=force)
    start = settled(given, numbers)
    exact, found = find_sticking_phases(given, start, 1), find_sticking_phases(own, start, 1)
    assert found[:3] == exact[:3] and exact.has_sticking
    assert abs(found.growth_rate - exact.growth_rate) < 1e-6


@pytest.mark.parametrize(
    ("numbers", "label"),
    [
        *(((1.5, 0.5, 0.1, restitution, (None, -1.0)), "P1-0-inf") for restitution in (0.2, 0.4, 0.6, 0.8)),
        *(((1.5, 0.5, 0.1, restitution, (1.0, None)), "P1-inf-0") for restitution in (0.2, 0.8)),
        ((1.5, 0.5, 0.1, 0.0, (None, 0.3)), "P102"),
        ((2.0, 0.2, 0.1, 0.4, (-1.0, 1.0)), "P1-inf-inf"),
        ((1.5, 0.5, 0.05, 0.5, (-0.2, 0.5)), "P1-inf-inf"),
        ((2.0, 0.4, 0.05, 0.0, (-1.0, 1.0)), "P111"),
    ],
)
def test_no_count_of_bounces_is_in_the_label_of_a_motion_that_sticks(numbers, label):
    (one,) = [one for one in jv.find_attractors(jv.make_scene(*numbers), starts=4) if one.share > 0]
    assert one.label == one.orbit.label == label
    assert one.rests and one.orbit.rests and (one.mirror_of is None or None not in numbers[-1])


def test_labels():
    hit = jv.find_attractors(jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0)), starts=4)
    assert not any(one.rests or one.orbit.rests for one in hit)
    assert format_label(("RRR",), "R") == "P1-0-inf" and format_label(("LR", "L"), "R") == "P2-2-inf"
    assert format_label(("L", "RR"), "LR") == "P2-inf-inf" and format_label(("LR",)) == "P111"


def strobed(draw, numbers, periods=1):
    """Return (x and v, times, speeds) of a `Draw` with other numbers `BY`, and the end and the impacts."""
    gamma, omega, _, *walls = draw.scene[:5]
    x, amplitude, place = numbers
    walls = [jv.Wall(*wall[:2]) for wall in (walls[0], walls[1]._replace(position=place))]
    scene = jv.make_scene(amplitude, omega, gamma, 0.5, walls)
    end, impacts = jv.strobe(scene, jv.State(x, draw.v, draw.phase), periods, slots=48)
    return (jnp.stack([end.x, end.v]), impacts.time, impacts.speed), (end, impacts)


def numbers_of(draw):
    return jnp.array([draw.x, draw.scene.amplitude, draw.scene.right.position])


def differentiated(draw, periods=1, way=jax.jacfwd):
    return way(lambda numbers: strobed(draw, numbers, periods), has_aux=True)(numbers_of(draw))


def true_derivatives(draw, known=()):
    """Return by differences the derivatives of the end, and {time: those of time and speed} of impacts, by `BY`."""
    columns, story = [slopes.names(draw.scene).index(name) for name in BY], rest_slopes.story(*draw)
    impacts = rest_slopes.impacts(draw, story, known, 2) if len(known) else {}
    end = rest_slopes.jacobian(draw, story)
    return story, end[:, columns], {time: rows[:, columns] for time, rows in impacts.items()}


@pytest.mark.parametrize("name", DRAWS)
def test_derivatives_of_the_end_and_of_impacts_are_those_of_differences(name):
    """Impacts before the last release count for nothing, however many there are."""
    draw, way = DRAWS[name], jax.jacrev if name == "released" else jax.jacfwd
    (end, times, speeds), (last, impacts) = differentiated(draw, way=way)
    story, true, of_impacts = true_derivatives(draw, np.asarray(impacts.time)[np.isfinite(impacts.time)])
    assert impacts.count > REPLAY_SLOTS or name == "both walls"
    assert (abs(last.contact) == 2) == bool(story.held) == (name == "held")
    assert [stretch.since and stretch.since[0] for stretch in story.stretches][1:] == {
        "released": [1],
        "held": [],
        "both walls": [-1, 1],
    }[name]
    assert np.array_equal(end[:, 0], [0.0, 0.0])
    np.testing.assert_allclose(end, true, rtol=1e-12, atol=1e-12)
    for time, rows in of_impacts.items():
        k = int(np.argmin(abs(impacts.time - time)))
        assert abs(impacts.time[k] - time) < 1e-9
        np.testing.assert_allclose([times[k], speeds[k]], rows, rtol=1e-10, atol=1e-14)
    assert of_impacts


def test_two_periods_with_sticking_are_two_strobes():
    draw = DRAWS["both walls"]
    first, (end, impacts) = differentiated(draw)
    after = draw._replace(x=float(end.x), v=float(end.v))

    def onward(z):
        (end, *_), _ = strobed(after._replace(v=z[1]), jnp.array([z[0], *z[2:]]))
        return end

    second = jax.jacfwd(onward)(jnp.array([after.x, after.v, *numbers_of(draw)[1:]]))
    (whole, times, speeds), _ = differentiated(draw, periods=2)
    assert np.allclose(whole, second[:, :2] @ first[0] + np.pad(second[:, 2:], ((0, 0), (1, 0))), rtol=1e-10)
    count = int(impacts.count)
    assert np.allclose(times[:count], first[1][:count], rtol=1e-10, atol=1e-13)
    assert np.allclose(speeds[:count], first[2][:count], rtol=1e-10, atol=1e-13)


def test_sticking_forgets_a_derivative_that_was_not_known():
    """Bounces of one period, more than there are slots for, end in the next."""
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
    draw = DRAWS["released"]
    _, (_, impacts) = strobed(draw, numbers_of(draw))
    late = np.array([np.mean(impacts.time[34:36]), (np.arccos(1.0 / 3.0) - draw.phase) / 0.5 - 0.1, 4.0 * np.pi])

    def states(numbers):
        scene = jv.make_scene(numbers[1], 0.5, 0.1, 0.85, (None, numbers[2]))
        found, _ = jv.sample(scene, jv.State(numbers[0], draw.v, draw.phase), late)
        return jnp.stack([found.x, found.v])

    found = jax.jacfwd(states)(numbers_of(draw))
    assert np.isnan(found[:, 0]).all()  # among its last bounces, too many for the slots
    assert np.array_equal(found[:, 1], [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(found[:, 2], true_derivatives(draw)[1], rtol=1e-11, atol=1e-13)

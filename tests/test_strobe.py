"""The stroboscopic map against ball arithmetic and closed forms, its rules for walls, and its lanes."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.flight.flow import fly
from jaxvibro.maps import reference_strobe
from jaxvibro.scene.codes import Contact, Status
from tests.lanes import one_by_one
from tests.reference import orbit
from tests.reference.scene import Motion, Scene, Wall
from tests.reference.search import Discard

WALLS = (-1.0, 1.0)
recorded = partial(jv.strobe, slots=32)
measured = partial(recorded, clearance=True)


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, WALLS)


def test_a_flight_that_stops_bending_before_a_wall_does_not_land_early():
    # Newton's last step is long here where the clearance's second derivative vanishes: it landed half way to the wall
    scene = jv.make_scene(4.65, 2.1, 0.05, 0.7, (-1.0, 1.0))
    shift = np.linspace(-1e-6, 1e-6, 2001)
    end, impacts = measured(scene, jv.State(-0.862, 2.718 + shift))
    assert (impacts.count == 2).all()
    for found, expected in ((end.x, -0.396212), (end.v, 1.834946)):
        assert abs(found - expected).max() < 1e-4
        assert abs(np.diff(found, 2)).max() < 1e-13  # smooth in the start
    assert (impacts.least_clearance > 0.25).all()


@pytest.mark.parametrize("swing", [None, 0.2])
def test_the_clearance_of_a_flight_that_turns_back_from_both_walls_within_a_step(swing):
    rng = np.random.default_rng(1)
    phase, pull, far = rng.uniform((1.0, 0.2, 1.0), (2.1, 0.6, 2.0), (60, 3)).T
    v = -0.4 * pull**2 / (2.0 * np.sin(phase))  # of A = 2 the pull changes by -2 sin(phase) t: v is zero twice soon
    x = 2.0 * np.cos(phase) - pull
    low, high = x - far, x + far + 0.05 * rng.normal(size=60)
    motion = None if swing is None else jv.Motion(swing * pull, 0.5)
    scene = jv.make_scene(2.0, 1.0, 0.0, 0.8, (jv.Wall(low), jv.Wall(high, motion=motion)))
    found = one_by_one(partial(jv.strobe, clearance=True), scene, jv.State(x, v, phase))[1].least_clearance
    count = 0
    for k in range(60):
        own = None if swing is None else Motion(swing * pull[k], 0.5, 1)
        walls = Wall(low[k], 0.8, None), Wall(high[k], 0.8, own)
        try:
            true = orbit.strobe(Scene(0.0, 1.0, 2.0, *walls), x[k], v[k], phase[k]).least_minimum
        except Discard:
            continue
        count += 1
        assert found[k] == pytest.approx(true, rel=0.0, abs=1e-12)
    assert count > 40


def test_a_speed_that_falls_nearly_to_zero_is_no_turning_point():
    """Of full steps: Halley's step is short where the pull is zero, though the speed is not."""
    scene = jv.make_scene(4.80168422825537, 2.1, 0.05, 0.7, WALLS)
    start = jv.State(-0.15317286635469873, 0.882185742781255)
    run = jax.jit(partial(reference_strobe.reference_strobe, periods=1, slots=4, min_lanes=1, clearance=True))
    impacts = run(scene, jax.tree.map(jnp.asarray, start))[1]
    assert impacts.count == 2 and np.isinf(impacts.least_clearance)
    assert np.isinf(measured(scene, start)[1].least_clearance)


def test_start_on_a_wall_moving_in_rebounds_at_time_zero(scene):
    end, impacts = recorded(scene, jv.State(1.0, 2.0))
    assert impacts.time[0] == 0
    assert impacts.side[0] == 1
    assert impacts.speed[0] == 2
    landed, later = recorded(scene, jv.State(1.0, -1.4, 0.0, 1.0))
    assert later.count == impacts.count - 1
    assert abs(landed.x - end.x) < 1e-13


def test_a_start_at_rest_on_a_wall_is_decided_by_the_contact_force():
    # the press on the right wall is A cos(phase) - 1: negative, it leaves at once; positive, it waits for the release
    scene = jv.make_scene(0.5, 2.0, 0.1, 0.7, (None, 1.0))
    end, impacts = jv.strobe(scene, jv.State(1.0, 0.0), slots=4)
    x, v = fly(scene, jv.State(1.0, 0.0, 0.0), np.pi)
    assert impacts.count == 0
    assert abs(end.x - x) < 1e-14
    assert abs(end.v - v) < 1e-14
    strong, release = scene.replace(amplitude=3.0), np.arccos(1 / 3.0)
    end, impacts = jv.strobe(strong, jv.State(1.0, 0.0, -0.3), slots=4)
    x, v = fly(strong, jv.State(1.0, 0.0, release), (2 * np.pi - 0.3 - release) / 2.0)
    assert impacts.count == 0
    assert abs(end.x - x) < 1e-13
    assert abs(end.v - v) < 1e-13


def test_sticks_through_the_end_of_a_period():
    scene = jv.make_scene(3.0, 0.5, 0.1, 0.0, (None, 1.0))
    end, impacts = jv.strobe(scene, jv.State(0.9, 1.0), slots=4)
    assert end.contact == 2
    assert end.x == 1
    assert end.v == 0
    again, more = jv.strobe(scene, end, slots=4)
    assert impacts.status == more.status == 0
    assert again.contact == 2


def test_complete_chatter_ends_at_rest():
    # the press 0.3 cos(theta) + 1 on the right wall never ends: hops die out like 0.6^n and the mass stays
    scene = jv.make_scene(0.3, 0.5, 0.1, 0.6, (None, -1.0))
    end, impacts = jv.strobe(scene, jv.State(-1.2, 0.3), slots=16)
    gaps = np.diff(np.asarray(impacts.time)[: impacts.count])
    assert 3 <= impacts.count < 8
    assert np.all(np.abs(gaps[1:] / gaps[:-1] - 0.6) < 0.05)
    assert impacts.speed[impacts.count - 1] > 0.1
    assert impacts.least_speed == 0
    assert impacts.status == 1
    assert (end.x, end.v, end.contact) == (-1.0, 0.0, 2.0)
    _, more = jv.strobe(scene, jv.State(-1.2, 0.3), periods=2, slots=16)  # at rest from then on
    assert (more.status, more.count) == (1, impacts.count)


def test_chatter_between_the_walls_of_a_narrow_gap_ends_in_sticking():
    """What the force does to a flight across the gap is at most its work, 7 times the gap."""
    rng = np.random.default_rng(5)
    place, gap = np.repeat([0.0, 0.7, -2.0], 10), np.tile(10.0 ** -np.arange(3.0, 13.0), 3)
    right, bounce = place + gap, rng.uniform(0.2, 0.8, 30)
    scene = jv.make_scene(5.0, 2.1, 0.05, bounce, (place, right))
    end, impacts = jv.strobe(scene, jv.State(place, 1.0), slots=8)
    np.testing.assert_array_equal(end.x, right)
    np.testing.assert_array_equal(end.v, 0.0)
    np.testing.assert_array_equal(end.contact, Contact.STUCK)
    assert set(np.asarray(impacts.status)) <= {Status.OK, Status.FULL}
    turn = np.arange(8)
    energy, work = bounce[:, None] ** (2 * turn), 2.0 * 7.0 * ((right - place) * 1.01)[:, None] * (turn + 1)
    flies = energy * bounce[:, None] ** 2 > 2.0 * work
    assert flies.sum() > 120
    assert np.all(np.where(flies, np.asarray(impacts.side) == np.where(turn % 2, -1, 1), True))
    assert np.all(np.where(flies, abs(np.asarray(impacts.speed) ** 2 - energy) <= work, True))


def test_hops_that_outlast_the_period_are_no_chatter():
    scene = jv.make_scene(0.3, 0.5, 0.1, 0.97, (None, -1.0))
    end, impacts = jv.strobe(scene, jv.State(-1.2, 0.3), slots=64)
    assert impacts.count > 5
    assert impacts.least_speed > 0.05
    assert end.x < -1.0


@pytest.mark.parametrize("state", [(1.5, 0.0), (-1.0000001, 0.0)])
def test_a_start_beyond_a_wall_is_refused(scene, state):
    assert jv.strobe(scene, jv.State(*state))[1].status == 3


def test_bad_numbers_inside_jit_are_a_status(scene):
    def run(damping, restitution):
        return jv.strobe(jv.make_scene(2.0, 2.1, damping, restitution, WALLS), jv.State(0.1, 0.2), slots=1)[1].status

    traced = jax.jit(run)
    assert traced(-0.1, 0.7) == 3
    assert traced(0.1, 1.5) == 3
    assert traced(jnp.nan, 0.7) == 4
    assert traced(0.1, 0.7) < 2


@pytest.mark.parametrize("value", [None, "a", 1j, [[1.0], [2.0, 3.0]]])
def test_a_state_that_is_no_number_is_refused_by_name(scene, value):
    with pytest.raises(jv.ArgumentError, match=r"^state\.v: must be a real number"):
        jv.strobe(scene, jv.State(0.0, value))
    with pytest.raises(jv.ArgumentError, match=r"^state: must be a State"):
        jv.strobe(scene, (0.0, value))


def test_batches_that_do_not_fit_are_refused(scene):
    with pytest.raises(jv.ArgumentError, match=r"state\.x"):
        jv.strobe(scene.replace(amplitude=np.ones(3)), jv.State(np.zeros(4), 0.0))


def test_extreme_numbers_end_with_a_status(scene):
    size = np.array([1.0, 1e200, 1e-160])
    scaled = scene.replace(amplitude=2.0 * size, **{"left.position": -size, "right.position": size})
    _, impacts = recorded(scaled, jv.State(0.9 * size, -1.1 * size))
    assert impacts.status.tolist() == [0, 4, 4]
    _, impacts = recorded(scene.replace(damping=1e300), jv.State(0.05, -1.1))
    assert impacts.status == 4


def test_a_bad_lane_harms_no_other_and_slots_change_nothing_else(scene):
    """Of lanes that the fast path decides, and some that start into a wall."""
    rng = np.random.default_rng(1)
    x, v = rng.uniform(-1, 1, 8), rng.uniform(-3, 3, 8)
    x[:3] = np.sign(v[:3])
    many, start = scene.replace(amplitude=rng.uniform(0, 6, 8)), jv.State(x, v)
    end, impacts = recorded(many, start)
    bad, others = recorded(many, jv.State(np.where(np.arange(8) == 1, 5.0, np.where(np.arange(8) == 6, np.nan, x)), v))
    kept = np.delete(np.arange(8), [1, 6])
    assert others.status[1] == Status.INVALID and others.status[6] == Status.NONFINITE
    for one, other in zip(jax.tree.leaves((bad, others)), jax.tree.leaves((end, impacts)), strict=True):
        np.testing.assert_array_equal(np.asarray(one)[kept], np.asarray(other)[kept])
    assert np.max(impacts.count[:3]) > 1
    for slots in (0, 1):
        short, fewer = jv.strobe(many, start, slots=slots)
        np.testing.assert_allclose([short.x, short.v], [end.x, end.v], rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(fewer.status == Status.FULL, impacts.count > slots)
        np.testing.assert_array_equal(fewer.count, impacts.count)
        np.testing.assert_allclose(fewer.time, impacts.time[:, :slots], rtol=1e-12)
        assert fewer.least_clearance is None


def test_a_clearance_counts_as_a_constant(scene):
    def clearance(v):
        return measured(scene, jv.State(0.5, v))[1].least_clearance

    assert clearance(0.3) > 0 and jax.grad(clearance)(0.3) == 0


def test_a_scene_without_walls_runs_inside_a_loop():
    # an operand that no result depends on would abort the process in XLA's emitter
    scene = jv.make_scene(1.0, 2.1, 0.05, 0.7, (None, None))

    def period(_, x):
        return jv.strobe(scene, jv.State(x, 0.0 * x), slots=2)[0].x

    x = jnp.array([0.1, 0.2])
    looped = jax.jit(lambda x: jax.lax.fori_loop(0, 2, period, x))(x)
    assert np.allclose(looped, period(0, period(0, x)), rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"periods": 0}, r"^periods: must be a whole number"),
        ({"periods": 1.5}, r"^periods: must be a whole number"),
        ({"slots": -1}, r"^slots: must be a whole number"),
        ({"slots": True}, r"^slots: must be a whole number"),
        ({"clearance": 1}, r"^clearance: must be True or False; got 1"),
        ({"scene": 5}, r"^scene: must be a Scene; got 5$"),
        ({"state": 0.5}, r"^state: must be a State; got 0\.5$"),
    ],
)
def test_invalid_arguments_are_refused(scene, given, message):
    with pytest.raises(jv.ArgumentError, match=message):
        jv.strobe(**{"scene": scene, "state": jv.State(0.0, 0.0)} | given)

"""The stroboscopic map: its rules for walls and rest, statuses, lanes, and invalid arguments of all maps."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from tests import truths
from tests.lanes import one_by_one
from tests.properties.motions import Contact, Status, lane_of
from tests.reference.search import Discard

WALLS = (-1.0, 1.0)
recorded = partial(jv.strobe, slots=32)
measured = partial(recorded, clearance=True)


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, WALLS)


def test_a_flight_that_stops_bending_before_a_wall_does_not_land_early():
    # Newton's last step is long here where the clearance's second derivative vanishes: it landed half way to the wall
    scene = jv.make_scene(4.65, 2.1, 0.05, 0.7, WALLS)
    end, impacts = measured(scene, jv.State(-0.862, 2.718 + np.linspace(-1e-6, 1e-6, 2001)))
    assert (impacts.count == 2).all() and (impacts.least_clearance > 0.25).all()
    for computed, expected in ((end.x, -0.396212), (end.v, 1.834946)):
        assert abs(computed - expected).max() < 1e-4
        assert abs(np.diff(computed, 2)).max() < 1e-13  # smooth in the start


@pytest.mark.parametrize("swing", [None, 0.2])
def test_the_clearance_of_a_flight_that_turns_back_from_both_walls_within_a_step(swing):
    rng = np.random.default_rng(1)
    phase, pull, far = rng.uniform((1.0, 0.2, 1.0), (2.1, 0.6, 2.0), (60, 3)).T
    v = -0.4 * pull**2 / (2.0 * np.sin(phase))  # of A = 2 the pull changes by -2 sin(phase) t: v is zero twice soon
    x = 2.0 * np.cos(phase) - pull
    low, high = x - far, x + far + 0.05 * rng.normal(size=60)
    motion = None if swing is None else jv.Motion(swing * pull, 0.5)
    scene, state = jv.make_scene(2.0, 1.0, 0.0, 0.8, (low, jv.Wall(high, motion=motion))), jv.State(x, v, phase)
    clearance = one_by_one(partial(jv.strobe, clearance=True), scene, state)[1].least_clearance
    count = 0
    for k in range(60):
        try:
            true = truths.closed_form(*lane_of(scene, state, k))
        except Discard:
            continue
        count += 1
        assert clearance[k] == pytest.approx(true.least_clearance, rel=0.0, abs=1e-12)
    assert count > 40


@pytest.mark.parametrize("drive", [(), ((0.0, 2, 0.0),)])
def test_a_speed_that_falls_nearly_to_zero_is_no_turning_point(drive):
    """By both paths: Halley's step is short where the force is zero, though the speed is not."""
    scene = jv.make_scene(4.80168422825537, 2.1, 0.05, 0.7, WALLS, drive=drive)
    impacts = measured(scene, jv.State(-0.15317286635469873, 0.882185742781255))[1]
    assert impacts.count == 2 and np.isinf(impacts.least_clearance)


def test_a_start_on_a_wall(scene):
    """A mass that moves into a wall rebounds at once; one at rest leaves as soon as the contact force is negative."""
    end, impacts = recorded(scene, jv.State(1.0, 2.0))
    assert (impacts.time[0], impacts.side[0], impacts.speed[0]) == (0.0, 1, 2.0)
    landed, later = recorded(scene, jv.State(1.0, -1.4, 0.0, Contact.LANDED))
    assert later.count == impacts.count - 1 and abs(landed.x - end.x) < 1e-13
    for amplitude, phase, release in ((0.5, 0.0, 0.0), (3.0, -0.3, np.arccos(1.0 / 3.0))):
        one_wall = jv.make_scene(amplitude, 2.0, 0.1, 0.7, (None, 1.0))  # contact force: A cos(phase) - 1
        free = jv.make_scene(amplitude, 2.0, 0.1, 0.7, (None, None))
        end, impacts = jv.strobe(one_wall, jv.State(1.0, 0.0, phase), slots=4)
        flown, _ = jv.sample(free, jv.State(1.0, 0.0, release), [(2.0 * np.pi + phase - release) / 2.0])
        assert impacts.count == 0 and np.allclose([end.x, end.v], [flown.x[0], flown.v[0]], rtol=0, atol=1e-13)


def test_a_mass_that_sticks_keeps_its_contact():
    """After an impact with R = 0, or when the hops of a chatter have died out like R^n."""
    scene = jv.make_scene(3.0, 0.5, 0.1, 0.0, (None, 1.0))
    end, impacts = jv.strobe(scene, jv.State(0.9, 1.0), slots=4)
    again, more = jv.strobe(scene, end, slots=4)
    assert (end.x, end.v, end.contact, again.contact) == (1.0, 0.0, Contact.STUCK, Contact.STUCK)
    assert impacts.status == more.status == Status.OK
    chatter = jv.make_scene(0.3, 0.5, 0.1, 0.6, (None, -1.0))  # the contact force 0.3 cos(theta) + 1 never ends
    end, impacts = jv.strobe(chatter, jv.State(-1.2, 0.3), slots=16)
    gaps = np.diff(np.asarray(impacts.time)[: impacts.count])
    assert 3 <= impacts.count < 8 and np.all(np.abs(gaps[1:] / gaps[:-1] - 0.6) < 0.05)
    assert impacts.speed[impacts.count - 1] > 0.1 and impacts.least_speed == 0
    assert (end.x, end.v, end.contact) == (-1.0, 0.0, Contact.STUCK)
    _, more = jv.strobe(chatter, jv.State(-1.2, 0.3), periods=2, slots=16)
    assert (impacts.status, more.status, more.count) == (Status.FULL, Status.FULL, impacts.count)
    end, impacts = jv.strobe(chatter.replace(restitution=0.97), jv.State(-1.2, 0.3), slots=16)
    assert impacts.count > 5 and impacts.least_speed > 0.05 and end.x < -1.0  # the hops outlast the period


def test_chatter_between_the_walls_of_a_narrow_gap_ends_in_sticking():
    """What the force does to a flight across the gap is at most its work, 7 times the gap."""
    rng = np.random.default_rng(5)
    place, gap = np.repeat([0.0, 0.7, -2.0], 10), np.tile(10.0 ** -np.arange(3.0, 13.0), 3)
    right, bounce = place + gap, rng.uniform(0.2, 0.8, 30)
    end, impacts = jv.strobe(jv.make_scene(5.0, 2.1, 0.05, bounce, (place, right)), jv.State(place, 1.0), slots=8)
    np.testing.assert_array_equal(end.x, right)
    np.testing.assert_array_equal(end.v, 0.0)
    np.testing.assert_array_equal(end.contact, Contact.STUCK)
    assert set(np.asarray(impacts.status)) <= {Status.OK, Status.FULL}
    turn = np.arange(8)
    energy, work = bounce[:, None] ** (2 * turn), 2.0 * 7.0 * ((right - place) * 1.01)[:, None] * (turn + 1)
    flies = energy * bounce[:, None] ** 2 > 2.0 * work
    assert flies.sum() > 120
    assert np.all((np.asarray(impacts.side) == np.where(turn % 2, -1, 1))[flies])
    assert np.all((abs(np.asarray(impacts.speed) ** 2 - energy) <= work)[flies])


def test_starts_and_numbers_that_are_invalid_are_a_status(scene):
    states = {  # x, v, phase, contact
        (1.5, 0.0, 0.0, 0.0): Status.INVALID,  # beyond a wall
        (-1.0000001, 0.0, 0.0, 0.0): Status.INVALID,
        (1.0, 0.0, 0.0, 2.0): Status.OK,
        (1.0, -0.5, 0.0, 1.0): Status.OK,
        (1.0, -0.5, 0.0, 2.0): Status.INVALID,  # a mass at rest does not move away
        (1.0, 0.5, 0.0, 1.0): Status.INVALID,  # nor does one that has landed go into its wall
        (1.0, 0.5, 0.0, 2.0): Status.INVALID,
        (0.9, 0.0, 0.0, 2.0): Status.INVALID,  # and both are at it
        (1.0, -0.5, 0.0, -1.0): Status.INVALID,
        (1.0, 0.0, 0.0, 3.0): Status.INVALID,  # within a rigid wall
        (0.0, np.nan, 0.0, 0.0): Status.NONFINITE,
    }
    impacts = recorded(scene, jv.State(*np.array(list(states)).T))[1]
    assert dict(zip(states, np.asarray(impacts.status), strict=True)) == states

    @jax.jit
    def traced(damping, restitution, left):
        scene = jv.make_scene(2.0, 2.1, damping, restitution, (left, 1.0))
        return jv.strobe(scene, jv.State(1.0, 0.0), slots=32)[1].status

    numbers = {(0.1, 0.7, -1.0): 0, (-0.1, 0.7, -1.0): 3, (0.1, 1.5, -1.0): 3, (jnp.nan, 0.7, -1.0): 4}
    numbers |= {(0.1, 0.7, 1.0): 3, (0.1, 0.7, 1.5): 3}  # walls at one place, or exchanged
    assert {given: int(traced(*given)) for given in numbers} == numbers


def test_extreme_numbers_end_with_a_status(scene):
    size = np.array([1.0, 1e200, 1e-160])
    scaled = scene.replace(amplitude=2.0 * size, **{"left.position": -size, "right.position": size})
    assert recorded(scaled, jv.State(0.9 * size, -1.1 * size))[1].status.tolist() == [0, 4, 4]
    assert recorded(scene.replace(damping=1e300), jv.State(0.05, -1.1))[1].status == 4
    endless = jv.make_scene(3.0, 0.05, 0.0, 1.0, (None, 1.0))
    _, impacts = jv.strobe(endless, jv.State(1.0, -1e-6), slots=2)
    assert impacts.status == Status.CAP and impacts.count == 1000


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


def test_a_scene_without_walls_runs_inside_a_loop():
    # an operand that no result depends on would abort the process in XLA's emitter
    scene = jv.make_scene(1.0, 2.1, 0.05, 0.7, (None, None))

    def period(_, x):
        return jv.strobe(scene, jv.State(x, 0.0 * x), slots=2)[0].x

    x = jnp.array([0.1, 0.2])
    looped = jax.jit(lambda x: jax.lax.fori_loop(0, 2, period, x))(x)
    assert np.allclose(looped, period(0, period(0, x)), rtol=0, atol=1e-13)


STATE, MANY = jv.State(0.0, 0.0), jv.State(np.zeros(3), 0.0)


@pytest.mark.parametrize(
    ("function", "arguments", "message"),
    [
        (jv.strobe, {"periods": 0}, r"^periods: must be a whole number"),
        (jv.strobe, {"periods": 1.5}, r"^periods: must be a whole number"),
        (jv.strobe, {"slots": -1}, r"^slots: must be a whole number"),
        (jv.strobe, {"slots": True}, r"^slots: must be a whole number"),
        (jv.strobe, {"clearance": 1}, r"^clearance: must be True or False; got 1"),
        (jv.strobe, {"scene": 5}, r"^scene: must be a Scene; got 5$"),
        (jv.strobe, {"state": 0.5}, r"^state: must be a State; got 0\.5$"),
        *[
            (jv.strobe, {"state": jv.State(0.0, value)}, r"^state\.v: must be a real number")
            for value in (None, "a", 1j, [[1.0], [2.0, 3.0]])
        ],
        (
            jv.strobe,
            {"scene": jv.make_scene(np.ones(3), 2.1, 0.1, 0.5, WALLS), "state": jv.State(np.zeros(4), 0.0)},
            r"state\.x",
        ),
        (jv.monodromy, {"periods": 0}, r"^periods: must be a whole number"),
        (jv.monodromy, {"state": 0.5}, r"^state: must be a State; got 0\.5$"),
        (jv.sample, {"times": [1.0, 0.5]}, r"^times: must be in order.*; got 0\.5 at index \(1,\)"),
        (jv.sample, {"times": [-1.0]}, r"^times: must not be negative; got -1\.0"),
        (jv.sample, {"times": [0.0, np.nan]}, r"^times: must be finite; got nan"),
        (jv.sample, {"times": 2.0}, r"^times: must have at least one axis"),
        (
            jv.sample,
            {"state": MANY, "times": np.zeros((4, 2))},
            r"^times: must have a shape \(\.\.\., n\) whose leading axes broadcast with \(3,\)",
        ),
        (jv.sample, {"times": "soon"}, r"^times: must be a real number or an array; got 'soon'"),
        (jv.sections, {"periods": 0}, "^periods: "),
        (jv.sections, {"settle": -1}, "^settle: "),
        (jv.sections, {"phase": np.nan}, "^phase: "),
        (jv.simulate, {"state": MANY}, r"^state: must be a single state"),
        (jv.simulate, {"state": jv.State(7.0, 0.0, 0.4)}, r"^state\.x: must lie between the walls at its phase; got 7"),
        (jv.return_map, {"side": "left"}, r"^side: must be a wall of the scene"),
    ],
)
def test_invalid_arguments_are_refused(function, arguments, message):
    valid = {"scene": jv.make_scene(1.0, 2.0, 0.1, 0.5, (None, 1.0)), "state": STATE}
    if function is jv.return_map:
        valid = {"scene": valid["scene"], "phase": 0.0, "velocity": 1.0}
    with pytest.raises(jv.ArgumentError, match=message):
        function(**valid | arguments)

"""Scenes without a drive, without a spring, and with walls at 0: no length, speed or time of such a scene is 0."""

from itertools import accumulate

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mp, mpf

import jaxvibro as jv
from jaxvibro.scene.scene_properties import is_driven
from jaxvibro.scene.state import Status

STUCK = 0.0, 0.0, -2.0  # x, v and contact of a mass that sticks to a left wall at 0
PERIOD = 2.0 * np.pi


def brake(t, x, v, p):
    """Weight, and drag by the square of the speed of a fall."""
    return -p["gravity"] + p["drag"] * v * v


def ball(c0=1.0, c1=0.0, damping=0.0, bounce=0.0, floor=0.0, frequency=1.0, **changes):
    """A mass above a floor, drawn to it by c0 + c1 x."""
    force = jv.Force("polynomial", {"c0": c0, "c1": c1, "damping": damping})
    given = {"amplitude": 0.0, "frequency": frequency, "restitution": bounce, "walls": (floor, None), "force": force}
    return jv.make_scene(**given | changes)


def test_scenes_without_lanes_have_strobes_without_lanes():
    nothing = np.zeros(0)
    given = {"mass": 0.5, "stiffness": 100.0, "damping_ratio": 0.02, "frequency_hz": 2.0, "gap": 0.01}
    scene = jv.scene_from_physical(**given, force=nothing, restitution=0.7)
    assert jv.strobe(scene, jv.State(nothing, nothing))[0].x.shape == (0,)


def ended(scene, start, slots=64):
    """Return ((x, v, contact), impacts) after a drive period."""
    end, impacts = jax.device_get(jv.strobe(scene, start, slots=slots))
    return (float(end.x), float(end.v), float(end.contact)), impacts


@pytest.mark.parametrize("numbers", [{}, {"c1": 0.1}, {"damping": 0.3}, {"c0": 1e-9, "c1": 1e-12}])
@pytest.mark.parametrize("floor", [0.0, -1.0, 2.0**-40])
@pytest.mark.parametrize("bounce", [0.0, 0.5, 1.0])
def test_a_mass_at_rest_on_a_floor_stays_there(numbers, floor, bounce):
    scene = ball(**numbers, bounce=bounce, floor=floor)
    for contact in (-2.0, -1.0, 0.0):
        end, impacts = ended(scene, jv.State(floor, 0.0, 0.0, contact))
        assert end == (floor, 0.0, -2.0)
        assert (impacts.status, impacts.count) == (Status.OK, 0)
        assert ended(scene, jv.State(*end[:2], 0.0, end[2]))[0] == end


def drag(gravity, drag):
    return {"force": jv.Force(brake, {"gravity": gravity, "drag": drag}), "frequency": 0.1}


@pytest.mark.parametrize(
    ("height", "gravity", "changes"),
    [
        *((height, 1.0, {}) for height in (1.0, 1e-6, 1e-100)),
        *((height, c0, drag(c0, by)) for height, c0, by in ((1000.0, 10.0, 0.01), (100.0, 10.0, 0.1), (3.0, 1.0, 0.2))),
    ],
)
def test_a_plastic_impact_on_a_floor_at_0_ends_in_sticking(height, gravity, changes):
    end, impacts = ended(ball(**changes), jv.State(height, 0.0))
    assert (end, impacts.status, impacts.count) == (STUCK, Status.OK, 1)
    time = speed = np.sqrt(2.0 * height)
    if changes:
        by = changes["force"].numbers["drag"]
        fall = np.exp(by * height)  # cosh of the time of fall
        time = np.log(fall + np.sqrt((fall - 1.0) * (fall + 1.0))) / np.sqrt(gravity * by)
        speed = np.sqrt(gravity / by * -np.expm1(-2.0 * by * height))
    assert impacts.time[0] == pytest.approx(time, rel=1e-13)
    assert impacts.speed[0] == pytest.approx(speed, rel=1e-13)


def landings(height, speed, gravity, bounce, count, root):
    """Return (times, speeds) of the landings of a ball that is thrown upwards."""
    first = root(speed * speed + 2 * gravity * height)
    speeds = list(accumulate(range(count - 1), lambda before, _: bounce * before, initial=first))
    flights = [(speed + first) / gravity, *(2 * bounce * before / gravity for before in speeds[:-1])]
    return list(accumulate(flights)), speeds


@pytest.mark.parametrize(
    ("gravity", "height", "bounce", "frequency", "fewest", "error"),
    [
        (1.0, 1.0, 0.5, 3.0, 3, 1e-13),
        (9.81, 2.0, 0.9, 3.0, 10, 1e-13),
        (2.0**-20, 2.0**-20, 0.9, 3.0, 10, 1e-13),
        (1.0, 1.0, 1.0, 1.0, 10, 1e-13),
        (9.81, 2.0, 0.99, 0.7, 300, 2e-12),
        (9.81, 2.0, 0.999, 0.7, 1000, 4e-12),
        (9.81, 2.0, 1.0, 0.7, 1000, 2e-12),
    ],
)
def test_bounces_are_those_of_the_closed_form(gravity, height, bounce, frequency, fewest, error):
    """A thousand bounces lose a few roundings of the time that is gone."""
    scene, state = ball(c0=gravity, bounce=bounce, frequency=frequency), jv.State(height, 0.0)
    length, late, speeds = 2.0 * np.pi / frequency, [], []
    for k in range(200):
        state, impacts = jax.device_get(jv.strobe(scene, state, slots=64 if fewest < 100 else 1000))
        late += [mpf(k * length) + mpf(float(time)) for time in impacts.time[: impacts.count]]
        speeds += impacts.speed[: impacts.count].tolist()
        if abs(state.contact) == 2 or len(late) >= 1000 or (bounce == 1.0 and len(late) >= fewest):
            break
    assert len(late) >= fewest
    with mp.workdps(40):
        times, exact = landings(mpf(height), mpf(0), mpf(gravity), mpf(bounce), len(late), mp.sqrt)
    assert max(abs(a - b) for a, b in zip(late, times, strict=True)) <= error * times[0]
    assert max(abs(a - b) for a, b in zip(speeds, exact, strict=True)) <= 1e-13 * exact[0]
    if bounce <= 0.9:
        assert (float(state.x), float(state.v), float(state.contact)) == STUCK
        assert impacts.status == Status.FULL and impacts.least_speed == 0.0 and impacts.count < 64


def test_more_impacts_than_slots_have_status_full_and_a_least_speed():
    fewer = ended(ball(bounce=1.0), jv.State(1e-4, 0.0))[1]
    assert fewer.status == Status.FULL and fewer.count > 64 and fewer.least_speed > 0.0


@pytest.mark.parametrize(
    "numbers", [(0.6, -0.2, 0.7, 0.85, 0.0), (1.2, 0.1, 1.0, 0.8, 0.0), (0.6, -0.2, 0.7, 0.85, -1.0)]
)
def test_derivatives_of_bounces_are_those_of_the_closed_form(numbers):
    """Three bounces, and the state at the end, by height, speed, gravity, R and floor."""

    def computed(numbers):
        height, speed, gravity, bounce, floor = numbers
        end, impacts = jv.strobe(ball(c0=gravity, bounce=bounce, floor=floor), jv.State(floor + height, speed))
        return jnp.concatenate([impacts.time[:3], impacts.speed[:3], jnp.stack([end.x, end.v])])

    def exact(numbers):
        height, speed, gravity, bounce, floor = numbers
        times, speeds = landings(height, speed, gravity, bounce, 3, jnp.sqrt)
        late, away = PERIOD - times[-1], bounce * speeds[-1]
        return jnp.stack([*times, *speeds, floor + away * late - 0.5 * gravity * late * late, away - gravity * late])

    numbers = jnp.array(numbers)
    found, expected = jax.jacfwd(computed)(numbers), jax.jacfwd(exact)(numbers)
    assert abs(computed(numbers) - exact(numbers)).max() <= 1e-13
    assert abs(found - expected).max() <= 1e-9 * abs(expected).max()


def test_a_mass_that_sticks_forgets_its_start_but_moves_with_its_floor():
    def end(numbers):
        start = jv.State(numbers[2] + numbers[0], numbers[1])
        found = jv.strobe(ball(bounce=0.0, floor=numbers[2]), start)[0]
        return jnp.stack([found.x, found.v])

    assert jax.jacfwd(end)(jnp.array([1.0, 0.0, 0.0])).tolist() == [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]


@pytest.mark.parametrize("bounce", [0.0, 0.5])
def test_strobe_sample_and_simulate_agree_on_a_ball_that_comes_to_rest(bounce):
    scene, start = ball(bounce=bounce), jv.State(0.7, 0.0)
    end, impacts = ended(scene, start)
    times = np.arange(9) * (PERIOD / 8)
    states, status = jv.sample(scene, start, times)
    path = jv.simulate(scene, start, samples=8)
    assert int(status) == Status.OK
    assert np.asarray(states.x) == pytest.approx(path.x.values, abs=1e-15)
    assert (float(states.x[-1]), float(states.v[-1]), float(states.contact[-1])) == end == STUCK
    assert (path.x.values[-1], path.v.values[-1]) == (0.0, 0.0)
    count = int(impacts.count)  # bounces are recorded until sticking is certain; that is later with more stops
    assert path.sizes["impact"] >= count
    assert path.impact_time.values[:count] == pytest.approx(impacts.time[:count], rel=1e-14)
    assert path.speed.values[:count] == pytest.approx(impacts.speed[:count], rel=1e-14)
    after = np.asarray(states.x)[times > np.sqrt(1.4) * (1.0 + bounce) / (1.0 - bounce)]
    assert len(after) and not after.any()


@pytest.mark.parametrize("steep", [1e4, 1e6])
def test_a_force_that_turns_away_from_the_floor_lets_a_fast_mass_escape(steep):
    scene = ball(c1=-steep, bounce=0.5, frequency=50.0)
    barrier = steep**-0.5  # speed with which a mass on the floor comes to the point where the force turns
    for part, escapes in ((0.9, False), (1.1, True), (3.0, True)):
        end, impacts = ended(scene, jv.State(1e-12, -2.0 * part * barrier))
        assert impacts.status <= Status.FULL
        assert (end[1] > 0.0) == escapes and (end == STUCK or escapes)


def test_a_motion_below_the_smallest_length_is_at_rest():
    scene = jv.make_scene(amplitude=0.0, frequency=1.0, damping=0.3, restitution=0.5, walls=(0.0, None))
    for size in (1e-110, 1e-123, 1e-140, 1e-300):
        end, impacts = ended(scene, jv.State(size, -size))
        assert impacts.status == Status.OK
        assert max(map(abs, end[:2])) <= size


@pytest.mark.parametrize("bounce", [0.0, 0.5])
def test_the_orbit_of_a_ball_at_rest_and_its_attractor(bounce):
    scene = ball(bounce=bounce)
    for start in (jv.State(0.0, 0.0, 0.0, -2.0), jv.State(1.0, 0.0)):
        orbit = jv.find_orbit(scene, start)
        assert (orbit.label, orbit.rests, orbit.stable) == ("P100", True, True)
        assert (orbit.state.x, orbit.state.v, orbit.state.contact) == STUCK
    (only,) = jv.find_attractors(scene, starts=40)
    assert (only.label, only.share, only.rests) == ("P100", 1.0, True)


def test_a_scene_without_a_drive_is_named_as_the_reason_why_there_is_no_orbit():
    free = jv.make_scene(amplitude=0.0, frequency=1.3, damping=0.0, restitution=1.0, walls=(0.0, None))
    for scene in (free, ball(bounce=1.0)):
        with pytest.raises(jv.OrbitError, match=r"the scene has no drive .*; a free motion repeats, if at all"):
            jv.find_orbit(scene, jv.State(1.0, 0.0))
    damped = jv.make_scene(amplitude=0.0, frequency=1.0, damping=0.1, walls=(None, None))
    orbit = jv.find_orbit(damped, jv.State(1.0, 0.0))
    assert orbit.label == "P100"
    assert abs(orbit.state.x) < 1e-40


def pulled(t, x, v, p):
    return p["a"] * jnp.cos(t) - x


@pytest.mark.parametrize(
    ("numbers", "driven"),
    [
        ({"damping": 0.1}, False),
        ({"damping": 0.1, "drive": ((1.0, 0, 0.0),)}, False),
        ({"force": jv.Force("duffing", {"cubic": 1.0, "damping": 0.1})}, False),
        ({"damping": 0.1, "amplitude": 1.0}, True),
        ({"damping": 0.1, "drive": ((1.0, 2, 0.0),)}, True),
        ({"damping": 0.1, "walls": (jv.Wall(-1.0, motion=jv.Motion(0.1)), None)}, True),
        ({"force": jv.Force(pulled, {"a": 1.0})}, True),
    ],
)
def test_forces_and_walls_that_depend_on_time_are_a_drive(numbers, driven):
    plain = {"amplitude": 0.0, "frequency": 1.0, "restitution": 0.5, "walls": (-1.0, None)}
    assert is_driven(jv.make_scene(**plain | numbers)) == driven

"""Scenes without a drive, without a spring, and with walls at 0: no length, speed or time of such a scene is 0."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mp, mpf

import jaxvibro as jv
from jaxvibro.scene.codes import Status
from jaxvibro.scene.typical_scales import is_driven

REST = -2.0  # contact of a mass that rests on the left wall
PERIOD = 2.0 * np.pi


def brake(t, x, v, p):
    """Weight, and drag by the square of the speed of a fall."""
    return -p["gravity"] + p["drag"] * v * v


def ball(c0=1.0, c1=0.0, damping=0.0, bounce=0.0, floor=0.0, frequency=1.0):
    """A mass above a floor, drawn to it by c0 + c1 x."""
    force = jv.Force("polynomial", {"c0": c0, "c1": c1, "damping": damping})
    return jv.make_scene(amplitude=0.0, frequency=frequency, restitution=bounce, walls=(floor, None), force=force)


def test_scenes_without_lanes_have_strobes_without_lanes():
    nothing = np.zeros(0)
    given = {"mass": 0.5, "stiffness": 100.0, "damping_ratio": 0.02, "frequency_hz": 2.0, "gap": 0.01}
    scene = jv.scene_from_physical(**given, force=nothing, restitution=0.7)
    assert jv.strobe(scene, jv.State(nothing, nothing))[0].x.shape == (0,)


def ended(scene, start):
    """((x, v, contact), impacts) after a drive period."""
    end, impacts = jax.device_get(jv.strobe(scene, start, slots=64))
    return (float(end.x), float(end.v), float(end.contact)), impacts


@pytest.mark.parametrize("numbers", [{}, {"c1": 0.1}, {"damping": 0.3}, {"c0": 1e-9, "c1": 1e-12}])
@pytest.mark.parametrize("floor", [0.0, -1.0, 2.0**-40])
@pytest.mark.parametrize("bounce", [0.0, 0.5, 1.0])
def test_a_mass_at_rest_on_a_floor_stays_there(numbers, floor, bounce):
    scene = ball(**numbers, bounce=bounce, floor=floor)
    for contact in (REST, -1.0, 0.0):
        end, impacts = ended(scene, jv.State(floor, 0.0, 0.0, contact))
        assert end == (floor, 0.0, REST)
        assert (impacts.status, impacts.count) == (Status.OK, 0)
        assert ended(scene, jv.State(*end[:2], 0.0, end[2]))[0] == end


@pytest.mark.parametrize("height", [1.0, 1e-6, 1e-100])
def test_a_plastic_impact_on_a_floor_at_0_ends_in_rest(height):
    end, impacts = ended(ball(), jv.State(height, 0.0))
    assert end == (0.0, 0.0, REST)
    assert (impacts.status, impacts.count) == (Status.OK, 1)
    assert impacts.time[0] == pytest.approx(np.sqrt(2.0 * height), rel=1e-15)
    assert impacts.speed[0] == pytest.approx(np.sqrt(2.0 * height), rel=1e-15)
    assert ended(ball(c1=0.1), jv.State(height, 0.0))[0] == (0.0, 0.0, REST)


@pytest.mark.parametrize(("height", "gravity", "drag"), [(1000.0, 10.0, 0.01), (100.0, 10.0, 0.1), (3.0, 1.0, 0.2)])
def test_a_brake_lands_and_rests(height, gravity, drag):
    force = jv.Force(brake, {"gravity": gravity, "drag": drag})
    scene = jv.make_scene(amplitude=0.0, frequency=0.1, restitution=0.0, walls=(0.0, None), force=force)
    end, impacts = ended(scene, jv.State(height, 0.0))
    assert (end, impacts.status, impacts.count) == ((0.0, 0.0, REST), Status.OK, 1)
    fall = np.exp(drag * height)  # cosh of the time of fall
    time = np.log(fall + np.sqrt((fall - 1.0) * (fall + 1.0))) / np.sqrt(gravity * drag)
    assert impacts.time[0] == pytest.approx(time, rel=1e-13)
    speed = np.sqrt(gravity / drag * -np.expm1(-2.0 * drag * height))
    assert impacts.speed[0] == pytest.approx(speed, rel=1e-13)


def hits(gravity, height, bounce, count):
    """(times, speeds) of the bounces of a ball that is dropped, to 40 digits."""
    with mp.workdps(40):
        gravity, height, bounce = mpf(gravity), mpf(height), mpf(bounce)
        speed = mp.sqrt(2 * gravity * height)
        times, speeds = [speed / gravity], [speed]
        for _ in range(count - 1):
            speeds.append(bounce * speeds[-1])
            times.append(times[-1] + 2 * speeds[-1] / gravity)
        return times, speeds


@pytest.mark.parametrize(
    ("gravity", "height", "bounce", "frequency"),
    [(1.0, 1.0, 0.5, 3.0), (9.81, 2.0, 0.9, 3.0), (2.0**-20, 2.0**-20, 0.9, 3.0), (1.0, 1.0, 1.0, 1.0)],
)
def test_bounces_are_those_of_the_closed_form(gravity, height, bounce, frequency):
    scene, state = ball(c0=gravity, bounce=bounce, frequency=frequency), jv.State(height, 0.0)
    length, late, speeds, status = 2.0 * np.pi / frequency, [], [], Status.OK
    for k in range(20):
        state, impacts = jax.device_get(jv.strobe(scene, state, slots=64))
        late += [mpf(k * length) + mpf(float(time)) for time in impacts.time[: impacts.count]]
        speeds += impacts.speed[: impacts.count].tolist()
        status = max(status, impacts.status)
        if abs(state.contact) == 2:
            break
    times, exact = hits(gravity, height, bounce, len(late))
    assert len(late) >= 10 if bounce > 0.5 else len(late) >= 3
    assert max(abs(a - b) for a, b in zip(late, times, strict=True)) <= 1e-13 * times[0]
    assert max(abs(a - b) for a, b in zip(speeds, exact, strict=True)) <= 1e-13 * exact[0]
    if bounce < 1.0:
        assert (float(state.x), float(state.v), float(state.contact)) == (0.0, 0.0, REST)
        assert status == Status.FULL


def test_a_thousand_bounces_lose_a_few_roundings_of_the_time_that_is_gone():
    for bounce, near in ((0.99, 2e-12), (0.999, 4e-12), (1.0, 2e-12)):
        scene, state = ball(c0=9.81, bounce=bounce, frequency=0.7), jv.State(2.0, 0.0)
        length, late, speeds = 2.0 * np.pi / 0.7, [], []
        for k in range(200):
            state, impacts = jax.device_get(jv.strobe(scene, state, slots=1000))
            late += [mpf(k * length) + mpf(float(time)) for time in impacts.time[: impacts.count]]
            speeds += impacts.speed[: impacts.count].tolist()
            if len(late) >= 1000 or abs(state.contact) == 2:
                break
        times, exact = hits(9.81, 2.0, bounce, len(late))
        assert max(abs(a - b) for a, b in zip(late, times, strict=True)) <= near * times[0]
        assert max(abs(a - b) for a, b in zip(speeds, exact, strict=True)) <= 1e-14 * exact[0]


def three_bounces(numbers):
    """Times and speeds of three bounces, and the state at the end; of (height, speed, gravity, R, floor)."""
    height, speed, gravity, bounce, floor = numbers
    end, impacts = jv.strobe(ball(c0=gravity, bounce=bounce, floor=floor), jv.State(floor + height, speed))
    return jnp.concatenate([impacts.time[:3], impacts.speed[:3], jnp.stack([end.x, end.v])])


def three_bounces_exactly(numbers):
    height, speed, gravity, bounce, floor = numbers
    speeds = [jnp.sqrt(speed * speed + 2.0 * gravity * height)]
    times = [(speed + speeds[0]) / gravity]
    for _ in range(2):
        speeds.append(bounce * speeds[-1])
        times.append(times[-1] + 2.0 * speeds[-1] / gravity)
    late, away = PERIOD - times[-1], bounce * speeds[-1]
    end = [floor + away * late - 0.5 * gravity * late * late, away - gravity * late]
    return jnp.stack([*times, *speeds, *end])


@pytest.mark.parametrize(
    "numbers", [(0.6, -0.2, 0.7, 0.85, 0.0), (1.2, 0.1, 1.0, 0.8, 0.0), (0.6, -0.2, 0.7, 0.85, -1.0)]
)
def test_derivatives_of_bounces_are_those_of_the_closed_form(numbers):
    numbers = jnp.array(numbers)
    found, exact = jax.jacfwd(three_bounces)(numbers), jax.jacfwd(three_bounces_exactly)(numbers)
    assert abs(three_bounces(numbers) - three_bounces_exactly(numbers)).max() <= 1e-13
    assert abs(found - exact).max() <= 1e-9 * abs(exact).max()


def test_a_mass_at_rest_forgets_its_start_but_moves_with_its_floor():
    def end(numbers):
        start = jv.State(numbers[2] + numbers[0], numbers[1])
        found = jv.strobe(ball(bounce=0.0, floor=numbers[2]), start)[0]
        return jnp.stack([found.x, found.v])

    assert jax.jacfwd(end)(jnp.array([1.0, 0.0, 0.0])).tolist() == [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]


@pytest.mark.parametrize("bounce", [0.0, 0.5])
def test_strobe_sample_and_simulate_agree_on_a_ball_that_comes_to_rest(bounce):
    scene, start = ball(bounce=bounce), jv.State(0.7, 0.0)
    end, impacts = jax.device_get(jv.strobe(scene, start, slots=64))
    times = np.arange(9) * (PERIOD / 8)
    states, status = jv.sample(scene, start, times)
    path = jv.simulate(scene, start, samples=8)
    assert int(status) == Status.OK
    assert np.asarray(states.x) == pytest.approx(path.x.values, abs=1e-15)
    assert (float(states.x[-1]), float(states.v[-1]), float(states.contact[-1])) == (end.x, end.v, end.contact)
    assert (path.x.values[-1], path.v.values[-1]) == (0.0, 0.0)
    count = int(impacts.count)  # hops are recorded until rest is certain; that is later where more stops are made
    assert path.sizes["impact"] >= count
    assert path.impact_time.values[:count] == pytest.approx(impacts.time[:count], rel=1e-14)
    assert path.speed.values[:count] == pytest.approx(impacts.speed[:count], rel=1e-14)
    after = np.asarray(states.x)[times > np.sqrt(1.4) * (1.0 + bounce) / (1.0 - bounce)]
    assert len(after)
    assert not after.any()


@pytest.mark.parametrize("steep", [1e4, 1e6])
def test_a_force_that_turns_away_from_the_floor_lets_a_fast_mass_escape(steep):
    scene = ball(c1=-steep, bounce=0.5, frequency=50.0)
    barrier = steep**-0.5  # speed with which a mass on the floor comes to the place where the force turns
    for part, escapes in ((0.9, False), (1.1, True), (3.0, True)):
        (x, v, contact), impacts = ended(scene, jv.State(1e-12, -2.0 * part * barrier))
        assert impacts.status <= Status.FULL
        assert (v > 0.0) == escapes
        assert (x, v, contact) == (0.0, 0.0, REST) or escapes


def test_complete_chatter_has_status_full_and_a_least_speed_of_0():
    impacts = ended(ball(bounce=0.5), jv.State(0.1, 0.0))[1]
    assert impacts.status == Status.FULL
    assert impacts.count < 64
    assert impacts.least_speed == 0.0
    fewer = ended(ball(bounce=1.0), jv.State(1e-4, 0.0))[1]
    assert fewer.status == Status.FULL
    assert fewer.count > 64
    assert fewer.least_speed > 0.0


def test_a_motion_below_the_smallest_length_is_at_rest():
    scene = jv.make_scene(amplitude=0.0, frequency=1.0, damping=0.3, restitution=0.5, walls=(0.0, None))
    for size in (1e-110, 1e-123, 1e-140, 1e-300):
        end, impacts = ended(scene, jv.State(size, -size))
        assert impacts.status == Status.OK
        assert max(map(abs, end[:2])) <= size


@pytest.mark.parametrize("bounce", [0.0, 0.5])
def test_the_orbit_of_a_ball_at_rest_and_its_attractor(bounce):
    scene = ball(bounce=bounce)
    for start in (jv.State(0.0, 0.0, 0.0, REST), jv.State(1.0, 0.0)):
        orbit = jv.find_orbit(scene, start)
        assert (orbit.label, orbit.rests, orbit.stable) == ("P100", True, True)
        assert (orbit.state.x, orbit.state.v, orbit.state.contact) == (0.0, 0.0, REST)
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


def test_forces_that_depend_on_time_are_a_drive():
    def pulled(t, x, v, p):
        return p["a"] * jnp.cos(t) - x

    plain = {"amplitude": 0.0, "frequency": 1.0, "restitution": 0.5, "walls": (-1.0, None)}

    def alone(**given):
        return is_driven(jv.make_scene(**plain | given))

    assert not alone(damping=0.1)
    assert not alone(damping=0.1, drive=((1.0, 0, 0.0),))
    assert not alone(force=jv.Force("duffing", {"cubic": 1.0, "damping": 0.1}))
    assert alone(damping=0.1, amplitude=1.0)
    assert alone(damping=0.1, drive=((1.0, 2, 0.0),))
    assert alone(damping=0.1, walls=(jv.Wall(-1.0, motion=jv.Motion(0.1)), None))
    assert alone(force=jv.Force(pulled, {"a": 1.0}))

"""Orbits and hystereses as functions of their scenes: against closed forms, and orbits found again."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import diff, mpf, pi, quad, sin, workdps

import jaxvibro as jv
from tests.reference import closed

GAMMA, OMEGA, R = 0.05, 2.1, 0.7
OK, JUMPED, VIRTUAL, NONE = jv.SolutionStatus


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.0, 1.0))


@pytest.fixture(scope="module")
def orbit(scene):
    return jv.find_orbit(scene, jv.State(0.9, -1.1))


def hitting(amplitude, damping):
    """P111 in closed form: of the two that there are the faster, which is the stable one."""
    found = closed.orbits(damping, OMEGA, amplitude, R, 1.0, symmetric=True)
    return max(found, key=lambda one: one.speed)


def test_speeds_and_multipliers_are_those_of_the_closed_form(scene, orbit):
    speeds, multipliers = jv.located(orbit, "speeds"), jv.located(orbit, "multipliers")
    with workdps(40):
        there = hitting(2.3, 0.08)
        speed = float(there.speed)
        slope = float(diff(lambda damping: hitting(2.3, damping).speed, mpf(0.08)))
        known = [complex(one) for one in closed.multipliers(0.08, OMEGA, 2.3, R, there, symmetric=True)]
    moved = scene.replace(amplitude=2.3, damping=0.08)
    assert np.asarray(speeds(moved)) == pytest.approx([speed, speed], rel=1e-13)
    assert np.asarray(jax.jacfwd(speeds)(moved).damping) == pytest.approx([slope, slope], rel=1e-11)
    assert sorted(np.asarray(multipliers(moved)), key=np.imag) == pytest.approx(sorted(known, key=np.imag), rel=1e-12)
    assert speeds.solve(moved).status == OK


def test_the_peak_of_a_motion_without_impacts(scene):
    free = jv.find_orbit(scene, jv.State(-0.585, 0.03))
    peak = jv.located(free, "peak")

    def known(frequency, damping):
        return 2.0 / jnp.hypot(1.0 - frequency**2, 2.0 * damping * frequency)

    def mine(frequency, damping):
        return peak(scene.replace(frequency=frequency, damping=damping))

    at = 2.2, 0.1
    assert float(mine(*at)) == pytest.approx(float(known(*at)), rel=1e-14)
    slopes = [float(one) for one in jax.grad(known, (0, 1))(*at)]
    assert np.array(jax.grad(mine, (0, 1))(*at)) == pytest.approx(slopes, rel=1e-9)


@pytest.mark.parametrize(
    "wall, names",
    [
        (jv.Wall(0.3), ("damping", "frequency")),
        (jv.Wall(0.3, stiffness=40.0, damping=0.5), ("damping",)),
    ],
)
def test_a_peak_moves_as_that_of_orbits_found_again(wall, names):
    scene = jv.make_scene(2.0, 1.6, 0.1, R, (None, wall))
    orbit = jv.find_orbit(scene, jv.State(0.1, -1.0))
    peak, step = jv.located(orbit, "peak"), 1e-5
    assert orbit.impacts.count and float(peak(scene)) == pytest.approx(jv.peak(orbit), rel=1e-13)
    slope = jax.grad(peak)(scene)
    for name in names:
        ends = [scene.replace(**{name: float(scene.parameter(name)) + way}) for way in (step, -step)]
        up, down = (jv.peak(jv.find_orbit(end, orbit.state)) for end in ends)
        assert float(slope.parameter(name)) == pytest.approx((up - down) / (2.0 * step), abs=1e-7), name


def test_lanes_under_jit_and_what_is_not_there(scene, orbit):
    speeds = jv.located(orbit, "speeds")
    amplitudes = jnp.array([0.6, 1.0, 2.0, 3.0])
    found = jax.jit(jax.vmap(lambda amplitude: speeds(scene.replace(amplitude=amplitude))))(amplitudes)
    for amplitude, speed in zip(amplitudes, found[:, 0], strict=True):
        with workdps(30):
            assert float(speed) == pytest.approx(float(hitting(float(amplitude), GAMMA).speed), rel=1e-12)
    none = scene.replace(amplitude=0.3)
    assert speeds.solve(none).status == NONE and np.isnan(speeds(none)).all()


def test_width_and_area_of_a_hysteresis(scene, orbit):
    branch = jv.follow(orbit, "amplitude", (0.0, 3.45))
    grazing = jv.located(branch.points("GR")[0], wall="right")
    lower = jv.find_orbit(scene, jv.State(-0.585, 0.03))
    loop = jv.hysteresis(branch.points("SN")[0], grazing, (orbit, lower), lambda found: found.state.v)

    def ends(damping):
        return closed.fold(damping, OMEGA, R, 1.0, symmetric=True).amplitude, closed.grazing(damping, OMEGA, 1.0)

    def area(damping):
        first, last = ends(damping)

        def height(angle):
            amplitude = first + (last - first) * sin(angle) ** 2
            upper = closed.at_phase(damping, OMEGA, amplitude, hitting(amplitude, damping), 0, True)
            low = closed.forced(damping, OMEGA, amplitude, 0)
            return (upper[1] - low[1]) * (last - first) * sin(2 * angle)

        return quad(height, [0, pi / 4, pi / 2], method="gauss-legendre")

    with workdps(40):
        first, last = ends(0.06)
        size, step = area(0.06), mpf(10) ** -8
        slope = (area(0.06 + step) - area(0.06 - step)) / (2 * step)
        width = diff(lambda damping: ends(damping)[1] - ends(damping)[0], 0.06)
    found = loop.solve(scene.replace(damping=0.06))
    assert found.status == OK
    assert [float(found.first), float(found.last)] == pytest.approx([float(first), float(last)], rel=1e-12)
    assert float(found.area) == pytest.approx(float(size), rel=1e-12)

    def of_damping(damping):
        moved = scene.replace(damping=damping)
        return jnp.stack([loop.width(moved), loop.area(moved)])

    assert np.asarray(jax.jacfwd(of_damping)(0.06)) == pytest.approx([float(width), float(slope)], rel=1e-9)
    assert float(jax.grad(loop.width)(scene.replace(damping=0.06)).damping) == pytest.approx(float(width), rel=1e-9)


def test_what_may_not_be(scene, orbit):
    with pytest.raises(jv.ArgumentError, match="name: must be one of an orbit's multipliers, speeds, peak"):
        jv.located(orbit, "amplitude")
    with pytest.raises(jv.ArgumentError, match="wall: must be None for an orbit"):
        jv.located(orbit, "peak", wall="left")
    with pytest.raises(jv.ArgumentError, match="scene: must be a Scene with walls of the same kinds"):
        jv.located(orbit, "peak")(jv.make_scene(2.0, OMEGA, GAMMA, R, (None, 1.0)))
    (fold,) = jv.follow(orbit, "amplitude", (0.4, 2.1)).points("SN")
    (other,) = jv.follow(orbit, "damping", (0.0, 2.0)).points("SN")[:1]
    with pytest.raises(jv.ArgumentError, match="last: must be a point in the same parameter as `first`, amplitude"):
        jv.hysteresis(fold, other)
    with pytest.raises(jv.ArgumentError, match="orbits: must be given to `hysteresis` for an area"):
        jv.hysteresis(fold, fold).area(scene)
    with pytest.raises(jv.ArgumentError, match="orbits: must be a pair of Orbits or None"):
        jv.hysteresis(fold, fold, (orbit, None))

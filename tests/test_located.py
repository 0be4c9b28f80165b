"""Special points, orbits and hystereses as functions of their scenes: closed forms, lanes, input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import diff, mpf, pi, quad, sin, workdps

import jaxvibro as jv
from jaxvibro.loci.point_continuation import make_continued_point, value_gradient
from tests.reference import closed

GAMMA, OMEGA, R = 0.05, 2.1, 0.7
OK, JUMPED, VIRTUAL, NONE = jv.SolutionStatus


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.0, 1.0))


@pytest.fixture(scope="module")
def orbit(scene):
    return jv.find_orbit(scene, jv.State(0.9, -1.1))


@pytest.fixture(scope="module")
def branch(orbit):
    return jv.follow(orbit, "amplitude", (0.0, 6.0))


def test_the_fold_in_closed_form(branch):
    """A(SN) of P111, its gradient and its Hessian by frequency and damping, against differences of the closed form."""
    value = jv.located(branch.points("SN")[0])

    def computed(numbers):
        return value(branch.scene.replace(frequency=numbers[0], damping=numbers[1]))

    def exact(frequency, damping):
        return closed.fold(damping, frequency, R, 1.0, symmetric=True).amplitude

    with workdps(40):
        at = OMEGA + 0.2, GAMMA + 0.1
        slopes = [float(diff(exact, at, order)) for order in ((1, 0), (0, 1))]
        bends = [float(diff(exact, at, order)) for order in ((2, 0), (1, 1), (0, 2))]
        here = float(exact(*at))
    numbers = jnp.array(at)
    assert abs(computed(numbers) - here) < 1e-13
    assert jax.grad(computed)(numbers) == pytest.approx(slopes, rel=1e-12)
    found = jax.hessian(computed)(numbers)
    assert [found[0, 0], found[0, 1], found[1, 1]] == pytest.approx(bends, rel=1e-10)


def test_a_second_derivative_of_a_fold_of_many_impacts():
    """From six impacts on the sum of squares of the null vector was a product of matrices that did not compile."""
    scene = jv.make_scene(1.35349688252687, 0.5681284414825132, 0.2826473694985851, 0.49, (None, 0.7418688488025945))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.3, 0.1)), "restitution", (0.48, 0.495))
    (fold,) = (point for point in branch.points("SN") if point.label == "P106")
    value, at, step = jv.located(fold), float(scene.frequency), 1e-5
    slope = jax.grad(lambda frequency: value(fold.scene.replace(frequency=frequency)))
    near, far = (slope(at + k * step) - slope(at - k * step) for k in (1, 2))
    assert abs(jax.grad(slope)(at) - (8 * near - far) / (12 * step)) < 1e-8


def test_numbers_that_change_together_keep_the_symmetry(branch):
    (point,) = branch.points("SB")
    assert jv.sensitivity(point)["number"].values.tolist() == ["frequency", "damping", "restitution"]
    both = jv.sensitivity(point, [("left.restitution", "right.restitution"), "damping"])
    moved = jv.located(point).solve(point.scene.replace(**{"left.restitution": 0.7001, "right.restitution": 0.7001}))
    assert both["number"].values.tolist() == ["left.restitution = right.restitution", "damping"]
    assert float(both[0]) == pytest.approx((float(moved.value) - point.value) / 1e-4, rel=1e-3)
    with pytest.raises(jv.ArgumentError, match=r"^names: must keep the scene symmetric"):
        jv.sensitivity(point, "right.position")


def test_a_fold_that_is_continued_moves_as_its_sensitivity_says(branch):
    (point,), names = branch.points("SN"), ("damping", "frequency")
    gradient = value_gradient(make_continued_point(point, names))
    assert gradient == pytest.approx(jv.sensitivity(point, names).values, rel=1e-8)


def test_bad_arguments_of_a_sensitivity(branch):
    (point,) = branch.points("SN")
    for names in ((), ("amplitude",), ("damping", "damping"), ("size",)):
        with pytest.raises(jv.ArgumentError, match=r"^names|size"):
            jv.sensitivity(point, names)
    with pytest.raises(jv.ArgumentError, match=r"^special: must be a special point of kind SN, PD, SB, GR; got 'EP"):
        jv.sensitivity(branch.special[0], ("damping",))


def impacting(amplitude, damping):
    """P111 in closed form: of the two that there are the faster, which is the stable one."""
    found = closed.orbits(damping, OMEGA, amplitude, R, 1.0, symmetric=True)
    return max(found, key=lambda orbit: orbit.speed)


def test_speeds_and_multipliers_are_those_of_the_closed_form(scene, orbit):
    speeds, multipliers = jv.located(orbit, "speeds"), jv.located(orbit, "multipliers")
    with workdps(40):
        there = impacting(2.3, 0.08)
        speed = float(there.speed)
        slope = float(diff(lambda damping: impacting(2.3, damping).speed, mpf(0.08)))
        known = [complex(each) for each in closed.multipliers(0.08, OMEGA, 2.3, R, there, symmetric=True)]
    moved = scene.replace(amplitude=2.3, damping=0.08)
    assert np.asarray(speeds(moved)) == pytest.approx([speed, speed], rel=1e-13)
    assert np.asarray(jax.jacfwd(speeds)(moved).damping) == pytest.approx([slope, slope], rel=1e-11)
    assert sorted(np.asarray(multipliers(moved)), key=np.imag) == pytest.approx(sorted(known, key=np.imag), rel=1e-12)
    assert speeds.solve(moved).status == OK


def test_the_peak_of_a_motion_without_impacts(scene):
    peak = jv.located(jv.find_orbit(scene, jv.State(-0.585, 0.03)), "peak")

    def exact(frequency, damping):
        return 2.0 / jnp.hypot(1.0 - frequency**2, 2.0 * damping * frequency)

    def computed(frequency, damping):
        return peak(scene.replace(frequency=frequency, damping=damping))

    at = 2.2, 0.1
    assert float(computed(*at)) == pytest.approx(float(exact(*at)), rel=1e-14)
    slopes = [float(slope) for slope in jax.grad(exact, (0, 1))(*at)]
    assert np.array(jax.grad(computed, (0, 1))(*at)) == pytest.approx(slopes, rel=1e-9)


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


def test_lanes_under_jit_and_orbits_that_do_not_exist(scene, orbit):
    speeds = jv.located(orbit, "speeds")
    amplitudes = jnp.array([0.6, 1.0, 2.0, 3.0])
    found = jax.jit(jax.vmap(lambda amplitude: speeds(scene.replace(amplitude=amplitude))))(amplitudes)
    for amplitude, speed in zip(amplitudes, found[:, 0], strict=True):
        with workdps(30):
            assert float(speed) == pytest.approx(float(impacting(float(amplitude), GAMMA).speed), rel=1e-12)
    none = scene.replace(amplitude=0.3)
    assert speeds.solve(none).status == NONE and np.isnan(speeds(none)).all()


def test_width_and_area_of_a_hysteresis(scene, orbit, branch):
    grazing = jv.located(branch.points("GR")[0], wall="right")
    lower = jv.find_orbit(scene, jv.State(-0.585, 0.03))
    loop = jv.hysteresis(branch.points("SN")[0], grazing, (orbit, lower), lambda found: found.state.v)

    def ends(damping):
        return closed.fold(damping, OMEGA, R, 1.0, symmetric=True).amplitude, closed.grazing(damping, OMEGA, 1.0)

    def area(damping):
        first, last = ends(damping)

        def height(angle):
            amplitude = first + (last - first) * sin(angle) ** 2
            upper = closed.at_phase(damping, OMEGA, amplitude, impacting(amplitude, damping), 0, True)
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


def test_bad_arguments_of_located_and_hysteresis(scene, orbit, branch):
    (fold,), other = branch.points("SN"), jv.follow(orbit, "damping", (0.0, 2.0)).points("SN")[0]
    with pytest.raises(jv.ArgumentError, match="name: must be one of an orbit's multipliers, speeds, peak"):
        jv.located(orbit, "amplitude")
    with pytest.raises(jv.ArgumentError, match="wall: must be None for an orbit"):
        jv.located(orbit, "peak", wall="left")
    with pytest.raises(jv.ArgumentError, match="scene: must be a Scene with walls of the same kinds"):
        jv.located(orbit, "peak")(jv.make_scene(2.0, OMEGA, GAMMA, R, (None, 1.0)))
    with pytest.raises(jv.ArgumentError, match="last: must be a point in the same parameter as `first`, amplitude"):
        jv.hysteresis(fold, other)
    with pytest.raises(jv.ArgumentError, match="orbits: must be given to `hysteresis` for an area"):
        jv.hysteresis(fold, fold).area(scene)
    with pytest.raises(jv.ArgumentError, match="orbits: must be a pair of Orbits or None"):
        jv.hysteresis(fold, fold, (orbit, None))

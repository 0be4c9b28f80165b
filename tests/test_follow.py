"""Branches of the oscillator: special points against references in 40 digits, grazings, ends, switching, saving."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.problem.orbit_equations import diagnose
from jaxvibro.problem.orbit_problem import make_orbit_problem

from . import figure_4
from .figure_4 import GAMMA, OMEGA, R
from .reference import closed


@pytest.fixture(scope="module")
def orbit():
    return figure_4.orbit()


@pytest.fixture(scope="module")
def branch():
    return figure_4.branch()


@pytest.fixture(scope="module")
def asymmetric():
    return figure_4.asymmetric()


def kinds(branch):
    return [(one.kind, one.label) for one in branch.special]


def value(branch, kind):
    (one,) = branch.points(kind)
    return one.value


def test_branches_of_many_orbits_are_those_of_each(orbit, branch):
    other = jv.find_orbit(orbit.scene.replace(damping=0.06, amplitude=2.2), jv.State(0.9, -1.1))
    one, two = jv.follow_all([orbit, other], "amplitude", (0.0, 6.0))
    assert one.table() == branch.table()
    assert two.table() == jv.follow(other, "amplitude", (0.0, 6.0)).table() != one.table()
    assert (one.scene.damping, two.scene.damping) == (0.05, 0.06)
    with pytest.raises(jv.ArgumentError, match=r"^orbits: must be a list or tuple of at least one Orbit"):
        jv.follow_all([], "amplitude", (0.0, 6.0))
    stray = replace(orbit, scene=orbit.scene.replace(amplitude=2.5))
    with pytest.raises(jv.OrbitError, match="the start is not an orbit") as raised:
        jv.follow_all([orbit, stray], "amplitude", (0.0, 6.0))
    assert raised.value.__notes__ == ["raised for orbits[1]"]


def test_the_symmetric_branch(branch):
    assert kinds(branch) == [("EP", "P100"), ("GR", "P111"), ("SN", "P111"), ("SB", "P111"), ("EP", "P111")]
    with mpmath.workdps(30):
        fold = float(closed.fold(GAMMA, OMEGA, R, 1, symmetric=True).amplitude)
        touch = float(closed.grazing(GAMMA, OMEGA, 1))
    assert abs(value(branch, "SN") - fold) < 1e-13
    assert abs(value(branch, "GR") - touch) < 1e-13
    assert abs(value(branch, "SB") - 3.543892249375) < 1e-12
    assert [one.label for one in branch.segments] == ["P100", "P111"]
    assert branch.values[0] == 0.0 and branch.values[-1] == 6.0
    stable = (abs(branch.multipliers) < 1.0 - 1e-9).all(axis=1)
    assert np.array_equal(branch.stable, stable) and 0 < stable.sum() < len(branch)
    assert branch.reason == {
        "first": "the parameter reached its bound 0",
        "last": "the parameter reached its bound 6",
    }
    assert branch.table().splitlines()[2].split() == [
        "GR",
        "3.41646015636",
        "P111",
        *("stable", "to", "saddle"),
        "RL",
        "inf,",
        "inf",
        "P100<",
        "P111<",
        "jump",
        *("5.04874", "sqrt(depth),", "+0.292701", "a", "unit"),
    ]


def test_switching_and_passing_through_a_grazing(branch, asymmetric):
    assert sorted(one.segments[-1].label for one in asymmetric) == ["P112", "P121"]
    for one in asymmetric:
        twin = one.segments[-1].label
        assert [kind for kind, _ in kinds(one)] == ["EP", "GR", "SN", "PD", "EP"]
        assert [each.label for each in one.segments] == ["P111", twin]
        assert abs(value(one, "GR") - 5.304177743857) < 1e-12
        assert abs(value(one, "SN") - 4.525079701581) < 1e-12
        assert abs(value(one, "PD") - 4.787450372300) < 1e-12
        (grazing,) = one.points("GR")
        assert sorted(each.label for each in grazing.meets) == ["P111", twin]
        assert all(each.scene.amplitude < grazing.value for each in grazing.meets)
        new = next(each for each in grazing.meets if each.label == twin)
        # the speed and the multiplier near it: paper.md, section 6
        assert abs(abs(new.multipliers[0]) * new.least_speed - 5.57) < 0.01
        assert grazing.residual < 1e-12
    up, down = asymmetric
    assert up.reasons[0] == f"it left SB at {branch.points('SB')[0].value:.12g}"
    assert repr(up) == f"Branch(amplitude from 3.54389 to 6, {len(up)} points, EP GR SN PD EP)"
    assert not up.points("SN")[0].orbit.stable and not up.stable[0]
    assert np.isinf(branch.points("GR")[0].orbit.multipliers).all()
    assert np.allclose(up.values, down.values, rtol=0, atol=1e-8)


def test_a_monitor_a_stop_and_a_direction(orbit):
    seen = {"half": lambda point: point.x[0] - 0.5, "slow": lambda point: point.speeds.min() - 1.0}
    one = jv.follow(orbit, "amplitude", (0.0, 6.0), direction="backward", monitors=seen, stop="slow")
    assert kinds(one)[0] == ("slow", "P111") and kinds(one)[-1] == ("EP", "P111")
    (half,), (slow,) = one.points("half"), one.points("slow")
    assert abs(half.spot.x - 0.5) < 1e-12 and abs(slow.spot.speeds.min() - 1.0) < 1e-12
    assert one.reason == {"first": f"stopped at slow, {slow.value:.12g}", "last": "the start"}
    assert one.values[-1] == 2.0


def test_a_file_is_not_overwritten_and_one_that_is_no_branch_is_refused(branch, tmp_path):
    branch.save(tmp_path / "branch.nc")
    with pytest.raises(FileExistsError):
        branch.save(tmp_path / "branch.nc")
    (tmp_path / "bad.nc").write_bytes(b"CDF nothing")
    with pytest.raises(jv.ArgumentError, match=r"^path: must be a NetCDF file"):
        jv.load_branch(tmp_path / "bad.nc")


def test_steps_and_tolerance_do_not_matter(branch, orbit):
    for first, largest, tolerance in ((0.05, 0.05, 1e-8), (1.0, 1.0, 1e-13), (0.05, 0.5, 1e-9)):
        one = jv.follow(orbit, "amplitude", (0.0, 6.0), "both", first, largest, tolerance)
        assert kinds(one) == kinds(branch)
        assert np.allclose([a.value for a in one.special], [a.value for a in branch.special], rtol=0, atol=1e-12)


def test_what_cannot_be_followed_is_refused(orbit, branch):
    fast = {"fast": lambda point: point.speeds.max() - 9.0}  # there is none without impacts
    for change, refusal in (
        ({"name": "stiffness"}, r"^stiffness: is not a parameter of this scene"),
        *(({"bounds": bounds}, r"^bounds: must ") for bounds in ((3.0, 6.0), (6.0, 0.0), (0.0, np.nan), 3.0)),
        ({"direction": "up"}, r"^direction: must be one of both, forward, backward"),
        ({"largest_step": 0.0}, r"^largest_step: must be a positive number"),
        ({"orbit": orbit.state}, r"^orbit: must be an Orbit"),
        ({"direction": "backward", "monitors": fast}, r"^monitors.fast: must return a number at every point"),
    ):
        with pytest.raises(jv.ArgumentError, match=refusal):
            jv.follow(**({"orbit": orbit, "name": "amplitude", "bounds": (0.0, 6.0)} | change))
    other = replace(branch.orbit(-1), scene=orbit.scene)
    with pytest.raises(jv.OrbitError, match=r"the start is not an orbit \(residual [0-9.e+-]+\)"):
        jv.follow(other, "amplitude", (0.0, 6.0))
    with pytest.raises(jv.ArgumentError, match=r"^special: must be of kind SB, BP, PD, GR"):
        jv.switch(branch.points("SN")[0])
    with pytest.raises(jv.ArgumentError, match=r"^bounds: must contain the branch's own"):
        jv.extend(branch, (1.0, 6.0))


def test_clearances_see_a_short_hop():
    """A flight that leaves slowly, falls back, passes the wall and turns, all within one of the samples' cells."""
    for speed in (1e-3, 1e-2, 0.05, 0.2):
        scene = jv.make_scene(1.0, 1.0, 0.02, 0.1, (None, 0.0))
        still = make_orbit_problem(scene, "amplitude", periods=1), np.array([0.0, 0.0, 1.0])
        problem, z = still[0].with_impacts(still[1], [(0.3, speed, 1.0)])
        seen = diagnose(problem, z[None])
        _, impacts = jv.strobe(scene, jv.State(0.0, -0.1 * speed, 0.3, 1.0), 1, 8)
        assert (impacts.time[0] < 6.0) == (seen.clearance.min() < 0)


def test_a_cascade_of_doublings(asymmetric):
    values = []
    (first,) = (one for one in asymmetric if one.segments[-1].label == "P112")
    (point,) = first.points("PD")
    for label in ("P112", "P224", "P448", "P8-8-16"):
        assert point.label == label
        values.append(point.value)
        (doubled,) = jv.switch(point, stop="PD")
        (point,) = doubled.points("PD")
    assert np.allclose(values[:2], [4.787450372300, 4.929889076576], rtol=0, atol=1e-11)
    ratios = np.diff(values)[:-1] / np.diff(values)[1:]
    assert np.allclose(ratios, [5.894322, 4.648941], rtol=0, atol=1e-5)


# (amplitude, frequency, damping, restitution), walls, state, bounds
BACK = {
    "a sharp turn": (  # a step of 0.1 once led to another branch
        (2.48299889, 0.90275811, 0.2033876, 0.71709371),
        (-0.44174891, jv.Wall(0.43310777, None, motion=jv.Motion(0.08727396, 1.16054328))),
        (0.2177246, -0.0025649),
        (1.0415, 4.7694),
    ),
    "a short piece": (  # an exit from a grazing was once missed on the way back
        (4.7154301, 2.08888252, 0.88295762, 0.59638251),
        (jv.Wall(-0.44342655, 0.34285064), 1.14221593),
        (0.0496024, 1.5237424),
        (2.1577, 8.7878),
    ),
}


@pytest.mark.parametrize("name", BACK)
def test_a_branch_goes_back_by_the_way_it_came(name):
    numbers, walls, state, bounds = BACK[name]
    orbit = jv.find_orbit(jv.make_scene(*numbers, walls), jv.State(*state))
    branch = jv.follow(orbit, "amplitude", bounds, "forward")
    back = jv.follow(branch.orbit(len(branch) - 2), "amplitude", bounds, largest_step=0.07)
    met, again = ([one.value for one in each.special if one.kind != "EP"] for each in (branch, back))
    for rest in [one.value for one in branch.points("CH")]:  # next to it some of infinitely many are left out
        assert min(abs(rest - other) for other in again) < 1e-9
        met = [value for value in met if abs(value - rest) > 5e-4]
    assert len(met) > 3
    assert max(min(abs(value - other) for other in again) for value in met) < 1e-9

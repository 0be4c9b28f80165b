"""Branches of the oscillator: special points against references in 40 digits, grazings, ends, switching, saving."""

from dataclasses import replace

import mpmath
import numpy as np
import pytest

import jaxvibro as jv
from continuation import augmented_systems
from jaxvibro.branches import switch
from jaxvibro.branches.follow import set_up_equations
from jaxvibro.problem.orbit_diagnostics import diagnose
from jaxvibro.problem.orbit_equations import continuation_problem
from jaxvibro.problem.orbit_point import OrbitPoint
from tests.reference import closed

GAMMA, OMEGA, R = 0.05, 2.1, 0.7


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.0, 1.0))


@pytest.fixture(scope="module")
def orbit(scene):
    return jv.find_orbit(scene, jv.State(0.9, -1.1))


@pytest.fixture(scope="module")
def branch(orbit):
    return jv.follow(orbit, "amplitude", (0.0, 6.0))


@pytest.fixture(scope="module")
def lopsided(branch):
    return jv.switch(branch.points("SB")[0])


def kinds(branch):
    return [(one.kind, one.label) for one in branch.special]


def test_branches_of_many_orbits_are_those_of_each(scene, orbit, branch):
    other = jv.find_orbit(scene.replace(damping=0.06, amplitude=2.2), jv.State(0.9, -1.1))
    one, two = jv.follow_all([orbit, other], "amplitude", (0.0, 6.0))
    assert one.table() == branch.table()
    assert two.table() == jv.follow(other, "amplitude", (0.0, 6.0)).table() != one.table()
    assert (one.scene.damping, two.scene.damping) == (0.05, 0.06)


def test_an_orbit_among_many_that_is_none_is_told(scene, orbit):
    with pytest.raises(jv.ArgumentError, match=r"^orbits: must be a list or tuple of at least one Orbit"):
        jv.follow_all([], "amplitude", (0.0, 6.0))
    with pytest.raises(jv.ArgumentError, match=r"^orbits\[1\]: must be an Orbit"):
        jv.follow_all([orbit, scene], "amplitude", (0.0, 6.0))
    stray = replace(orbit, scene=scene.replace(amplitude=2.5))
    with pytest.raises(jv.OrbitError, match="the start is not an orbit") as raised:
        jv.follow_all([orbit, stray], "amplitude", (0.0, 6.0))
    assert raised.value.__notes__ == ["raised for orbits[1]"]


def value(branch, kind):
    (one,) = branch.points(kind)
    return one.value


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


def test_switching_and_passing_through_a_grazing(branch, lopsided):
    assert sorted(one.segments[-1].label for one in lopsided) == ["P112", "P121"]
    for one in lopsided:
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
    up, down = lopsided
    assert up.reasons[0] == f"it left SB at {branch.points('SB')[0].value:.12g}"
    assert repr(up) == f"Branch(amplitude from 3.54389 to 6, {len(up)} points, EP GR SN PD EP)"
    assert not up.points("SN")[0].orbit.stable and not up.stable[0]
    assert np.isinf(branch.points("GR")[0].orbit.multipliers).all()
    assert np.allclose(up.values, down.values, rtol=0, atol=1e-8)


def test_a_doubled_orbit_begins_along_a_null_vector_of_its_equations(lopsided):
    """Of those of the orbit gone through twice; its halves move apart."""
    ((along, begun),) = switch.branch_starts(lopsided[0].points("PD")[0])
    slopes = augmented_systems.jacobian_at(continuation_problem(along), begun.z, along)
    rows, count = len(along.sequence.sides), len(along.impact_rows)
    assert abs(slopes @ begun.tangent).max() < 1e-8 * abs(slopes).max() and begun.tangent[-1] == 0.0
    first, second = begun.tangent[:count].reshape(2, -1)
    assert np.array_equal(first, -second) and abs(first).max() > 1e-3 and count == 6 and rows == 8


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
    with pytest.raises(jv.ArgumentError, match=r"^stiffness: is not a parameter of this scene"):
        jv.follow(orbit, "stiffness", (0.0, 1.0))
    for bounds in ((3.0, 6.0), (6.0, 0.0), (0.0, np.nan), 3.0):
        with pytest.raises(jv.ArgumentError, match=r"^bounds: must "):
            jv.follow(orbit, "amplitude", bounds)
    with pytest.raises(jv.ArgumentError, match=r"^direction: must be one of both, forward, backward"):
        jv.follow(orbit, "amplitude", (0.0, 6.0), direction="up")
    with pytest.raises(jv.ArgumentError, match=r"^largest_step: must be a positive number"):
        jv.follow(orbit, "amplitude", (0.0, 6.0), largest_step=0.0)
    with pytest.raises(jv.ArgumentError, match=r"^orbit: must be an Orbit"):
        jv.follow(orbit.state, "amplitude", (0.0, 6.0))
    other = jv.Branch.orbit(branch, -1)
    object.__setattr__(other, "scene", orbit.scene)
    with pytest.raises(jv.OrbitError, match=r"the start is not an orbit \(residual [0-9.e+-]+\)"):
        jv.follow(other, "amplitude", (0.0, 6.0))
    with pytest.raises(jv.ArgumentError, match=r"^monitors.fast: must return a number at every point"):
        jv.follow(orbit, "amplitude", (0.0, 6.0), "backward", monitors={"fast": lambda point: point.speeds.max() - 9.0})
    with pytest.raises(jv.ArgumentError, match=r"^special: must be of kind SB, BP, PD, GR"):
        jv.switch(branch.points("SN")[0])
    with pytest.raises(jv.ArgumentError, match=r"^bounds: must contain the branch's own"):
        jv.extend(branch, (1.0, 6.0))


def test_a_parameter_ends_at_its_domain(orbit):
    one = jv.follow(orbit, "damping", (-1.0, 0.1))
    assert one.values.min() == 0.0 and "the parameter's domain ends at 0" in one.reasons


def test_clearances_see_a_short_hop():
    """A flight that leaves slowly, falls back, passes the wall and turns, all within one of the samples' cells."""
    for speed in (1e-3, 1e-2, 0.05, 0.2):
        scene = jv.make_scene(1.0, 1.0, 0.02, 0.1, (None, 0.0))
        spot = OrbitPoint(1.0, np.array([0.3]), np.array([speed]), np.array([1.0]), 1, 0.0, 0.0, 0.0)
        seen = diagnose(*(each for each in _single(scene, spot)))
        _, impacts = jv.strobe(scene, jv.State(0.0, -0.1 * speed, 0.3, 1.0), 1, 8)
        assert (impacts.time[0] < 6.0) == (seen.clearance.min() < 0)


def _single(scene, spot):
    along, z = set_up_equations(scene, "amplitude", spot)
    return along, z[None]


def test_a_cascade_of_doublings(lopsided):
    values, labels = [], []
    (first,) = (one for one in lopsided if one.segments[-1].label == "P112")
    (point,) = first.points("PD")
    for label in ("P112", "P224", "P448", "P8-8-16"):
        labels.append((point.label, label))
        values.append(point.value)
        (doubled,) = jv.switch(point, stop="PD")
        (point,) = doubled.points("PD")
    assert all(a == b for a, b in labels)
    assert np.allclose(values[:2], [4.787450372300, 4.929889076576], rtol=0, atol=1e-11)
    ratios = np.diff(values)[:-1] / np.diff(values)[1:]
    assert np.allclose(ratios, [5.894322, 4.648941], rtol=0, atol=1e-5)


BACK = {  # a step of 0.1 once led to another branch; an exit from a grazing was once missed on the way back
    "a sharp turn": ((2.48299889, 0.90275811, 0.2033876, 0.71709371), (0.2177246, -0.0025649), (1.0415, 4.7694)),
    "a short piece": ((4.7154301, 2.08888252, 0.88295762, 0.59638251), (0.0496024, 1.5237424), (2.1577, 8.7878)),
}
WALLS = {
    "a sharp turn": (-0.44174891, jv.Wall(0.43310777, None, motion=jv.Motion(0.08727396, 1.16054328))),
    "a short piece": (jv.Wall(-0.44342655, 0.34285064), 1.14221593),
}


@pytest.mark.parametrize("name", BACK)
def test_a_branch_goes_back_by_the_way_it_came(name):
    numbers, state, bounds = BACK[name]
    scene = jv.make_scene(*numbers, WALLS[name])
    branch = jv.follow(jv.find_orbit(scene, jv.State(*state)), "amplitude", bounds, "forward")
    back = jv.follow(branch.orbit(len(branch) - 2), "amplitude", bounds, largest_step=0.07)
    met = [[one.value for one in each.special if one.kind != "EP"] for each in (branch, back)]
    for rest in [one.value for one in branch.points("CH")]:  # next to it some of infinitely many are left out
        assert min(abs(rest - other) for other in met[1]) < 1e-9
        met[0] = [value for value in met[0] if abs(value - rest) > 5e-4]
    assert len(met[0]) > 3
    assert max(min(abs(value - other) for other in met[1]) for value in met[0]) < 1e-9

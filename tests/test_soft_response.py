"""Soft walls: the largest x, how folds and grazings move, and figure 10 of the paper, against closed forms."""

import mpmath as mp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.loci.point_continuation import continue_to_values, make_continued_point
from jaxvibro.reproduction import special_point_fitting
from jaxvibro.scene.scene import harden_wall
from tests.reference import compliant

A, GAMMA, GAMMA2 = 0.3, 0.076, 0.1
NAMES = ("amplitude", "damping", ("left.damping", "right.damping"))
NEAR = {10: (1.48, 0.96, 1.3, 0.9), 50: (1.74, 1.1, 1.2, 0.43)}  # the folds: frequency, phase, speed, stay


def scene(k2, frequency=1.3):
    walls = (jv.Wall(side, stiffness=k2, damping=GAMMA2) for side in (-1.0, 1.0))
    return jv.make_scene(A, frequency, GAMMA, 0.7, tuple(walls))


def hitting(k2):
    orbit = jv.find_orbit(scene(k2), jv.State(0.9, -1.1), periods=1, itinerary=("RL",))
    return jv.follow(orbit, "frequency", (0.5, 2.0), stop="GR")


@pytest.fixture(scope="module")
def branches():
    return {k2: hitting(k2) for k2 in NEAR}


@pytest.fixture(scope="module")
def free():
    orbit = jv.find_orbit(scene(10, 1.5), jv.State(0.0, 0.0), periods=1)
    return jv.follow(orbit, "frequency", (0.5, 2.0), "backward", stop="GR")


def fold(branch):
    return max(branch.points("SN"), key=lambda one: one.value)


def exact_fold(k2, amplitude, gamma, gamma2, near=None):
    with mp.workdps(34):
        return float(compliant.fold((amplitude, gamma, gamma2, k2), *map(mp.mpf, near or NEAR[k2])))


def test_the_largest_x_without_impacts_is_the_closed_form(free):
    w = free.values
    assert jv.peaks(free) == pytest.approx(A / np.hypot(1 - w**2, 2 * GAMMA * w), rel=1e-13)
    assert jv.peak(free.orbit(3)) == pytest.approx(jv.peaks(free)[3], rel=1e-14)


@pytest.mark.parametrize("k2", NEAR)
def test_the_largest_x_within_a_wall_is_the_reference(branches, k2):
    branch = branches[k2]
    found = jv.peaks(branch)
    for place in range(3, len(branch) - 3, 25):
        row = branch.data.isel(point=place)
        w, side = float(branch.values[place]), row["side"].values
        right = int(np.flatnonzero(side == 1)[0])
        theta, u = w * float(row["time"][right]), float(row["speed"][right])
        with mp.workdps(30):
            exact = compliant.height((A, GAMMA, GAMMA2, k2), mp.mpf(w), mp.mpf(theta), mp.mpf(u))
        assert found[place] == pytest.approx(float(exact), rel=1e-12)
        assert jv.peak(branch.orbit(place)) == pytest.approx(found[place], rel=1e-12)


def test_the_largest_x_between_rigid_walls_is_theirs():
    walls = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.5, 1.0))
    orbit = jv.find_orbit(walls, jv.State(0.9, -1.1))
    seen = abs(jv.simulate(walls, orbit.state, orbit.periods, 4000)["x"].values).max()
    assert jv.peak(orbit) == pytest.approx(1.5, abs=1e-12) and seen <= 1.5


@pytest.mark.parametrize("k2", NEAR)
def test_folds_move_as_differences_of_the_reference_say(branches, k2):
    numbers, step = (A, GAMMA, GAMMA2), 1e-5
    found = jv.sensitivity(fold(branches[k2]), NAMES).values
    for k, slope in enumerate(found):
        ends = [exact_fold(k2, *(one + sign * step * (j == k) for j, one in enumerate(numbers))) for sign in (1, -1)]
        assert slope == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-7)


def by_hardness(decades):
    """The fold where both walls are so much harder than k2 = 10."""
    k2, gamma2 = harden_wall(10, GAMMA2, decades)
    return exact_fold(k2, A, GAMMA, gamma2, NEAR[10])


def test_a_fold_moves_with_the_hardness_as_differences_of_the_reference_say(branches):
    point, step = fold(branches[10]), 1e-5
    slope, by_amplitude = jv.sensitivity(point, ("hardness", "amplitude")).values
    assert slope == pytest.approx((by_hardness(step) - by_hardness(-step)) / (2 * step), rel=1e-7)
    assert by_amplitude == pytest.approx(float(jv.sensitivity(point, NAMES)[0]), rel=1e-11)
    harder, share = continue_to_values(make_continued_point(point, ("hardness",)), [1.05])
    assert share == 1.0 and harder.value == pytest.approx(by_hardness(0.05), abs=1e-12)
    with pytest.raises(jv.ArgumentError, match=r"^names: must not contain the hardness together"):
        jv.sensitivity(point, ("hardness", "left.stiffness"))


def test_a_fold_along_the_hardness_moves_with_the_frequency(branches):
    near = branches[10].orbit(fold(branches[10]).place - 2)
    (point,) = jv.follow(near, "hardness", (0.8, 1.2), "backward", stop="SN").points("SN")
    decades, step = point.value - 1.0, 1e-5
    assert by_hardness(decades) == pytest.approx(float(near.scene.frequency), abs=1e-12)
    slope = (by_hardness(decades + step) - by_hardness(decades - step)) / (2 * step)
    assert float(jv.sensitivity(point, ("frequency",))[0]) == pytest.approx(1.0 / slope, rel=1e-7)


def test_a_grazing_moves_as_the_closed_form(free):
    (graze,) = free.points("GR")
    step = 1e-6
    by_amplitude = compliant.grazing(A + step, GAMMA) - compliant.grazing(A - step, GAMMA)
    by_damping = compliant.grazing(A, GAMMA + step) - compliant.grazing(A, GAMMA - step)
    expected = [float(one) / (2 * step) for one in (by_amplitude, by_damping)] + [0.0]
    assert jv.sensitivity(graze, NAMES).values == pytest.approx(expected, abs=1e-8)
    point, share = continue_to_values(make_continued_point(graze, NAMES), [0.4, 0.05, 0.1])
    assert share == 1.0 and point.value == pytest.approx(float(compliant.grazing(0.4, 0.05)), abs=1e-13)


def test_figure_10_fitted_is_the_reference_to_ten_digits(branches, free):
    folds, (graze,) = [fold(one) for one in branches.values()], free.points("GR")
    both = special_point_fitting.fit_parameters(
        [make_continued_point(one, ("damping",)) for one in folds], [1.48, 1.74], [0.05], 0.0, 0.5
    )
    assert both.converged and both.values[0] == pytest.approx(0.0761074934, abs=1e-9)
    assert abs(both.jacobian.T @ both.misfits).max() < 1e-12
    for k2, one in zip(NEAR, both.points, strict=True):
        assert one.value == pytest.approx(exact_fold(k2, A, both.values[0], GAMMA2), abs=1e-10)
    points = [make_continued_point(one, NAMES) for one in (*folds, graze)]
    three = special_point_fitting.fit_parameters(
        points, [1.48, 1.74, 1.18], (0.45, 0.1, 0.2), (0.05, 0.0, 0.0), (2.0, 0.5, 1.0)
    )
    assert three.converged and abs(three.misfits).max() < 1e-13
    amplitude, gamma, gamma2 = three.values
    for k2, one in zip(NEAR, three.points, strict=False):
        near = (one.value, *_start(one, k2))
        assert exact_fold(k2, amplitude, gamma, gamma2, near) == pytest.approx(one.value, abs=1e-10)
    assert float(compliant.grazing(amplitude, gamma)) == pytest.approx(1.18, abs=1e-10)


def _start(point, k2):
    """(phase, speed, stay) of an entry into the right wall, the stay roughly."""
    rows = len(point.problem.sequence.sides)
    theta = point.value * point.z[0] + (np.pi if point.problem.sequence.sides[0] < 0 else 0.0)
    return theta, point.z[rows], np.pi / np.sqrt(1.0 + k2)

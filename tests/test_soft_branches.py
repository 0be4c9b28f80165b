"""Branches between soft walls, special points, loci and sensitivities: closed forms, 34 digits, other branches."""

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.loci.point_continuation import make_continued_point
from jaxvibro.reproduction.special_points import fit_parameters
from tests.reference import soft_orbits

A, GAMMA, GAMMA2, K2 = 0.3, 0.05, 0.1, 10.0
FITTED = 0.076  # the oscillator's damping of the fits to figure 10
NAMES = ("amplitude", "damping", ("left.damping", "right.damping"))
NEAR = {10: (1.48, 0.96, 1.3, 0.9), 50: (1.74, 1.1, 1.2, 0.43)}  # the folds: frequency, phase, speed, duration
PAIR = ("frequency", "amplitude")
BOUNDS = {"frequency": (0.3, 4.0), "amplitude": (0.01, 3.0)}


def wall(place, stiffness=K2, damping=GAMMA2, **more):
    return jv.Wall(place, stiffness=stiffness, damping=damping, **more)


def between(stiffness=K2, damping=GAMMA2, frequency=0.7, gamma=GAMMA, amplitude=A):
    """Return a scene between equal soft walls at -1 and 1."""
    walls = tuple(wall(place, stiffness, damping) for place in (-1.0, 1.0))
    return jv.make_scene(amplitude, frequency, gamma, 0.7, walls)


def followed(scene, name, bounds, state=(0.1, 0.0), **more):
    return jv.follow(jv.find_orbit(scene, jv.State(*state)), name, bounds, **more)


@pytest.fixture(scope="module")
def branch():
    """The branch of the motion without impacts along the frequency, through its grazings."""
    return followed(between(), "frequency", (0.5, 3.0))


@pytest.fixture(scope="module")
def folded():
    """Branches of P111 near the upper fold of figure 10, {stiffness: branch}."""
    found = {}
    for stiffness in NEAR:
        scene = between(stiffness, frequency=1.3, gamma=FITTED)
        orbit = jv.find_orbit(scene, jv.State(0.9, -1.1), periods=1, itinerary=("RL",))
        found[stiffness] = jv.follow(orbit, "frequency", (0.5, 2.0), stop="GR")
    return found


@pytest.fixture(scope="module")
def free():
    """The motion without impacts down to its grazing."""
    return followed(between(frequency=1.5, gamma=FITTED), "frequency", (0.5, 2.0), direction="backward", stop="GR")


def grazing_frequencies(amplitude=A, gamma=GAMMA, place=1.0):
    """Return where the motion without impacts has the amplitude `place`, (8)."""
    return np.sqrt(np.sort(np.roots([1.0, 4 * gamma**2 - 2.0, 1.0 - (amplitude / place) ** 2])))


def test_a_branch_passes_the_grazings_of_soft_walls(branch):
    values = np.sort([point.value for point in branch.points("GR")])
    assert np.allclose(values, grazing_frequencies(), rtol=0, atol=1e-11)
    assert all(reason.startswith("the parameter reached its bound") for reason in branch.reasons)
    for point in branch.points("GR"):
        assert abs(np.prod(point.multipliers).real - np.exp(-2 * GAMMA * 2 * np.pi / point.value)) < 1e-9


def test_a_branch_continues_after_a_touch_that_follows_a_long_contact():
    # a contact takes a sixth of the period: a touch is counted from the end of the contact before it
    soft = wall(0.0144, 7.0, 0.05, motion=jv.Motion(0.2, 4.65))
    branch = followed(jv.make_scene(0.9, 0.75, 0.222, 0.7, (None, soft)), "frequency", (0.6, 0.9), (-0.1, 0.0))
    assert [part.label for part in branch.segments] == ["P102", "P101"]
    assert all(reason.startswith("the parameter reached its bound") for reason in branch.reasons)
    assert branch.data["residual"].values.max() < 1e-9
    for place in range(0, len(branch), 9):
        orbit = branch.orbit(place)
        if orbit.least_speed == 0.0:  # the touch itself, where errors grow like a root
            continue
        end, impacts = jv.strobe(orbit.scene, orbit.state, slots=32)
        assert abs(end.x - orbit.state.x) < 1e-10 and impacts.count == orbit.impacts.count


def test_folds_and_doublings_close_to_a_grazing():
    walls = wall(-1.2, 20.0, 0.3), wall(0.8, 50.0, 0.2)
    scene = jv.make_scene(amplitude=0.4, frequency=1.8, damping=0.1, restitution=0.7, walls=walls)
    points = followed(scene, "frequency", (0.4, 2.3)).special
    points = points if points[0].value < points[-1].value else points[::-1]
    assert [point.kind for point in points] == ["EP", "GR", "PD", "PD", "GR", "SN", "GR", "SN", "GR", "EP"]
    expected = grazing_frequencies(0.4, 0.1, 0.8)
    assert np.allclose([points[1].value, points[8].value], expected, rtol=0, atol=1e-11)
    assert 0 < points[2].value - points[1].value < 1e-4 and 0 < points[8].value - points[7].value < 2e-5
    for point in (point for point in points if point.kind in ("PD", "SN")):
        roots = np.linalg.eigvals(jv.monodromy(point.scene, point.orbit.state))
        assert min(abs(roots - (1.0 if point.kind == "SN" else -1.0))) < 1e-6


# ---- loci ----------------------------------------------------------------------------------------------------------


def kinds(locus):
    return " ".join(point.kind for point in locus.special)


def assert_sound(locus):
    data = locus.data
    size = 1.0 + abs(locus.values).max(axis=1)
    assert (data["residual"] <= 3e-12 * size).all() and (data["least_clearance"] >= -1e-8).all()
    assert (data["least_speed"] > 0).all()


def test_the_locus_of_a_grazing_is_the_linear_response(branch):
    for graze in branch.points("GR"):
        locus = jv.locus(graze, PAIR, BOUNDS)
        assert_sound(locus)
        assert kinds(locus) == "EP EP" and len(locus) > 50
        w, force = locus.values.T
        assert force == pytest.approx(np.hypot(1.0 - w**2, 2.0 * GAMMA * w), rel=1e-11)
        square = locus.data["multiplier_real"] ** 2 + locus.data["multiplier_imag"] ** 2
        assert np.allclose(square.values[:, 0], np.exp(-4.0 * np.pi * GAMMA / w), rtol=0, atol=1e-12)


def test_the_locus_of_a_fold_passes_a_cusp(branch):
    first, second = (jv.locus(point, PAIR, BOUNDS) for point in branch.points("SN"))
    assert_sound(first)
    assert kinds(first) == kinds(second) == "EP CP EP"
    (cusp,), (same,) = first.points("CP"), second.points("CP")
    assert list(cusp.values.values()) == pytest.approx(list(same.values.values()), abs=1e-9)
    for place in range(1, len(first) - 1, 40):
        row = first.data.isel(point=place)
        time, speed = entry(row)
        w, force = first.values[place]
        oscillator = soft_orbits.symmetric(force, GAMMA, GAMMA2, K2)
        stay = soft_orbits.duration(oscillator, 1, w, time, speed)
        assert abs(soft_orbits.fold(oscillator, w, w * time, speed, stay) - w) < 1e-10
    assert abs(first.data["multiplier_real"][1:-1] - 1.0).min(axis=1).max() < 1e-7


def entry(row):
    """Return the time and the speed of the entry into the right wall."""
    right = int(np.flatnonzero(row["side"].values == 1)[0])
    return float(row["time"][right]), float(row["speed"][right])


def test_the_locus_of_symmetry_breaking_along_the_hardness():
    branch = followed(between(100.0, 0.5, 2.1, amplitude=2.0), "amplitude", (0.0, 6.0), (0.9, -1.1), stop="SB")
    bounds = {"amplitude": (0.0, 8.0), "hardness": (1.5, 2.5)}
    locus = jv.locus(branch.points("SB")[0], tuple(bounds), bounds)
    assert_sound(locus)
    assert kinds(locus) == "EP EP"
    amplitude, hardness = locus.values[len(locus) // 4]
    orbit, near = locus.orbit(len(locus) // 4), locus.scene.replace(amplitude=amplitude - 0.02, hardness=hardness)
    orbit = jv.find_orbit(near, orbit.state, orbit.periods, orbit.itinerary, settle=0)
    points = jv.follow(orbit, "amplitude", (amplitude - 0.05, amplitude + 0.05)).points("SB")
    assert min(abs(point.value - amplitude) for point in points) < 1e-10


# ---- the largest x, sensitivities and fits ---------------------------------------------------------------------------


def upper_fold(branch):
    return max(branch.points("SN"), key=lambda point: point.value)


def exact_fold(k2, amplitude, gamma, gamma2, near=None):
    return float(soft_orbits.fold(soft_orbits.symmetric(amplitude, gamma, gamma2, k2), *(near or NEAR[k2])))


def exact_fold_of_hardness(decades):
    """Return the fold where both walls are some decades stiffer and give back as much as with K2."""
    stiffness = K2 * 10.0**decades
    damping = jv.contact_damping(stiffness, float(jv.effective_restitution(K2, GAMMA2)))
    return exact_fold(stiffness, A, FITTED, float(damping), NEAR[10])


def test_the_largest_x_without_impacts_is_the_closed_form(free):
    w = free.values
    assert jv.peaks(free) == pytest.approx(A / np.hypot(1 - w**2, 2 * FITTED * w), rel=1e-13)
    assert jv.peak(free.orbit(3)) == pytest.approx(jv.peaks(free)[3], rel=1e-14)
    rigid = jv.find_orbit(jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.5, 1.0)), jv.State(0.9, -1.1))
    assert jv.peak(rigid) == pytest.approx(1.5, abs=1e-12)


@pytest.mark.parametrize("k2", NEAR)
def test_the_largest_x_within_a_wall_and_the_slopes_of_its_fold(folded, k2):
    branch = folded[k2]
    largest = jv.peaks(branch)
    for place in range(3, len(branch) - 3, 25):
        row = branch.data.isel(point=place)
        oscillator = soft_orbits.symmetric(A, FITTED, GAMMA2, k2)
        exact = soft_orbits.height(oscillator, float(branch.values[place]), *entry(row))
        assert largest[place] == pytest.approx(float(exact), rel=1e-12)
        assert jv.peak(branch.orbit(place)) == pytest.approx(largest[place], rel=1e-12)
    numbers, step = (A, FITTED, GAMMA2), 1e-5
    for k, slope in enumerate(jv.sensitivity(upper_fold(branch), NAMES).values):
        ends = [exact_fold(k2, *(each + sign * step * (j == k) for j, each in enumerate(numbers))) for sign in (1, -1)]
        assert slope == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-7)


def test_slopes_of_a_fold_along_the_hardness(folded):
    point, step = upper_fold(folded[10]), 1e-5
    slope, by_amplitude = jv.sensitivity(point, ("hardness", "amplitude")).values
    expected = (exact_fold_of_hardness(step) - exact_fold_of_hardness(-step)) / (2 * step)
    assert slope == pytest.approx(expected, rel=1e-7)
    assert by_amplitude == pytest.approx(float(jv.sensitivity(point, NAMES)[0]), rel=1e-11)
    harder = float(jv.located(point)(point.scene.replace(hardness=1.02)))
    assert harder == pytest.approx(exact_fold_of_hardness(0.02), abs=1e-12)
    names, bounds = ("hardness", "left.stiffness"), {"hardness": (0.5, 2.0), "left.stiffness": (5.0, 20.0)}
    for call in (lambda: jv.sensitivity(point, names), lambda: jv.locus(point, names, bounds)):
        with pytest.raises(jv.ArgumentError, match=r"^names: must not contain the hardness together"):
            call()
    near = folded[10].orbit(point.place - 2)
    (other,) = jv.follow(near, "hardness", (0.8, 1.2), "backward", stop="SN").points("SN")
    decades = other.value - 1.0
    assert exact_fold_of_hardness(decades) == pytest.approx(float(near.scene.frequency), abs=1e-12)
    slope = (exact_fold_of_hardness(decades + step) - exact_fold_of_hardness(decades - step)) / (2 * step)
    assert float(jv.sensitivity(other, ("frequency",))[0]) == pytest.approx(1.0 / slope, rel=1e-7)


def test_a_grazing_moves_as_the_closed_form(free):
    (graze,) = free.points("GR")
    step = 1e-6
    by_amplitude = soft_orbits.free_grazing(A + step, FITTED) - soft_orbits.free_grazing(A - step, FITTED)
    by_damping = soft_orbits.free_grazing(A, FITTED + step) - soft_orbits.free_grazing(A, FITTED - step)
    expected = [float(each) / (2 * step) for each in (by_amplitude, by_damping)] + [0.0]
    assert jv.sensitivity(graze, NAMES).values == pytest.approx(expected, abs=1e-8)
    value = float(jv.located(graze, wall="right")(graze.scene.replace(amplitude=0.32, damping=0.07)))
    assert value == pytest.approx(float(soft_orbits.free_grazing(0.32, 0.07)), abs=1e-13)


def test_fits_of_figure_10_are_the_reference(folded, free):
    folds, (graze,) = [upper_fold(branch) for branch in folded.values()], free.points("GR")
    points = [make_continued_point(point, ("damping",)) for point in folds]
    both = fit_parameters(points, [1.48, 1.74], [0.05], 0.0, 0.5)
    assert both.converged and both.values[0] == pytest.approx(0.0761074934, abs=1e-9)
    assert abs(both.jacobian.T @ both.misfits).max() < 1e-12
    for k2, point in zip(NEAR, both.points, strict=True):
        assert point.value == pytest.approx(exact_fold(k2, A, both.values[0], GAMMA2), abs=1e-10)
    points = [make_continued_point(point, NAMES) for point in (*folds, graze)]
    three = fit_parameters(points, [1.48, 1.74, 1.18], (0.45, 0.1, 0.2), (0.05, 0.0, 0.0), (2.0, 0.5, 1.0))
    assert three.converged and abs(three.misfits).max() < 1e-13
    amplitude, gamma, gamma2 = three.values
    for k2, point in zip(NEAR, three.points, strict=False):
        sides = point.problem.sequence.sides
        theta = point.value * point.z[0] + (np.pi if sides[0] < 0 else 0.0)
        near = point.value, theta, point.z[len(sides)], np.pi / np.sqrt(1.0 + k2)
        assert exact_fold(k2, amplitude, gamma, gamma2, near) == pytest.approx(point.value, abs=1e-10)
    assert float(soft_orbits.free_grazing(amplitude, gamma)) == pytest.approx(1.18, abs=1e-10)

"""Branches between soft walls, special points, loci and sensitivities: closed forms, 34 digits, other branches."""

import mpmath as mp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.loci.point_continuation import continue_to_values, make_continued_point
from jaxvibro.reproduction.special_point_fitting import fit_parameters
from tests.reference import compliant

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
    for point in branch.points("SN"):
        assert min(abs(point.multipliers - 1.0)) < 1e-6
    for place in range(5, len(branch), 40):
        orbit = branch.orbit(place)
        roots = np.linalg.eigvals(np.asarray(jv.monodromy(orbit.scene, orbit.state)))
        assert min(abs(roots - root).min() for root in orbit.multipliers) < 1e-10


def test_a_branch_that_starts_beyond_a_grazing_has_the_same_points(branch):
    scene = between(frequency=1.3)
    other = jv.follow(jv.find_orbit(scene, jv.strobe(scene, jv.State(1.5, 1.0), 300)[0]), "frequency", (0.5, 3.0))
    for kind in ("GR", "SN"):
        values, others = (np.sort([point.value for point in each.points(kind)]) for each in (branch, other))
        assert np.allclose(values, others, rtol=0, atol=1e-10)
    (point,) = [each for each in other.points("GR") if each.value < 1.0]
    distance = other.values - point.value  # the multipliers change like the root of the distance to the grazing
    near = (distance > 1e-10) & (distance < 1e-6) & (other.data["side"].values[:, 0] != 0)
    change = abs(other.multipliers.sum(axis=1).real[near] - sum(point.multipliers).real)
    assert near.sum() >= 3 and abs(np.polyfit(np.log(distance[near]), np.log(change), 1)[0] - 0.5) < 0.01


def test_a_period_doubling_just_before_a_grazing():
    scene = between(50.0, 1.0, amplitude=0.5, frequency=0.8511)
    orbit = jv.find_orbit(scene, jv.strobe(scene, jv.State(0.5, 0.3), periods=2000)[0])
    branch = jv.follow(orbit, "frequency", (0.845, 0.8515))
    kinds = [point.kind for point in branch.special]
    assert orbit.label == "P111" and kinds in (["EP", "PD", "GR", "EP"], ["EP", "GR", "PD", "EP"])
    (point,) = branch.points("PD")
    assert point.value == pytest.approx(0.849936879123, abs=1e-11)  # where the branch of P222 ends
    assert min(abs(point.multipliers + 1.0)) < 1e-7 and point.spot.speeds.min() < 2e-3


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
    orbit = jv.find_orbit(scene, jv.strobe(scene, jv.State(0.0, 0.0), periods=300)[0])
    points = [jv.follow(orbit, "frequency", (0.4, 2.3), largest_step=step).special for step in (0.1, 0.3)]
    fine, coarse = (each if each[0].value < each[-1].value else each[::-1] for each in points)
    kinds = ["EP", "GR", "PD", "PD", "GR", "SN", "GR", "SN", "GR", "EP"]
    assert [point.kind for point in fine] == kinds and [point.kind for point in coarse] == kinds
    assert np.allclose([point.value for point in fine], [point.value for point in coarse], rtol=0, atol=1e-11)
    expected = grazing_frequencies(0.4, 0.1, 0.8)
    assert np.allclose([fine[1].value, fine[8].value], expected, rtol=0, atol=1e-11)
    assert 0 < fine[2].value - fine[1].value < 1e-4 and 0 < fine[8].value - fine[7].value < 2e-5
    for point in (point for point in fine if point.kind in ("PD", "SN")):
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


def assert_on_branch(locus, place, aside, width=0.05):
    """Check a point of a locus against a branch in the first parameter that starts beside it."""
    (first, second), (value, other) = locus.names, locus.values[place]
    start, near = locus.orbit(place), locus.scene.replace(**{first: value + aside, second: other})
    orbit = jv.find_orbit(near, start.state, start.periods, start.itinerary, settle=0)
    points = jv.follow(orbit, first, (value - width, value + width)).points(locus.kind)
    assert min(abs(point.value - value) for point in points) < 1e-10


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
        right = int(np.flatnonzero(row["side"].values == 1)[0])
        (w, force), u = first.values[place], float(row["speed"][right])
        theta = w * float(row["time"][right])
        with mp.workdps(34):
            start = (mp.mpf(each) for each in (w, theta, u, duration(force, w, theta, u)))
            exact = compliant.fold((force, GAMMA, GAMMA2, K2), *start)
        assert abs(float(exact) - w) < 1e-10
    assert abs(first.data["multiplier_real"][1:-1] - 1.0).min(axis=1).max() < 1e-7


def duration(force, w, theta, u):
    """Return the approximate duration of a contact with the right wall, by the reference."""
    half = compliant.Half((force, GAMMA, GAMMA2, K2), w, mp.mpf(theta), mp.mpf(u), None)
    times = np.linspace(0.0, 3.0, 300)[1:]
    return times[np.argmax([float(half.within(mp.mpf(time))[0][0]) < 0 for time in times])]


@pytest.mark.parametrize(("kind", "name", "aside"), [("SN", "left.restitution", 0.02), ("GR", "frequency", -0.02)])
def test_loci_between_a_rigid_and_a_soft_wall(kind, name, aside):
    scene = jv.make_scene(2.0, 2.1, GAMMA, 0.7, (-1.0, wall(1.0, 1e3, 2.0)))
    branch = followed(scene, "amplitude", (0.0, 6.0), (0.9, -1.1))
    start = [point for point in branch.points(kind) if point.value < 1.0 or point.value > 5.0][-1]
    bounds = {"amplitude": (0.0, 8.0), name: {"left.restitution": (0.2, 1.0), "frequency": (1.3, 3.0)}[name]}
    locus = jv.locus(start, ("amplitude", name), bounds)
    assert_sound(locus)
    assert kinds(locus) == {"SN": "EP EP", "GR": "EP PD EP"}[kind]
    for point in locus.points("PD"):  # of the orbit without the touch
        doubling, doubled = jv.switch(point)
        assert abs(doubling.data["multiplier_real"].values.min(axis=1) + 1.0).max() < 1e-7
        assert (doubling.kind, doubled.kind, doubled.label) == ("PD", "GR", "P232")
    for place in (2, len(locus) // 2, len(locus) - 3):
        assert_on_branch(locus, place, aside)


def test_the_locus_of_a_fold_up_to_a_stiffness_of_10_000():
    scene = jv.make_scene(1.0, 2.0, GAMMA, 0.7, (None, wall(0.5, 50.0, 0.5)))
    fold = followed(scene, "frequency", (0.8, 4.0), (0.0, 0.0)).points("SN")[0]
    bounds = {"frequency": (0.5, 5.0), "right.stiffness": (1.0, 1e4)}
    locus = jv.locus(fold, tuple(bounds), bounds, largest_step=1.0)
    assert_sound(locus)
    assert kinds(locus) == "EP CP EP" and len(locus) < 1500
    assert locus.points("CP")[0].values["right.stiffness"] == pytest.approx(44.2966626645, abs=1e-8)
    high = locus.values[[0, -1], 0] > 1.8  # on the other side a fold is near the grazing
    assert_on_branch(locus, {0: 1, 1: len(locus) - 2}[int(np.argmax(high))], -0.01)


def test_the_locus_of_symmetry_breaking_along_the_hardness():
    branch = followed(between(100.0, 0.5, 2.1, amplitude=2.0), "amplitude", (0.0, 6.0), (0.9, -1.1))
    locus = jv.locus(
        branch.points("SB")[0], ("amplitude", "hardness"), {"amplitude": (0.0, 8.0), "hardness": (1.0, 5.0)}
    )
    assert_sound(locus)
    assert kinds(locus) == "EP EP"
    for place in range(1, len(locus), len(locus) // 4):
        assert_on_branch(locus, place, -0.02)


@pytest.mark.parametrize("damping", [None, 0.3])  # smooth there; with a root
def test_the_locus_of_the_grazing_of_a_moving_wall(damping):
    soft = wall(1.0, 30.0, damping, motion=jv.Motion(0.1))
    branch = followed(jv.make_scene(1.0, 1.7, GAMMA, 0.7, (None, soft)), "frequency", (0.8, 4.0), (0.0, 0.0))
    locus = jv.locus(branch.points("GR")[0], PAIR, {"frequency": (0.5, 3.0), "amplitude": (0.01, 3.0)})
    assert_sound(locus)
    w, force = locus.values.T
    response = force / (1.0 - w**2 + 2j * GAMMA * w)  # x - x_b swings by 1
    assert abs(response - 0.1) == pytest.approx(np.ones(len(w)), abs=1e-11)


# ---- the largest x, sensitivities and fits ---------------------------------------------------------------------------


def upper_fold(branch):
    return max(branch.points("SN"), key=lambda point: point.value)


def exact_fold(k2, amplitude, gamma, gamma2, near=None):
    with mp.workdps(34):
        return float(compliant.fold((amplitude, gamma, gamma2, k2), *map(mp.mpf, near or NEAR[k2])))


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
        w, right = float(branch.values[place]), int(np.flatnonzero(row["side"].values == 1)[0])
        theta, u = w * float(row["time"][right]), float(row["speed"][right])
        with mp.workdps(30):
            exact = compliant.height((A, FITTED, GAMMA2, k2), mp.mpf(w), mp.mpf(theta), mp.mpf(u))
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
    harder, share = continue_to_values(make_continued_point(point, ("hardness",)), [1.05])
    assert share == 1.0 and harder.value == pytest.approx(exact_fold_of_hardness(0.05), abs=1e-12)
    with pytest.raises(jv.ArgumentError, match=r"^names: must not contain the hardness together"):
        jv.sensitivity(point, ("hardness", "left.stiffness"))
    near = folded[10].orbit(point.place - 2)
    (other,) = jv.follow(near, "hardness", (0.8, 1.2), "backward", stop="SN").points("SN")
    decades = other.value - 1.0
    assert exact_fold_of_hardness(decades) == pytest.approx(float(near.scene.frequency), abs=1e-12)
    slope = (exact_fold_of_hardness(decades + step) - exact_fold_of_hardness(decades - step)) / (2 * step)
    assert float(jv.sensitivity(other, ("frequency",))[0]) == pytest.approx(1.0 / slope, rel=1e-7)


def test_a_grazing_moves_as_the_closed_form(free):
    (graze,) = free.points("GR")
    step = 1e-6
    by_amplitude = compliant.grazing(A + step, FITTED) - compliant.grazing(A - step, FITTED)
    by_damping = compliant.grazing(A, FITTED + step) - compliant.grazing(A, FITTED - step)
    expected = [float(each) / (2 * step) for each in (by_amplitude, by_damping)] + [0.0]
    assert jv.sensitivity(graze, NAMES).values == pytest.approx(expected, abs=1e-8)
    point, share = continue_to_values(make_continued_point(graze, NAMES), [0.4, 0.05, 0.1])
    assert share == 1.0 and point.value == pytest.approx(float(compliant.grazing(0.4, 0.05)), abs=1e-13)


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
    assert float(compliant.grazing(amplitude, gamma)) == pytest.approx(1.18, abs=1e-10)

"""Curves of special points between soft walls: closed forms, a reference in 34 digits, branches beside."""

import mpmath as mp
import numpy as np
import pytest

import jaxvibro as jv
from tests.reference import compliant

A, GAMMA, GAMMA2, K2 = 0.3, 0.05, 0.1, 10.0
PAIR = ("frequency", "amplitude")
BOUNDS = {"frequency": (0.3, 4.0), "amplitude": (0.01, 3.0)}


def soft(place, stiffness=K2, damping=GAMMA2, **more):
    return jv.Wall(place, stiffness=stiffness, damping=damping, **more)


def special(scene, kind, name, bounds, state=(0.1, 0.0)):
    """The first special point of a kind of the branch of what a scene settles on."""
    return jv.follow(jv.find_orbit(scene, jv.State(*state)), name, bounds).points(kind)[0]


@pytest.fixture(scope="module")
def branch():
    scene = jv.make_scene(A, 0.7, GAMMA, 0.7, (soft(-1.0), soft(1.0)))
    return jv.follow(jv.find_orbit(scene, jv.State(0.1, 0.0)), "frequency", (0.5, 3.0))


def kinds(locus):
    return " ".join(one.kind for one in locus.special)


def is_sound(locus, residual=3e-12):
    data = locus.data
    size = 1.0 + abs(locus.values).max(axis=1)
    assert (data["residual"] <= residual * size).all() and (data["least_clearance"] >= -1e-8).all()
    return bool((data["least_speed"] > 0).all())


def by_branch(locus, place, aside, width=0.05):
    """How far a point is from the special point of a branch along the first parameter, the second being as it is; the
    branch begins beside it, where there are orbits."""
    (first, second), (value, other) = locus.names, locus.values[place]
    near, at = locus.scene.replace(**{first: value + aside, second: other}), locus.orbit(place)
    orbit = jv.find_orbit(near, at.state, at.periods, at.itinerary, settle=0)
    found = jv.follow(orbit, first, (value - width, value + width)).points(locus.kind)
    return min(abs(one.value - value) for one in found)


def test_the_grazing_is_that_of_the_linear_response(branch):
    for graze in branch.points("GR"):
        locus = jv.locus(graze, PAIR, BOUNDS)
        assert is_sound(locus) and kinds(locus) == "EP EP" and len(locus) > 50
        w, force = locus.values.T
        assert force == pytest.approx(np.hypot(1.0 - w**2, 2.0 * GAMMA * w), rel=1e-11)
        # the multipliers are those of the free flight over one period
        square = locus.data["multiplier_real"] ** 2 + locus.data["multiplier_imag"] ** 2
        assert np.allclose(square.values[:, 0], np.exp(-4.0 * np.pi * GAMMA / w), rtol=0, atol=1e-12)


def test_the_fold_is_the_reference_round_its_cusp(branch):
    first, second = (jv.locus(one, PAIR, BOUNDS) for one in branch.points("SN"))
    assert is_sound(first) and kinds(first) == kinds(second) == "EP CP EP"
    (cusp,), (same,) = first.points("CP"), second.points("CP")
    assert list(cusp.values.values()) == pytest.approx(list(same.values.values()), abs=1e-9)
    for place in range(1, len(first) - 1, 40):
        row = first.data.isel(point=place)
        right = int(np.flatnonzero(row["side"].values == 1)[0])
        (w, force), u = first.values[place], float(row["speed"][right])
        stay = compliant_stay(force, w, w * float(row["time"][right]), u)
        with mp.workdps(34):
            start = (mp.mpf(each) for each in (w, w * float(row["time"][right]), u, stay))
            exact = compliant.fold((force, GAMMA, GAMMA2, K2), *start)
        assert abs(float(exact) - w) < 1e-10
    assert abs(first.data["multiplier_real"][1:-1] - 1.0).min(axis=1).max() < 1e-7


def compliant_stay(force, w, theta, u):
    """How long the reference's mass stays within the right wall."""
    half = compliant.Half((force, GAMMA, GAMMA2, K2), w, mp.mpf(theta), mp.mpf(u), None)
    times = np.linspace(0.0, 3.0, 300)[1:]
    depth = np.array([float(half.within(mp.mpf(time))[0][0]) for time in times])
    return times[np.argmax(depth < 0)]


@pytest.mark.parametrize(
    "kind, names, high, aside",
    [
        pytest.param("SN", "left.restitution", 1.0, 0.02, marks=pytest.mark.long),
        pytest.param("GR", "frequency", 3.0, -0.02, marks=pytest.mark.long),
    ],
)
def test_one_wall_rigid_and_one_soft(kind, names, high, aside):
    scene = jv.make_scene(2.0, 2.1, GAMMA, 0.7, (-1.0, soft(1.0, 1e3, 2.0)))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (0.0, 6.0))
    begun = [one for one in branch.points(kind) if one.value < 1.0 or one.value > 5.0][-1]
    low = {"left.restitution": 0.2, "frequency": 1.3}[names]
    locus = jv.locus(begun, ("amplitude", names), {"amplitude": (0.0, 8.0), names: (low, high)})
    assert is_sound(locus) and kinds(locus) == {"SN": "EP EP", "GR": "EP PD EP"}[kind]
    for point in locus.points("PD"):  # of the orbit without the touch
        doubling, doubled = jv.switch(point)
        assert abs(doubling.data["multiplier_real"].values.min(axis=1) + 1.0).max() < 1e-7
        assert (doubling.kind, doubled.kind, doubled.label) == ("PD", "GR", "P232")
    for place in (2, len(locus) // 2, len(locus) - 3):
        assert by_branch(locus, place, aside) < 1e-10


def test_one_soft_wall_from_stiffness_44_to_ten_thousand():
    scene = jv.make_scene(1.0, 2.0, GAMMA, 0.7, (None, soft(0.5, 50.0, 0.5)))
    fold = special(scene, "SN", "frequency", (0.8, 4.0), (0.0, 0.0))
    bounds = {"frequency": (0.5, 5.0), "right.stiffness": (1.0, 1e4)}
    locus = jv.locus(fold, tuple(bounds), bounds, largest_step=1.0)
    assert is_sound(locus) and kinds(locus) == "EP CP EP" and len(locus) < 1500
    assert locus.points("CP")[0].values["right.stiffness"] == pytest.approx(44.2966626645, abs=1e-8)
    high = locus.values[[0, -1], 0] > 1.8  # on the other side a fold is near the grazing
    place = {0: 1, 1: len(locus) - 2}[int(np.argmax(high))]
    assert by_branch(locus, place, -0.01) < 1e-10


def test_symmetry_breaking_while_both_walls_get_harder():
    scene = jv.make_scene(2.0, 2.1, GAMMA, 0.7, (soft(-1.0, 100.0, 0.5), soft(1.0, 100.0, 0.5)))
    breaking = special(scene, "SB", "amplitude", (0.0, 6.0), (0.9, -1.1))
    locus = jv.locus(breaking, ("amplitude", "hardness"), {"amplitude": (0.0, 8.0), "hardness": (1.0, 5.0)})
    assert is_sound(locus) and kinds(locus) == "EP EP"
    for place in range(1, len(locus), len(locus) // 4):
        assert by_branch(locus, place, -0.02) < 1e-10


@pytest.mark.parametrize("damping", [None, 0.3])  # smooth there; with a root
def test_the_grazing_of_a_wall_that_moves(damping):
    wall = soft(1.0, 30.0, damping, motion=jv.Motion(0.1))
    scene = jv.make_scene(1.0, 1.7, GAMMA, 0.7, (None, wall))
    graze = special(scene, "GR", "frequency", (0.8, 4.0), (0.0, 0.0))
    locus = jv.locus(graze, PAIR, {"frequency": (0.5, 3.0), "amplitude": (0.01, 3.0)})
    assert is_sound(locus)
    w, force = locus.values.T
    response = force / (1.0 - w**2 + 2j * GAMMA * w)  # x - x_b swings by 1
    assert abs(response - 0.1) == pytest.approx(np.ones(len(w)), abs=1e-11)

"""Curves of special points in two parameters on one scene: closed forms, ends, points of codimension two, input."""

import mpmath
import numpy as np
import pytest

import jaxvibro as jv
from tests.reference import closed
from tests.reference.codim import codim
from tests.reference.scene import Scene, Wall

from .properties.special_points import codim2_error, locus_error

GAMMA, OMEGA, R = 0.05, 2.1, 0.7
PAIR = ("amplitude", "frequency")
BOUNDS = {"amplitude": (0.0, 12.0), "frequency": (1.2, 3.0)}
MEETING = 1.84718918172, 1.22152745847  # amplitude and frequency at which loci of P112 meet
OK, JUMPED, VIRTUAL, NONE = jv.SolutionStatus


@pytest.fixture(scope="module")
def branch():
    scene = jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.0, 1.0))
    return jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (0.0, 6.0))


@pytest.fixture(scope="module")
def points(branch):
    """A special point of each kind and orbit."""
    (lopsided,) = (one for one in jv.switch(branch.points("SB")[0]) if one.segments[-1].label == "P112")
    symmetric = {f"{point.kind} of P111": point for point in branch.special if point.kind != "EP"}
    return symmetric | {f"{point.kind} of P112": point for point in lopsided.special if point.kind != "EP"}


@pytest.fixture(scope="module")
def loci(points):
    return {name: jv.locus(point, PAIR, BOUNDS) for name, point in points.items()}


def kinds(locus):
    return " ".join(point.kind for point in locus.special)


def is_sound(locus, residual=2e-12):
    """Its orbits are orbits and keep to their walls; only the end of an SN, PD or SB may graze."""
    size = 1.0 + abs(dict(zip(locus.names, locus.values.T, strict=True)).get("amplitude", locus.scene.amplitude))
    assert (locus.data["residual"] <= residual * size).all()
    assert (locus.data["least_clearance"] >= -1e-8 * size).all()
    slow = locus.data["least_speed"].values
    grazes = {point.place for point in locus.special if point.kind in ("GR", "GG")}
    assert grazes <= {0, len(locus) - 1}
    assert (np.delete(slow, list(grazes)) > 0).all() and (slow >= -1e-12).all()
    return True


def test_the_fold_and_the_grazing_in_closed_form(loci):
    fold, grazing = loci["SN of P111"], loci["GR of P111"]
    for locus in (fold, grazing):
        assert kinds(locus) == "EP EP" and is_sound(locus) and len(locus) > 20
        assert sorted(locus.values[[0, -1], 1]) == [1.2, 3.0]
    for amplitude, frequency in fold.values:
        with mpmath.workdps(30):
            expected = closed.fold(GAMMA, frequency, R, 1, symmetric=True)
        assert expected.speed > 0 and abs(float(expected.amplitude - amplitude)) < 1e-12
    assert abs(fold.data["multiplier_real"][:, 0] - 1.0).max() < 1e-9
    speeds, times = fold.data["speed"].values, fold.data["time"].values
    assert np.array_equal(speeds[:, 0], speeds[:, 1])
    assert np.allclose(np.diff(times), np.pi / fold.data["frequency"].values[:, None], rtol=0, atol=1e-13)
    for amplitude, frequency in grazing.values:
        with mpmath.workdps(30):
            assert abs(float(closed.grazing(GAMMA, frequency, 1) - amplitude)) < 1e-12
    assert abs(grazing.data["speed"]).max() < 1e-12 and np.isinf(grazing.data["least_speed"]).all()


@pytest.mark.parametrize("name", ["SB of P111", "GR of P112", "SN of P112", "PD of P112"])
def test_loci_of_impacting_orbits_agree_with_the_reference(loci, points, name):
    locus, start = loci[name], points[name]
    assert is_sound(locus) and len(locus) > 50
    for place in range(0, len(locus), 25):
        assert locus_error(locus, place) < 1e-11
    closing = {"SB": 1.0, "SN": 1.0, "PD": -1.0}.get(locus.kind)
    if closing:
        assert abs(locus.data["multiplier_real"][1:-1] - closing).min(axis=1).max() < 1e-8
    (near,) = np.flatnonzero(abs(locus.values - [start.value, OMEGA]).max(axis=1) < 1e-11)
    speeds = np.sort(locus.data["speed"][near])
    assert np.allclose(speeds[-len(start.spot.speeds) :], np.sort(start.spot.speeds), rtol=0, atol=1e-8)
    assert speeds[: len(speeds) - len(start.spot.speeds)].max(initial=0.0) < 1e-12


def test_loci_of_fold_and_doubling_end_at_the_resonant_grazing(loci):
    assert [kinds(loci[f"{kind} of P112"]) for kind in ("SN", "PD", "GR")] == ["GR EP", "GR EP", "EP RG PD EP"]
    for kind in ("SN", "PD", "GR"):
        point = loci[f"{kind} of P112"].special[kind == "GR"]
        assert np.allclose(list(point.values.values()), MEETING, rtol=0, atol=1e-9)
        assert codim2_error(point) < 1e-12
    fold = loci["SN of P112"]
    end = fold.special[0]
    assert end.values == dict(zip(PAIR, fold.values[0], strict=True))
    assert end.scene.amplitude == end.values["amplitude"] and end.scene.frequency == end.values["frequency"]
    assert min(end.orbit.impacts.speed) < 1e-12 and end.orbit.label == end.label == "P112"
    assert fold.reason == {
        "first": "an impact loses its speed there, a flight touches a wall, or a rest ends",
        "last": "frequency reached its bound 3",
    }
    assert repr(fold).startswith(f"Locus(SN of P112 in amplitude and frequency, {len(fold)} points, ")
    row = loci["GR of P112"].table().splitlines()[2]
    assert row.split() == ["RG", "1.84718918172", "1.22152745847", "P112", "RLR"]


def test_loci_of_fold_and_doubling_leave_the_resonant_grazing(loci):
    """They are the loci from the points of branches."""
    (point,) = loci["GR of P112"].points("RG")
    for locus in jv.switch(point):
        other = loci[f"{locus.kind} of P112"]
        assert kinds(locus) == "GR EP" and is_sound(locus, 1e-10) and locus.bounds == point.bounds
        assert locus.special[0].values == pytest.approx(point.values, abs=1e-9)
        assert np.allclose(locus.values[-1], other.values[-1], rtol=0, atol=1e-9)
        assert locus.reasons[0] == "it left RG at amplitude 1.84718918172, frequency 1.22152745847"
        assert locus.data["least_speed"][1] > 0


def test_a_fold_beyond_the_end_of_its_locus_is_virtual(loci, points):
    point, locus = points["SN of P112"], loci["SN of P112"]
    edge, far = locus.values[0, 1], np.array([1e-5, 1e-3, 1e-2, 0.1])
    found = jv.located(point).solve(point.scene.replace(frequency=edge + np.concatenate([-0.1 * far, far])))
    assert np.asarray(found.status).tolist() == 4 * [VIRTUAL] + 4 * [OK]


def test_points_that_nothing_leaves_are_refused(loci):
    locus = loci["GR of P112"]
    (point,) = locus.points("RG")
    with pytest.raises(
        jv.ArgumentError, match=r"^special: must be a point from which other loci emanate: .*; got 'EP of a locus of"
    ):
        jv.switch(locus.special[0])
    with pytest.raises(jv.ArgumentError, match=r"^special: must be a Special or a Codim2"):
        jv.switch(locus)
    for key, given in (("monitors", {"still": lambda point: point.value}), ("stop", "GPD")):
        with pytest.raises(jv.ArgumentError, match=rf"^{key}: must be omitted"):
            jv.switch(point, **{key: given})
    with pytest.raises(jv.ArgumentError, match=r"^bounds: must give \(low, high\) for amplitude and for frequency"):
        jv.switch(point, (0.0, 20.0))
    with pytest.raises(jv.ArgumentError, match=r"^largest_step: must be a positive number"):
        jv.switch(point, largest_step=0.0)


def test_the_reference_of_resonant_grazings_against_their_closed_form():
    scene = Scene(GAMMA, 2.0, 3.0, None, Wall(1.0, R))
    with mpmath.workdps(60):
        frequency = 2 * mpmath.sqrt(1 - mpmath.mpf(GAMMA) ** 2)
        true = closed.grazing(GAMMA, frequency, 1), frequency
        at = float(mpmath.atan2(2 * GAMMA * frequency, 1 - frequency**2) / frequency)
        found = codim(scene, PAIR, "RG", [float(each) for each in true], [at], [1e-4], [1], 1)
        assert max(abs(a - b) for a, b in zip(found, true, strict=True)) < 1e-40


@pytest.fixture(scope="module")
def slow_drive():
    """Where symmetric P111 at a low frequency breaks its symmetry, and what goes on from there doubles its period."""
    scene = jv.make_scene(2.0, 0.7, GAMMA, R, (-1.0, 1.0))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.0, 3.0), stop="SB")
    breaking = branch.points("SB")[0]
    return {"DSB": breaking, "GPD": jv.switch(breaking, stop="PD")[0].points("PD")[0]}


@pytest.mark.parametrize(
    "kind, name, bounds, values",
    [
        ("DSB", "frequency", (0.5, 4.0), (0.73656127323413395930, 0.87811842201733201397)),
        ("GPD", "damping", (0.0, 1.2), (0.57163054731347008931, 0.17203541428470594473)),
    ],
)
def test_doublings_and_breakings_that_degenerate(slow_drive, kind, name, bounds, values):
    """Where they change their side; a fold of the doubled or the asymmetric orbits leaves the point."""
    locus = jv.locus(slow_drive[kind], ("amplitude", name), {"amplitude": (0.0, 20.0), name: bounds})
    (point,) = locus.points(kind)
    assert is_sound(locus)
    assert np.allclose(list(point.values.values()), values, rtol=0, atol=1e-7)
    assert codim2_error(point) < 1e-9
    for end in locus.points("GR"):
        assert codim2_error(end, kind == "DSB") < 1e-12
    near = {key: (value - 0.02, value + 0.02) for key, value in point.values.items()}
    (folds,) = jv.switch(point, near)
    assert folds.kind == "SN" and folds.reasons[0].startswith(f"it left {kind} at amplitude ")
    assert abs(folds.data["multiplier_real"][1:-1, 0] - 1.0).max() < 1e-7
    assert locus_error(folds, len(folds) // 2) < 1e-11


def test_a_cusp():
    scene = jv.make_scene(2.0, 1.2, 0.02, 0.9, (-1.5, 1.0))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.0, 3.0))
    doubled = jv.switch(branch.points("PD")[0])[0]
    point = next(point for point in doubled.points("SN") if point.label == "P212")
    locus = jv.locus(point, PAIR, {"amplitude": (0.0, 20.0), "frequency": (0.5, 4.0)})
    (cusp,) = locus.points("CP")
    assert is_sound(locus) and codim2_error(cusp) < 1e-11
    assert np.allclose(list(cusp.values.values()), (0.732811723456128, 1.180086394958394), rtol=0, atol=1e-11)
    beside = locus.values[cusp.place - 1 : cusp.place + 2] - locus.values[cusp.place]
    assert beside[0] @ beside[2] > 0  # it turns back
    for end in locus.points("GR"):
        assert codim2_error(end) < 1e-12


def test_grazings_leave_the_grazing_at_which_a_breaking_ends(points):
    """Those of the symmetric, the asymmetric and the doubled orbits; they are tangent to the locus of their kind."""
    (end,) = jv.locus(points["SB of P111"], PAIR, BOUNDS | {"frequency": (0.9, 3.2)}).points("GR")
    through, lopsided = jv.switch(end)
    assert (through.kind, through.label, lopsided.kind, lopsided.label) == ("GR", "P122", "GR", "P112")
    (breaking,), (doubling,) = through.points("SB"), lopsided.points("PD")
    assert breaking.values == pytest.approx(end.values, abs=1e-9)
    for point, labels in ((breaking, ("P111", "P112")), (doubling, ("P111", "P223"))):
        assert codim2_error(point) < 1e-9
        own, third = jv.switch(point)
        assert (own.kind, third.kind) == (point.kind, "GR") and (own.label, third.label) == labels
        assert max(locus_error(third, place) for place in range(1, len(third) - 1, 20)) < 1e-10
        distances = []
        for gap in (2e-4, 1e-4):
            near = point.bounds | {"frequency": tuple(point.values["frequency"] + way * gap for way in (-1.0, 1.0))}
            ends = [locus.values[-1] for locus in jv.switch(point, near, first_step=1e-3)]
            assert ends[0][1] == ends[1][1]
            distances.append(ends[1][0] - ends[0][0])
        assert abs(np.log2(distances[0] / distances[1]) - 2.0) < 0.05


def test_damping_past_one_and_its_domain(points):
    """The flow changes its form at 1; without damping a locus is at the end of its domain."""
    bounds = {"amplitude": (0.0, 30.0), "damping": (-1.0, 1.5)}
    locus = jv.locus(points["GR of P111"], ("amplitude", "damping"), bounds)
    assert sorted(locus.reasons) == ["damping reached its bound 1.5", "the domain of damping ends at 0"]
    for amplitude, gamma in locus.values:
        with mpmath.workdps(30):
            assert abs(float(closed.grazing(gamma, OMEGA, 1) - amplitude)) < 1e-12
    assert is_sound(locus) and {0.0, 1.5} == set(locus.values[[0, -1], 1])


def test_what_cannot_be_followed_is_refused(points, branch):
    fold, breaking = points["SN of P112"], points["SB of P111"]
    moving = {"amplitude": (0.0, 12.0), "right.position": (0.5, 2.0)}
    cases = [(special, PAIR, BOUNDS, r"special: must be a") for special in (branch.special[0], branch.orbit(0), None)]
    for names in (("amplitude", "amplitude"), ("amplitude",), "amplitude", ("amplitude", "frequency", "damping"), None):
        cases.append((fold, names, BOUNDS, r"names: must be (two different parameters|a list of strings)"))
    cases.append((fold, ("amplitude", "stiffness"), {"amplitude": (0, 1), "stiffness": (0, 1)}, r"stiffness: "))
    for bounds in ({"amplitude": (0.0, 12.0)}, BOUNDS | {"damping": (0.0, 1.0)}, (0.0, 12.0), None):
        cases.append((fold, PAIR, bounds, r"bounds: must (give \(low, high\) for amplitude and for|be a mapping)"))
    for wrong in ((5.0, 12.0), (12.0, 0.0), (0.0, np.nan), 3.0):
        cases.append((fold, PAIR, BOUNDS | {"amplitude": wrong}, r"bounds.*: must "))
    cases.append((fold, PAIR, BOUNDS | {"frequency": (2.2, 3.0)}, r"bounds.*: must "))
    cases.append((breaking, tuple(moving), moving, r"names: must keep the scene symmetric"))
    for special, names, bounds, message in cases:
        with pytest.raises(jv.ArgumentError, match=f"^{message}"):
            jv.locus(special, names, bounds)
    with pytest.raises(jv.ArgumentError, match=r"^largest_step: must be a positive number"):
        jv.locus(fold, PAIR, BOUNDS, largest_step=0.0)
    with pytest.raises(jv.ArgumentError, match=r"^place: must be a point of the locus, from 0 to "):
        jv.locus(fold, PAIR, BOUNDS).orbit(10**6)

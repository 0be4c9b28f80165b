"""Curves of special points in two parameters: closed forms, references in 40 digits, ends, resonant grazing, input."""

import mpmath
import numpy as np
import pytest

import jaxvibro as jv
from tests.codim2_proof import exponent, gaps, grazing
from tests.locus_proof import codim_error, error
from tests.reference import closed
from tests.reference.codim import codim
from tests.reference.scene import Scene, Wall

GAMMA, OMEGA, R = 0.05, 2.1, 0.7
PAIR = ("amplitude", "frequency")
BOUNDS = {"amplitude": (0.0, 12.0), "frequency": (1.2, 3.0)}
RESONANCE = 2.0 * np.sqrt(1.0 - GAMMA**2)  # the impacts of P101 come at every n-th half swing where it is n omega
MEETING = 1.84718918172, 1.22152745847  # amplitude and frequency at which loci of P112 meet
SAME = 1e-9


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(2.0, OMEGA, GAMMA, R, (-1.0, 1.0))


@pytest.fixture(scope="module")
def branch(scene):
    return jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (0.0, 6.0))


@pytest.fixture(scope="module")
def points(branch):
    """One special point of each kind and orbit."""
    (lopsided,) = (one for one in jv.switch(branch.points("SB")[0]) if one.segments[-1].label == "P112")
    symmetric = {f"{one.kind} of P111": one for one in branch.special if one.kind != "EP"}
    return symmetric | {f"{one.kind} of P112": one for one in lopsided.special if one.kind != "EP"}


@pytest.fixture(scope="module")
def loci(points):
    return {name: jv.locus(one, PAIR, BOUNDS) for name, one in points.items()}


@pytest.fixture(scope="module")
def lone():
    """Branches of the scene with one wall, at a frequency below the resonance of P101 and at one above it."""

    def branch(frequency):
        scene = jv.make_scene(1.0, frequency, GAMMA, R, (None, 1.0))
        return jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.0, 6.0))

    return {frequency: branch(frequency) for frequency in (1.7, 2.3)}


def kinds(locus):
    return " ".join(one.kind for one in locus.special)


def meetings(locus):
    """(amplitude, frequency) of the points of codimension two, by frequency."""
    found = [[one.values[name] for name in PAIR] for one in locus.special if one.kind != "EP"]
    return np.array(sorted(found, key=lambda one: one[1]))


def is_sound(locus, residual=2e-12):
    """Its orbits are orbits and keep to their walls; only the end of an SN, PD or SB may graze."""
    size = 1.0 + abs(dict(zip(locus.names, locus.values.T, strict=True)).get("amplitude", locus.scene.amplitude))
    assert (locus.data["residual"] <= residual * size).all()
    assert (locus.data["least_clearance"] >= -1e-8 * size).all()
    slow = locus.data["least_speed"].values
    grazes = {one.place for one in locus.special if one.kind in ("GR", "GG")}
    assert grazes <= {0, len(locus) - 1}
    assert (np.delete(slow, list(grazes)) > 0).all() and (slow >= -1e-12).all()
    return True


def test_the_fold_of_the_symmetric_orbit(loci):
    locus = loci["SN of P111"]
    assert kinds(locus) == "EP EP" and is_sound(locus) and len(locus) > 20
    assert sorted(locus.values[[0, -1], 1]) == [1.2, 3.0]
    for amplitude, frequency in locus.values:
        with mpmath.workdps(30):
            fold = closed.fold(GAMMA, frequency, R, 1, symmetric=True)
        assert fold.speed > 0 and abs(float(fold.amplitude - amplitude)) < 1e-12
    assert abs(locus.data["multiplier_real"][:, 0] - 1.0).max() < 1e-9
    speeds, times = locus.data["speed"].values, locus.data["time"].values
    assert np.array_equal(speeds[:, 0], speeds[:, 1])
    assert np.allclose(np.diff(times), np.pi / locus.data["frequency"].values[:, None], rtol=0, atol=1e-13)


def test_the_grazing_of_the_orbit_without_impacts(loci):
    locus = loci["GR of P111"]
    assert kinds(locus) == "EP EP" and is_sound(locus) and len(locus) > 20
    for amplitude, frequency in locus.values:
        with mpmath.workdps(30):
            assert abs(float(closed.grazing(GAMMA, frequency, 1) - amplitude)) < 1e-12
    assert abs(locus.data["speed"]).max() < 1e-12 and np.isinf(locus.data["least_speed"]).all()


@pytest.mark.parametrize("name", ["SB of P111", "GR of P112", "SN of P112", "PD of P112"])
def test_loci_against_forty_digits(loci, points, name):
    locus = loci[name]
    assert is_sound(locus) and len(locus) > 50
    for place in range(0, len(locus), 13):
        assert error(locus, place) < 1e-11
    closing = {"SB": 1.0, "SN": 1.0, "PD": -1.0}.get(locus.kind)
    if closing:
        assert abs(locus.data["multiplier_real"][1:-1] - closing).min(axis=1).max() < 1e-8
    begun = points[name]
    (near,) = np.flatnonzero(abs(locus.values - [begun.value, OMEGA]).max(axis=1) < 1e-11)
    speeds = np.sort(locus.data["speed"][near])
    assert np.allclose(speeds[-len(begun.spot.speeds) :], np.sort(begun.spot.speeds), rtol=0, atol=1e-8)
    assert speeds[: len(speeds) - len(begun.spot.speeds)].max(initial=0.0) < 1e-12


def test_loci_of_fold_and_doubling_end_at_the_resonant_grazing(loci):
    assert [kinds(loci[f"{kind} of P112"]) for kind in ("SN", "PD", "GR")] == ["GR EP", "GR EP", "EP RG PD EP"]
    for kind in ("SN", "PD", "GR"):
        there = meetings(loci[f"{kind} of P112"])[0]
        assert np.allclose(there, MEETING, rtol=0, atol=1e-9)
        assert codim_error(loci[f"{kind} of P112"].special[kind == "GR"], "RG", kind) < 1e-12
    end = loci["SN of P112"].special[0]
    assert end.values == dict(zip(PAIR, loci["SN of P112"].values[0], strict=True))
    assert end.scene.amplitude == end.values["amplitude"] and end.scene.frequency == end.values["frequency"]
    assert min(end.orbit.impacts.speed) < 1e-12 and end.orbit.label == end.label == "P112"
    assert loci["SN of P112"].reason == {
        "first": "an impact loses its speed there, a flight touches a wall, or a rest ends",
        "last": "frequency reached its bound 3",
    }
    for name in ("SN of P112", "PD of P112"):
        locus = loci[name]
        assert repr(locus).startswith(f"Locus({name} in amplitude and frequency, {len(locus)} points, ")
    told = loci["GR of P112"].table().splitlines()[2]
    assert told.split() == ["RG", "1.84718918172", "1.22152745847", "P112", "RLR"]


def test_loci_of_fold_and_doubling_leave_the_resonant_grazing(loci):
    """The same as from branches; to the GR, in 40 digits, their distance grows as the square of the way."""
    (point,) = loci["GR of P112"].points("RG")
    for one in jv.switch(point):
        other = loci[f"{one.kind} of P112"]
        assert (
            kinds(one) == "GR EP"
            and is_sound(one, 1e-10)
            and one.special[0].values == pytest.approx(point.values, abs=SAME)
        )
        assert np.allclose(one.values[-1], other.values[-1], rtol=0, atol=SAME)
        assert one.reasons[0] == "it left RG at amplitude 1.84718918172, frequency 1.22152745847"
        assert one.data["least_speed"][1] > 0
    for found in gaps(point, "frequency").values():
        away = [(gap, values[0] - grazing(point, PAIR[1], values[1], PAIR[0])) for gap, *values in found]
        assert abs(exponent(away) - 2.0) < 0.01


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


def test_a_locus_from_its_other_end_in_other_steps(loci):
    """From orbits where the first loci end, the special points there; their loci lead back along the same curves."""
    far = {name: loci[name].orbit(-1) for name in ("PD of P112", "SN of P112")}
    begun = {name: jv.follow(one, "amplitude", (8.0, 11.0)) for name, one in far.items()}
    for name, other in (("SN of P112", "PD of P112"), ("PD of P112", "SN of P112")):
        kind, first = name[:2], loci[name]
        (point,) = (one for one in begun[other].points(kind) if one.label == "P112")
        assert abs(point.value - first.values[-1, 0]) < 1e-11
        for names, steps in ((PAIR, (0.02, 0.02)), (PAIR[::-1], (0.1, 0.5)), (PAIR, (0.5, 0.5))):
            locus = jv.locus(point, names, BOUNDS, *steps)
            assert is_sound(locus) and kinds(locus) == "GR EP"
            assert np.allclose(meetings(locus), MEETING, rtol=0, atol=SAME)
            for place in range(0, len(locus), 1 + len(locus) // 5):
                gap = abs(first.values[:, 1] - locus.data["frequency"].values[place])
                assert error(locus, place, 20, near=(first, int(np.argmin(gap)))) < 1e-11


def test_steps_and_order_do_not_matter(loci, points):
    for name in ("SB of P111", "GR of P112"):
        for names, steps in ((PAIR, (0.02, 0.02, 1e-9)), (PAIR[::-1], (0.5, 0.5)), (PAIR[::-1], (0.02, 0.3, 1e-13))):
            locus = jv.locus(points[name], names, BOUNDS, *steps)
            assert kinds(locus) in (kinds(loci[name]), " ".join(kinds(loci[name]).split()[::-1]))
            assert np.allclose(meetings(locus), meetings(loci[name]), rtol=0, atol=SAME)
            ends, others = (np.sort(one.data["amplitude"][[0, -1]]) for one in (locus, loci[name]))
            assert np.allclose(ends, others, rtol=0, atol=SAME)
            for place in range(1, len(locus) - 1, 1 + len(locus) // 4):
                assert error(locus, place) < 1e-11


def test_a_fold_or_a_doubling_comes_quadratically_to_a_grazing(lone):
    """Simpson and Ghosh: SN below the grazing, on the side where sin(2 pi n r / omega) < 0; PD on the other side."""
    for kind, frequency in (("SN", 1.7), ("PD", 2.3)):
        (point,) = lone[frequency].points(kind)
        side = np.sign(frequency - RESONANCE)
        assert (np.sin(2 * np.pi * RESONANCE / 2.0 / frequency) < 0) == (kind == "SN") == (side < 0)
        logs = []
        for gap in (1e-3, 1e-4, 1e-5):
            edge = RESONANCE + side * gap
            bounds = {"amplitude": (0.0, 20.0), "frequency": tuple(sorted((edge, RESONANCE + side)))}
            locus = jv.locus(point, PAIR, bounds)
            (place,) = np.flatnonzero(locus.values[:, 1] == edge)
            with mpmath.workdps(30):
                above = locus.values[place, 0] - closed.grazing(GAMMA, edge, 1)
                if kind == "SN":
                    fold = closed.fold(GAMMA, edge, R, 1, periods=1)
                    assert fold.speed > 0 and abs(fold.amplitude - locus.values[place, 0]) < 1e-13
            assert above * side > 0
            logs.append([np.log(gap), np.log(abs(float(above)))])
        assert np.allclose(np.diff(logs, axis=0)[:, 1] / np.diff(logs, axis=0)[:, 0], 2.0, rtol=0, atol=0.01)


def test_resonant_grazings_of_one_wall(lone):
    (point,) = lone[1.7].points("GR")
    bounds = {"amplitude": (0.0, 20.0), "frequency": (0.6, 3.2)}
    locus = jv.locus(point, PAIR, bounds)
    assert kinds(locus) == "EP RG RG RG EP" and is_sound(locus)
    with mpmath.workdps(30):
        true = [(float(closed.grazing(GAMMA, RESONANCE / m, 1)), RESONANCE / m) for m in (3, 2, 1)]
    assert np.allclose(meetings(locus), true, rtol=0, atol=SAME)
    fold, doubling = (jv.locus(lone[at].points(kind)[0], PAIR, bounds) for kind, at in (("SN", 1.7), ("PD", 2.3)))
    assert np.allclose(meetings(fold), true[1:], rtol=0, atol=SAME)
    assert np.allclose(meetings(doubling), true[2:], rtol=0, atol=SAME)
    assert is_sound(fold) and is_sound(doubling) and "amplitude reached its bound 20" in doubling.reasons
    for amplitude, frequency in fold.values[1:-1]:
        with mpmath.workdps(30):
            assert abs(float(closed.fold(GAMMA, frequency, R, 1, periods=1).amplitude) - amplitude) < 1e-12


def test_the_reference_of_resonant_grazings_against_their_closed_form():
    scene = Scene(GAMMA, 2.0, 3.0, None, Wall(1.0, R))
    with mpmath.workdps(60):
        frequency = 2 * mpmath.sqrt(1 - mpmath.mpf(GAMMA) ** 2)
        true = closed.grazing(GAMMA, frequency, 1), frequency
        at = float(mpmath.atan2(2 * GAMMA * frequency, 1 - frequency**2) / frequency)
        found = codim(scene, PAIR, "RG", [float(each) for each in true], [at], [1e-4], [1], 1)
        assert max(abs(a - b) for a, b in zip(found, true, strict=True)) < 1e-40


@pytest.fixture(scope="module")
def slowly():
    """Symmetric P111 at a low frequency breaks its symmetry, and what goes on from there doubles its period."""
    scene = jv.make_scene(2.0, 0.7, GAMMA, R, (-1.0, 1.0))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.0, 3.0))
    breaking = branch.points("SB")[0]
    return {"DSB": breaking, "GPD": jv.switch(breaking)[0].points("PD")[0]}


DEGENERATE = {  # amplitude, and the other parameter
    ("DSB", "frequency"): (0.73656127323413395930, 0.87811842201733201397),
    ("DSB", "damping"): (0.70270966166614647403, 0.20092382128820312304),
    ("GPD", "frequency"): (0.47670986720423051278, 0.94613199424931461124),
    ("GPD", "damping"): (0.57163054731347008931, 0.17203541428470594473),
}


@pytest.mark.parametrize("kind, name", DEGENERATE)
def test_where_doubling_and_breaking_change_their_side(slowly, kind, name):
    bounds = {"amplitude": (0.0, 20.0), "frequency": (0.5, 4.0), "damping": (0.0, 1.2)}
    locus = jv.locus(slowly[kind], ("amplitude", name), {key: bounds[key] for key in ("amplitude", name)})
    (point,) = locus.points(kind)
    assert is_sound(locus)
    assert np.allclose(list(point.values.values()), DEGENERATE[kind, name], rtol=0, atol=1e-7)
    assert codim_error(point, kind, locus.kind) < SAME
    for end in locus.points("GR"):
        assert codim_error(end, "GR", locus.kind, kind == "DSB") < 1e-12


def test_cusps():
    scene = jv.make_scene(2.0, 1.2, 0.02, 0.9, (-1.5, 1.0))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.0, 3.0))
    doubled = jv.switch(branch.points("PD")[0])[0]
    bounds = {"amplitude": (0.0, 20.0), "frequency": (0.5, 4.0)}
    true = {"P222": (1.055364381387206, 1.514504747228536), "P212": (0.732811723456128, 1.180086394958394)}
    for point in doubled.points("SN"):
        if point.label not in true:
            continue
        locus = jv.locus(point, PAIR, bounds)
        (cusp,) = locus.points("CP")
        assert is_sound(locus) and codim_error(cusp, "CP", "SN") < 1e-11
        assert np.allclose(list(cusp.values.values()), true.pop(point.label), rtol=0, atol=1e-11)
        beside = locus.values[cusp.place - 1 : cusp.place + 2] - locus.values[cusp.place]
        assert beside[0] @ beside[2] > 0  # it turns back
        for end in locus.points("GR"):
            assert codim_error(end, "GR", "SN") < 1e-12
    assert not true


PAIRS = {
    ("amplitude", "damping"): ((0.0, 12.0), (0.0, 1.2)),
    ("restitution", "frequency"): ((0.05, 1.0), (1.2, 3.0)),
    ("right.position", "amplitude"): ((0.5, 2.0), (0.0, 12.0)),
}


@pytest.mark.parametrize(
    "names", [pytest.param(one, marks=pytest.mark.long if "restitution" in one else pytest.mark.slow) for one in PAIRS]
)
def test_other_parameters(points, names):
    bounds = dict(zip(names, PAIRS[names], strict=True))
    for name in ("PD of P112", "GR of P112"):
        locus = jv.locus(points[name], names, bounds)
        assert is_sound(locus) and len(locus) > 10
        length = np.cumsum(np.hypot(*np.diff(locus.values, axis=0).T))  # of the curve: at an end, points crowd together
        for place in np.searchsorted(length, np.linspace(0.0, length[-1], 5, endpoint=False)):
            assert error(locus, int(place)) < 1e-11


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
    one, breaking = points["SN of P112"], points["SB of P111"]
    for given in (branch.special[0], branch.orbit(0), None):
        with pytest.raises(jv.ArgumentError, match=r"^special: must be a (special point of kind SN|Special)"):
            jv.locus(given, PAIR, BOUNDS)
    for names in (("amplitude", "amplitude"), ("amplitude",), "amplitude", ("amplitude", "frequency", "damping"), None):
        with pytest.raises(jv.ArgumentError, match=r"^names: must be (two different parameters|a list of strings)"):
            jv.locus(one, names, BOUNDS)
    with pytest.raises(jv.ArgumentError, match=r"^stiffness: "):
        jv.locus(one, ("amplitude", "stiffness"), {"amplitude": (0, 1), "stiffness": (0, 1)})
    for bounds in ({"amplitude": (0.0, 12.0)}, BOUNDS | {"damping": (0.0, 1.0)}, (0.0, 12.0), None):
        with pytest.raises(
            jv.ArgumentError, match=r"^bounds: must (give \(low, high\) for amplitude and for|be a mapping)"
        ):
            jv.locus(one, PAIR, bounds)
    for wrong in ((5.0, 12.0), (12.0, 0.0), (0.0, np.nan), 3.0):
        with pytest.raises(jv.ArgumentError, match=r"^bounds.*: must "):
            jv.locus(one, PAIR, BOUNDS | {"amplitude": wrong})
    with pytest.raises(jv.ArgumentError, match=r"^bounds.*: must "):
        jv.locus(one, PAIR, BOUNDS | {"frequency": (2.2, 3.0)})
    with pytest.raises(jv.ArgumentError, match=r"^names: must keep the scene symmetric"):
        jv.locus(breaking, ("amplitude", "right.position"), {"amplitude": (0.0, 12.0), "right.position": (0.5, 2.0)})
    with pytest.raises(jv.ArgumentError, match=r"^largest_step: must be a positive number"):
        jv.locus(one, PAIR, BOUNDS, largest_step=0.0)
    with pytest.raises(jv.ArgumentError, match=r"^place: must be a point of the locus, from 0 to "):
        jv.locus(one, PAIR, BOUNDS).orbit(10**6)


SCENES = {
    "uneven walls": ((-1.5, 1.0), {}),
    "one wall, much damping": ((None, 0.2), {"damping": 0.9}),
    "a moving wall": ((None, jv.Wall(1.0, None, motion=jv.Motion(0.1, 0.5))), {}),
    "two, one moving": (
        (-1.0, jv.Wall(1.0, 0.8, motion=jv.Motion(0.1, 0.5))),
        {"frequency": 2.4, "damping": 0.1, "restitution": 0.6},
    ),
    "restitution per wall": ((jv.Wall(-1.2, 0.5), jv.Wall(1.0, 0.9)), {"frequency": 1.5}),
}


MARKS = {"one wall, much damping": pytest.mark.slow}


@pytest.mark.parametrize("name", [pytest.param(name, marks=MARKS.get(name, pytest.mark.long)) for name in SCENES])
def test_loci_of_other_scenes(name):
    walls, numbers = SCENES[name]
    numbers = {"frequency": OMEGA, "damping": GAMMA, "restitution": R} | numbers
    scene = jv.make_scene(2.0, walls=walls, **numbers)
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, -1.1)), "amplitude", (0.0, 8.0))
    begun = [one for one in branch.special if one.kind in ("SN", "PD", "GR") and len(one.spot.times) <= 4]
    assert begun
    bounds = {"amplitude": (0.0, 12.0), "frequency": (1.0, 3.2), "damping": (0.0, 1.4)}
    for one in begun:
        for names in (PAIR, ("amplitude", "damping")):
            locus = jv.locus(one, names, {key: bounds[key] for key in names})
            assert is_sound(locus, 1e-11)
            for place in range(0, len(locus), 1 + len(locus) // 6):
                assert error(locus, place) < 1e-11

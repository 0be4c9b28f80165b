"""The loci that leave points of codimension two: closed forms, branches, references in 40 digits."""

import mpmath
import pytest

import jaxvibro as jv
from tests import codim2_proof as proof
from tests.locus_proof import error
from tests.reference import closed

GAMMA, R, WALL = 0.05, 0.7, 1.0
PAIR = ("amplitude", "frequency")
PLACE = 1.9974984355438178  # 2 sqrt(1 - gamma^2)


def grazing_of(frequency, walls):
    """The GR of the motion without impacts."""
    scene = jv.make_scene(1e-3, frequency, GAMMA, R, walls)
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.0, 0.0)), "amplitude", (0.0, 30.0), stop="GR")
    return branch.points("GR")[0]


@pytest.fixture(scope="module")
def locus():
    bounds = {"amplitude": (0.0, 20.0), "frequency": (1.98, 2.02)}
    return jv.locus(grazing_of(1.99, (None, WALL)), PAIR, bounds)


@pytest.fixture(scope="module")
def resonant(locus):
    (point,) = locus.points("RG")
    return point


def test_fold_and_doubling_leave_a_resonant_grazing_quadratically(resonant):
    with mpmath.workdps(30):
        omega, *coefficients = proof.resonance(GAMMA, R, WALL, 1)
        graze = closed.grazing(GAMMA, omega, WALL)
    assert abs(float(omega) - PLACE) < 1e-15
    found = resonant.values
    assert abs(found["frequency"] - PLACE) < 1e-9 and abs(found["amplitude"] - float(graze)) < 1e-9
    beside = proof.gaps(resonant, "frequency")
    for kind, coefficient, way in zip(("SN", "PD"), coefficients, (-1.0, 1.0), strict=True):
        away = []
        for gap, amplitude, edge in beside[kind]:
            assert edge == PLACE + way * gap or abs(edge - PLACE - way * gap) < 1e-15
            with mpmath.workdps(30):
                away.append((gap, float(amplitude - closed.grazing(GAMMA, edge, WALL))))
                if kind == "SN":
                    assert abs(float(closed.fold(GAMMA, edge, R, WALL).amplitude) - amplitude) < 1e-13
        shares = [far / gap**2 / float(coefficient) for gap, far in away]
        assert abs(proof.exponent(away) - 2.0) < 0.01
        assert abs((10.0 * shares[1] - shares[0]) / 9.0 - 1.0) < 1e-4


def test_what_leaves_is_told_and_leads_back(resonant):
    folds, doublings = jv.switch(resonant)
    assert (folds.kind, doublings.kind) == ("SN", "PD")
    for one in (folds, doublings):
        assert one.bounds == resonant.bounds and one.special[0].values == pytest.approx(resonant.values, abs=1e-12)
        assert one.reason["first"] == "it left RG at amplitude 2.99666481275, frequency 1.99749843554"
        assert one.data["least_speed"][1:].min() > 0 and abs(one.data["least_speed"][0]) < 1e-12


def test_the_fold_of_the_doubled_orbit_leaves_a_degenerate_doubling():
    """Along it the doubled orbit is an SN of branches that come from elsewhere; it is tangent to the PD."""
    span = {"amplitude": (0.0, 20.0), "frequency": (0.6, 3.2)}
    point = jv.locus(grazing_of(1.05, (None, WALL)), PAIR, span).points("RG")[1]
    doublings = next(one for one in jv.switch(point) if one.kind == "PD")
    (there,) = doublings.points("GPD")
    (folds,) = jv.switch(there)
    assert folds.kind == "SN" and folds.label == "P202" and folds.points("GR")
    assert folds.reason["first"].startswith("it left GPD at amplitude 0.476709867")
    assert abs(folds.data["multiplier_real"][:-1, 0] - 1.0).max() < 1e-7
    for place in (1, len(folds) // 2):
        assert error(folds, place) < 1e-11
    place = len(folds) // 2
    values = list(proof.by_branches(folds, place))
    assert min(abs(value - folds.values[place, 0]) for value in values) < 1e-9


@pytest.fixture(scope="module")
def breaking():
    """Where the SB of symmetric P111 ends on a grazing."""
    scene = jv.make_scene(2.0, 2.1, GAMMA, R, (-WALL, WALL))
    branch = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (0.0, 6.0))
    bounds = {"amplitude": (0.0, 12.0), "frequency": (0.9, 3.2)}
    (end,) = jv.locus(branch.points("SB")[0], PAIR, bounds).points("GR")
    return end


def test_grazings_of_lopsided_and_doubled_orbits_leave_nonhyperbolic_grazings(breaking):
    through, lopsided = jv.switch(breaking)
    assert (through.kind, through.label, lopsided.kind, lopsided.label) == ("GR", "P122", "GR", "P112")
    (there,) = through.points("SB")
    assert there.values == pytest.approx(breaking.values, abs=1e-9)
    (doubling,) = lopsided.points("PD")
    for point, labels in ((there, ("P111", "P112")), (doubling, ("P111", "P223"))):
        own, third = jv.switch(point)
        assert proof.misplaced(point) < 1e-9
        assert (own.kind, third.kind) == (point.kind, "GR") and (own.label, third.label) == labels
        assert max(error(third, place) for place in range(1, len(third) - 1, 9)) < 1e-10
        assert abs(proof.exponent(proof.apart(point, own)) - 2.0) < 0.01

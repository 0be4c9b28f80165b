"""The reference for special points held against known values, closed forms, changes of frame and plain differences."""

import pytest
from mpmath import atan2, mpf, sqrt, workdps

from tests.reference import closed
from tests.reference.scene import Motion, Scene, Wall
from tests.reference.special import special

GAMMA, OMEGA, R = 0.05, 2.1, 0.7
SYMMETRIC = Scene(GAMMA, OMEGA, 4.65, Wall(-1.0, R), Wall(1.0, R))
UNEVEN = Scene(GAMMA, OMEGA, 4.65, Wall(-1.5, 0.8), Wall(1.0, 0.6, Motion(0.1, 0.4, 2)))

# kind, amplitude, (times, speeds, sides), flight that touches a wall
FOLD = "SN", 0.508057896812, ([0.78979, 2.285786], [1.2439, 1.2439], [1, -1]), None
FORCED = "GR", 3.416460156361, ([], [], []), (0, 1.5, 1)
BREAKING = "SB", 3.543892249375, ([0.110293, 1.606289], [2.535221, 2.535221], [1, -1]), None
UNEVEN_FOLD = "SN", 4.525079701581, ([0.841659, 1.776842, 2.713951], [0.722141, 3.88472, 2.515456], [1, -1, 1]), None
DOUBLING = "PD", 4.787450372300, ([0.716276, 1.689198, 2.76655], [0.932294, 3.908229, 2.359174], [1, -1, 1]), None
GRAZED = "GR", 5.304177743857, ([1.111574, 1.986166, 2.700868], [5.3e-5, 4.067352, 3.386474], [1, -1, 1]), None
TOUCHED = "GR", 5.304177743857, ([1.986172, 2.700877], [4.067296, 3.386492], [-1, 1]), (1, 1.1115, 1)
UNEVEN_DOUBLING = "PD", 6.792343, ([0.171319, 1.797598, 2.596755], [1.981852, 4.995306, 3.026987], [1, -1, 1]), None
KNOWN = {
    "fold of P111": FOLD,
    "grazing of P100": FORCED,
    "symmetry breaking of P111": BREAKING,
    "fold of P112": UNEVEN_FOLD,
    "period doubling of P112": DOUBLING,
    "grazing of P112": GRAZED,
    "grazing of P111": TOUCHED,
}
known = pytest.mark.parametrize("case", KNOWN.values(), ids=KNOWN)


def amplitude(case, scene=SYMMETRIC):
    """The exact amplitude of a case."""
    kind, value, impacts, touch = case
    return special(scene, "amplitude", kind, round(value, 6), *impacts, 1, touch)


@known
def test_known_values(case):
    assert abs(amplitude(case) - case[1]) < 1e-12


def test_closed_forms():
    with workdps(60):
        fold = closed.fold(GAMMA, OMEGA, R, 1.0, symmetric=True)
        assert abs(amplitude(FOLD) - fold.amplitude) < 1e-50
        assert abs(amplitude(FORCED) - closed.grazing(GAMMA, OMEGA, 1.0)) < 1e-50


def test_two_branches_meet_where_one_grazes_and_the_other_touches():
    with workdps(60):
        assert abs(amplitude(GRAZED) - amplitude(TOUCHED)) < 1e-50
        times, speeds, sides = [2.061103, 2.750847], [4.319816, 4.29858], [-1, 1]
        grazed = "GR", 5.477065, ([0.973733, *times], [1e-5, *speeds], [1, *sides]), None
        touched = "GR", 5.477065, (times, speeds, sides), (1, 0.97373, 1)
        assert abs(amplitude(grazed, UNEVEN) - amplitude(touched, UNEVEN)) < 1e-50


@pytest.mark.parametrize("name, value", [("restitution", R), ("damping", GAMMA), ("frequency", OMEGA)])
@pytest.mark.parametrize("case", [BREAKING, DOUBLING, TOUCHED], ids=lambda case: case[0])
def test_another_parameter_leads_back(case, name, value):
    kind, _, impacts, touch = case
    scene = SYMMETRIC._replace(amplitude=amplitude(case))
    assert abs(special(scene, name, kind, value + 1e-6, *impacts, 1, touch) - mpf(value)) < 1e-50


@known
def test_shaken_walls_are_another_drive(case):
    """y = x - b cos(omega t) has walls at rest and the drive (A - b (1 - omega^2)) cos + 2 gamma omega b sin."""
    kind, _, (times, speeds, sides), touch = case
    with workdps(60):
        b, gamma, omega = mpf(0.3), mpf(GAMMA), mpf(OMEGA)
        quarter = 2 * gamma * omega * b
        inphase = sqrt(amplitude(case) ** 2 - quarter**2)
        late = atan2(quarter, inphase) / omega
        shaken = Wall(-1.0, R, Motion(0.3)), Wall(1.0, R, Motion(0.3))
        touch = touch and (touch[0], touch[1] + late, touch[2])
        there = Scene(GAMMA, OMEGA, 4.65, *shaken)
        expected = inphase + b * (1 - omega**2)
        impacts = [each + late for each in times], speeds, sides
        assert abs(special(there, "amplitude", kind, round(expected, 6), *impacts, 1, touch) - expected) < 1e-50


def test_another_kind_of_point_is_refused():
    with pytest.raises(ArithmeticError):
        amplitude(("SB", *FOLD[1:]))
    with pytest.raises(ArithmeticError, match="not near amplitude"):
        special(SYMMETRIC, "amplitude", "GR", 3.5, [], [], [], 1, (0, 1.5, 1))
    for kind in ("SN", "HB"):
        with pytest.raises(ValueError, match=kind):
            special(SYMMETRIC, "amplitude", kind, 3.5, [], [], [], 1)

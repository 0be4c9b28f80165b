"""Families of loci over a third parameter: closed forms, `locus` one by one, where the point is not there, input."""

import mpmath
import numpy as np
import pytest

import jaxvibro as jv

from . import figure_4
from .figure_4 import GAMMA, OMEGA, R
from .reference import closed

PAIR = ("amplitude", "frequency")
BOUNDS = {"amplitude": (0.0, 12.0), "frequency": (1.2, 3.0)}
TOUCHING = {"frequency": (0.3, 3.0), "damping": (0.0, 0.4)}


@pytest.fixture(scope="module")
def branch():
    return figure_4.branch()


def are_the_same(one, other):
    """Whether two loci are one: both ways along it, their special points and their number of points."""
    assert (one.kind, one.names, one.bounds, len(one)) == (other.kind, other.names, other.bounds, len(other))
    assert one.reasons == other.reasons and one.label == other.label
    for first, second in zip(one.special, other.special, strict=True):
        assert (first.kind, first.place) == (second.kind, second.place)
        assert np.allclose(list(first.values.values()), list(second.values.values()), rtol=0, atol=1e-9)
        assert np.allclose(np.sort(first.spot.speeds), np.sort(second.spot.speeds), rtol=0, atol=1e-9)
    assert np.allclose(one.values, other.values, rtol=0, atol=1e-9)
    return True


def test_a_grazing_for_amplitudes_at_two_of_which_there_is_none(branch):
    """P100 touches at A = sqrt(D): least at resonance, so that most amplitudes are passed twice, the first time above;
    below the least and where the bound of the frequency comes first there is no such point."""
    (touch,) = branch.points("GR")
    values = np.array([0.5, 3.0, 0.09, touch.value, 9.0])
    family = jv.family(touch, ("frequency", "damping"), TOUCHING, "amplitude", values)
    assert [one is None for one in family] == [False, False, True, False, True]
    for value, locus in zip(values, family, strict=True):
        if locus is None:
            continue
        assert locus.scene.amplitude == value and 1.0 < float(locus.scene.frequency) < 3.0
        assert len(locus) > 5 and locus.special[0].kind == locus.special[-1].kind == "EP"
        with mpmath.workdps(30):
            for frequency, damping in (*locus.values, (float(locus.scene.frequency), GAMMA)):
                assert abs(float(closed.grazing(damping, frequency, 1)) - value) < 1e-11
    assert are_the_same(family[3], jv.locus(touch, ("frequency", "damping"), TOUCHING))


def test_a_fold_over_damping(branch):
    (fold,) = branch.points("SN")
    values = [0.2, GAMMA, 0.35]
    family = jv.family(fold, PAIR, BOUNDS, "damping", values)
    for gamma, locus in zip(values, family, strict=True):
        assert float(locus.scene.damping) == gamma and locus.scene.frequency == OMEGA
        assert len(locus) > 20 and sorted(locus.values[[0, -1], 1]) == [1.2, 3.0]
        with mpmath.workdps(30):
            for amplitude, frequency in locus.values:
                true = closed.fold(gamma, frequency, R, 1, symmetric=True)
                assert true.speed > 0 and abs(float(true.amplitude) - amplitude) < 1e-11
    assert are_the_same(family[1], jv.locus(fold, PAIR, BOUNDS))


@pytest.mark.parametrize(("third", "values"), [("right.position", [1.0, 1.02, 0.97]), ("right.restitution", [R, 0.72])])
def test_a_fold_whose_symmetry_the_third_parameter_breaks(branch, third, values):
    """Where the walls are alike half the orbit is followed, else all of it."""
    (fold,) = branch.points("SN")
    family = jv.family(fold, PAIR, BOUNDS, third, values)
    assert are_the_same(family[0], jv.locus(fold, PAIR, BOUNDS))
    for value, locus in zip(values[1:], family[1:], strict=True):
        scene = locus.scene.replace(amplitude=2.0)
        assert scene.parameter(third) == value
        (found,) = jv.follow(jv.find_orbit(scene, jv.State(0.9, -1.1)), "amplitude", (0.0, 2.5)).points("SN")
        assert are_the_same(locus, jv.locus(found, PAIR, BOUNDS))


@pytest.mark.parametrize(
    ("key", "given"),
    [
        ("bounds", {"bounds": BOUNDS | {"frequency": (2.2, 3.0)}}),
        ("third", {"third": "amplitude"}),
        ("values", {"values": [[0.1], 0.2]}),
        ("damping", {"values": [0.1, -0.1]}),
        ("right.position", {"third": "right.position", "values": [1.0, -1.5]}),
        ("third", {"special": "SB", "third": "right.position", "values": [1.0, 1.1]}),
        ("special", {"special": "EP"}),
    ],
)
def test_bad_arguments(key, given, branch):
    given = {"special": "GR", "names": PAIR, "bounds": BOUNDS, "third": "damping", "values": [0.1]} | given
    given["special"] = branch.points(given["special"])[0]
    with pytest.raises(jv.ArgumentError) as error:
        jv.family(**given)
    assert error.value.key == key

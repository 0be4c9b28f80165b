"""Chaos that a short look leaves undecided: weighed by the spectrum's estimator, and told from what is regular."""

import numpy as np

import jaxvibro as jv
from jaxvibro.attractors import classify_attractors
from jaxvibro.attractors.weak_chaos import assess_weak_chaos
from tests.attractors_proof import drawn
from tests.reference.lyapunov import Oscillator, exponents


def scene(amplitude, left=-1.5, damping=0.05, restitution=0.7):
    return jv.make_scene(amplitude, 2.1, damping, restitution, (left, 1.0))


def lane(x, v):
    return jv.State(np.array([x]), np.array([v]), np.zeros(1), np.zeros(1))


def test_weak_chaos_is_an_attractor():
    """Half of all starts; .0633 +- .0019 by `spectrum`."""
    found = jv.find_attractors(scene(6.75), starts=32)
    assert sorted(one.label for one in found) == ["P232", "chaotic"]
    weak = next(one for one in found if one.label == "chaotic")
    assert abs(weak.exponent - 0.0633) < 0.01 and weak.share > 0.3


def test_where_the_first_look_decides_nothing_the_estimator_does(monkeypatch):
    """Two chaotic attractors, mirror images, and two orbits: the same starts on each as with the first look."""
    given = scene(5.0, left=-1.0)
    found = jv.find_attractors(given, starts=32)
    first = classify_attractors.largest_exponents

    def unsure(*numbers):
        rates, errors = first(*numbers)
        return rates, np.where(rates > 0, rates, errors)

    monkeypatch.setattr(classify_attractors, "largest_exponents", unsure)
    again = jv.find_attractors(given, starts=32)
    assert sorted(one.label for one in again) == ["P111", "P111", "chaotic", "chaotic"]
    assert sorted((one.label, one.share) for one in again) == sorted((one.label, one.share) for one in found)
    wild = [one for one in again if one.kind == "chaotic"]
    assert all("standard error of its exponent" in one.note and abs(one.exponent - 0.343) < 0.01 for one in wild)
    monkeypatch.setattr(classify_attractors, "MAX_LONG_ESTIMATES", 0)
    (*orbits, rest) = jv.find_attractors(given, starts=32)
    assert [one.kind for one in orbits] == ["periodic"] * 2 and "was not examined for long" in rest.note


def test_what_is_regular_is_not_taken_for_chaos():
    rate, why = assess_weak_chaos(scene(4.65), lane(0.9, -1.1))
    assert rate == -np.inf and "recurs" in why
    rate, why = assess_weak_chaos(scene(0.8, left=-1.0, damping=0.0, restitution=1.0), lane(0.9, -1.1))  # a shear alone
    assert rate == -np.inf and "not positive beyond doubt" in why


def test_a_mass_that_rests_is_not_chaotic():
    """It comes back exactly after 89 periods; trajectories beside it rest at other times, and so part."""
    found = jv.find_attractors(drawn("two", 129), starts=24, seed=129)
    assert [one.kind for one in found] == ["unresolved"] and "sticks to a wall" in found[0].note


def test_an_orbit_that_stretches_rounding_is_one():
    """Each start comes back to within 2e-9 after 21 periods, not nearer."""
    (one,) = jv.find_attractors(drawn("two", 152), starts=24, seed=152)
    assert (one.label, one.rests, one.share) == ("P21-21-inf", True, 1.0)


def test_chaos_that_ends_is_not_chaotic():
    """Half of what is not on P100 by 300 periods comes to it in each 2,000 that follow."""
    (one,) = jv.find_attractors(drawn("one", 35), starts=64, seed=35)
    assert (one.label, one.share) == ("P100", 1.0)


def test_the_exponent_is_that_of_another_method():
    """At amplitudes where chaos is weak, from starts near the attractor's state."""
    seen = 0
    for amplitude in (6.72, 6.75, 6.8):
        for one in jv.find_attractors(scene(amplitude), starts=24):
            assert one.kind != "unresolved" or "its exponent -" in one.note  # an orbit of more than 32 periods
            if one.kind == "chaotic":
                x = np.full(48, one.state.x)
                v = one.state.v + 1e-7 * np.random.default_rng(2).normal(size=48)
                growth, _ = exponents(Oscillator(np.full(48, amplitude), 2.1, 0.05, 0.7, (-1.5, 1.0)), x, v, 600, 200)
                error = growth[:, 0].std(ddof=1) / 48**0.5
                assert abs(growth[:, 0].mean() - one.exponent) < 4.0 * error + 0.02
                seen += 1
    assert seen >= 2

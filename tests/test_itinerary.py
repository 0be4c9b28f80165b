"""Itineraries: words, labels, cyclic comparison, mirror images, and impacts at the phase where periods begin."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import bisect

import jaxvibro as jv
from jaxvibro.maps.itinerary import (
    canonical_itinerary,
    format_label,
    is_same_itinerary,
    itinerary_of_impacts,
    itinerary_of_rows,
    minimal_period,
    mirror_itinerary,
)

WORDS = st.lists(st.text("LR", max_size=4), min_size=1, max_size=6).map(tuple)


def test_words_of_sides():
    sides = [[1, -1, 0, 0], [0, 0, 0, 0], [-1, -1, 1, 0]]
    assert itinerary_of_rows(np.array(sides)) == ("RL", "", "LLR")
    assert itinerary_of_rows(np.zeros((2, 0), int)) == ("", "")


def test_an_impact_at_a_periods_end_belongs_to_the_period_that_ends():
    length = 2 * np.pi / 2.1
    time = np.array([0.0, 0.3, length, np.nextafter(2 * length, 9), 2 * length + 1e-9, np.inf])
    side = np.array([-1, 1, 1, -1, 1, 0])
    assert itinerary_of_impacts(time, side, 3, length) == ("LRR", "L", "R")


@pytest.mark.parametrize(
    "words, label",
    [
        (("",), "P100"),
        (("LR",), "P111"),
        (("RLR",), "P112"),
        (("RLL",), "P121"),
        (("", "L"), "P210"),
        (("LLLLL", "LLLL"), "P290"),
        (("LLLLL", "LLLLL"), "P2-10-0"),
        (("R",) * 12, "P12-0-12"),
        (("LR",) * 8, "P888"),
        (("LRLR",) * 4 + ("",) * 12, "P16-8-8"),
    ],
)
def test_labels(words, label):
    assert format_label(words) == label


def test_least_period_and_cyclic_comparison():
    words = ("LR", "LR", "LR", "LR"), ("LR", "R", "LR", "R"), ("LR", "R", "LR"), "abcabc"
    assert [minimal_period(each) for each in words] == [1, 2, 3, 3]
    assert is_same_itinerary(("LR", "LRR"), ("LRR", "LR"))
    assert is_same_itinerary(("LR",), ("RL",))  # an impact has crossed phase 0
    assert not is_same_itinerary(("LRR",), ("LLR",))
    assert not is_same_itinerary(("LR", ""), ("LR",))  # the same walls in twice the time
    assert not is_same_itinerary(("LR", "LR"), ("LR",))
    assert not is_same_itinerary(("LLRR",), ("LRLR",))
    assert canonical_itinerary(("R", "", "LL")) == ("", "LL", "R")


@given(WORDS, st.integers(0, 5))
def test_turning_and_mirroring(words, by):
    turned = words[by % len(words) :] + words[: by % len(words)]
    assert canonical_itinerary(turned) == canonical_itinerary(words)
    assert is_same_itinerary(turned, words)
    assert format_label(turned) == format_label(words)
    assert mirror_itinerary(mirror_itinerary(words)) == words
    twin = mirror_itinerary(words)
    assert "".join(twin).count("L") == "".join(words).count("R")
    assert minimal_period(words * 3) == minimal_period(words) <= len(words)


def test_the_itinerary_of_some_periods_is_that_of_single_ones():
    scene, start = jv.make_scene(5.6, 2.1, 0.05, 0.7, (-1.0, 1.0)), jv.State(0.2, 1.0)
    _, whole = jv.strobe(scene, start, periods=3, slots=32)
    rows, state = [], start
    for _ in range(3):
        state, impacts = jv.strobe(scene, state, slots=32)
        rows.append(impacts.side)
    words = itinerary_of_impacts(whole.time, whole.side, 3, 2 * np.pi / 2.1)
    assert words == itinerary_of_rows(np.stack(rows))


def test_an_attractor_and_its_orbit_agree_beside_an_impact_at_phase_0():
    def one_wall(frequency):
        return jv.make_scene(1.0, frequency, 0.05, 0.8, (None, 0.5))

    def phase(frequency):
        impacts = jv.find_orbit(one_wall(frequency), jv.State(0.2, 0.0), periods=1).impacts
        return float(np.mod(frequency * impacts.time[0] + np.pi, 2 * np.pi) - np.pi)

    crossing = bisect(phase, 0.9, 1.3, xtol=1e-8)  # where rounding decides the period of the impact
    for off in (-1e-3, -3e-8, 3e-8, 1e-3):
        (found,) = jv.find_attractors(one_wall(crossing + off), starts=4, settle=100)
        assert (found.label, found.itinerary, found.state.phase) == ("P101", found.orbit.itinerary, 0.0)
        apart = max(abs(found.orbit.state.x - found.state.x), abs(found.orbit.state.v - found.state.v))
        assert apart < 1e-7 * (1.0 + abs(found.points).max())

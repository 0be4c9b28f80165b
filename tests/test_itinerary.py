"""Itineraries: words, labels, cyclic comparison, mirror images."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxvibro as jv
from jaxvibro.maps import itinerary

WORDS = st.lists(st.text("LR", max_size=4), min_size=1, max_size=6).map(tuple)


def test_words_of_sides():
    sides = [[1, -1, 0, 0], [0, 0, 0, 0], [-1, -1, 1, 0]]
    assert itinerary.itinerary_of_rows(np.array(sides)) == ("RL", "", "LLR")
    assert itinerary.itinerary_of_rows(np.zeros((2, 0), int)) == ("", "")


def test_an_impact_at_a_periods_end_belongs_to_the_period_that_ends():
    length = 2 * np.pi / 2.1
    time = np.array([0.0, 0.3, length, np.nextafter(2 * length, 9), 2 * length + 1e-9, np.inf])
    side = np.array([-1, 1, 1, -1, 1, 0])
    assert itinerary.itinerary_of_impacts(time, side, 3, length) == ("LRR", "L", "R")


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
    assert itinerary.format_label(words) == label


def test_least_period():
    assert itinerary.minimal_period(("LR", "LR", "LR", "LR")) == 1
    assert itinerary.minimal_period(("LR", "R", "LR", "R")) == 2
    assert itinerary.minimal_period(("LR", "R", "LR")) == 3
    assert itinerary.minimal_period("abcabc") == 3


def test_cyclic_comparison():
    assert itinerary.is_same_itinerary(("LR", "LRR"), ("LRR", "LR"))
    assert itinerary.is_same_itinerary(("LR",), ("RL",))  # an impact has crossed phase 0
    assert not itinerary.is_same_itinerary(("LRR",), ("LLR",))
    assert not itinerary.is_same_itinerary(("LR", ""), ("LR",))  # the same walls in twice the time
    assert not itinerary.is_same_itinerary(("LR", "LR"), ("LR",))
    assert not itinerary.is_same_itinerary(("LLRR",), ("LRLR",))
    assert itinerary.canonical_itinerary(("R", "", "LL")) == ("", "LL", "R")


@given(WORDS, st.integers(0, 5))
def test_turning_and_mirroring(words, by):
    turned = words[by % len(words) :] + words[: by % len(words)]
    assert itinerary.canonical_itinerary(turned) == itinerary.canonical_itinerary(words)
    assert itinerary.is_same_itinerary(turned, words)
    assert itinerary.format_label(turned) == itinerary.format_label(words)
    assert itinerary.mirror_itinerary(itinerary.mirror_itinerary(words)) == words
    twin = itinerary.mirror_itinerary(words)
    assert "".join(twin).count("L") == "".join(words).count("R")
    assert itinerary.minimal_period(words * 3) == itinerary.minimal_period(words) <= len(words)


def test_the_two_readings_of_a_strobe_agree():
    scene = jv.make_scene(amplitude=5.6, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))
    start = jv.State(x=0.2, v=1.0)
    _, whole = jv.strobe(scene, start, periods=3, slots=32)
    rows, state = [], start
    for _ in range(3):
        state, impacts = jv.strobe(scene, state, slots=32)
        rows.append(impacts.side)
    assert itinerary.itinerary_of_impacts(whole.time, whole.side, 3, 2 * np.pi / 2.1) == itinerary.itinerary_of_rows(
        np.stack(rows)
    )

"""Impacts flown to forward and backward, and clearances, against the certified strobe."""

from itertools import pairwise

import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.design.impact_chain_equations import ChainNodes
from jaxvibro.design.impact_prediction import Impact, MotionPredictor

SWINGING = jv.Wall(-0.8, 0.85, motion=jv.Motion(0.1, 1.0, harmonic=2))
SCENES = [
    jv.make_scene(1.0, 1.3, 0.05, 0.8, (jv.Wall(-1.0, 0.8), jv.Wall(1.0, 0.7))),
    jv.make_scene(1.3, 0.9, 0.1, 0.8, (SWINGING, jv.Wall(0.6, 0.6))),
    jv.make_scene(9.0, 1.1, 1.4, 0.8, (-0.9, None)),
]
MARKED = [*SCENES[:2], pytest.param(SCENES[2], marks=pytest.mark.long)]
PHASE = 0.7


def motion(scene):
    """(the nodes of forty impacts, the least clearance at a turning point)."""
    _, first = jv.strobe(scene, jv.State(0.0, 0.9, PHASE), periods=30, slots=64, clearance=True)
    assert float(first.least_speed) > 0
    sides, times, speeds = (np.asarray(one)[:40] for one in (first.side, first.time, first.speed))
    hit = sides != 0
    return ChainNodes(sides[hit].astype(float), 0 * times[hit], times[hit], speeds[hit]), float(first.least_clearance)


@pytest.mark.slow
@pytest.mark.parametrize("scene", MARKED)
def test_impacts_are_those_of_the_strobe_forward_and_backward(scene):
    nodes, _ = motion(scene)
    there = np.array([nodes.sides, nodes.time_or_x, nodes.speed_or_v]).T
    ends = [(1, there, nodes.time_or_x[-1]), (-1, there[::-1], nodes.time_or_x[0])]
    for way, expected, last in ends:
        going = MotionPredictor(scene, PHASE, way)
        for one, after in pairwise(expected):
            (found,) = going.next_impacts(Impact(*one), last + way, 1)
            grown = np.exp(2.0 * scene.damping * max(0.0, one[1] - after[1]))  # of roundings, backward
            assert np.array(found) == pytest.approx(after, abs=1e-12 * grown + 1e-11)
        assert going.next_impacts(Impact(*expected[0]), expected[1][1] - 0.01 * way, 5) == []
    assert len(MotionPredictor(scene, PHASE).next_impacts(Impact(*there[0]), there[9, 1] + 1e-6, 20)) == 9


@pytest.mark.slow
@pytest.mark.parametrize("scene", MARKED)
def test_clearance_is_that_of_the_strobe_and_below_zero_where_an_impact_was_passed_over(scene):
    nodes, clearance = motion(scene)
    short, _, _ = MotionPredictor(scene, PHASE).min_clearances(nodes)
    assert np.all(short > 0)
    assert np.min(short) >= clearance - 1e-6
    for k in (3, 8):
        without = ChainNodes(*(np.delete(one, k) for one in nodes))
        least, sides, when = MotionPredictor(scene, PHASE).min_clearances(without)
        assert least[k - 1] < -1e-3
        assert sides[k - 1] == nodes.sides[k]
        assert nodes.time_or_x[k] < when[k - 1] < nodes.time_or_x[k + 1]
        assert np.all(np.delete(least, k - 1) > 0)
